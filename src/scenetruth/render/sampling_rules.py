"""Rules that average a pixel footprint, and the finest texture that each of them averages within a stated error."""

from __future__ import annotations

import hashlib
import math
from collections import OrderedDict
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.texture import SurfaceTexture, TintedTexture
from scenetruth.threads import with_one_blas_thread

__all__ = [
    "FILTER_TAPS",
    "GAUSS_ORDERS",
    "WIDE_ORDERS",
    "Rule",
    "compute_longest_steps",
    "compute_rule_errors",
    "compute_widest_steps",
    "even_rule",
    "filter_transfer",
    "gauss_rule",
    "gauss_transfer",
    "lattice_rule",
    "square_rule",
    "step_indices",
]

Rule = tuple[NDArray[np.float64], NDArray[np.float64]]
Floats = NDArray[np.float64]

_GOLDEN = (math.sqrt(5) - 1) / 2


def even_rule(count: int) -> Rule:
    """Return equally spaced samples in [-1/2, 1/2] px along one axis of a footprint, with weights of the highest order.

    Equal weights (midpoint rule) are exact for linear functions only and amplify a wave of f cycles per pixel by 1 +
    (πf / n)² / 6. For three or more samples the weights 1/n + a (x² - mean of x²) are exact for cubic functions.
    """
    positions = (np.arange(count) + 0.5) / count - 0.5
    weights = np.full(count, 1 / count)
    if count > 2:
        squares = positions**2 - np.mean(positions**2)
        # The second moment of a unit interval is 1/12; equal weights give (1 - 1/n²) / 12.
        weights += squares * (1 / 12 - np.mean(positions**2)) / np.sum(squares**2)
    return positions, weights


def gauss_rule(count: int) -> Rule:
    """Return n Gauss-Legendre positions in [-1/2, 1/2] px and weights with sum 1, exact up to degree 2n - 1."""
    positions, weights = np.polynomial.legendre.leggauss(count)
    return positions / 2, weights / 2


def lattice_rule(count: int) -> Rule:
    """Return at least ``count`` positions in the square [-1/2, 1/2]² px with equal weights: a lattice of rank 1.

    Their number is prime, so that the projections onto both axes and both diagonals are equally spaced: no edge in
    these directions passes several samples together. Returns offsets (x, y), shape (n, 2), and weights, shape (n,).
    """
    size = next(n for n in range(max(count, 5), 2 * count + 6) if all(n % k for k in range(2, math.isqrt(n) + 1)))
    number = np.arange(size)
    offsets = np.stack([number, (number * round(_GOLDEN * size)) % size], axis=-1)
    return (offsets + 0.5) / size - 0.5, np.full(size, 1 / size)


def square_rule(steps: Floats, weights: Floats) -> Rule:
    """Return the offsets (x, y) and weights of the tensor-product rule over a footprint."""
    across, down = np.meshgrid(steps, steps)
    return np.column_stack([across.ravel(), down.ravel()]), np.outer(weights, weights).ravel()


_HIGHEST = 0.25  # cycles per pixel up to which the filter equals the mean over a pixel, within 3e-5


def _filter_polynomial() -> Floats:
    """Return the coefficients c of 1 + Σ c_k q^k, q = sin²(πf), k = 1 to 3, near sinc(f) up to f = `_HIGHEST`."""
    most = math.sin(math.pi * _HIGHEST) ** 2
    # Interpolation at Chebyshev points is nearly the best approximation.
    q = most * (1 - np.cos((np.arange(3) + 0.5) * np.pi / 3)) / 2
    slopes = (np.sinc(np.arcsin(np.sqrt(q)) / np.pi) - 1) / q
    return np.asarray(np.linalg.solve(q[:, None] ** np.arange(3), slopes))


def _filter_taps() -> Floats:
    polynomial, power = _filter_polynomial(), np.ones(1)
    taps = np.zeros(7)
    taps[3] = 1.0
    for order, coefficient in enumerate(polynomial.tolist(), start=1):
        # q is minus a quarter of the second difference.
        power = np.convolve(power, [-0.25, 0.5, -0.25])
        taps[3 - order : 4 + order] += coefficient * power
    return taps


FILTER_TAPS = _filter_taps()
"""Filter along one axis that turns samples at pixel centres into means over pixels: seven weights with sum 1.

Samples at pixel centres determine an image without waves shorter than 2 px, and with it the means over its pixels,
whose transfer is sinc(f) for f cycles per pixel.
"""

GAUSS_ORDERS = (2, 3, 4, 6, 8)
"""Orders n of the rules of n x n Gauss points, from the cheapest."""


WIDE_ORDERS = (5, 6, 7, 8, 9, 10, 12, 14, 16)
"""Orders of further Gauss rules, for pixels that contain many texels."""


def filter_transfer(frequency: Floats) -> Floats:
    """Return the transfer of the filter for waves of a frequency in cycles per pixel, with their aliases."""
    return np.asarray(FILTER_TAPS @ np.cos(2 * np.pi * np.multiply.outer(np.arange(-3, 4), frequency)).reshape(7, -1))


