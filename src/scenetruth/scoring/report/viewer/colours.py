"""Colour maps for the viewer, as matplotlib has them: evenly spaced to the eye, and readable without red and green."""

from __future__ import annotations

import base64
from collections.abc import Mapping

import numpy as np

__all__ = ["COLOUR_MAPS", "colour_tables"]

COLOUR_MAPS: Mapping[str, str] = {
    "viridis": "viridis",
    "cividis": "cividis",
    "magma": "magma",
    "grey": "gray",
    "blue-white-red": "RdBu_r",
    "blue-dark-red": "berlin",
}
"""What the page calls them, and what matplotlib does; the last two are for values about zero."""

_INSTEAD = {"berlin": "PuOr_r"}
"""What older releases of matplotlib have in place of new ones."""


def colour_tables() -> dict[str, str]:
    """Return 256 colours of each of `COLOUR_MAPS`, three bytes each, in base 64."""
    from matplotlib import colormaps

    tables = {}
    for name, theirs in COLOUR_MAPS.items():
        chosen = colormaps[theirs if theirs in colormaps else _INSTEAD[theirs]]
        colours = np.rint(255 * chosen(np.arange(256) / 255)[:, :3]).astype(np.uint8)
        tables[name] = base64.b64encode(colours.tobytes()).decode("ascii")
    return tables
