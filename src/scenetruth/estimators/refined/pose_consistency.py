"""Pose errors that no recording states, or that exceed what it states: their size from the images, and their effect."""

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
from scenetruth.estimators.refined.pose_corrections import (
    Blocks,
    CorrectionUncertainty,
    Elimination,
    Equations,
    PoseCorrections,
    ShiftObservations,
    compute_correction_uncertainty,
    join_blocks,
    select_blocks,
)
from scenetruth.estimators.refined.row_bands import bands
from scenetruth.number_format import format_two_digits
from scenetruth.schema.variables import MOTION_ACCELERATED_IN_PART

__all__ = ["PoseErrors", "compare_with_stated", "estimate_pose_errors", "observe_blocks", "warn_of_pose_errors"]

Map = NDArray[np.float64]

# Blocks with a residual above this multiple of the median do not move as a point.
_OUTLIER, _PASSES, _STEPS = 4.0, 3, 20
# Twice the gain in log-likelihood above which errors are significant: χ² of five variances at 1e-4 is 26, with a margin
# for residuals that are not independent from block to block.
_SIGNIFICANT = 50.0
# The same for the shifts of visits that are not stated, one variance, and for all deviations from stated errors.
_SIGNIFICANT_VISITS, _CONTRADICTED = 20.0, 30.0
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
    turned_px: tuple[float, float]
    """Standard deviations of the shifts of positions along x and y, which may be rotations, in columns."""
    excess: float | None = None
    """Ratio of the errors of positions to those that the recording states, None if it states none."""

    def effect(self, images: ImageStack, fields: Map) -> CorrectionUncertainty:
        """Return their effect on disparity and velocity, as that of uncertain corrections."""
        return compute_correction_uncertainty(images.view(), fields, self.rooted)


def estimate_pose_errors(regions: Sequence[RefinedState], settings: RefinedSettings) -> PoseErrors | None:
    """Return the errors of the images around fits with exact poses, None if they are not significant.

    The fits are of a whole image, or of several regions of it.

    The variances of shifts, rolls and scales of positions and of the shifts of visits maximise the likelihood of the
    shifts of blocks (EM algorithm). Shifts along x and y have one variance: those along x that are proportional to s
    look like disparity, those along y do not.
    """
    observed = _observe(regions, settings)
    if observed is None:
        return None
    images, blocks, elimination = observed.images, observed.blocks, observed.elimination
    poses, of_poses = _parts_of(images)
    common = _parts_of_view(images)
    # Unsteady motion of the whole view displaces all cameras of a frame alike.
    parts, own = np.concatenate([poses, common], axis=1), poses.shape[1]
    group = np.concatenate([of_poses, np.full(common.shape[1], of_poses.max() + 1)]).astype(np.intp)
    kept, excess = np.ones(len(blocks.shift)), 1.0
    variance: Map = np.full(group.max() + 1, _START_PX**2)
    gain, seen = 0.0, np.zeros(len(variance))
    for _ in range(_PASSES):
        equations = elimination.equations(kept)
        noise = _noise_of(observed, parts, equations, excess)
        matrix, side = _determined(parts.T @ equations.matrix @ parts / noise, parts.T @ equations.side / noise)
        variance, unknown, gain, seen = maximise_likelihood(matrix, side, group, variance)
        if common.shape[1]:
            alone = np.full(1, _START_PX**2)
            of_common = np.zeros(common.shape[1], dtype=np.intp)
            gain -= maximise_likelihood(matrix[own:, own:], side[own:], of_common, alone)[2]
        if gain < _SIGNIFICANT:
            return None
        left = elimination.misfit((parts @ unknown).reshape(-1, 4))
        kept = (left < _OUTLIER * float(np.median(left))).astype(np.float64)
        excess = max(1.0, float(left[kept > 0].mean())) if kept.any() else 1.0
    # Few errors are seen: the next is distributed as t with as many degrees of freedom, of variance n / (n - 2).
    freedom = np.maximum(seen, 3.0)
    variance = variance * freedom / (freedom - 2.0)
    rooted = poses * np.sqrt(variance[of_poses])
    added = observed.effect(rooted)
    shift, visit = float(np.sqrt(variance[0])), float(np.sqrt(variance[3 : of_poses.max() + 1].max(initial=0.0)))
    relevant = bool((added > _RELEVANT * observed.own()).any()) and max(shift, visit) > _LEAST_PX
    return PoseErrors(shift, visit, rooted, relevant, (shift, shift))


