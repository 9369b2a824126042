"""Pose errors that no recording states: their size from the images, and what they add to the standard deviations."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import EstimateWarning
from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.refined.acquisition import PosePriors
from scenetruth.estimators.refined.fit_maps import extract_fields
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.initialisation import fill_gaps
from scenetruth.estimators.refined.iterations import RefinedState
from scenetruth.estimators.refined.noise_estimation import spline_transfer
from scenetruth.estimators.refined.pose_corrections import (
    CorrectionUncertainty,
    Elimination,
    PoseCorrections,
    ShiftObservations,
    compute_correction_uncertainty,
    select_blocks,
)
from scenetruth.estimators.refined.row_bands import bands
from scenetruth.schema.variables import MOTION_ACCELERATED_IN_PART

__all__ = ["PoseErrors", "estimate_pose_errors", "warn_of_pose_errors"]

Map = NDArray[np.float64]

# Blocks with a residual above this multiple of the median do not move as a point.
_OUTLIER, _PASSES, _STEPS = 4.0, 3, 20
# Twice the gain in log-likelihood above which errors are significant: χ² of five variances at 1e-4 is 26, with a margin
# for residuals that are not independent from block to block.
_SIGNIFICANT = 50.0
_START_PX = 0.1
_SINGULAR, _FINEST_PX = 1e-8, 1e-5  # eigenvalues are relative; no displacement is more accurate
# Ratio of variances, and displacement in px, above which errors matter: curved and aliased surfaces with exact poses
# reach 4e-3 px.
_RELEVANT, _LEAST_PX = 0.2, 5e-3


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of the images, estimated from the part that surface and motion do not explain."""

    shift_px: float
    """Standard deviation of the shifts of positions along x and y, in columns."""
    visit_px: float
    """Standard deviation of the shifts of single visits."""
    rooted: Map
    """L of the covariance L Lᵀ of the errors of all images, shape (4 n, any)."""
    relevant: bool
    """Whether they exceed those of exact poses, and standard deviations become larger by a tenth or more."""

    @property
    def turned_px(self) -> tuple[float, float]:
        """Standard deviations of the shifts of positions along x and y, which may be rotations, in columns."""
        return self.shift_px, self.shift_px

    def effect(self, images: ImageStack, fields: Map) -> CorrectionUncertainty:
        """Return their effect on disparity and velocity, as that of uncertain corrections."""
        return compute_correction_uncertainty(images.view(), fields, self.rooted)


def estimate_pose_errors(fitted: RefinedState, settings: RefinedSettings) -> PoseErrors | None:
    """Return the errors of the images around a fit with exact poses, None if they are not significant.

    The variances of shifts, rolls and scales of positions and of the shifts of visits maximise the likelihood of the
    shifts of blocks (EM algorithm). Shifts along x and y have one variance: those along x that are proportional to s
    look like disparity, those along y do not.
    """
    images, theta = fitted.images, fitted.fit.theta
    # Where the fit takes fewer frames, it does not predict the others.
    valid = np.isfinite(theta).all(axis=0) & (fitted.motion != MOTION_ACCELERATED_IN_PART)
    if not valid.any():
        return None
    fields = extract_fields(theta)
    if len(images.positions) < 2 or images.count < len(images.positions) * len(images.times):
        return None
    shifts = ShiftObservations.blank(images.shape, images.count)
    gains = settings.photometric_model == "per_image"
    seen_at = np.where(valid, fields, np.nan)
    # Every other row is enough for shifts of whole blocks.
    seen_at[:, 1::2] = np.nan
    for _ in bands(images, seen_at, settings.window_sigma_px, gains=gains, shifts=shifts):
        pass
    blocks = select_blocks(shifts, fill_gaps(fields[:4], valid))
    if not len(blocks.shift) or not blocks.noise > 0:
        return None
    parts, group = _parts_of(images)
    elimination = Elimination(blocks, images.view())
    kept, excess = np.ones(len(blocks.shift)), 1.0
    variance: Map = np.full(group.max() + 1, _START_PX**2)
    gain, seen = 0.0, np.zeros(len(variance))
    for _ in range(_PASSES):
        equations = elimination.equations(kept)
        noise = excess * (blocks.noise / spline_transfer(images.spline)) ** 2
        noise = max(noise, _FINEST_PX**2 * float(np.diag(parts.T @ equations.matrix @ parts).max()))
        matrix, side = _determined(parts.T @ equations.matrix @ parts / noise, parts.T @ equations.side / noise)
        variance, unknown, gain, seen = maximise_likelihood(matrix, side, group, variance)
        if gain < _SIGNIFICANT:
            return None
        left = elimination.misfit((parts @ unknown).reshape(-1, 4))
        kept = (left < _OUTLIER * float(np.median(left))).astype(np.float64)
        excess = max(1.0, float(left[kept > 0].mean())) if kept.any() else 1.0
    # Few errors are seen: the next is distributed as t with as many degrees of freedom, of variance n / (n - 2).
    freedom = np.maximum(seen, 3.0)
    variance = variance * freedom / (freedom - 2.0)
    rooted = parts * np.sqrt(variance[group])
    added = compute_correction_uncertainty(images.view(), fill_gaps(fields[:4], valid), rooted).variance[:, valid]
    own = fitted.fit.variance[[0, 3, 4, 5]][:, valid] / spline_transfer(images.spline) ** 2
    shift, visit = float(np.sqrt(variance[0])), float(np.sqrt(variance[3:].max(initial=0.0)))
    relevant = bool((np.median(added, axis=1) > _RELEVANT * np.median(own, axis=1)).any())
    return PoseErrors(shift, visit, rooted, relevant and max(shift, visit) > _LEAST_PX)


