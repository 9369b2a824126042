"""Simulated twins of a measurement: scene of the same rig, and the errors that it predicts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.capture.twin.prediction import Comparison, RegionError, TwinPrediction
    from scenetruth.capture.twin.twin_run import TwinRun, run_twin
    from scenetruth.capture.twin.twin_scene import Twin, make_twin

__all__ = ["Comparison", "RegionError", "Twin", "TwinPrediction", "TwinRun", "make_twin", "run_twin"]

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "prediction": "Comparison RegionError TwinPrediction",
        "twin_run": "TwinRun run_twin",
        "twin_scene": "Twin make_twin",
    },
)
