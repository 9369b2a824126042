"""Plane sweep: disparity by semi-global matching of all cameras, and scene flow by random search."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.estimators.plane_sweep.cost_volume import choose_hypotheses, make_camera_row, spread_hypotheses
    from scenetruth.estimators.plane_sweep.disparity_sweep import sweep_disparity
    from scenetruth.estimators.plane_sweep.motion_search import MotionResult, sweep_motion

__all__ = [
    "MotionResult", "choose_hypotheses", "make_camera_row", "spread_hypotheses", "sweep_disparity", "sweep_motion",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "cost_volume": "choose_hypotheses make_camera_row spread_hypotheses",
        "disparity_sweep": "sweep_disparity",
        "motion_search": "MotionResult sweep_motion",
    },
)
