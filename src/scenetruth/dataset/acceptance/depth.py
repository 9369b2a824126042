"""How far what is seen may be."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, ClassVar, Literal

from scenetruth.dataset.acceptance.base import ObjectBound

if TYPE_CHECKING:
    from scenetruth.dataset.acceptance.look import Look

__all__ = ["DepthRange"]


class DepthRange(ObjectBound):
    """Depth of everything that the reference camera sees of an object at the reference frame, in mm."""

    unit: ClassVar[str] = " mm"

    kind: Literal["depth"] = "depth"

    def measured(self, look: Look) -> Iterable[tuple[str, float]]:
        """Return the least and the largest depth of every object that is seen."""
        for number in self._matching(look):
            seen = look.truth("depth")[look.object_id == number]
            if seen.size:
                yield f"depth of {look.names[number]}", float(seen.min())
                yield f"depth of {look.names[number]}", float(seen.max())
