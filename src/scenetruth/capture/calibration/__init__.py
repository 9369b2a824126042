"""Calibration of a camera on its stage with boards and strips: detection, bundle adjustment, covariance."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.capture.calibration.boards import Board, CharucoBoard, Checkerboard, DotGrid
    from scenetruth.capture.calibration.bundle_adjustment import RigFit, ViewResidual, adjust
    from scenetruth.capture.calibration.corner_detection import Detection, charuco_board, detect_board
    from scenetruth.capture.calibration.corner_refinement import (
        RefinedPoints,
        disc_bias,
        estimate_noise,
        refine_points,
    )
    from scenetruth.capture.calibration.measurement_covariance import (
        CommonError,
        RigGeometry,
        common_error,
        triangulate,
    )
    from scenetruth.capture.calibration.rig_model import (
        CalibrationTarget,
        Observations,
        RigGuess,
        RigLayout,
        RigPriors,
        RigState,
        TargetView,
        project,
        rotation_matrix,
    )
    from scenetruth.capture.calibration.start_values import start_state

__all__ = [
    "Board", "CalibrationTarget", "CharucoBoard", "Checkerboard", "CommonError", "Detection", "DotGrid", "Observations",
    "RefinedPoints", "RigFit", "RigGeometry", "RigGuess", "RigLayout", "RigPriors", "RigState", "TargetView",
    "ViewResidual", "adjust", "charuco_board", "common_error", "detect_board", "disc_bias", "estimate_noise", "project",
    "refine_points", "rotation_matrix", "start_state", "triangulate",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "boards": "Board CharucoBoard Checkerboard DotGrid",
        "corner_detection": "Detection charuco_board detect_board",
        "corner_refinement": "RefinedPoints disc_bias estimate_noise refine_points",
        "bundle_adjustment": "RigFit ViewResidual adjust",
        "measurement_covariance": "CommonError RigGeometry common_error triangulate",
        "rig_model": (
            "CalibrationTarget Observations RigGuess RigLayout RigPriors RigState TargetView project rotation_matrix"
        ),
        "start_values": "start_state",
    },
)
