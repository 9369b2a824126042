"""The structure tensor: the noise that passes its filters along x, y, s and t, and its window."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.model import Motion
from scenetruth.design.predict.information import moments_of
from scenetruth.design.predict.look import Look
from scenetruth.design.predict.methods.base import MethodModel, Setup
from scenetruth.design.predict.seen import Seen, flow_of
from scenetruth.estimators.structure_tensor.filters import PAPER, gaussian_window, transfer
from scenetruth.estimators.structure_tensor.rig import Rig, rig_of
from scenetruth.estimators.structure_tensor.settings import StructureTensorSettings

if TYPE_CHECKING:
    from scenetruth.design.predict.rendered import Rendered

__all__ = ["StructureTensorModel"]

Array = NDArray[np.float64]
Sums = dict[tuple[int, int], Array]

_HIGHEST_POWER = 2
# The two components of the gradient, as pairs.
_PAIRS = ((0, 0), (0, 1), (1, 1))
# Registrations that are tried beside the nearest: of some, divergence has smaller error bars.
_OFF = (0, -1, 1, -2, 2)
# Of a matrix with ones on its diagonal.
_LEAST_DETERMINANT = 1e-9
# Disparities that are left are told apart by this.
_STEP_PX = 0.25


class _Texture(NamedTuple):
    """Sums over windows of products of gradients, as far as noise and information need them.

    Products xx, xy and yy, by the powers of the distance. ``normal`` has the window's weights, the others have their
    squares, and gradients that are smoothed once more, or differentiated once more along x or y. Of the change along x
    between cameras of different places, ``change`` and ``change_smoothed``, there is no distance.
    """

    normal: list[Sums]
    smoothed: list[Sums]
    along_x: list[Sums]
    along_y: list[Sums]
    change: Array
    change_smoothed: Array


class _At(NamedTuple):
    """Where windows stand, and the noise there."""

    x: Array
    y: Array
    depth: Array
    disparity: Array
    flow: Array
    velocity: Array
    noise: Array
    pattern: Array
    shared: Callable[[Array, Array], Array | float]
    """What filters along s and t leave of the variance of noise that stays with the pixels."""


class StructureTensorModel(MethodModel):
    """Least squares of g_s, and of g_t, by g_x, g_y and x g_x + y g_y, with the noise that its filters let through.

    To the first order in the noise, total least squares is least squares. With a = (g_x, g_y, ξ g_x + η g_y + h), the
    window w, and the noise e that the filters leave,

        Cov p = (Σ w a aᵀ)⁻¹ Σ Σ w w' a a'ᵀ <e e'> (Σ w a aᵀ)⁻¹

    The noise is smoothed along x and y as the gradients are, so that the double sum is one over w² of gradients that
    are smoothed once more. Along s and t it has the energy of the filters, with the window along t. h is what each
    camera's own coordinate x - D s adds where a disparity v is left after registration by D: of a wave of wave number
    k, D Σ S_s s sin(k v s) times its gradient. Of the registrations near the disparity, the one that tells the
    divergence best counts.
    """

    name: ClassVar[str] = "structure_tensor"

    def motion_of(self, settings: StructureTensorSettings) -> Motion:
        """Return what it does not know of the velocity gradient: nothing, for it takes growth for coming nearer."""
        return "translation"

    def frames_of(self, settings: StructureTensorSettings, count: int) -> int:
        """Return how many frames it looks at together."""
        return rig_of(np.arange(3.0) - 1.0, count, settings).frames

    def from_spectrum(self, setup: Setup, look: Look, seen: Seen) -> dict[str, Array]:
        """Return standard deviations from the texture's spectrum; see `MethodModel`."""
        rig = _rig_of(setup)
        turn = 2 * np.pi * seen.frequency
        derivative, smoothing = (np.asarray(each) for each in transfer(turn))
        gradient = np.stack([derivative[..., 0] * smoothing[..., 1], smoothing[..., 0] * derivative[..., 1]], axis=-1)
        smooth = smoothing[..., 0] * smoothing[..., 1]
        windows = moments_of(look, setup.window_sigma_px, _HIGHEST_POWER)
        points = look.points

        def sums(moments: Sums, factor: Array) -> list[Sums]:
            found = []
            for k, m in _PAIRS:
                mean = (seen.variance * gradient[..., k] * gradient[..., m] * factor**2).sum(axis=1)
                found.append({powers: mean * moment for powers, moment in moments.items()})
            return found

        def textured(left: Array) -> _Texture:
            phase = turn[..., 0, None] * left[:, None, None] * rig.over_s.nodes
            # What is left to move blurs the mean over the cameras.
            kept = (rig.over_s.smoothing * np.cos(phase)).sum(axis=-1)
            odd = (rig.over_s.smoothing * rig.over_s.nodes * np.sin(phase)).sum(axis=-1)
            change = seen.variance * (gradient[..., 0] * odd) ** 2
            return _Texture(
                sums(windows[0], kept),
                sums(windows[1], kept * smooth),
                sums(windows[1], kept * gradient[..., 0]),
                sums(windows[1], kept * gradient[..., 1]),
                change.sum(axis=1) * windows[0][0, 0],
                (change * smooth**2).sum(axis=1) * windows[1][0, 0],
            )

        velocity = points.q * setup.scene.stage.baseline_mm
        weight = seen.variance * np.square(gradient).sum(axis=-1) * smooth**2
        shared = partial(_shared, look, turn, weight, rig, setup.window_sigma_px)
        flow = flow_of(look).T
        at = _At(points.x, points.y, look.depth_mm, points.d, flow, velocity, seen.noise, seen.pattern, shared)
        return _deviations(setup, rig, at, textured)

    def from_images(self, setup: Setup, scene: Rendered) -> dict[str, Array]:
        """Return maps from an image without noise; see `MethodModel`.

        What disparity is left after registration blurs all products as it blurs the square of the gradient along x.
        """
        from scipy.ndimage import correlate1d

        rig, settings = _rig_of(setup), setup.settings
        truth = scene.truth.sel(t=0)
        along_d, along_s = PAPER.derivative, PAPER.smoothing

        def filtered(image: Array, over_x: Array, over_y: Array) -> Array:
            return np.asarray(correlate1d(correlate1d(image, over_x, axis=1), over_y, axis=0))

        gradient = filtered(scene.level_map, along_d, along_s), filtered(scene.level_map, along_s, along_d)
        own = setup.window_sigma_px == settings.window_sigma_px
        taps = settings.window_taps_px if own else 2 * math.ceil(2 * setup.window_sigma_px) + 1
        line = gaussian_window(setup.window_sigma_px, taps)
        distance = np.arange(len(line)) - len(line) // 2

        def window(product: Array, weights: Array, j: int, i: int) -> Array:
            return filtered(product, weights * distance**j, weights * distance**i)

        def sums(parts: Sequence[Array], weights: Array) -> list[Sums]:
            return [
                {
                    (j, i): window(parts[k] * parts[m], weights, j, i)
                    for j in range(_HIGHEST_POWER + 1)
                    for i in range(_HIGHEST_POWER + 1 - j)
                }
                for k, m in _PAIRS
            ]

        normal = sums(gradient, line)
        smoothed = sums([filtered(each, along_s, along_s) for each in gradient], line**2)
        along_x = sums([filtered(each, along_d, along_s) for each in gradient], line**2)
        along_y = sums([filtered(each, along_s, along_d) for each in gradient], line**2)
        turn = 2 * np.pi * np.fft.rfftfreq(gradient[0].shape[1])
        spectrum = np.fft.rfft(gradient[0], axis=1)

        @cache
        def changes(step: int) -> tuple[Array, Array, Array, Array]:
            # What is left to move between cameras blurs their mean, and changes from camera to camera.
            phase = turn[:, None] * (step * _STEP_PX) * rig.over_s.nodes
            mean = (rig.over_s.smoothing * np.cos(phase)).sum(axis=1)
            odd = 1j * (rig.over_s.smoothing * rig.over_s.nodes * np.sin(phase)).sum(axis=1)
            found = []
            for factor in (mean, odd):
                one = np.fft.irfft(spectrum * factor, gradient[0].shape[1], axis=1)
                found += [window(one**2, line, 0, 0), window(filtered(one, along_s, along_s) ** 2, line**2, 0, 0)]
            return found[0], found[1], found[2], found[3]

        def textured(left: Array) -> _Texture:
            step = np.rint(np.abs(np.nan_to_num(left)) / _STEP_PX).astype(np.int64)
            told = np.zeros((4, *step.shape))
            for one in np.unique(step).tolist():
                here = step == one
                for total, values in zip(told, changes(one), strict=True):
                    total[here] = values[here]
            blur, blur_smoothed = told[0] / changes(0)[0], told[1] / changes(0)[1]
            return _Texture(
                _scaled(normal, blur),
                _scaled(smoothed, blur_smoothed),
                _scaled(along_x, blur_smoothed),
                _scaled(along_y, blur_smoothed),
                told[2],
                told[3],
            )

        c_x, c_y = setup.scene.camera.principal_point
        x, y = np.meshgrid(truth["x"].values - c_x, truth["y"].values - c_y)
        at = _At(
            x,
            y,
            truth["depth"].values,
            truth["disparity"].values,
            truth["flow"].values,
            truth["velocity"].values,
            scene.noise_map,
            np.zeros_like(scene.pattern_map),
            lambda *_: 0.0,
        )
        found = _deviations(setup, rig, at, textured)
        return {name: np.where(np.isfinite(truth["depth"].values), values, np.nan) for name, values in found.items()}


