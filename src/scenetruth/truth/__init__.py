"""Exact maps of what the camera sees: a geometry pass of its own at pixel centres, in float64."""

from scenetruth.truth.assembly import (
    TruthChoice,
    TruthPoses,
    TruthViews,
    blank_truth,
    fill_truth,
    make_truth,
    refuse_arguments,
    truth_of_world,
)
from scenetruth.truth.following import Follower, PixelPoints, compile_visibility
from scenetruth.truth.interior import interior_warnings
from scenetruth.truth.maps import Geometries, GeometryPass, TruthMaps, truth_maps
from scenetruth.truth.rolling import truth_by_rows
from scenetruth.truth.tracks import track_points
from scenetruth.truth.visibility import SurfacePoints, points_seen

__all__ = [
    "Follower",
    "Geometries",
    "GeometryPass",
    "PixelPoints",
    "SurfacePoints",
    "TruthChoice",
    "TruthMaps",
    "TruthPoses",
    "TruthViews",
    "blank_truth",
    "compile_visibility",
    "fill_truth",
    "interior_warnings",
    "make_truth",
    "points_seen",
    "refuse_arguments",
    "track_points",
    "truth_by_rows",
    "truth_maps",
    "truth_of_world",
]
