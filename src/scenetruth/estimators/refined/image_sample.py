"""Properties of whole images from a sample of regions: excluded images, noise, and poses.

Tiles are estimated one after another, but these properties are common to all of them. They are estimated from regions
spread over the image, which are fitted as small images are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.refined.alias_residuals import with_measured_noise
from scenetruth.estimators.refined.fit_maps import extract_fields
from scenetruth.estimators.refined.image_consistency import (
    correlate_blocks,
    find_inconsistent_of_regions,
    judge_blocks,
)
from scenetruth.estimators.refined.image_stack import ImageStack, Region
from scenetruth.estimators.refined.initialisation import fill_gaps
from scenetruth.estimators.refined.iterations import RefinedState, refine
from scenetruth.estimators.refined.motion_model_selection import refit_motion_models
from scenetruth.estimators.refined.noise_estimation import GreyVariance, estimate_noise, estimate_variance
from scenetruth.estimators.refined.pose_consistency import (
    PoseErrors,
    compare_with_stated,
    estimate_pose_errors,
    observe_blocks,
)
from scenetruth.estimators.refined.pose_corrections import PoseCorrections, join_blocks
from scenetruth.estimators.refined.row_bands import local_means
from scenetruth.estimators.refined.systematic_error import estimate_systematic_errors
from scenetruth.estimators.refined.tiles import RegionImages, spread_regions

__all__ = ["ImageSample", "measure_agreement", "sample_images"]

_POSE_ROUNDS = 8  # largest number of fits for pose corrections; depth and motion of the blocks are eliminated in each

Map = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ImageSample:
    """Properties of the images of a frame's window."""

    images: ImageStack
    """Images without coefficients, with their poses, noise, and exclusions."""
    cameras: PoseCorrections | None
    errors: PoseErrors | None
    """Pose errors that are not stated."""


def measure_agreement(source: RegionImages, fields: Map, sigma_px: float) -> float:
    """Return the fraction of the blocks that agree for fields of the whole image; see `compute_agreement`."""
    near = source.outline.within(1.0)
    blocks = []
    for region in spread_regions(source.outline.shape):
        own = fields[:, region.rows, region.columns].astype(np.float64)
        blocks.append(correlate_blocks(source.stack(region, fields, near), own, sigma_px, even=True))
    return judge_blocks(blocks).blocks


def sample_images(
    source: RegionImages, start: Map, settings: RefinedSettings, report: Callable[[int], None] | None = None
) -> ImageSample:
    """Fit regions spread over the image from fields of the whole image, shape (4, y, x)."""
    outline, sigma = source.outline, settings.window_sigma_px
    regions = spread_regions(outline.shape)
    cameras = None if outline.priors is None else PoseCorrections(outline.priors, outline)
    plain = replace(outline, priors=None)
    states = _fit(source, regions, start, plain, settings)
    if cameras is not None:
        for done in range(_POSE_ROUNDS):
            blocks = [(observe_blocks(each, settings), each.images) for each in states]
            known = [(each, images) for each, images in blocks if each is not None]
            moved = cameras.update_by_blocks(join_blocks(known), plain) if known else 0.0
            plain = replace(plain, moved=cameras.values)
            if report is not None:
                report(done + 1)
            if moved < settings.tolerance_px:
                break
            states = _fit(source, regions, start, plain, settings)
    of_plain = _common_noise([each.fit.residual[0] for each in states], _common_limit(states))
    if cameras is None:
        states = [with_measured_noise(refit_motion_models(each, settings), settings) for each in states]
        states = [estimate_systematic_errors(each, settings)[0] for each in states]
    left_out = find_inconsistent_of_regions([(each.images.without(()), _finite(each)) for each in states], sigma)
    states = [replace(each, images=each.images.without(left_out)) for each in states]
    states = [with_measured_noise(each, settings) for each in states]
    variance, noise = _noise(states, settings, outline.variance)
    errors = None
    if settings.pose_corrections == "auto" and cameras is None:
        errors = estimate_pose_errors(states, settings)
    elif cameras is not None:
        errors = compare_with_stated(states, cameras, settings)
    found = plain.without(left_out)
    return ImageSample(replace(found, variance=variance, noise=noise, noise_of_plain=of_plain), cameras, errors)


def _fit(
    source: RegionImages, regions: Sequence[Region], start: Map, outline: ImageStack, settings: RefinedSettings
) -> list[RefinedState]:
    """Fit surface and motion in each region."""
    states = []
    for region in regions:
        fields = start[:, region.rows, region.columns].astype(np.float64)
        states.append(refine(source.stack(region, start, outline), fields, settings))
    return states


def _finite(state: RefinedState) -> Map:
    fields = extract_fields(state.fit.theta)[:4]
    known = np.asarray(np.isfinite(fields).all(axis=0))
    return fill_gaps(fields, known) if known.any() else np.nan_to_num(fields)


def _noise(
    states: Sequence[RefinedState], settings: RefinedSettings, variance: GreyVariance
) -> tuple[GreyVariance, float]:
    """Return the noise variance as a function of the grey value, and the residual of windows that fit well."""
    squares = [each.noise_residual for each in states]
    limit = _common_limit(states)
    if settings.noise != "estimated" or states[0].images.demosaiced is not None:
        return variance, _common_noise(squares, limit)
    greys = [local_means(each.images.reference_grey()) for each in states]
    own = [each.images.variance.at(grey) for each, grey in zip(states, greys, strict=True)]
    of_pixels = [each.seen.square * level for each, level in zip(states, own, strict=True)]
    found = estimate_variance(
        np.concatenate([grey.ravel() for grey in greys]), np.concatenate([each.ravel() for each in of_pixels])
    )
    # Residuals are relative to the variance of their region.
    scaled = [square * level / found.at(grey) for square, level, grey in zip(squares, own, greys, strict=True)]
    return found, _common_noise(scaled, limit)


def _common_noise(squares: Sequence[Map], limit: float) -> float:
    """Return the residual of windows that fit well, of all regions."""
    return min(estimate_noise(np.sqrt(np.concatenate([each.ravel() for each in squares]))), limit)


def _common_limit(states: Sequence[RefinedState]) -> float:
    return float(np.median([each.images.noise_limit for each in states]))
