"""Errors of the fits by light that does not move with the surface, such as highlights.

Highlights, shadows and shading are smoother than most textures. A window has a gain and an offset for every image, but
the rest of a highlight that slides over the surface displaces the texture. Images without their smooth part have nearly
nothing of it. One step of the fits to them, at the nodes of a lattice, shows the error; it is added to the variances.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.refined.fit_maps import accelerated
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.initialisation import fill_gaps
from scenetruth.estimators.refined.iterations import RefinedState, select_models
from scenetruth.estimators.refined.kernels.window_solver import EVERY_VARIANCE, FULL, Fit
from scenetruth.estimators.refined.lattice import sample_step
from scenetruth.estimators.refined.model_tests import Alternative, Linearisation, at_nodes, of_nearest_node
from scenetruth.estimators.refined.systematic_error import Quantities, collect_quantities, mean_change
from scenetruth.schema.variables import MOTION_AFFINE, MOTION_PLAIN

__all__ = ["SmoothLight", "compare_without_smooth_light"]

# Standard deviation of the Gaussian mean that is subtracted from the images, relative to that of the window.
_OF_WINDOW = 1 / 3
# Ratio of residual to noise up to which one surface explains the images without their smooth part.
_EXPLAINED = 1.3
# Change of the scale of a surface between the reference and the farthest image, per px, up to which the means in both
# images cover the same part of the texture. Beyond, they differ by more than noise.
_LONGEST_STRETCH = 0.05
# Number of standard deviations from which the change of a single window is significant.
_SIGNIFICANT = 2.5
_CORRELATED = 0.2  # variance of a mean over windows, as for spans of frames of windows of the same size

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class SmoothLight:
    """Fits to images without their smooth part, at the nodes of a lattice."""

    found: Quantities
    """Values and variances; NaN where they are not comparable."""
    explained: Mask
    """Whether one surface, seen at similar scales, explains these images."""
    whole: Mask
    """Pixels whose windows contain a single surface."""
    sigma: float
    """Standard deviation of the windows in nodes."""
    step: int

    def added(self, fit: Fit, near: Mask, noise_ratio: float = 1.0) -> Fit:
        """Return a fit with the errors in its variances, which maps multiply by ``noise_ratio``.

        ``near``: Pixels with a fit to parts of their windows, whose changes are compared with noise one by one.
        """
        full = collect_quantities(at_nodes(fit, self.step), noise_ratio)
        change = self.found.values - full.values
        parts = near | ~self.whole
        among = (~parts)[:: self.step, :: self.step] & self.explained
        noise = np.maximum(self.found.variances - full.variances, 0.5 * self.found.variances)
        square, *_ = mean_change(change, noise, among, self.sigma, _CORRELATED)
        with np.errstate(invalid="ignore"):
            limit = _SIGNIFICANT**2 * np.maximum(self.found.variances, full.variances)
            single = np.where(self.explained & (change**2 > limit), change**2, 0.0)
        count, variance, element = self.found.fields, fit.variance.copy(), fit.element_variance.copy()
        for where, each in ((~parts, square), (parts, single)):
            errors = of_nearest_node(each, self.step, where) / noise_ratio
            variance[:count, where] += errors[:count]
            element[: len(errors) - count, where] += errors[count:].astype(np.float32)
        return fit._replace(variance=variance, element_variance=element)


def compare_without_smooth_light(refined: RefinedState, settings: RefinedSettings, whole: Mask) -> SmoothLight:
    """Fit all windows to images without their smooth part, and those of ``not whole`` once more from there.

    Motions that are accelerated, or were fitted to fewer frames, are not compared.
    """
    fit, step = refined.fit, sample_step(settings.window_sigma_px)
    known = np.asarray(np.isfinite(fit.theta).all(axis=0))
    images = _without_smooth_part(refined.images, _OF_WINDOW * settings.window_sigma_px)
    full = collect_quantities(at_nodes(fit, step))
    values, variances = np.full((2, *full.values.shape), np.nan)
    residual = np.full(values.shape[1:], np.nan)
    state = fill_gaps(fit.theta, known) if known.any() else fit.theta
    affine = settings.model_copy(update={"motion": "affine"}) if settings.motion == "auto" else settings
    gains = settings.photometric_model == "per_image"
    for among in (known, known & ~whole):
        moved = np.zeros((len(state), *residual.shape))
        for motion, own in ((MOTION_PLAIN, settings), (MOTION_AFFINE, affine)):
            where = among & (refined.motion == motion)
            if not where.any():
                continue
            models = select_models(images, own.model_copy(update={"acceleration": settings.accelerated}))
            theta = accelerated(state) if settings.accelerated else state[:FULL]
            at = Linearisation(images, theta, where, refined.curved, gains, step)
            (found,) = at.fits([Alternative(images, models, settings.window_sigma_px, EVERY_VARIANCE)])
            solved = where[::step, ::step] & np.isfinite(found.theta[0])
            quantities = collect_quantities(found, refined.noise_ratio)
            values[:, solved], variances[:, solved] = quantities.values[:, solved], quantities.variances[:, solved]
            residual[solved] = found.residual[0][solved]
            moved[: len(theta), solved] = (found.theta - theta[:, ::step, ::step])[:, solved]
        state = state + _spread(moved, step, state.shape)
    noise = images.residual_noise(residual)
    with np.errstate(invalid="ignore"):
        explained = np.asarray(residual <= (_EXPLAINED * noise) ** 2)
        stretch = images.farthest * np.hypot(*fit.theta[1:3, ::step, ::step])
        explained &= stretch <= _LONGEST_STRETCH
    if images.demosaiced is not None:
        explained &= _without_strong_aliases(refined)[::step, ::step]
    of_nodes = settings.window_sigma_px / step
    return SmoothLight(Quantities(values, variances, full.fields), explained, whole, of_nodes, step)


def _without_strong_aliases(refined: RefinedState) -> Mask:
    """Return where aliases are weaker than noise: they remain when the smooth part of a texture is gone."""
    if refined.alias_residual is None:
        return np.zeros(refined.images.shape, dtype=np.bool_)
    noise = refined.images.residual_noise(refined.noise_residual)
    return np.asarray(refined.alias_residual[0] <= noise**2)


def _without_smooth_part(images: ImageStack, sigma_px: float) -> ImageStack:
    """Return images of which a Gaussian mean is subtracted; of splines, which are linear, that of the coefficients."""
    from scipy.ndimage import gaussian_filter

    wide = (0.0, sigma_px, sigma_px)
    fine = [
        np.stack([each - gaussian_filter(each, wide, mode="mirror") for each in frame]) for frame in images.coefficients
    ]
    return replace(images, coefficients=fine)


def _spread(values: Map, step: int, shape: tuple[int, ...]) -> Map:
    """Return maps of nodes at all pixels by linear interpolation."""
    from scipy.ndimage import map_coordinates

    places = np.mgrid[: shape[-2], : shape[-1]] / step
    return np.stack([map_coordinates(each, places, order=1, mode="nearest") for each in values])