def _parts_of(images: ImageStack) -> tuple[Map, NDArray[np.intp]]:
    """Return the errors of images by unknowns, shape (4 n, u), and the group of unknowns with one variance of each."""
    arm = max(images.shape) / 2
    groups: list[PosePriors] = [
        PosePriors((1.0, 1.0, 0.0, 0.0), (0.0, 0.0)),
        PosePriors((0.0, 0.0, 1.0 / arm, 0.0), (0.0, 0.0)),
        PosePriors((0.0, 0.0, 0.0, 1.0 / arm), (0.0, 0.0)),
    ]
    if len(images.times) > 1:
        groups += [PosePriors((0.0,) * 4, (1.0, 0.0)), PosePriors((0.0,) * 4, (0.0, 1.0))]
    parts = [PoseCorrections(priors, images).parts for priors in groups]
    return np.concatenate(parts, axis=1), np.repeat(np.arange(len(parts)), [part.shape[1] for part in parts])


def _determined(matrix: Map, side: Map) -> tuple[Map, Map]:
    """Return normal equations without the directions that are not determined, of which rounding errors remain."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    kept = vectors[:, values > _SINGULAR * values[-1]]
    return kept @ (kept.T @ matrix @ kept) @ kept.T, kept @ (kept.T @ side)


def maximise_likelihood(matrix: Map, side: Map, group: NDArray[np.intp], variance: Map) -> tuple[Map, Map, float, Map]:
    """Return variances of groups of unknowns, unknowns, twice the gain in log-likelihood, and unknowns determined.

    ``matrix``, ``side``: Normal equations of the unknowns, in units of the noise. ``variance``: Initial variances.
    """
    count = len(variance)
    sizes = np.bincount(group, minlength=count)
    unknown, spread, determined = np.zeros(len(group)), np.ones(len(group)), np.zeros(len(group))
    values: Map = np.zeros(len(group))
    for _ in range(_STEPS):
        root = np.sqrt(variance[group])
        values, vectors = np.linalg.eigh(root[:, None] * matrix * root)
        # Rounding errors may leave small negative values.
        values = np.maximum(values, 0.0)
        turned = root[:, None] * vectors
        unknown = turned @ ((turned.T @ side) / (values + 1.0))
        spread = (turned**2 / (values + 1.0)).sum(axis=1)
        before, variance = variance, np.bincount(group, unknown**2 + spread, count) / sizes
        determined = 1.0 - spread / before[group]
    seen = np.bincount(group, determined, count).astype(np.float64)
    return variance, unknown, float(side @ unknown - np.log1p(values).sum()), seen


# Frames of the call stack up to the caller of `scenetruth.estimate`, to whose line the warning refers.
_CALLER = 7


def warn_of_pose_errors(found: Sequence[PoseErrors | None], step_px: float) -> None:
    """Warn of errors of the images that a recording does not state, of all frames."""
    errors = [each for each in found if each is not None and each.relevant]
    if not errors:
        return
    shift, visit = (step_px * max(values) for values in zip(*((e.shift_px, e.visit_px) for e in errors), strict=True))
    message = (
        f"images: are displaced against each other by about {shift:.2g} px from position to position and {visit:.2g} "
        "px from image to image, which steady motion seen from the stated positions does not explain; standard "
        "deviations are larger by what this adds; state the errors of the stage (attributes stage_tolerance_*), or set "
        "pose_corrections"
    )
    warnings.warn(message, EstimateWarning, stacklevel=_CALLER)
