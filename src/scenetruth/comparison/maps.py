"""Maps of a point that pictures need: the reference's image, and the errors of what is told in pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenetruth.comparison.case import Case, Found
from scenetruth.errors import StoreError
from scenetruth.placing import write_aside
from scenetruth.scoring.reading import Pairs

__all__ = ["PICTURED", "Maps", "maps_of", "read_maps", "write_maps"]

PICTURED = ("disparity", "flow_x", "flow_y")
"""Quantities whose errors are pictured, the first that a case measures."""


@dataclass(frozen=True)
class Maps:
    """What is pictured of a point.

    Parameters
    ----------
    image
        The reference camera's image at t = 0, shape (y, x).
    quantity
        Whose errors they are.
    errors
        Estimate minus truth in px by method, shape (y, x); NaN where nothing is told.
    """

    image: NDArray[np.float32]
    quantity: str
    errors: Mapping[str, NDArray[np.float32]]


def maps_of(case: Case, found: Found) -> Maps | None:
    """Return the maps of what was found with the first noise; None if a case measures nothing in pixels."""
    quantity = next((name for name in PICTURED if name in case.quantities), None)
    if quantity is None:
        return None
    errors = {}
    for label, estimate in found.estimates.items():
        pairs = Pairs(estimate, found.truth)
        if quantity in pairs:
            pair = pairs[quantity]
            with np.errstate(invalid="ignore"):
                error = pair.estimate[0] - pair.truth[0]
            errors[label] = np.where(True if pair.full is None else pair.full[0], error, np.nan).astype(np.float32)
    image = np.asarray(found.recording["image"].sel(s=0, t=0).values, dtype=np.float32)
    return Maps(image, quantity, errors)


def write_maps(maps: Maps, path: Path) -> None:
    """Write maps to a file."""
    labels = list(maps.errors)
    stack = np.stack([maps.errors[label] for label in labels]) if labels else np.zeros((0, *maps.image.shape))
    with write_aside(path, overwrite=True) as aside, aside.open("wb") as stream:
        np.savez_compressed(
            stream,
            image=maps.image.astype(np.float16),
            quantity=np.array(maps.quantity),
            labels=np.array(labels, dtype=str),
            errors=stack.astype(np.float16),
        )


def read_maps(path: Path) -> Maps | None:
    """Return the maps in a file; None if there is none.

    Raises
    ------
    StoreError
        If it is damaged.
    """
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            errors = dict(zip(map(str, stored["labels"]), stored["errors"].astype(np.float32), strict=True))
            return Maps(stored["image"].astype(np.float32), str(stored["quantity"]), errors)
    except (OSError, ValueError, KeyError) as error:
        raise StoreError(path, f"is damaged: {error}; remove it, and run the comparison again") from error
