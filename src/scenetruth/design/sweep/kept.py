"""Errors at some pixels of every simulation, from which the scatter between seeds follows."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import StoreError
from scenetruth.placing import write_aside
from scenetruth.plain import parse_json
from scenetruth.scoring import QUANTITIES
from scenetruth.scoring.reading import Pair

__all__ = ["Kept", "errors_of", "every_px", "read_kept", "write_kept"]

_PIXELS = 10_000
"""Pixels of an image that are kept: errors of neighbours are alike over a window's width, so that more tell no more."""

_REGION, _ERROR = "region", "error"
Map = NDArray[np.float32]


def every_px(dataset: xr.Dataset) -> int:
    """Return the distance of the rows and columns that are kept."""
    return max(1, math.ceil(math.sqrt(dataset.sizes["y"] * dataset.sizes["x"] / _PIXELS)))


@dataclass(frozen=True)
class Kept:
    """Errors of a simulation at some pixels.

    Parameters
    ----------
    regions
        Where regions lie at these pixels, by method and region.
    errors
        Estimate minus truth by method and quantity, shape (t, y, x); NaN where nothing is told.
    """

    regions: Mapping[tuple[str, str], NDArray[np.bool_]]
    errors: Mapping[tuple[str, str], Map]


def errors_of(pairs: Mapping[str, Pair], step_px: int) -> dict[str, Map]:
    """Return the errors of all scalars in every so many rows and columns."""
    found = {}
    for name, pair in pairs.items():
        if QUANTITIES[name].error != "difference":
            continue
        with np.errstate(over="ignore", invalid="ignore"):
            error = (pair.estimate - pair.truth)[..., ::step_px, ::step_px]
        known = np.isfinite(error)
        if pair.full is not None:
            known &= pair.full[..., ::step_px, ::step_px]
        found[name] = np.where(known, error, np.nan).astype(np.float32)
    return found


def write_kept(kept: Kept, path: Path) -> None:
    """Write errors to a file."""
    arrays: dict[str, Any] = {json.dumps([_REGION, *names]): mask for names, mask in kept.regions.items()}
    arrays |= {json.dumps([_ERROR, *names]): errors for names, errors in kept.errors.items()}
    # Names of methods may hold anything; those of arrays in a file may not.
    numbered: dict[str, Any] = {f"a{number}": array for number, array in enumerate(arrays.values())}
    with write_aside(path, overwrite=True) as aside, aside.open("wb") as stream:
        np.savez_compressed(stream, names=np.array(list(arrays), dtype=str), **numbered)


def read_kept(path: Path) -> Kept:
    """Return what a file holds.

    Raises
    ------
    StoreError
        If it is not there, or damaged.
    """
    regions: dict[tuple[str, str], Any] = {}
    errors: dict[tuple[str, str], Any] = {}
    try:
        with np.load(path, allow_pickle=False) as stored:
            for number, name in enumerate(map(str, stored["names"])):
                kind, method, what = parse_json(name)
                (regions if kind == _REGION else errors)[method, what] = stored[f"a{number}"]
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise StoreError(path, f"is damaged: {error}; remove it, and run the sweep again") from error
    return Kept(regions, errors)
