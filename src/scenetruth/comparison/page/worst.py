"""The worst places of each method: where the fewest pixels are good, as pictures."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from scenetruth.comparison.maps import PICTURED, Maps
from scenetruth.comparison.measures.figures import GOOD_PX
from scenetruth.comparison.result import Comparison
from scenetruth.comparison.rows import ALL

__all__ = ["Worst", "scale_words", "worst_places"]

_MOST = 3
_SCALE_PX = 0.5
"""Errors that are drawn in full colour."""


@dataclass(frozen=True)
class Worst:
    """A picture of where a method is at its worst.

    Parameters
    ----------
    method
        Its label.
    title
        Which case and value.
    alt
        What the picture shows, in words.
    picture
        A PNG, in base64.
    """

    method: str
    title: str
    alt: str
    picture: str


def worst_places(found: Comparison, maps: Mapping[tuple[str, float], Maps]) -> list[Worst]:
    """Return pictures of the values at which each method has the fewest good pixels, at most one of each case.

    Parameters
    ----------
    found
        The comparison.
    maps
        What is pictured, by case and value.
    """
    titles = {case.kind: case for case in found.cases}
    pictures = []
    for label in found.methods:
        shares = sorted(
            (
                (row.number, row.case, row.value, row.quantity)
                for row in found.rows
                if row.method == label and row.pixels == ALL and row.statistic == "good" and row.quantity in PICTURED
            ),
        )
        seen: set[str] = set()
        for share, kind, value, quantity in shares:
            case = titles[kind]
            one = maps.get((kind, value))
            if kind in seen or len(seen) == _MOST or share > _FINE:
                continue
            if one is None or one.quantity != quantity or label not in one.errors:
                continue
            seen.add(kind)
            good = f"{100 * share:.0f} % of {quantity} within {GOOD_PX:g} px"
            title = f"{case.title}, {case.varied} = {case.label_of(value)}: {good}"
            words = f"Image of the reference camera beside the errors of {one.quantity} by {label}; {title}."
            pictures.append(Worst(label, title, words, _drawn(one, label)))
    return pictures


_FINE = 0.95
"""Where more pixels are good, nothing is worth a picture."""


def _drawn(maps: Maps, label: str) -> str:
    """Draw image and errors side by side; grey is what is not told."""
    from matplotlib import colormaps
    from PIL import Image

    image = maps.image
    low, high = np.percentile(image, [0.5, 99.5])
    grey = np.clip((image - low) / max(float(high - low), 1e-9), 0, 1)
    shown = np.repeat(grey[..., None], 3, axis=-1)
    error = maps.errors[label]
    colours = colormaps["RdBu_r"](np.clip(np.nan_to_num(error) / (2 * _SCALE_PX) + 0.5, 0, 1))[..., :3]
    colours[~np.isfinite(error)] = 0.6
    both = np.concatenate([shown, np.ones((len(image), 6, 3)), colours], axis=1)
    picture = Image.fromarray((255 * both).astype(np.uint8)).resize((2 * both.shape[1], 2 * both.shape[0]), 0)
    stream = io.BytesIO()
    picture.save(stream, "PNG", optimize=True)
    return base64.b64encode(stream.getvalue()).decode("ascii")


def scale_words() -> Sequence[str]:
    """Return what the colours mean, in words."""
    return (
        f"blue is {-_SCALE_PX:g} px and less",
        "white is right",
        f"red is {_SCALE_PX:g} px and more",
        "grey is not told",
    )