def gauss_transfer(count: int, frequency: Floats) -> Floats:
    """Return the transfer of n Gauss points along one axis for waves of a frequency in cycles per pixel."""
    positions, weights = gauss_rule(count)
    return np.asarray(weights @ np.cos(2 * np.pi * np.multiply.outer(positions, frequency)).reshape(count, -1))


_LINES, _POINTS, _PER_TEXEL = 24, 512, 2
_STEPS = 2.0 ** np.arange(-6, 6.01, 0.0625)  # steps tried, in texels per pixel
_ROUNDED = 1e-6  # rounding of the index of a step
# Lines of the texture whose mean square is compared with the error: the roughest of this fraction.
_ROUGHEST = 1


@lru_cache(maxsize=1)
def _squared_errors() -> Floats:
    """Return the squared transfer errors of the filter and the Gauss rules, shape (rules, frequencies, steps)."""
    frequency = np.fft.rfftfreq(_POINTS, 1 / _PER_TEXEL)
    waves = np.multiply.outer(frequency, _STEPS)
    exact = np.sinc(waves)
    flat = [filter_transfer(waves.ravel()), *(gauss_transfer(n, waves.ravel()) for n in GAUSS_ORDERS)]
    return np.stack([(transfer.reshape(waves.shape) - exact) ** 2 for transfer in flat])


class _Steps(NamedTuple):
    """Results for a texture: errors of the rules, see `compute_rule_errors`; and which of `WIDE_ORDERS` suffice.

    ``within``: By error and first step, for the steps tried so far.
    """

    errors: list[Floats]
    within: dict[tuple[float, float], dict[int, NDArray[np.bool_]]]


_THIN = 4999  # one texel of as many distinguishes textures
_MOST_KNOWN = 256  # textures whose steps are kept after the last use
_by_content: OrderedDict[tuple[Any, ...], _Steps] = OrderedDict()
_by_texture: WeakKeyDictionary[SurfaceTexture, _Steps] = WeakKeyDictionary()


def _steps_of(texture: SurfaceTexture) -> _Steps:
    """Return the results determined so far.

    Textures of the same scene, which is often built again, have them in common: those with the same size, parameters
    and thousands of equal texels, on which no step depends.
    """
    known = _by_texture.get(texture)
    if known is None:
        values = getattr(texture, "coefficients", None)
        known = _Steps([], {})
        if values is not None and values.size > _THIN:
            thinned = hashlib.sha256(values.ravel()[::_THIN].tobytes()).digest()
            rest = [(name, value) for name, value in vars(texture).items() if not isinstance(value, np.ndarray)]
            known = _by_content.setdefault((type(texture), values.shape, thinned, *rest), known)
            while len(_by_content) > _MOST_KNOWN:
                _by_content.popitem(last=False)
        _by_texture[texture] = known
    return known


def compute_longest_steps(textures: Sequence[SurfaceTexture], error: float) -> Floats:
    """Return the longest steps of textures per pixel, in texels, for which a rule is within an RMS error.

    Textures with steps, whose spectrum does not end, get short steps, and a uniform texture infinite steps.

    ``error``: RMS error of the radiance.
    Returns: Steps of the filter at pixel centres (`FILTER_TAPS`) and of each of `GAUSS_ORDERS`, ascending from the
    second on, shape (textures, rules).
    """
    beyond = compute_rule_errors(textures) > error
    first = beyond.argmax(axis=-1)
    return np.where(beyond.any(axis=-1), np.where(first > 0, _STEPS[first - 1], 0.0), np.inf)


def compute_rule_errors(textures: Sequence[SurfaceTexture]) -> Floats:
    """Return the RMS errors of the radiance by the filter at pixel centres and by each of `GAUSS_ORDERS`.

    The power spectrum of the texture along lines in four directions, with all waves between its texels, gives the error
    of every rule as a function of the step from pixel to pixel.

    Returns: Errors at the steps of `step_indices`, not descending along them, shape (textures, rules, steps). From the
    second on, rules are not worse than those before.
    """
    # The same rules for all bands, unless they would be too coarse for a band that is brighter than the texture.
    tinted = [item if isinstance(item, TintedTexture) else TintedTexture(item, 1.0) for item in textures]
    wanted = [(item.untinted, max(item.factor, 1.0)) for item in tinted]
    # Held here: a texture shares the entry of an equal one, with which it ends.
    known = [_steps_of(item) for item, _ in wanted]
    missing = [(item, steps) for (item, _), steps in zip(wanted, known, strict=True) if not steps.errors]
    if missing:
        _remember(missing)
    return np.stack([factor * steps.errors[0] for (_, factor), steps in zip(wanted, known, strict=True)])


def step_indices(steps: NDArray[np.floating[Any]]) -> NDArray[np.int64]:
    """Return the index of the smallest of the steps of `compute_rule_errors` that is at least as long, or the last."""
    with np.errstate(divide="ignore"):
        number = np.ceil(np.log2(steps / _STEPS[0]) / np.log2(_STEPS[1] / _STEPS[0]) - _ROUNDED)
    return np.asarray(np.clip(number, 0, len(_STEPS) - 1).astype(np.int64))