def _deviations(setup: Setup, rig: Rig, at: _At, textured: Callable[[Array], _Texture]) -> dict[str, Array]:
    """Return what is told of windows: disparity, depth, flow and velocity.

    Parameters
    ----------
    setup, rig, at
        The method at work.
    textured
        Gives `_Texture`, called with the disparity that is left after registration.
    """
    focal, found = setup.scene.camera.focal_px, dict[str, Array]()
    relative: Array = np.zeros_like(at.x)
    nearest = np.rint(at.disparity) if setup.sees_depth else np.zeros_like(at.x)
    left = at.disparity - nearest if setup.sees_depth else np.zeros_like(at.x)
    texture = textured(left)
    if setup.sees_depth:
        inverse = _inverse(_matrix(texture.normal))
        along, smooth = (
            _energy(at, each, np.convolve(rig.window_t, rig.over_t.smoothing))
            for each in (rig.over_s.derivative, rig.over_s.smoothing)
        )
        scatter = _times(along, _matrix(texture.smoothed)) + _times(smooth * left**2, _matrix(texture.along_x))
        found["disparity"] = np.sqrt((inverse @ scatter @ inverse)[..., 0, 0])
        relative = found["disparity"] / np.abs(at.disparity)
        found["depth"] = at.depth * relative
    if not setup.sees_motion:
        return found
    left_x, left_y = at.flow - np.rint(at.flow)
    along, smooth = (
        _energy(at, rig.over_s.smoothing, np.convolve(rig.window_t, each))
        for each in (rig.over_t.derivative, rig.over_t.smoothing)
    )
    best: Array | None = None
    for off in _OFF if setup.sees_depth else _OFF[:1]:
        tried = texture if off == 0 else textured(left - off)
        own = (nearest + off) ** 2 if setup.sees_depth else np.zeros_like(at.x)
        inverse = _inverse(_matrix(tried.normal, own * tried.change))
        scatter = _times(along, _matrix(tried.smoothed, own * tried.change_smoothed))
        scatter += _times(smooth * left_x**2, _matrix(tried.along_x))
        scatter += _times(smooth * left_y**2, _matrix(tried.along_y))
        covariance = inverse @ scatter @ inverse
        if off == 0:
            found |= {f"flow.{k}": np.sqrt(covariance[..., k, k]) for k in range(2)}
        if best is None:
            best = covariance.copy()
        else:
            better = covariance[..., 2, 2] < best[..., 2, 2]
            best[better] = covariance[better]
    assert best is not None
    if setup.sees_depth:
        nearer = best[..., 2, 2]
        for k, place in enumerate((at.x, at.y)):
            own = found[f"flow.{k}"] ** 2 - 2 * place * best[..., k, 2] + place**2 * nearer
            found[f"velocity.{k}"] = np.sqrt((at.depth / focal) ** 2 * own + (at.velocity[k] * relative) ** 2)
        found["velocity.2"] = np.sqrt(at.depth**2 * nearer + (at.velocity[2] * relative) ** 2)
    return found


