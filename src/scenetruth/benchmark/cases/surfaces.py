"""Cases that vary the surface: slope, curvature, discontinuities, sinusoids, growth."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.benchmark.cases.case import BenchmarkRecord, Case, CaseEstimates, Mask, mask_interior
from scenetruth.benchmark.cases.reference_scene import DISTANCE_MM, build_reference_scene, build_wall
from scenetruth.benchmark.error_statistics import compute_growth_records
from scenetruth.benchmark.spatial_resolution import compute_amplitude_records, compute_cutoff_records

__all__ = ["GrowthIntervalCase"]


class CurvatureCase(Case):
    """Upright cylinders with decreasing radius."""

    kind = "curvature"
    title = "Curvature"
    question = "How does surface curvature affect the accuracy?"
    varied = "curvature, 1/m"
    core = (20.0,)
    full = (2.0, 5.0, 10.0, 20.0, 40.0)
    logarithmic = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return a cylinder whose nearest line is at the distance of the plane, in front of a background."""
        radius = 1000.0 / value
        round_one = build_wall("cylinder")
        # Its axis, Z of the mesh, is rotated upright.
        round_one["mesh"] = {"kind": "cylinder", "radius_mm": radius, "length_mm": 240, "resolution_mm": 2.0}
        round_one["pose"] = {
            "position_mm": [0.0, 0.0, DISTANCE_MM + radius],
            "rotations": [{"axis": [1, 0, 0], "angle_deg": 90}],
        }
        behind = build_wall("behind", distance_mm=DISTANCE_MM + 2.5 * radius, size_mm=(1200, 900))
        return build_reference_scene({"objects": [round_one, behind]}, baseline_mm=12.3)


_STEP_WIDTH_PX = 1.0
"""Width of the evaluated range of distances."""


class DepthDiscontinuityCase(Case):
    """A plane with a vertical edge in front of another; pixels by distance from the edge."""

    kind = "edge_of_depth"
    title = "Depth discontinuity"
    question = "How close to a depth discontinuity is the estimate accurate?"
    varied = "distance from the discontinuity, px"
    core = (1.5, 4.5, 9.5)
    full = (0.5, 1.5, 2.5, 3.5, 4.5, 6.5, 9.5, 14.5)
    margin_px = 22.0
    one_scene = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return two planes with a depth difference of a sixth of the distance, moving in opposite directions."""
        near = build_wall("near", distance_mm=640.0, size_mm=(60, 300), velocity=(0.3, -0.2, 0.1))
        far = build_wall("far", distance_mm=760.0, size_mm=(320, 240), velocity=(-0.2, 0.3, 0.0))
        return build_reference_scene({"objects": [near, far]}, baseline_mm=8.3)

    def region_at(self, truth: xr.Dataset, value: float) -> Mask:
        """Return the pixels at a distance from the discontinuity."""
        off = np.abs(truth["boundary_distance"].values - value)
        return np.asarray(
            np.isfinite(truth["depth"].values) & mask_interior(truth, self.margin_px) & (off <= _STEP_WIDTH_PX)
        )


def build_growing_scene(rate_per_hour: float, interval_min: float) -> Mapping[str, Any]:
    """Return the growing plane, rotated by 20 degrees."""
    return build_reference_scene(
        {
            "frames.frame_interval_s": 60 * interval_min,
            "objects.0.motion": [],
            "objects.0.mesh.resolution_mm": 2.0,
            "objects.0.pose.rotations": [{"axis": [0, 1, 0], "angle_deg": 20}],
            "objects.0.deformation": [{"kind": "growth", "rate_per_hour": rate_per_hour, "along_share": 0.5}],
        },
        baseline_mm=12.3,
    )


class GrowthIntervalCase(Case):
    """A plane growing at 3 %/h, with increasing frame intervals."""

    kind = "growth"
    title = "Growth by frame interval"
    question = "How accurate is the growth rate over 20 px, by frame interval?"
    varied = "interval between frames, minutes"
    core = (2.0, 15.0)
    full = (1.0, 2.0, 5.0, 10.0, 15.0, 30.0)
    headline = ("growth_rate_windowed", "rmse")
    logarithmic = True
    quantities = ("velocity_z", "flow_x")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the plane growing at 3 %/h."""
        return build_growing_scene(0.03, value)

    def further_rows(self, found: CaseEstimates) -> Iterable[BenchmarkRecord]:
        """Return the errors of windowed growth in %/h."""
        return compute_growth_records(self, found)


