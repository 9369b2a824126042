"""Ground truth: exact maps at pixel centres, computed from the geometry in float64."""

from scenetruth.truth.geometry_maps import Geometries, GeometryPass, LightProvider, TruthMaps, truth_by_rows, truth_maps
from scenetruth.truth.point_tracking import (
    PixelPoints,
    PointTracker,
    SurfacePoints,
    compile_visibility,
    find_visible_points,
    track_points,
)
from scenetruth.truth.truth_dataset import (
    TruthOptions,
    TruthPoses,
    TruthTasks,
    TruthViews,
    announce_truth,
    count_tasks_at_once,
    fill_truth,
    interior_warnings,
    memory_for,
    outline_truth,
    refuse_arguments,
    truth_from_world,
)

__all__ = [
    "Geometries", "GeometryPass", "LightProvider", "PixelPoints", "PointTracker", "SurfacePoints", "TruthMaps",
    "TruthOptions", "TruthPoses", "TruthTasks", "TruthViews", "announce_truth", "compile_visibility",
    "count_tasks_at_once", "fill_truth", "find_visible_points", "interior_warnings", "memory_for", "outline_truth",
    "refuse_arguments", "track_points", "truth_by_rows", "truth_from_world", "truth_maps",
]  # fmt: skip
