"""How much of an object is seen."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Literal

from scenetruth.dataset.acceptance.base import ObjectBound

if TYPE_CHECKING:
    from scenetruth.dataset.acceptance.look import Look

__all__ = ["VisibleShare"]


class VisibleShare(ObjectBound):
    """Share of an object's silhouette that the reference camera sees at the reference frame, from 0 to 1.

    What other objects hide and what lies outside the image is not seen; what the object hides of itself does not count.
    """

    kind: Literal["visible_share"] = "visible_share"

    def measured(self, look: Look) -> Iterable[tuple[str, float]]:
        """Return the share of every object."""
        for number in self._matching(look):
            yield f"visible share of {look.names[number]}", look.visible_share(number)
