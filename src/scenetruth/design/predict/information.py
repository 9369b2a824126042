"""What images tell of points by the spectrum of their texture: the Cramér-Rao bound without images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.functionals import functionals_of, with_products
from scenetruth.bound.geometry import Views
from scenetruth.bound.model import Model, columns_of
from scenetruth.bound.products import pair_of, sensitivity
from scenetruth.bound.solving import normal_matrix, variances_of
from scenetruth.bound.windows import window_weights
from scenetruth.design.predict.look import Look
from scenetruth.design.predict.seen import Seen
from scenetruth.schema import Intrinsics

__all__ = ["deviations", "moments_of", "square_root"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Moments = dict[tuple[int, int], Array]

# Pixels of a window along one side that are looked at; of wider windows, every other or third one.
_ACROSS = 15
# Where less of a window is on the surface, nothing is told: a strip along an edge tells neither slope nor motion.
_LEAST_SHARE = 0.1
# Noise that stays with the pixels is left out where it is a smaller share than this of what is new in every image.
_LITTLE_PATTERN = 0.05
# Slopes are linear in the distance, and their products of second order.
_HIGHEST_POWER = 2


def moments_of(look: Look, sigma_px: float, highest: int) -> tuple[Moments, Moments]:
    """Sum up the weights of windows, and their squares, times powers of the distance, over their own surface.

    Parameters
    ----------
    look
        The windows' middles, and the pieces of surface.
    sigma_px
        Standard deviation of the Gaussian window, which is cut off at twice that.
    highest
        Highest power along x and y together.

    Returns
    -------
    tuple of dict
        The sums by the powers along x and y, each of shape (n,); NaN where most of the window is not on the surface.
    """
    line = window_weights("gaussian", sigma_px)[0]
    reach = len(line) // 2
    at = np.arange(-reach, reach + 1, dtype=np.float64)
    # Of wide windows, pixels count where the middle of their group is; sums over whole windows stay exact.
    every = -(-len(line) // _ACROSS)
    group = np.rint(at / every).astype(np.int64)
    group -= group[0]
    middles = every * np.unique(np.rint(at / every))
    across, down = (each.ravel() for each in np.meshgrid(middles, middles))
    own = look.own_around(np.stack([across, down], axis=-1))
    powers = [(j, i) for j in range(highest + 1) for i in range(highest + 1 - j)]
    found, known = [], None
    for weights in (line, line**2):
        along = [np.bincount(group, weights * at**j) for j in range(highest + 1)]
        terms = np.stack([np.outer(along[i], along[j]).ravel() for j, i in powers], axis=-1)
        sums = own @ terms
        if known is None:
            known = np.where(sums[:, 0] >= _LEAST_SHARE * terms[:, 0].sum(), 1.0, np.nan)
        found.append(dict(zip(powers, (sums * known[:, None]).T, strict=True)))
    return found[0], found[1]


def square_root(variance: Array, response: Array) -> Array:
    """Return two gradients for each point whose products add up to those of its texture, in the mean.

    Parameters
    ----------
    variance, response
        Of the waves; see `Seen`.

    Returns
    -------
    numpy.ndarray
        Shape (2, 2, n): the gradient, its component along x and y.
    """
    xx, xy, yy = ((variance * response[..., k] * response[..., m]).sum(axis=1) for k, m in ((0, 0), (0, 1), (1, 1)))
    first = np.sqrt(np.maximum(xx, 1e-300))
    slant = xy / first
    return np.array([[first, slant], [np.zeros_like(first), np.sqrt(np.maximum(yy - slant**2, 0.0))]])


def deviations(
    look: Look,
    views: Views,
    shown: Mask,
    seen: Seen,
    sigma_px: float,
    model: Model,
    intrinsics: Intrinsics,
) -> dict[str, Array]:
    """Return the least standard deviations of a fit in windows, as `cramer_rao`, of the mean over textures.

    Parameters
    ----------
    look, views
        Surface points, and the images.
    shown
        Which images show them, shape (images, n).
    seen
        What images show of them.
    sigma_px
        Standard deviation of the window.
    model
        What is unknown in a window.
    intrinsics
        Of the camera.

    Returns
    -------
    dict
        As of `functionals_of`, each of shape (n,); not finite where the images do not tell it.
    """
    points = look.points
    s, s_y, t = (each[:, None] for each in (views.s, views.s_y, views.t))
    inverse, moves = sensitivity(points, s, s_y, t, shown)
    sides = []
    # By a gradient of 1 along x, and along y.
    for along, down in ((inverse[0], inverse[2]), (inverse[1], inverse[3])):
        own = [along * moves[0] + down * moves[1]]
        if model.moving:
            own += [along * moves[2], down * moves[2], along * moves[3] + down * moves[4]]
        sides.append(own)
    # Side, field, image, point.
    change = np.array(sides)
    count = np.maximum(shown.sum(axis=0), 1)
    change = np.where(shown, change - change.sum(axis=2, keepdims=True) / count, 0.0)
    a = np.einsum("lsn,sfvn->lfvn", square_root(seen.variance, seen.response), change)
    products = np.einsum("lkvn,lmvn->kmn", a, a)
    scatter = products.copy()
    if (seen.pattern > _LITTLE_PATTERN * seen.noise).any():
        scatter += (seen.pattern / seen.noise) ** 2 * _pattern_products(look, views, seen, change, sigma_px)
    moments, new = moments_of(look, sigma_px, _HIGHEST_POWER), seen.noise
    normal, squared = (
        {
            (number, j, i): part[k, m] / new**2 * moment[j, i]
            for (k, m), number in pair_of(model.fields).items()
            for j in range(model.degree_of(k) + model.degree_of(m) + 1)
            for i in range(model.degree_of(k) + model.degree_of(m) + 1 - j)
        }
        for part, moment in ((products, moments[0]), (scatter, moments[1]))
    )
    columns = columns_of(model, points)
    told = functionals_of(points, intrinsics, model)
    information, spread = (normal_matrix(each, columns, model) for each in (normal, squared))
    variances = variances_of(information, spread, columns, list(told.values()))
    return with_products(dict(zip(told, np.sqrt(variances), strict=True)))


def _pattern_products(look: Look, views: Views, seen: Seen, change: Array, sigma_px: float) -> Array:
    """Return what noise that stays with the pixels adds to the scatter of fits.

    Images that show the surface at places Δ apart have the same noise there, seen against a texture that is Δ further:
    they share it as far as the texture's gradient, and the window, are like themselves Δ further. With waves of the
    texture that is Σ_waves |Σ_i a_i exp(i k x_i)|². The window takes exp(-Δ² / 4σ²), as waves that scatter by
    1 / (√2 σ) do.
    """
    place = look.points.place(*(each[:, None] for each in (views.s, views.s_y, views.t)))
    turn = 2 * np.pi * seen.frequency
    # The same at every call: a prediction is no draw.
    turn = turn + np.random.default_rng(0).normal(0.0, 1.0 / (np.sqrt(2.0) * sigma_px), turn.shape)
    phase = np.einsum("nw,vn->nwv", turn[..., 0], place.x) + np.einsum("nw,vn->nwv", turn[..., 1], place.y)
    total = np.exp(1j * phase) @ np.moveaxis(change, -1, 0).reshape(len(look), -1, change.shape[2]).swapaxes(1, 2)
    total = total.reshape(*turn.shape[:2], *change.shape[:2])
    waves = np.einsum("nws,nwsf->nwf", np.sqrt(seen.variance)[..., None] * seen.response, total)
    return np.asarray(np.einsum("nwk,nwm->kmn", waves, waves.conj()).real)