def compare_with_stated(
    regions: Sequence[RefinedState], corrections: PoseCorrections | None, settings: RefinedSettings
) -> PoseErrors | None:
    """Return the remaining errors of corrected images, larger where the images contradict the stated errors.

    The variances of shifts, rolls and scales of positions and of the shifts of visits, relative to those that are
    stated, and that of additional shifts of visits along x and y, maximise the likelihood of the shifts of blocks.
    Stated variances are multiplied by these ratios where they exceed 1 (as by the ratio of R. T. Birge, 1932), because
    what images do not determine probably is as large as what they do. None if nothing is corrected or observed.
    """
    observed = None if corrections is None else _observe(regions, settings)
    if corrections is None or observed is None:
        return None
    images, blocks, elimination = observed.images, observed.blocks, observed.elimination
    stated, kinds = corrections.parts, corrections.kinds
    used, group = np.unique(kinds, return_inverse=True)
    fresh = PoseCorrections(PosePriors((0.0,) * 4, (1.0, 1.0)), images).parts
    parts, count = np.concatenate([stated, fresh], axis=1), len(used)
    every = np.concatenate([group, np.full(fresh.shape[1], count)]).astype(np.intp)
    current, own = corrections.values.ravel(), stated.shape[1]
    kept, excess = np.ones(len(blocks.shift)), 1.0
    variance: Map = np.append(np.ones(count), _START_PX**2)
    matrix, gains, seen = np.eye(own), (0.0, 0.0, 0.0), np.zeros(count + 1)
    for _ in range(_PASSES):
        equations = elimination.equations(kept)
        noise = _noise_of(observed, parts, equations, excess)
        # Of all errors, also those that are corrected.
        whole, side = (
            parts.T @ equations.matrix @ parts / noise,
            parts.T @ (equations.side + equations.matrix @ current) / noise,
        )
        matrix = whole[:own, :own]
        least = _likelihood(*_determined(matrix, side[:own]), np.ones(own))
        _, _, without, _ = maximise_likelihood(*_determined(matrix, side[:own]), group, np.ones(count))
        variance, unknown, gain, seen = maximise_likelihood(*_determined(whole, side), every, variance)
        gains = least, without, gain
        left = elimination.misfit((parts @ unknown - current).reshape(-1, 4))
        kept = (left < _OUTLIER * float(np.median(left))).astype(np.float64)
        excess = max(1.0, float(left[kept > 0].mean())) if kept.any() else 1.0
    least, without, gain = gains
    ratio = np.maximum(variance[:count], 1.0)
    scaled = stated * np.sqrt(ratio[group])
    root = np.sqrt(ratio[group])
    covariance = np.linalg.inv(root[:, None] * matrix * root + np.eye(own))
    rooted = scaled @ np.linalg.cholesky((covariance + covariance.T) / 2)
    visit = 0.0
    if gain - without > _SIGNIFICANT_VISITS:
        # These are not corrected.
        freedom = max(float(seen[count]), 3.0)
        visit = float(np.sqrt(variance[count] * freedom / (freedom - 2.0)))
        rooted = np.concatenate([rooted, fresh * visit], axis=1)
    turned = corrections.turned_px
    of_shift = float(np.sqrt(ratio[0])) if used[0] == 0 else 1.0
    before, after = observed.effect(corrections.rooted) + observed.own(), observed.effect(rooted) + observed.own()
    relevant = max(gain, without) - least > _CONTRADICTED and bool((after > (1.0 + _RELEVANT) * before).any())
    return PoseErrors(
        of_shift * max(turned),
        visit,
        rooted,
        relevant,
        (of_shift * turned[0], of_shift * turned[1]),
        float(np.sqrt(ratio.max(initial=1.0))),
    )


