"""How fast what is seen moves in the image."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from scenetruth.dataset.acceptance.base import ObjectBound

if TYPE_CHECKING:
    from scenetruth.dataset.acceptance.look import Look

__all__ = ["ImageMotion"]


class ImageMotion(ObjectBound):
    """Largest motion in the image of what is seen of an object at the reference frame, px per frame."""

    unit: ClassVar[str] = " px per frame"

    kind: Literal["image_motion"] = "image_motion"

    def measured(self, look: Look) -> Iterable[tuple[str, float]]:
        """Return the length of the fastest flow of every object that is seen."""
        speed = np.hypot(*look.truth("flow")) * look.scale
        for number in self._matching(look):
            seen = speed[look.object_id == number]
            if seen.size:
                yield f"image motion of {look.names[number]}", float(seen.max())
