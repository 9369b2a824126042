"""Simulated twins of a measurement: scene of the same rig, and the errors that it predicts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.capture.twin.measured_motion import MeasuredMotion, fit_motion
    from scenetruth.capture.twin.measured_surface import (
        Canvas,
        GridMesh,
        SurfacePart,
        find_parts,
        mesh_part,
        smooth_map,
    )
    from scenetruth.capture.twin.prediction import (
        Comparison,
        RegionError,
        TwinPrediction,
        mark_bends,
        predict_errors,
        sampling_std,
    )
    from scenetruth.capture.twin.surface_texture import (
        ImageMean,
        ImageSet,
        NoiseLine,
        average_images,
        fit_noise_line,
        make_texture,
    )
    from scenetruth.capture.twin.twin_rig import SensorModel, TwinRig, describe_sensor, make_rig
    from scenetruth.capture.twin.twin_run import TwinRun, run_twin
    from scenetruth.capture.twin.twin_scene import Twin, make_twin, open_run

__all__ = [
    "Canvas", "Comparison", "GridMesh", "ImageMean", "ImageSet", "MeasuredMotion", "NoiseLine", "RegionError",
    "SensorModel", "SurfacePart", "Twin", "TwinPrediction", "TwinRig", "TwinRun", "average_images", "describe_sensor",
    "find_parts", "fit_motion", "fit_noise_line", "make_rig", "make_texture", "make_twin", "mark_bends", "mesh_part",
    "open_run", "predict_errors", "run_twin", "sampling_std", "smooth_map",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "measured_motion": "MeasuredMotion fit_motion",
        "measured_surface": "Canvas GridMesh SurfacePart find_parts mesh_part smooth_map",
        "prediction": "Comparison RegionError TwinPrediction mark_bends predict_errors sampling_std",
        "surface_texture": "ImageMean ImageSet NoiseLine average_images fit_noise_line make_texture",
        "twin_rig": "SensorModel TwinRig describe_sensor make_rig",
        "twin_run": "TwinRun run_twin",
        "twin_scene": "Twin make_twin open_run",
    },
)