def observe_blocks(fitted: RefinedState, settings: RefinedSettings) -> Blocks | None:
    """Return the shifts of blocks of the images around a fit, None if there are none."""
    images, valid = fitted.images, _find_predicted(fitted)
    if not valid.any():
        return None
    fields = extract_fields(fitted.fit.theta)
    shifts = ShiftObservations.blank(images.shape, len(images.times) * len(images.positions))
    gains = settings.photometric_model == "per_image"
    seen_at = np.where(valid, fields, np.nan)
    # Every other row is enough for shifts of whole blocks.
    seen_at[:, 1::2] = np.nan
    for _ in bands(images, seen_at, settings.window_sigma_px, gains=gains, shifts=shifts):
        pass
    blocks = select_blocks(shifts, fill_gaps(fields[:4], valid))
    return blocks if len(blocks.shift) and blocks.noise > 0 else None


def _find_predicted(fitted: RefinedState) -> NDArray[np.bool_]:
    """Return the pixels whose fit predicts all images: where it takes fewer frames, it does not."""
    return np.asarray(np.isfinite(fitted.fit.theta).all(axis=0) & (fitted.motion != MOTION_ACCELERATED_IN_PART))


@dataclass(frozen=True, eq=False)
class _Observed:
    """Shifts of blocks around fits of a whole image, or of several regions of it."""

    fits: list[RefinedState]
    blocks: Blocks
    elimination: Elimination

    @property
    def images(self) -> ImageStack:
        """Images of the first fit; they have the same poses in all."""
        return self.fits[0].images

    def own(self) -> Map:
        """Return the median variances of disparity and velocity, without errors of poses, shape (4,)."""
        parts = [each.fit.variance[[0, 3, 4, 5]][:, _find_predicted(each)] for each in self.fits]
        scale = self.images.transfer**2
        return np.asarray(np.median(np.concatenate(parts, axis=1), axis=1) / scale)

    def effect(self, rooted: Map) -> Map:
        """Return the median variances of disparity and velocity due to errors of poses, shape (4,)."""
        parts = []
        for each in self.fits:
            valid = _find_predicted(each)
            finite = fill_gaps(extract_fields(each.fit.theta)[:4], valid)
            parts.append(compute_correction_uncertainty(each.images.view(), finite, rooted).variance[:, valid])
        return np.asarray(np.median(np.concatenate(parts, axis=1), axis=1))


def _observe(regions: Sequence[RefinedState], settings: RefinedSettings) -> _Observed | None:
    images = regions[0].images
    if len(images.positions) < 2 or images.count < len(images.positions) * len(images.times):
        return None
    observed = [(observe_blocks(fitted, settings), fitted) for fitted in regions]
    found = [(blocks, fitted) for blocks, fitted in observed if blocks is not None]
    if not found:
        return None
    blocks = join_blocks([(each, fitted.images) for each, fitted in found])
    return _Observed([fitted for _, fitted in found], blocks, Elimination(blocks, images.whole_view()))


def _noise_of(observed: _Observed, parts: Map, equations: Equations, excess: float) -> float:
    """Return the variance of the image noise, at least that of the finest displacement."""
    noise = excess * (observed.blocks.noise / observed.images.transfer) ** 2
    return max(noise, _FINEST_PX**2 * float(np.diag(parts.T @ equations.matrix @ parts).max()))


