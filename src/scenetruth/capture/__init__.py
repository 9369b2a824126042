"""Real images: capture files, radiometry and corrections, import as recordings, boards, simulated captures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.capture.board_artwork import (
        BoardArtwork,
        BoardKind,
        BoardPrint,
        default_board,
        draw_board,
        draw_dots,
        read_board_print,
    )
    from scenetruth.capture.board_check import describe_blurred, sharpness
    from scenetruth.capture.board_rendering import (
        BoardLight,
        BoardRenderer,
        InkRenderer,
        PlacedBoard,
        open_board_renderer,
        project_points,
    )
    from scenetruth.capture.calibration import RigCalibration, calibrate
    from scenetruth.capture.calibration_errors import add_calibration_errors
    from scenetruth.capture.capture_calibration import calibrate_capture
    from scenetruth.capture.capture_check import CaptureReport, check_capture
    from scenetruth.capture.capture_file import CAPTURE_FILE, Capture, CaptureLike, load_capture
    from scenetruth.capture.capture_import import import_capture
    from scenetruth.capture.capture_run import CaptureRun, run_capture
    from scenetruth.capture.capture_template import capture_text, write_capture_file
    from scenetruth.capture.corrections import FixedPatternCorrection, PatternMatch, correct_images, undistort_images
    from scenetruth.capture.edge_response import fit_edge_exponent
    from scenetruth.capture.file_patterns import (
        FilePattern,
        GuessedPattern,
        expected_indices,
        guess_patterns,
        list_names,
        nearest_patterns,
        read_pattern,
    )
    from scenetruth.capture.folder_reading import CaptureFolder, open_capture
    from scenetruth.capture.image_reading import (
        FrameMoments,
        ImageHeader,
        PixelFormat,
        average_frames,
        frame_moments,
        read_header,
        read_pixels,
    )
    from scenetruth.capture.ingest import read_images
    from scenetruth.capture.measurement_check import compare_measurement
    from scenetruth.capture.radiometry import (
        GammaFit,
        Linearity,
        SensorNoise,
        compare_exposures,
        find_defects,
        fit_gamma,
        measure_linearity,
        measure_noise,
    )
    from scenetruth.capture.region_means import RegionMean, region_mean
    from scenetruth.capture.response_check import CaptureFinding
    from scenetruth.capture.simulated_capture import simulate_capture
    from scenetruth.capture.simulated_rig import BoardPose, CaptureSimulation
    from scenetruth.capture.twin import Comparison, RegionError, Twin, TwinPrediction, TwinRun, make_twin, run_twin

__all__ = [
    "CAPTURE_FILE", "BoardArtwork", "BoardKind", "BoardLight", "BoardPose", "BoardPrint", "BoardRenderer", "Capture",
    "CaptureFinding", "CaptureFolder", "CaptureLike", "CaptureReport", "CaptureRun", "CaptureSimulation",
    "Comparison", "FilePattern", "FixedPatternCorrection", "FrameMoments", "GammaFit", "GuessedPattern",
    "ImageHeader", "InkRenderer", "Linearity", "PatternMatch", "PixelFormat", "PlacedBoard", "RegionError",
    "RegionMean", "RigCalibration", "SensorNoise", "Twin", "TwinPrediction", "TwinRun", "add_calibration_errors",
    "average_frames", "calibrate", "calibrate_capture", "capture_text", "check_capture", "compare_exposures",
    "compare_measurement", "correct_images", "default_board", "describe_blurred", "draw_board", "draw_dots",
    "expected_indices", "find_defects", "fit_edge_exponent", "fit_gamma", "frame_moments", "guess_patterns",
    "import_capture", "list_names", "load_capture", "make_twin", "measure_linearity", "measure_noise",
    "nearest_patterns", "open_board_renderer", "open_capture", "project_points", "read_board_print", "read_header",
    "read_images", "read_pattern", "read_pixels", "region_mean", "run_capture", "run_twin", "sharpness",
    "simulate_capture", "undistort_images", "write_capture_file",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "calibration": "RigCalibration calibrate",
        "calibration_errors": "add_calibration_errors",
        "region_means": "RegionMean region_mean",
        "capture_calibration": "calibrate_capture",
        "capture_check": "CaptureReport check_capture",
        "capture_file": "CAPTURE_FILE Capture CaptureLike load_capture",
        "capture_run": "CaptureRun run_capture",
        "capture_template": "capture_text write_capture_file",
        "corrections": "FixedPatternCorrection PatternMatch correct_images undistort_images",
        "file_patterns": (
            "FilePattern GuessedPattern expected_indices guess_patterns list_names nearest_patterns read_pattern"
        ),
        "edge_response": "fit_edge_exponent",
        "measurement_check": "compare_measurement",
        "board_check": "describe_blurred sharpness",
        "capture_import": "import_capture",
        "folder_reading": "CaptureFolder open_capture",
        "image_reading": ("FrameMoments ImageHeader PixelFormat average_frames frame_moments read_header read_pixels"),
        "ingest": "read_images",
        "radiometry": (
            "GammaFit Linearity SensorNoise compare_exposures find_defects fit_gamma measure_linearity measure_noise"
        ),
        "board_artwork": "BoardArtwork BoardKind BoardPrint default_board draw_board draw_dots read_board_print",
        "board_rendering": ("BoardLight BoardRenderer InkRenderer PlacedBoard open_board_renderer project_points"),
        "response_check": "CaptureFinding",
        "simulated_capture": "simulate_capture",
        "simulated_rig": "BoardPose CaptureSimulation",
        "twin": "Comparison RegionError Twin TwinPrediction TwinRun make_twin run_twin",
    },
)
