"""Residuals by aliases of demosaicing, separated from noise by their phases.

Demosaicing adds an alias to every wave of the texture, with the wave vector shifted by (π, 0), (0, π) or (π, π). The
phase of an alias relative to its wave is π times the position of the point in the image. Over registered images, the
grey values of a pixel are therefore a constant, plus sines and cosines of π X, π Y and π (X + Y) with unknown
amplitudes, plus noise. Their least squares fit shows which part of the residual is noise. Noise that demosaicing
correlates is larger at low frequencies than its variance suggests; aliases are not, and they are no reason to distrust
a fit.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.refined.aliasing import combine_displacements, measure_noise_coupling
from scenetruth.estimators.refined.fit_maps import extract_fields
from scenetruth.estimators.refined.image_consistency import replace_reference
from scenetruth.estimators.refined.image_stack import ImageStack, without_aliases
from scenetruth.estimators.refined.initialisation import fill_gaps
from scenetruth.estimators.refined.iterations import RefinedState
from scenetruth.estimators.refined.kernels.smoothing import gaussian_mean
from scenetruth.estimators.refined.kernels.warp import STEADY
from scenetruth.estimators.refined.row_bands import FIT_LIMITS, NO_OCCLUSION, even_images, window_weights

__all__ = ["Aliases", "find_aliases", "measure_alias_residual", "project_aliases", "separate", "with_measured_noise"]

_CARRIERS = ((1, 0), (0, 1), (1, 1))
# Smallest number of images: six amplitudes and the mean leave three degrees of freedom.
_LEAST_IMAGES = 10
# Aliases whose phases agree in all images leave no residual: relative to a sum of squares of N / 2.
_PRIOR = 1.0
_PARAMETERS = [0, 3, 4, 5]  # d, q_X, q_Y and q_Z among the parameters of a fit
_WIDER = 2.0  # standard deviation of the window of mean square displacements, relative to that of fits
_ROWS = 16
_CUT = 2.0  # half-width of windows in standard deviations
# Amplitudes of the carriers along x and along y; those that are squares of grey values among the sums of a pixel.
_ALONG = [0, 1, 4, 5], [2, 3, 4, 5]
_SQUARES, _SUMS = [0, 2, 4, 7], 10
# The power of two carriers is twice the mean square amplitude. Least sum of the squared shares of four amplitudes, and
# degrees of freedom, from which on they are used.
_OF_CARRIERS, _LEAST_FOUND, _LEAST_FREEDOM = 2.0, 0.3, 1e-3

Map = NDArray[np.float64]


class Aliases(NamedTuple):
    """Aliases of n pixels.

    ``sums``: As from `project_aliases`. ``turned``: Linear combinations of the images of aliases a quarter of a period
    later, shape (m, n). ``of_noise``: Their variance by noise of 1.
    """

    sums: Map
    turned: Map
    of_noise: Map


def project_aliases(images: Map, right: Map, down: Map) -> Map:
    """Return sums over the images at n pixels, shape (10, n), whose means over a window `separate` evaluates.

    Squares and degrees of freedom of all residuals, and of those without aliases; and for the carriers along x and
    along y the squares of the amplitudes, their variance by noise of 1, and the squares of the estimated shares.

    ``images``: Registered grey values, shape (images, n); NaN where invalid.
    ``right``, ``down``: Positions of the points in the images in px, of the same shape.
    """
    return find_aliases(images, right, down, np.zeros((0, len(images)))).sums


def find_aliases(images: Map, right: Map, down: Map, combined: Map) -> Aliases:
    """Return sums, and combinations of aliases in the images, for images and positions as in `project_aliases`.

    ``combined``: Coefficients of the linear combinations, shape (m, images).
    """
    valid = np.isfinite(images)
    count = np.maximum(valid.sum(axis=0), 1)
    phases = [np.pi * (p * right + q * down) for p, q in _CARRIERS]
    design = np.stack([part(phase) for phase in phases for part in (np.cos, np.sin)])
    design = np.where(valid, design, 0.0)
    design = np.where(valid, design - design.sum(axis=1, keepdims=True) / count, 0.0)
    grey = np.where(valid, images, 0.0)
    grey = np.where(valid, grey - grey.sum(axis=0) / count, 0.0)
    normal = np.einsum("kin,lin->nkl", design, design)
    inverse = np.linalg.inv(normal + _PRIOR * np.eye(len(design)))
    hat = inverse @ normal
    amplitudes = np.einsum("nkl,lin,in->kn", inverse, design, grey, optimize=True)
    left = grey - np.einsum("kin,kn->in", design, amplitudes)
    # Of (1 - H)² with the smoother matrix H.
    used = 2.0 * np.einsum("nkk->n", hat) - np.einsum("nkl,nlk->n", hat, hat)
    freedom = count - 1.0
    sums = [(grey**2).sum(axis=0), freedom, (left**2).sum(axis=0), np.maximum(freedom - used, 0.0)]
    by_noise = np.einsum("nkl,nlk->kn", hat, inverse)
    # Carriers with nearly equal phases share their amplitudes.
    found = np.einsum("nkl,nkl->kn", hat, hat)
    for own in _ALONG:
        sums += [each[own].sum(axis=0) for each in (amplitudes**2, by_noise, found)]
    later = np.stack([part for phase in phases for part in (-np.sin(phase), np.cos(phase))])
    effect = np.einsum("mi,kin->mkn", combined, np.where(valid, later, 0.0))
    turned = np.einsum("mkn,kn->mn", effect, amplitudes)
    of_noise = np.einsum("mkn,nkl,mln->mn", effect, hat @ inverse, effect, optimize=True)
    return Aliases(np.stack(sums), turned, of_noise)


def separate(sums: Map) -> Map:
    """Return the mean square residual by aliases, and the powers of the aliases along x and y, shape (3, n).

    ``sums``: Means of `project_aliases` over a window. Residuals of noise alone are those without aliases.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        noise = sums[2] / sums[3]
        excess = sums[0] / sums[1] - noise
        along = [
            _OF_CARRIERS * (square - noise * by_noise) / np.maximum(found, _LEAST_FOUND)
            for square, by_noise, found in (sums[4:7], sums[7:])
        ]
    return np.where(sums[3] > _LEAST_FREEDOM, np.maximum(np.nan_to_num([excess, *along]), 0.0), 0.0)