class OcclusionCase(Case):
    """Bars in front of a plane; pixels that are visible in all images, or occluded in some."""

    kind = "occlusion"
    title = "Occlusion"
    question = "Are points estimated that are occluded in some of the images?"
    varied = "images in which the point is visible"
    core = (0.0, 1.0)
    margin_px = 22.0
    one_scene = True

    def labels(self) -> Mapping[float, str]:
        """Return the names of both levels."""
        return {0.0: "some", 1.0: "all"}

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return three vertical bars in front of a plane."""
        bars = [
            build_wall(f"bar-{n}", distance_mm=600.0, size_mm=(12, 260), centre_mm=(x, 0.0), velocity=(0.2, 0.0, 0.0))
            for n, x in enumerate((-40.0, 0.0, 40.0))
        ]
        return build_reference_scene(
            {"objects": [build_wall(distance_mm=760.0, size_mm=(320, 240)), *bars]}, baseline_mm=8.3
        )

    def region_at(self, truth: xr.Dataset, value: float) -> Mask:
        """Return the pixels of the plane that are visible in all images, or occluded in some."""
        there = (
            np.isfinite(truth["depth"].values) & (truth["object_id"].values == 0) & mask_interior(truth, self.margin_px)
        )
        # Pixels at a silhouette show both surfaces.
        there &= truth["boundary_distance"].values >= 1.5
        return np.asarray(there & (truth["seen_throughout"].values == bool(value)))


_INTERVAL_MIN = 10.0


class GrowthRateCase(Case):
    """A plane with increasing growth rate, recorded every ten minutes."""

    kind = "rate_of_growth"
    title = "Growth by growth rate"
    question = "How accurate is the growth rate over 20 px, by growth rate?"
    varied = "areal growth rate with a frame every 10 minutes, %/h"
    full = (0.0, 1.0, 3.0, 10.0, 30.0)
    headline = ("growth_rate_windowed", "rmse")
    quantities = ("velocity_z", "flow_x")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the plane growing at this rate."""
        return build_growing_scene(value / 100, _INTERVAL_MIN)

    def further_rows(self, found: CaseEstimates) -> Iterable[BenchmarkRecord]:
        """Return the errors of windowed growth in %/h."""
        return compute_growth_records(self, found)


class SlopeCase(Case):
    """A plane rotated about the vertical axis."""

    kind = "slope"
    title = "Slope"
    question = "How does surface slope affect the accuracy?"
    varied = "angle to the image plane, degrees"
    core = (30.0, 60.0)
    full = (0.0, 15.0, 30.0, 45.0, 60.0, 70.0)

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the rotated plane, large enough to fill the image."""
        turned = build_wall(size_mm=(700, 260))
        turned["pose"]["rotations"] = [{"axis": [0, 1, 0], "angle_deg": value}]
        return build_reference_scene({"objects": [turned]}, baseline_mm=12.3)


_STAR_WIDTH_PX, _STAR_HEIGHT_PX = 384, 96
_MESH_MM = (_STAR_WIDTH_PX + 80.0, _STAR_HEIGHT_PX + 80.0)
_PERIODS_MM = (120.0, 4.0)
"""Period at the left and at the right edge: it decreases by 1 px per 4 px, from 110 px to 14 px in the image."""
_BELOW_PX = 12.0
"""Offset of the star's centre line from the image centre, because accuracy may be better on the optical axis."""
_WITHIN = 0.1
"""Relative tolerance of the local period of a column."""


class StarPatternCase(Case):
    """A plane with a cosine displacement along Y whose period decreases from left to right; its centre is evaluated."""

    kind = "star"
    title = "Star pattern"
    question = "Down to which period is the displacement along the centre line of a star attenuated by at most 10 %?"
    varied = "period of the displacement, px"
    core = (20.0, 26.0, 32.0, 40.0, 48.0, 60.0, 72.0, 96.0)
    headline = ("flow_y", "cutoff_period_first")
    logarithmic = True
    quantities = ("flow_y", "velocity_y")
    one_scene = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the star, with a displacement amplitude of 0.2 px/frame."""
        star = build_wall(size_mm=_MESH_MM, centre_mm=(0.0, _BELOW_PX))
        star["mesh"]["resolution_mm"] = 1.0
        star["motion"] = []
        amplitude = {"kind": "linear", "rate_per_frame": 0.2}
        star["deformation"] = [{"kind": "star", "amplitude_mm": amplitude, "period_mm": list(_PERIODS_MM)}]
        return build_reference_scene(
            {"camera.width": _STAR_WIDTH_PX, "camera.height": _STAR_HEIGHT_PX, "stage.positions": 3, "objects": [star]},
        )

    def noise_std(self, value: float) -> float:
        """Return 0, because attenuation is not a noise effect."""
        return 0.0

    def region_at(self, truth: xr.Dataset, value: float) -> Mask:
        """Return the pixels of nearly this period within an eighth of it from the star's centre line."""
        y, x = np.mgrid[: truth.sizes["y"], : truth.sizes["x"]]
        # 1 px corresponds to 1 mm.
        along = (x - (truth.sizes["x"] - 1) / 2) / _MESH_MM[0] + 0.5
        period = _PERIODS_MM[0] + along * (_PERIODS_MM[1] - _PERIODS_MM[0])
        near = np.abs(period - value) <= _WITHIN * value
        middle = np.abs(y - (truth.sizes["y"] - 1) / 2 - _BELOW_PX) <= value / 8
        return np.asarray(np.isfinite(truth["depth"].values) & mask_interior(truth, self.margin_px) & near & middle)

    def further_rows(self, found: CaseEstimates) -> Iterable[BenchmarkRecord]:
        """Return the amplitude ratio of the displacement."""
        return compute_amplitude_records(self, found, "flow_y", of_mean=True)

    def conclusions(self, rows: Sequence[BenchmarkRecord]) -> Iterable[BenchmarkRecord]:
        """Return the cut-off periods at an amplitude ratio of 0.9."""
        return compute_cutoff_records(self, rows, "flow_y")


