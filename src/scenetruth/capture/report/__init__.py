"""Report of a capture: sources of the error, suggestions, figures of calibration and noise, and the page."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.capture.report.calibration_figures import CalibrationData, draw_calibration
    from scenetruth.capture.report.capture_page import CaptureResults, write_capture_page
    from scenetruth.capture.report.error_budget import BudgetPart, DepthBudget, depth_budget, depth_grid
    from scenetruth.capture.report.noise_figures import draw_noise, noise_words
    from scenetruth.capture.report.suggestions import (
        BoardCoverage,
        PoseEffect,
        Suggestion,
        assess_poses,
        cover,
        place_targets,
        suggest,
    )

__all__ = [
    "BoardCoverage", "BudgetPart", "CalibrationData", "CaptureResults", "DepthBudget", "PoseEffect", "Suggestion",
    "assess_poses", "cover", "depth_budget", "depth_grid", "draw_calibration", "draw_noise", "noise_words",
    "place_targets", "suggest", "write_capture_page",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "calibration_figures": "CalibrationData draw_calibration",
        "capture_page": "CaptureResults write_capture_page",
        "error_budget": "BudgetPart DepthBudget depth_budget depth_grid",
        "noise_figures": "draw_noise noise_words",
        "suggestions": "BoardCoverage PoseEffect Suggestion assess_poses cover place_targets suggest",
    },
)