def with_measured_noise(refined: RefinedState, settings: RefinedSettings) -> RefinedState:
    """Return a fit to demosaiced images with the residuals by aliases, and the effect of its correlated noise."""
    images = refined.images
    if images.demosaiced is None:
        return refined
    found = replace(refined, alias_residual=measure_alias_residual(refined, settings))
    noise = images.residual_noise(found.noise_residual) / images.transfer
    if not np.isfinite(noise):
        return found
    shown = replace_reference(images, extract_fields(found.fit.theta))
    return replace(found, coupling=measure_noise_coupling(shown, settings.window_sigma_px, noise))


def measure_alias_residual(refined: RefinedState, settings: RefinedSettings) -> Map | None:
    """Return the mean square residual of windows by aliases, their powers along x and y, and the variances they cause.

    The first three have the units of the residual of a fit. The other maps are variances of d, q_X, q_Y and q_Z:
    aliases resemble waves of the texture, and are alike in several images, so that they displace fits by more than
    white noise of the same power does. The displacement itself is absorbed by the fit; that of aliases a quarter of a
    period later has the same mean square. Shape (7, y, x).

    None where it cannot be separated: images without demosaicing, fewer than ten images, or images of a lens.
    """
    images, theta = refined.images, refined.fit.theta
    if images.demosaiced is None or images.lens is not None or images.count < _LEAST_IMAGES:
        return None
    view, bad = images.view(), images.bad_stack()
    known = np.asarray(np.isfinite(theta).all(axis=0))
    if not known.any():
        return None
    fields = np.ascontiguousarray(extract_fields(fill_gaps(theta, known)))
    sigma = settings.window_sigma_px
    weights = window_weights(sigma)[0, 0] if settings.photometric_model == "per_image" else None
    margin = 0 if weights is None else len(weights)
    height, width = images.shape
    sums = np.zeros((_SUMS, height, width))
    inverse = combine_displacements(view, accelerated=settings.accelerated and len(images.times) > 2)
    sides = np.concatenate([inverse[:, : len(view.s)], inverse[:, len(view.s) :]])
    pushes, of_noise = np.zeros((2, 2, len(inverse), height, width))
    energy, complete = np.zeros((2, height, width)), np.zeros((height, width))
    size = max(_ROWS, int(FIT_LIMITS.scratch_bytes / (4 * len(view.s) * width)) - 2 * margin)
    least = max(2, math.ceil(0.5 * images.count))
    for top in range(0, height, size):
        bottom = min(top + size, height)
        first, end = max(top - margin, 0), min(bottom + margin, height)
        for channel in range(images.channels):
            each = images.stack(channel), view, fields, NO_OCCLUSION, bad, first, weights, least, end - first
            warped, gradient = even_images(*each)
            for row in range(top, bottom):
                grey = warped[:, row - first].astype(np.float64)
                right, down = _find_positions(images, fields[:, row], row)
                count = np.isfinite(grey).sum(axis=0)
                unit = 1.0 / images.variance.at(np.nansum(grey, axis=0) / np.maximum(count, 1))
                found = find_aliases(grey, right, down, sides)
                of_row = found.sums
                of_row[_SQUARES] *= unit
                enough = count >= _LEAST_IMAGES
                sums[:, row] += np.where(enough, of_row, 0.0)
                enough &= known[row]
                slopes = np.where(enough, np.nan_to_num(gradient[:, row - first].astype(np.float64)), 0.0)[:, None]
                pushes[:, :, row] += np.nan_to_num(found.turned.reshape(2, -1, width)) * slopes * unit
                of_noise[:, :, row] += found.of_noise.reshape(2, -1, width) * slopes**2 * unit
                energy[:, row] += (slopes**2 * unit)[:, 0]
                complete[row] = enough
    separated = separate(np.stack([gaussian_mean(each, sigma, _CUT) for each in sums]))
    noise = without_aliases(refined.fit.residual[0], separated) * images.demosaiced.of_pixels
    noise = np.where(known, noise, 0.0)
    means = [gaussian_mean(each, sigma, _CUT) for each in energy]
    pixels = 4.0 * np.pi * sigma**2
    unknowns, equivalent = len(inverse), np.zeros(pushes.shape[1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        for p in range(unknowns):
            total, by_noise, by_unit = np.zeros((3, height, width))
            for k, mean in enumerate(means):
                total += gaussian_mean(pushes[k, p], sigma, _CUT) / mean
                by_noise += noise * gaussian_mean(of_noise[k, p], sigma, _CUT) / mean**2 / pixels
                by_unit += (sides[k * unknowns + p] ** 2).sum() / mean / pixels
            # Few windows overlap an area: the mean square needs a larger one.
            square = gaussian_mean(complete * np.nan_to_num((total**2 - by_noise) / by_unit), _WIDER * sigma, _CUT)
            equivalent[p] = np.maximum(np.nan_to_num(square / gaussian_mean(complete, _WIDER * sigma, _CUT)), 0.0)
    # Lateral velocities away from the centre of the image include that along the axis.
    equivalent[1:3] = np.maximum(equivalent[1:3], equivalent[3])
    with np.errstate(divide="ignore", invalid="ignore"):
        variances = refined.fit.variance[_PARAMETERS] / refined.fit.residual[0] * equivalent
    return np.concatenate([separated, variances])


def _find_positions(images: ImageStack, fields: Map, row: int) -> tuple[Map, Map]:
    """Return the positions of the points of a row in all images, shape (images, n), with corrections of poses."""
    view, columns = images.view(), np.arange(fields.shape[1])
    s, s_y, t = view.s[:, None], view.s_y[:, None], view.t[:, None]
    d, q_x, q_y, q_z = fields[:STEADY]
    right, down, ahead = t * q_x, t * q_y, t * q_z
    if len(fields) > STEADY:
        half = 0.5 * t * t
        right, down, ahead = (at + half * each for at, each in zip((right, down, ahead), fields[STEADY:], strict=True))
    scale = 1.0 / (1.0 + d * ahead / view.focal)
    x = (columns - view.centre_x + d * (right - s)) * scale + view.moved[:, :1]
    y = (row - view.centre_y + d * (down - s_y)) * scale + view.moved[:, 1:2]
    return x + view.centre_x, y + view.centre_y