class MotionDiscontinuityCase(Case):
    """Two coplanar planes with a common edge, moving in opposite directions along it."""

    kind = "step_of_motion"
    title = "Motion discontinuity"
    question = "How close to a velocity discontinuity is the estimate accurate?"
    varied = "distance from the discontinuity, px"
    core = (1.5, 4.5, 9.5)
    full = (0.5, 1.5, 2.5, 3.5, 4.5, 6.5, 9.5, 14.5)
    margin_px = 18.0
    quantities = ("velocity_y", "flow_y")
    headline = ("flow_y", "rmse")
    one_scene = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the planes, side by side."""
        left = build_wall("left", size_mm=(130, 260), centre_mm=(-65.0, 0.0), velocity=(0.0, 0.4, 0.0))
        right = build_wall("right", size_mm=(130, 260), centre_mm=(65.0, 0.0), velocity=(0.0, -0.4, 0.0))
        return build_reference_scene({"objects": [left, right]})

    def region_at(self, truth: xr.Dataset, value: float) -> Mask:
        """Return the pixels at a distance from the discontinuity."""
        off = np.abs(truth["boundary_distance"].values - value)
        return np.asarray(np.isfinite(truth["depth"].values) & mask_interior(truth, self.margin_px) & (off <= 1.0))


_STEEPNESS = 1 / 15
"""Amplitude over period; slopes are below 23 degrees."""


class DepthResolutionCase(Case):
    """A sinusoidal relief with decreasing period."""

    kind = "waves_of_depth"
    title = "Depth resolution"
    question = "Down to which period is a relief attenuated by at most 10 %?"
    varied = "period of the relief, px"
    core = (20.0, 32.0, 48.0, 96.0)
    full = (16.0, 20.0, 26.0, 32.0, 40.0, 48.0, 60.0, 72.0, 96.0)
    headline = ("depth", "cutoff_period_first")
    logarithmic = True
    quantities = ("depth", "disparity")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the relief with waves along Y, which all cameras along X see equally."""
        relief = {
            "kind": "relief",
            "size_mm": [240, 200],
            "amplitude_mm": _STEEPNESS * value,
            "wavelength_mm": [None, value],
            "resolution_mm": 1.0,
        }
        # The scene is static: more frames would be identical.
        changes = {"objects.0.mesh": relief, "objects.0.motion": [], "frames.count": 3}
        return build_reference_scene(changes, baseline_mm=12.3)

    def noise_std(self, value: float) -> float:
        """Return 0, because attenuation is not a noise effect."""
        return 0.0

    def further_rows(self, found: CaseEstimates) -> Iterable[BenchmarkRecord]:
        """Return the amplitude ratio of the relief."""
        return compute_amplitude_records(self, found, "depth")

    def conclusions(self, rows: Sequence[BenchmarkRecord]) -> Iterable[BenchmarkRecord]:
        """Return the cut-off periods at an amplitude ratio of 0.9."""
        return compute_cutoff_records(self, rows, "depth")


class DisplacementResolutionCase(Case):
    """A plane with a sinusoidal displacement field."""

    kind = "waves_of_motion"
    title = "Displacement resolution"
    question = "Down to which period is a displacement attenuated by at most 10 %?"
    varied = "period of the displacement, px"
    core = (32.0, 48.0, 96.0)
    full = (16.0, 20.0, 26.0, 32.0, 40.0, 48.0, 60.0, 72.0, 96.0)
    headline = ("flow_y", "cutoff_period_first")
    logarithmic = True
    quantities = ("flow_y", "velocity_y")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the plane with a displacement amplitude of 0.2 px/frame."""
        wave = {"kind": "star", "amplitude_mm": {"kind": "linear", "rate_per_frame": 0.2}, "period_mm": [value, value]}
        changes = {"objects.0.motion": [], "objects.0.mesh.resolution_mm": 1.0, "objects.0.deformation": [wave]}
        return build_reference_scene(changes)

    def noise_std(self, value: float) -> float:
        """Return 0, because attenuation is not a noise effect."""
        return 0.0

    def further_rows(self, found: CaseEstimates) -> Iterable[BenchmarkRecord]:
        """Return the amplitude ratio of the displacement."""
        return compute_amplitude_records(self, found, "flow_y")

    def conclusions(self, rows: Sequence[BenchmarkRecord]) -> Iterable[BenchmarkRecord]:
        """Return the cut-off periods at an amplitude ratio of 0.9."""
        return compute_cutoff_records(self, rows, "flow_y")
