"""Errors over the contrast of the texture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenetruth.comparison.case import Case
from scenetruth.comparison.sheet import sheet


class Contrast(Case):
    """A sheet whose texture fades."""

    kind = "contrast"
    title = "Contrast"
    question = "How faint may a texture be, and is that known?"
    varied = "rms contrast of the texture"
    core = (0.03, 0.2)
    full = (0.003, 0.006, 0.01, 0.03, 0.06, 0.1, 0.2, 0.3)
    logarithmic = True
    bounded = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet with this contrast."""
        return sheet({"objects.0.texture.rms_contrast": value})
