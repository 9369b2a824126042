"""Exact maps of what the camera sees: a geometry pass of its own at pixel centres, in float64."""

from scenetruth.truth.assembly import TruthPoses, TruthViews, make_truth, truth_of_world
from scenetruth.truth.following import PixelPoints, follow_points
from scenetruth.truth.interior import interior_warnings
from scenetruth.truth.maps import GeometryPass, TruthMaps, truth_maps
from scenetruth.truth.rolling import truth_by_rows
from scenetruth.truth.tracks import track_points
from scenetruth.truth.visibility import SurfacePoints, points_seen

__all__ = [
    "GeometryPass",
    "PixelPoints",
    "SurfacePoints",
    "TruthMaps",
    "TruthPoses",
    "TruthViews",
    "follow_points",
    "interior_warnings",
    "make_truth",
    "points_seen",
    "track_points",
    "truth_by_rows",
    "truth_maps",
    "truth_of_world",
]