@with_one_blas_thread
def _remember(missing: Sequence[tuple[SurfaceTexture, _Steps]]) -> None:
    """Find the errors of textures; together, because the limit of threads takes some ms."""
    for item, steps in missing:
        if not steps.errors:
            steps.errors.append(_rule_errors(item))


def _rule_errors(texture: SurfaceTexture) -> Floats:
    rows, columns = texture.shape
    size = np.array([columns, rows], dtype=np.float64)
    along = (np.arange(_POINTS) - _POINTS / 2) / _PER_TEXEL
    # Low-discrepancy points, so that the lines cover the texture evenly.
    number = np.arange(_LINES) + 0.5
    starts = np.column_stack([number / _LINES, (number * _GOLDEN) % 1.0]) * size
    if not texture.tiled:
        # Lines stay inside the image where it is large enough; outside, its border is extended.
        reach = np.minimum(_POINTS / _PER_TEXEL / 2, size / 2)
        starts = np.clip(starts, reach, size - reach)
    window = np.sin(np.pi * (np.arange(_POINTS) + 0.5) / _POINTS) ** 2
    powers = []
    for direction in ((1.0, 0.0), (0.0, 1.0), (0.5**0.5, 0.5**0.5), (0.5**0.5, -(0.5**0.5))):
        points = starts[:, None] + along[:, None] * np.array(direction)
        values = texture.radiance((points / size).reshape(-1, 2)).reshape(_LINES, _POINTS).astype(np.float64)
        values -= (values @ window)[:, None] / window.sum()
        spectrum = np.abs(np.fft.rfft(values * window)) ** 2
        # Both signs of every frequency; Parseval's theorem gives the mean square under the window.
        powers.append(2 * spectrum / (_POINTS * np.sum(window**2)))
    power = np.stack(powers)
    errors = []
    for squared in _squared_errors():
        lines = np.sort(power @ squared, axis=1)[:, -_LINES // _ROUGHEST :]
        # The two axes of a pixel share the error.
        errors.append(np.sqrt(2 * np.maximum.accumulate(lines.mean(axis=1).max(axis=0))))
    errors[1:] = np.minimum.accumulate(errors[1:])
    return np.stack(errors)


_FOOTPRINTS = 24  # footprints on which rules are compared, of each shape
_SHAPES = (1.0, 4.0)  # their ratios of length and width
_REFERENCE = 20  # order of the rule with which the others are compared
_TRIED = 2.0 ** (np.arange(25) / 6)  # steps that are tried, relative to the first
_SAFETY = 1.5  # factor of the error, because the footprints are few


def compute_widest_steps(texture: SurfaceTexture, error: float, least: float, most: float = np.inf) -> Floats:
    """Return the longest steps of a texture, in texels, for which the rules of `WIDE_ORDERS` are within an RMS error.

    Means over footprints of several shapes and all orientations are compared with those by a finer rule. The lines of
    `compute_longest_steps` would require more points, because they disregard the mean along the other axis of a pixel.

    ``least``: Step from which these rules are wanted. ``most``: Longest step that matters.
    """
    found = np.zeros(len(WIDE_ORDERS))
    known = _steps_of(texture).within.setdefault((error, least), {})
    for number, step in enumerate(least * _TRIED if 0 < least < np.inf else ()):
        if number not in known:
            within = _rule_differences(texture, float(step)) <= error / _SAFETY
            known[number] = within & known[number - 1] if number else within
        found[known[number]] = step
        if step >= most or not known[number][-1]:
            break
    return found


@lru_cache(maxsize=1)
def _compared_rules() -> list[Rule]:
    return [square_rule(*gauss_rule(order)) for order in (*WIDE_ORDERS, _REFERENCE)]


def _rule_differences(texture: SurfaceTexture, step: float) -> Floats:
    """Return the RMS errors of the rules of `WIDE_ORDERS` over footprints of a length, for their worst shape."""
    size = np.array(texture.shape[::-1])
    number = np.arange(_FOOTPRINTS) + 0.5
    centres = np.column_stack([number / _FOOTPRINTS, (number * _GOLDEN) % 1.0])
    angle = 2 * np.pi * ((number * _GOLDEN**2) % 1.0)
    along = step * np.column_stack([np.cos(angle), np.sin(angle)])
    across = step * np.column_stack([-np.sin(angle), np.cos(angle)])
    rules = _compared_rules()
    offsets, errors = np.concatenate([offsets for offsets, _ in rules]), []
    ends = np.cumsum([len(weights) for _, weights in rules])
    for shape in _SHAPES:
        points = offsets @ (np.stack([along, across / shape], axis=1) / size) + centres[:, None]
        values = texture.radiance(points.reshape(-1, 2)).astype(np.float64).reshape(_FOOTPRINTS, -1)
        parts = np.split(values, ends[:-1], axis=1)
        means = [part @ weights for part, (_, weights) in zip(parts, rules, strict=True)]
        errors.append([np.sqrt(np.mean((mean - means[-1]) ** 2)) for mean in means[:-1]])
    return np.asarray(np.max(errors, axis=0))
