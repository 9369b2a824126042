"""How much of what is seen is hidden from other cameras."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Literal

import numpy as np

from scenetruth.dataset.acceptance.base import Bound

if TYPE_CHECKING:
    from scenetruth.dataset.acceptance.look import Look

__all__ = ["OccludedShare"]


class OccludedShare(Bound):
    """Share of what the reference camera sees, at the reference frame, that is hidden from another camera, 0 to 1."""

    kind: Literal["occluded_share"] = "occluded_share"

    def measured(self, look: Look) -> Iterable[tuple[str, float]]:
        """Return the share."""
        seen = look.object_id >= 0
        yield "occluded share", float(np.mean(look.truth("occluded_in_s")[seen])) if seen.any() else 0.0
