"""What a recording states of its acquisition: times of the images, and prior standard deviations of their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.estimators.method_settings import CorrectionPriors, RefinedSettings
from scenetruth.schema import StageTolerances, compute_pixel_grid, read_acquisition, read_intrinsics

__all__ = [
    "AcquisitionTimes",
    "PosePriors",
    "corrects_poses",
    "derive_priors",
    "read_priors",
    "read_schedule",
    "remove_delay_bias",
]

Map = NDArray[np.float64]

_ROUNDING = 1e-9  # frames below which a time is that of its frame


@dataclass(frozen=True, eq=False)
class AcquisitionTimes:
    """Planned times of all images, in frames."""

    times: Map
    """Times of the images of the reference camera, shape (frames,)."""
    delays: Map | None
    """Times of all images after that of the reference camera, shape (frames, cameras); None if they are equal."""
    shutter: tuple[float, float]
    """Rolling shutter: frames and stage steps from one row to the next."""

    def delays_of(self, first: int, last: int) -> Map | None:
        """Return the delays of consecutive frames."""
        return None if self.delays is None else self.delays[first:last]


def read_schedule(recording: xr.Dataset, positions: Map) -> AcquisitionTimes:
    """Read the times of a recording; the reference is the camera nearest to position 0, as of an `ImageStack`.

    ``positions``: Positions (s, s_y) of the cameras in steps, shape (cameras, 2).
    """
    acquisition, intrinsics = read_acquisition(recording), read_intrinsics(recording)
    interval = intrinsics.frame_interval_s
    times = acquisition.time_s.reshape(len(positions), -1).T / interval
    # Frames are numbered from 0 at the reference.
    own = times[:, int(np.argmin(np.abs(positions).sum(axis=1)))]
    delays = times - own[:, None]
    even = np.rint(own)
    own = np.where(np.abs(own - even) < _ROUNDING, even, own)
    row_s = acquisition.line_time_s * compute_pixel_grid(recording).step_px
    step = row_s * acquisition.stage_speed_mm_per_s / intrinsics.baseline_mm if intrinsics.baseline_mm else 0.0
    return AcquisitionTimes(
        own, delays if np.abs(delays).max(initial=0.0) > _ROUNDING else None, (row_s / interval, step)
    )


_LEAST_FACTOR = 0.5  # smallest ratio to the apparent disparity: a flow of half of it from camera to camera


def remove_delay_bias(fields: Map, positions: Map, delays: Map, focal: float, centre_x: float) -> None:
    """Correct initial fields, shape (4, y, x), for motion from camera to camera, in place.

    Cameras that are taken s τ later, in frames, show the disparity d - τ (u - x u_Z / f) in place of d, with the
    flow u = d q of the fields, which is that of the images whatever the disparity.

    ``positions``, ``delays``: Positions (s, s_y) of the cameras, and times after the reference camera.
    """
    s = positions[:, 0]
    if not s.any():
        return
    later = float(s @ delays / (s @ s))
    x = np.arange(fields.shape[-1]) - centre_x
    factor = 1.0 + later * (fields[1] - x * fields[3] / focal)
    factor = np.clip(factor, _LEAST_FACTOR, 1.0 / _LEAST_FACTOR)
    fields[0] *= factor
    fields[1:] /= factor


@dataclass(frozen=True)
class PosePriors:
    """Standard deviations of the errors of images, in the units of `warp.corrected`: px, rad and 1."""

    position: tuple[float, float, float, float]
    """Of a position, common to all visits: shifts along x and y, roll, scale."""
    visit: tuple[float, float]
    """Of a single visit: shifts along x and y."""


def corrects_poses(recording: xr.Dataset, settings: RefinedSettings) -> bool:
    """Return whether the images of a recording are corrected."""
    if settings.pose_corrections == "auto":
        sizes = recording["image"].sizes
        # A single position is never left.
        return sizes["s"] * sizes.get("s_y", 1) > 1 and read_acquisition(recording).stage.corrects
    return isinstance(settings.pose_corrections, CorrectionPriors)


def read_priors(
    recording: xr.Dataset, settings: RefinedSettings, focal: float, px_per_mm: float, step_px: float
) -> PosePriors | None:
    """Return the priors of a recording, None if its images are not corrected.

    ``focal``: Focal length in columns. ``px_per_mm``: f / Z of the surface, in columns. ``step_px``: Pixels per column.
    """
    if not corrects_poses(recording, settings):
        return None
    given = settings.pose_corrections
    if isinstance(given, CorrectionPriors):
        entries = given.in_columns(step_px)
        fixed = (entries.x_px, entries.y_px, 1e-6 * entries.roll_urad, 1e-6 * entries.scale_ppm)
        return PosePriors(fixed, (entries.repeatability_px, entries.repeatability_px))
    return derive_priors(read_acquisition(recording).stage, focal, px_per_mm)


def derive_priors(stage: StageTolerances, focal: float, px_per_mm: float) -> PosePriors:
    """Return the priors of a stage: angles shift the image by f, displacements by f / Z."""
    per_um = 1e-3 * px_per_mm
    along = (1e-6 * focal * stage.yaw_urad, per_um * stage.accuracy_um)
    across = (1e-6 * focal * stage.pitch_urad, per_um * stage.straightness_um)
    # A displacement along Z enlarges the image by δZ / Z.
    scale = per_um * stage.straightness_um / focal
    # Approaches from either side miss a position by half the backlash.
    visit = (per_um * stage.repeatability_um, 0.5 * per_um * stage.backlash_um)
    position = (_root(along), _root(across), 1e-6 * stage.roll_urad, scale)
    return PosePriors(position, (_root(visit), 0.0))


def _root(parts: tuple[float, float]) -> float:
    return float((parts[0] ** 2 + parts[1] ** 2) ** 0.5)