def _rig_of(setup: Setup) -> Rig:
    settings: Any = setup.settings
    return rig_of(np.unique(setup.views.s), setup.scene.frames.count, settings)


def _scaled(products: list[Sums], factor: Array) -> list[Sums]:
    return [{powers: factor * values for powers, values in each.items()} for each in products]


def _energy(at: _At, over_s: Array, over_t: Array) -> Array:
    """Return the variance of what filters along s and t leave of the noise."""
    new = np.square(over_s).sum() * np.square(over_t).sum()
    kept = at.shared(over_s, over_t) if at.pattern.any() else 0.0
    return np.asarray(at.noise**2 * new + at.pattern**2 * kept)


def _shared(look: Look, turn: Array, weight: Array, rig: Rig, sigma_px: float, over_s: Array, over_t: Array) -> Array:
    """Return what filters along s and t leave of the variance of noise that stays with the pixels.

    Images that show the surface at places Δ apart share it as far as the texture's gradient, and the window, are like
    themselves Δ further: of waves, filters along s leave |Σ_s f_s exp(i k d s)|².

    Parameters
    ----------
    look
        The points.
    turn, weight
        Wave numbers of their texture, and what each wave counts.
    rig, sigma_px
        Places of the cameras, and standard deviation of the window.
    over_s, over_t
        The filters.
    """
    # The same at every call: a prediction is no draw.
    scattered = turn[..., 0] + np.random.default_rng(0).normal(0.0, 1.0 / (np.sqrt(2.0) * sigma_px), turn.shape[:2])
    by_s = (scattered * look.points.d[:, None])[..., None] * rig.positions
    by_t = np.einsum("nwk,nk->nw", turn, flow_of(look))[..., None] * np.arange(len(over_t))
    left = weight.copy()
    for filtered, phase in ((over_s, by_s), (over_t, by_t)):
        left *= np.abs((filtered * np.exp(1j * phase)).sum(axis=-1)) ** 2
    return np.asarray(left.sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300))


