"""How fine textures are in the image."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, ClassVar, Literal

from scenetruth.dataset.acceptance.base import ObjectBound

if TYPE_CHECKING:
    from scenetruth.dataset.acceptance.look import Look

__all__ = ["Wavelength"]


class Wavelength(ObjectBound):
    """Shortest and longest wavelength of an object's texture in the image, px, where it is farthest and nearest."""

    unit: ClassVar[str] = " px"

    kind: Literal["wavelength"] = "wavelength"

    def measured(self, look: Look) -> Iterable[tuple[str, float]]:
        """Return both ends for every object that is seen and whose texture has them; foreshortening does not count."""
        for number in self._matching(look):
            ends, seen = look.wavelengths_mm(number), look.truth("depth")[look.object_id == number]
            if ends is not None and seen.size:
                focal = look.scene.camera.focal_px
                yield f"wavelength of {look.names[number]}", ends[0] * focal / float(seen.max())
                yield f"wavelength of {look.names[number]}", ends[1] * focal / float(seen.min())
