"""How much disparity remains after registration."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from scenetruth.dataset.acceptance.base import Bound

if TYPE_CHECKING:
    from scenetruth.dataset.acceptance.look import Look

__all__ = ["ResidualDisparity"]


class ResidualDisparity(Bound):
    """Largest disparity that remains after registration by the whole number nearest to the mean, px per step."""

    unit: ClassVar[str] = " px per step"

    kind: Literal["residual_disparity"] = "residual_disparity"

    def measured(self, look: Look) -> Iterable[tuple[str, float]]:
        """Return the largest absolute value over all that is seen."""
        disparity = look.truth("disparity")[look.object_id >= 0] * look.scale
        yield "residual disparity", float(np.abs(disparity - np.round(disparity.mean())).max(initial=0.0))
