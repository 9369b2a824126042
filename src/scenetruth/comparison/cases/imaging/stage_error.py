"""Errors where positions of the stage are missed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenetruth.comparison.case import Case
from scenetruth.comparison.sheet import sheet


class StageError(Case):
    """Positions that are missed by chance, at every visit anew."""

    kind = "stage_error"
    title = "Error of the stage"
    question = "What do missed positions cost?"
    varied = "repeatability of the stage, px in the image"
    core = (0.1,)
    full = (0.0, 0.03, 0.1, 0.3)

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet seen from such a stage; 1 px is 1 mm here."""
        return sheet({"stage.errors.repeatability_um": 1000 * value})