def _inverse(matrices: Array) -> Array:
    """Return inverses; NaN where the texture does not tell all three."""
    scale = np.sqrt(np.abs(np.einsum("...ii->...i", matrices)))
    scaled = matrices / (scale[..., :, None] * scale[..., None, :])
    known = np.isfinite(scaled).all(axis=(-2, -1))
    safe = np.where(known[..., None, None], scaled, np.eye(3))
    known &= np.linalg.det(safe) > _LEAST_DETERMINANT
    inverse = np.linalg.inv(np.where(known[..., None, None], safe, np.eye(3)))
    inverse[~known] = np.nan
    return np.asarray(inverse / (scale[..., :, None] * scale[..., None, :]))


def _times(factor: Array, matrices: Array) -> Array:
    return np.asarray(factor[..., None, None] * matrices)


def _matrix(products: list[Sums], change: Array | float = 0.0) -> Array:
    """Return Σ w a aᵀ of a = (g_x, g_y, ξ g_x + η g_y + h), shape (..., 3, 3)."""
    xx, xy, yy = products
    one, right, down = (0, 0), (1, 0), (0, 1)
    rows = [
        [xx[one], xy[one], xx[right] + xy[down]],
        [xy[one], yy[one], xy[right] + yy[down]],
        [xx[right] + xy[down], xy[right] + yy[down], xx[2, 0] + 2 * xy[1, 1] + yy[0, 2] + change],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
