"""Errors where images are blurred, as out of focus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenetruth.comparison.case import Case
from scenetruth.comparison.sheet import sheet


class Blur(Case):
    """The same sheet, less and less sharp."""

    kind = "blur"
    title = "Defocus"
    question = "How sharp must images be?"
    varied = "standard deviation of the point spread, px"
    core = (1.0,)
    full = (0.5, 1.0, 2.0, 3.0, 4.0)
    bounded = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet behind such a lens."""
        return sheet({"optics.psf": {"kind": "gaussian", "sigma_px": value}})
