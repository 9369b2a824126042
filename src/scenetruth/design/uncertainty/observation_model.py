"""Observation model of a scene for error propagation: noise-free images, exact surface, and errors of growth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.bound.surface_geometry import (
    ImagePosition,
    ReferencePoints,
    compute_reference_points,
    label_surface_segments,
)
from scenetruth.camera import Schedule
from scenetruth.scene import Scene
from scenetruth.schema import Intrinsics, read_intrinsics
from scenetruth.scoring import compute_growth_rate

__all__ = [
    "Disturbance",
    "ImageDisturbance",
    "Map",
    "Mask",
    "ObservationModel",
    "build_observation_model",
    "compute_growth_error",
    "displace_camera",
    "disturb_poses",
    "shift_in_time",
]


Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


class ImageDisturbance(NamedTuple):
    """Displacement in px of the reference points in an image, and change of grey values relative to full scale."""

    x: Map | float = 0.0
    y: Map | float = 0.0
    grey: Map | float = 0.0


Disturbance = Callable[[int, int], ImageDisturbance | None]
"""Disturbance of the image of camera s at frame t; None for no effect."""


@dataclass(frozen=True, eq=False)
class ObservationModel:
    """A scene without the errors under investigation, at the reference camera and frame."""

    scene: Scene  # with all its errors
    recording: xr.Dataset  # images without errors, and ``radiance``, the input of the sensor
    truth: xr.Dataset  # at t = 0, of one camera
    points: ReferencePoints
    texture: Map  # reference image, relative to full scale
    intrinsics: Intrinsics
    known: Mask  # mask of the valid depth and motion estimates for these images

    @property
    def s(self) -> list[int]:
        """Camera indices; 0 is the reference."""
        return [int(one) for one in self.recording["s"].values]

    @property
    def t(self) -> list[int]:
        """Frame indices; 0 is the reference."""
        return [int(one) for one in self.recording["t"].values]

    @property
    def depth(self) -> Map:
        """Depth Z in mm, shape (y, x); NaN where there is no surface."""
        return np.asarray(self.truth["depth"].values, dtype=np.float64)

    @property
    def velocity(self) -> Map:
        """U_X, U_Y, U_Z in mm per frame, shape (3, y, x)."""
        return np.asarray(self.truth["velocity"].values, dtype=np.float64)

    @property
    def flow(self) -> Map:
        """Optical flow in px per frame, shape (2, y, x)."""
        return np.asarray(self.truth["flow"].values, dtype=np.float64)

    def steps(self, s: int) -> float:
        """Return the position of a camera in baselines."""
        return float(self.recording["stage_x_mm"].sel(s=s)) / self.intrinsics.baseline_mm

    def place(self, s: int, t: float) -> ImagePosition:
        """Return the image positions of the points for camera s at time t in frames."""
        return self.points.place(self.steps(s), 0.0, t)

    def fetched(self, image: Map, s: int, t: int) -> Map:
        """Return the values of an image (y, x) of camera s at frame t at the points, by nearest neighbour."""
        place = self.place(s, t)
        height, width = image.shape
        column = np.rint(place.x - self.points.x[0, 0])
        row = np.rint(place.y - self.points.y[0, 0])
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        at = tuple(np.where(inside, part, 0).astype(np.int64) for part in (row, column))
        return np.where(inside, image[at], 0.0)


def build_observation_model(scene: Scene, recording: xr.Dataset, truth: xr.Dataset, known: Mask) -> ObservationModel:
    """Return the observation model, given the mask (y, x) of valid depth and motion estimates."""
    now = truth.drop_vars([name for name in ("visible", "view_count") if name in truth]).sel(t=0)
    intrinsics = read_intrinsics(recording)
    texture = recording["image"].sel(s=0, t=0).values.astype(np.float64) / float(recording.attrs["full_scale"])
    return ObservationModel(
        scene,
        recording,
        now,
        compute_reference_points(now, intrinsics, label_surface_segments(now)),
        texture,
        intrinsics,
        known,
    )


def shift_in_time(sight: ObservationModel, s: int, t: float, later: Map | float) -> ImageDisturbance:
    """Return the effect on an image of showing its points at a later time than planned."""
    planned = sight.place(s, t)
    time = np.asarray(t + np.asarray(later, dtype=np.float64))
    # Each point has its own time.
    real = sight.points.place(np.asarray(sight.steps(s)), np.asarray(0.0), time)
    return ImageDisturbance(real.x - planned.x, real.y - planned.y)


def displace_camera(
    sight: ObservationModel, s: int, t: float, off_mm: NDArray[np.float64], turn_rad: NDArray[np.float64]
) -> ImageDisturbance:
    """Return the first-order effect on an image of an error in camera position and orientation."""
    focal = sight.intrinsics.focal_length_px
    place = sight.place(s, t)
    depth = focal * sight.intrinsics.baseline_mm / (sight.points.d * place.scale)
    x, y = place.x / focal, place.y / focal
    # In camera coordinates, the point P is at P - C - ω x P.
    along = -off_mm[0] / depth - (turn_rad[1] - turn_rad[2] * y)
    down = -off_mm[1] / depth - (turn_rad[2] * x - turn_rad[0])
    ahead = -off_mm[2] / depth - (turn_rad[0] * y - turn_rad[1] * x)
    return ImageDisturbance(focal * (along - x * ahead), focal * (down - y * ahead))


def disturb_poses(schedule: Schedule, sight: ObservationModel) -> Disturbance:
    """Return the effect of all errors of a stage on the images: position, orientation and time."""

    def change(s: int, t: int) -> ImageDisturbance:
        real, planned = schedule.moment(s, t), schedule.nominal(s, t)
        off = real.viewpoint.position_mm - planned.viewpoint.position_mm
        by_pose = displace_camera(sight, s, t, off, real.rotation_rad)
        by_time = shift_in_time(sight, s, t, real.t - planned.t)
        return ImageDisturbance(np.asarray(by_pose.x + by_time.x), np.asarray(by_pose.y + by_time.y))

    return change


def compute_growth_error(
    sight: ObservationModel, errors: Mapping[str, Map], intrinsics: Intrinsics | None = None
) -> Map:
    """Return the error of the growth rate in the windows used for scoring, per frame."""
    right = _maps(sight, {}, sight.intrinsics)
    wrong = _maps(sight, errors, intrinsics or sight.intrinsics)
    return np.asarray((compute_growth_rate(wrong) - compute_growth_rate(right)).values[0])


def _maps(sight: ObservationModel, errors: Mapping[str, Map], intrinsics: Intrinsics) -> xr.Dataset:
    truth = sight.truth.expand_dims("t")
    known = sight.known & np.isfinite(sum(errors.values(), np.zeros_like(sight.depth)))
    depth = np.where(known, sight.depth + errors.get("depth", 0.0), np.nan)
    parts = [sight.velocity[k] + errors.get(f"velocity_{axis}", 0.0) for k, axis in enumerate("xyz")]
    velocity = np.where(known, np.stack(parts), np.nan)
    found = truth[["depth", "velocity"]].transpose("component", "t", "y", "x").copy()
    found["depth"] = (("t", "y", "x"), depth[None])
    found["velocity"] = (("component", "t", "y", "x"), velocity[:, None])
    # Windows do not cross object boundaries, as in scoring.
    found["object_id"] = (("t", "y", "x"), sight.truth["object_id"].values[None])
    found.attrs = {**truth.attrs, **intrinsics.to_attrs()}
    return found