def _parts_of(images: ImageStack) -> tuple[Map, NDArray[np.intp]]:
    """Return the errors of images by unknowns, shape (4 n, u), and the group of unknowns with one variance of each."""
    arm = max(images.whole_shape) / 2
    groups: list[PosePriors] = [
        PosePriors((1.0, 1.0, 0.0, 0.0), (0.0, 0.0)),
        PosePriors((0.0, 0.0, 1.0 / arm, 0.0), (0.0, 0.0)),
        PosePriors((0.0, 0.0, 0.0, 1.0 / arm), (0.0, 0.0)),
    ]
    if len(images.times) > 1:
        groups += [PosePriors((0.0,) * 4, (1.0, 0.0)), PosePriors((0.0,) * 4, (0.0, 1.0))]
    parts = [PoseCorrections(priors, images).parts for priors in groups]
    return np.concatenate(parts, axis=1), np.repeat(np.arange(len(parts)), [part.shape[1] for part in parts])


def _parts_of_view(images: ImageStack) -> Map:
    """Return displacements that all cameras of a frame have in common, shape (4 n, u): shifts, scale, disparity."""
    view = images.view()
    columns = []
    for t in np.unique(images.times[images.times != 0.0]):
        at = np.repeat(images.times == t, len(images.positions)).astype(np.float64)
        nil = np.zeros_like(at)
        columns += [np.stack([at, nil, nil, nil], axis=-1), np.stack([nil, at, nil, nil], axis=-1)]
        columns += [np.stack([nil, nil, nil, at / (max(images.whole_shape) / 2)], axis=-1)]
        columns += [np.stack([at * view.s, at * view.s_y, nil, nil], axis=-1)]
    return np.stack([each.ravel() for each in columns], axis=-1) if columns else np.zeros((4 * images.count, 0))


def _determined(matrix: Map, side: Map) -> tuple[Map, Map]:
    """Return normal equations without the directions that are not determined, of which rounding errors remain."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    kept = vectors[:, values > _SINGULAR * values[-1]]
    return kept @ (kept.T @ matrix @ kept) @ kept.T, kept @ (kept.T @ side)


def _likelihood(matrix: Map, side: Map, variance: Map) -> float:
    """Return twice the gain in log-likelihood by unknowns of given variances."""
    root = np.sqrt(variance)
    values, vectors = np.linalg.eigh(root[:, None] * matrix * root)
    values = np.maximum(values, 0.0)
    turned = vectors.T @ (root * side)
    return float((turned**2 / (values + 1.0)).sum() - np.log1p(values).sum())


def maximise_likelihood(matrix: Map, side: Map, group: NDArray[np.intp], variance: Map) -> tuple[Map, Map, float, Map]:
    """Return variances of groups of unknowns, unknowns, twice the gain in log-likelihood, and unknowns determined.

    ``matrix``, ``side``: Normal equations of the unknowns, in units of the noise. ``variance``: Initial variances.
    """
    count = len(variance)
    sizes = np.bincount(group, minlength=count)
    unknown, spread, determined = np.zeros(len(group)), np.ones(len(group)), np.zeros(len(group))
    values: Map = np.zeros(len(group))
    # In a direction that is not determined, rounding errors of the side would grow without limit.
    matrix, side = _determined(matrix, side)
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
    ratios = [each.excess for each in errors if each.excess is not None]
    if ratios:
        parts = (
            [f"positions by {format_two_digits(max(ratios))} times the stated errors of the stage"]
            if max(ratios) > 1.0
            else []
        )
        parts += [f"single images by about {format_two_digits(visit)} px, which are not stated"] if visit else []
        message = (
            f"images: are displaced against each other: {' and '.join(parts)}; standard deviations are larger by what "
            "this adds; check the errors that are stated (attributes stage_tolerance_*, setting pose_corrections)"
        )
    else:
        message = (
            "images: are displaced against each other by about "
            f"{format_two_digits(shift)} px from position to position and "
            f"{format_two_digits(visit)} px from image to image, which steady "
            "motion seen from the stated positions does not explain: "
            "by errors of the poses, or by unsteady motion; standard deviations are larger by what this adds; state "
            "the errors of the stage (attributes stage_tolerance_*), or set pose_corrections"
        )
    warnings.warn(message, EstimateWarning, stacklevel=_CALLER)
