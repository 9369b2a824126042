"""Calibration of a camera on its stage with boards and strips: detection, bundle adjustment, covariance."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.capture.calibration.added_poses import advise_pose
    from scenetruth.capture.calibration.boards import Board, CharucoBoard, Checkerboard, DotGrid
    from scenetruth.capture.calibration.bundle_adjustment import PoseScatter, RigFit, ViewResidual, adjust
    from scenetruth.capture.calibration.calibration_result import RigCalibration
    from scenetruth.capture.calibration.corner_detection import Detection, charuco_board, detect_board
    from scenetruth.capture.calibration.corner_refinement import (
        RefinedPoints,
        disc_bias,
        estimate_gain_spread,
        estimate_noise,
        refine_points,
    )
    from scenetruth.capture.calibration.diagnostics import (
        Combination,
        HalvesTest,
        ModelTest,
        ScaleTest,
        apparent_steps,
        check_models,
        check_scale,
        compare_halves,
        diagnose,
        field_of_residuals,
        identify_combinations,
        inconsistent_images,
        pose_of_change,
        refit,
        step_problems,
    )
    from scenetruth.capture.calibration.foreign_calibrations import (
        export_calibration,
        import_calibration,
        import_camera,
    )
    from scenetruth.capture.calibration.measurement_covariance import (
        CommonError,
        MeasurementSlopes,
        Moment,
        RigGeometry,
        common_error,
        moving_point_modes,
        point_modes,
        triangulate,
    )
    from scenetruth.capture.calibration.rig_calibration import (
        BoardImage,
        RigSolution,
        calibrate,
        describe_fit,
        fit_rig,
        observe_boards,
    )
    from scenetruth.capture.calibration.rig_model import (
        CalibrationError,
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
    from scenetruth.capture.calibration.start_values import start_state, with_other_tilts
    from scenetruth.capture.calibration.strip_detection import observe_strip
    from scenetruth.capture.calibration.variance_components import (
        VarianceComponents,
        estimate_components,
        places_of_points,
        scatter_of_poses,
    )

__all__ = [
    "Board", "BoardImage", "CalibrationError", "CalibrationTarget", "CharucoBoard", "Checkerboard", "Combination",
    "CommonError", "Detection", "DotGrid", "HalvesTest", "MeasurementSlopes", "ModelTest", "Moment", "Observations",
    "PoseScatter", "RefinedPoints", "RigCalibration", "RigFit", "RigGeometry", "RigGuess", "RigLayout", "RigPriors",
    "RigSolution", "RigState", "ScaleTest", "TargetView", "VarianceComponents", "ViewResidual", "adjust", "advise_pose",
    "apparent_steps", "calibrate", "charuco_board", "check_models", "check_scale", "common_error", "compare_halves",
    "describe_fit", "detect_board", "diagnose", "disc_bias", "estimate_components", "estimate_gain_spread",
    "estimate_noise", "export_calibration", "field_of_residuals", "fit_rig", "identify_combinations",
    "import_calibration", "import_camera", "inconsistent_images", "moving_point_modes", "observe_boards",
    "observe_strip", "places_of_points", "point_modes", "pose_of_change", "project", "refine_points", "refit",
    "rotation_matrix", "scatter_of_poses", "start_state", "step_problems", "triangulate", "with_other_tilts",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "added_poses": "advise_pose",
        "boards": "Board CharucoBoard Checkerboard DotGrid",
        "bundle_adjustment": "PoseScatter RigFit ViewResidual adjust",
        "calibration_result": "RigCalibration",
        "corner_detection": "Detection charuco_board detect_board",
        "corner_refinement": "RefinedPoints disc_bias estimate_gain_spread estimate_noise refine_points",
        "diagnostics": (
            "Combination HalvesTest ModelTest ScaleTest apparent_steps compare_halves diagnose "
            "field_of_residuals identify_combinations inconsistent_images pose_of_change refit step_problems "
            "check_models check_scale"
        ),
        "foreign_calibrations": "export_calibration import_calibration import_camera",
        "measurement_covariance": (
            "CommonError MeasurementSlopes Moment RigGeometry common_error moving_point_modes point_modes triangulate"
        ),
        "rig_calibration": "BoardImage RigSolution calibrate describe_fit fit_rig observe_boards",
        "rig_model": (
            "CalibrationError CalibrationTarget Observations RigGuess RigLayout RigPriors RigState TargetView project "
            "rotation_matrix"
        ),
        "start_values": "start_state with_other_tilts",
        "strip_detection": "observe_strip",
        "variance_components": "VarianceComponents estimate_components places_of_points scatter_of_poses",
    },
)
