"""Prior standard deviations of the errors of images: as set, or from the stated tolerances of the stage."""

from __future__ import annotations

from dataclasses import dataclass

import xarray as xr

from scenetruth.estimators.method_settings import CorrectionPriors, RefinedSettings
from scenetruth.schema import StageTolerances, read_acquisition

__all__ = ["PosePriors", "corrects_poses", "derive_priors", "read_priors"]


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
        return read_acquisition(recording).stage.corrects
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
