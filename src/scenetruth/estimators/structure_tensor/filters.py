"""Separable filters: matched derivative and smoothing pairs, the window, and their selection for a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenetruth.errors import Problem
from scenetruth.estimators.method_settings import StructureTensorSettings

__all__ = [
    "DERIVATIVE",
    "DERIVATIVE_MOMENT",
    "PAPER",
    "SMOOTHING",
    "AcquisitionAxes",
    "FilterPair",
    "axis_problems",
    "choose_acquisition_axes",
    "compact_pair",
    "gaussian_window",
    "least_squares_pair",
    "pair_for",
    "transfer",
]


Array = NDArray[np.float64]

DERIVATIVE = np.array([0.0838, 0.3324, 0.0, -0.3324, -0.0838])
"""D of the paper (section 4), the derivative as a convolution kernel."""

DERIVATIVE_MOMENT = -np.arange(-2, 3) * DERIVATIVE
"""M with M_m = -m D_m: D * (x g) = x (D * g) + M * g, the difference between filtered x g and x times filtered g."""

SMOOTHING = np.array([0.0234, 0.2416, 0.4700, 0.2416, 0.0234])
"""S of the paper, the smoothing in all directions other than that of the derivative."""

# Design of the least-squares pairs: largest wave number, in radian per mean gap, at which the two filters must match
# (a registered image moves less than one pixel per step, a texture has at least six pixels per period), and the weight
# of the noise.
_BAND, _NOISE_WEIGHT = 1.0, 1e-3


@dataclass(frozen=True, eq=False)
class FilterPair:
    """A matched derivative and smoothing along one axis: D g = S ∂g for every slowly varying g.

    Both are sums of samples, out = Σ_i weight_i g(node_i); the estimate is centred at the node 0.
    """

    name: str
    """Name of the pair, with its source."""
    nodes: Array
    """Positions of the samples, in steps of the axis, relative to the centre of the estimate."""
    smoothing: Array
    """Weights of S; their sum is 1."""
    derivative: Array
    """Weights of D; the derivative of a ramp is its slope."""

    @property
    def noise_ratio(self) -> float:
        """Ratio of the white-noise power of the derivative to that of the smoothed signal, (ΣD²) / (ΣS²)."""
        return float(np.sum(self.derivative**2) / np.sum(self.smoothing**2))

    def transfer(self, wave_number: float | Array) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Return D̂(w) and Ŝ(w), complex128, for w in radian per step; matched filters have D̂(w) = i w Ŝ(w)."""
        phase = np.exp(1j * np.multiply.outer(np.asarray(wave_number, dtype=np.float64), self.nodes))
        return np.asarray(phase @ self.derivative), np.asarray(phase @ self.smoothing)


def _equidistant(name: str, smoothing: ArrayLike, derivative: ArrayLike) -> FilterPair:
    """Return a pair at unit distance, normalised to preserve a constant and the slope of a ramp."""
    s, d = np.asarray(smoothing, dtype=np.float64), np.asarray(derivative, dtype=np.float64)
    nodes = np.arange(len(s), dtype=np.float64) - (len(s) - 1) / 2
    return FilterPair(name, nodes, s / s.sum(), d / (d @ nodes))


def compact_pair(nodes: ArrayLike) -> FilterPair:
    """Return the pair that matches to the highest order that the number of nodes allows.

    Σ_i d_i f(s_i) = Σ_i a_i f'(s_i) for every polynomial f of degree 2 n - 2: the divided difference of f over all
    nodes taken twice vanishes, and gives a_i ~ Π_j (s_i - s_j)⁻² and d_i = 2 a_i Σ_j 1 / (s_i - s_j), j ≠ i. Two nodes
    give the trapezium rule, three Simpson's rule, Collatz's and Lele's compact scheme of fourth order (S. K. Lele,
    J. Comput. Phys. 103, 1992), four the scheme of sixth order between two samples.
    """
    s = np.asarray(nodes, dtype=np.float64)
    differences = s[:, None] - s[None, :]
    np.fill_diagonal(differences, 1.0)
    smoothing = 1 / np.prod(differences, axis=1) ** 2
    smoothing = np.asarray(smoothing / smoothing.sum(), dtype=np.float64)
    inverse = 1 / differences
    np.fill_diagonal(inverse, 0.0)
    derivative = 2 * smoothing * inverse.sum(axis=1)
    return FilterPair("compact scheme (Lele 1992)", s, smoothing, derivative)


def least_squares_pair(nodes: ArrayLike, band: float = _BAND, noise_weight: float = _NOISE_WEIGHT) -> FilterPair:
    """Return the pair with the best match in the least-squares sense, for samples at arbitrary positions.

    Minimises the mean of |D̂(w) - i w Ŝ(w)|² over 0 <= w <= ``band`` plus ``noise_weight``² (Σ d² + Σ a²), so that D g =
    S ∂g and noise is averaged over all samples. A constant and the slope of a ramp are preserved, and the smoothed
    signal is centred at 0.
    """
    s = np.asarray(nodes, dtype=np.float64)
    gap = (s.max() - s.min()) / (len(s) - 1)
    u = s / gap
    points, weights = np.polynomial.legendre.leggauss(40)
    w = band * (points + 1) / 2
    phase = np.exp(1j * np.outer(w, u))
    misfit = np.hstack([-1j * w[:, None] * phase, phase]) * np.sqrt(weights / 2)[:, None]
    equations = np.vstack([misfit.real, misfit.imag, noise_weight * np.eye(2 * len(u))])
    one, none = np.ones_like(u), np.zeros_like(u)
    conditions = np.array([[*one, *none], [*u, *none], [*none, *one], [*none, *u]])
    start = np.linalg.lstsq(conditions, np.array([1.0, 0.0, 0.0, 1.0]), rcond=None)[0]
    free = np.linalg.svd(conditions)[2][np.linalg.matrix_rank(conditions) :].T
    solution = start + free @ np.linalg.lstsq(equations @ free, -equations @ start, rcond=None)[0]
    smoothing, derivative = solution[: len(u)], solution[len(u) :] / gap
    return FilterPair("least squares", s, smoothing, derivative)


PAPER = _equidistant("Scharr 5 taps (Scharr and Kuesters 2002)", SMOOTHING, DERIVATIVE[::-1])
"""Filter pair of the paper as sums of samples."""

_FARID = "Farid and Simoncelli {} taps (IEEE Trans. Image Process. 13, 2004)"
_NAMED = {
    2: compact_pair([-0.5, 0.5]),
    3: compact_pair([-1, 0, 1]),
    4: compact_pair([-1.5, -0.5, 0.5, 1.5]),
    5: PAPER,
    7: _equidistant(
        _FARID.format(7),
        [0.004711, 0.069321, 0.245410, 0.361117, 0.245410, 0.069321, 0.004711],
        [-0.018708, -0.125376, -0.193091, 0.0, 0.193091, 0.125376, 0.018708],
    ),
    9: _equidistant(
        _FARID.format(9),
        [0.000721, 0.015486, 0.090341, 0.234494, 0.317916, 0.234494, 0.090341, 0.015486, 0.000721],
        [-0.003059, -0.035187, -0.118739, -0.143928, 0.0, 0.143928, 0.118739, 0.035187, 0.003059],
    ),
}


def single() -> FilterPair:
    """Return the pair of an axis with a single sample, which has no derivative."""
    return FilterPair("one sample", np.zeros(1), np.ones(1), np.zeros(1))


def pair_for(nodes: ArrayLike) -> FilterPair:
    """Return the preferred pair for samples at specified positions.

    Equidistant samples around 0 have the published pair for their number (2, 3, 4, 5, 7, 9); two other samples have
    the compact pair, and all others the least-squares pair.
    """
    s = np.asarray(nodes, dtype=np.float64)
    count = len(s)
    if count == 1:
        return single()
    gap = (s[-1] - s[0]) / (count - 1)
    even = gap * (np.arange(count) - (count - 1) / 2)
    if count in _NAMED and np.allclose(s, even, rtol=0, atol=1e-9 * abs(gap)):
        named = _NAMED[count]
        return FilterPair(named.name, s, named.smoothing, named.derivative / gap)
    if count == 2:
        return compact_pair(s)
    return least_squares_pair(s)


def gaussian_window(sigma: float, taps: int) -> Array:
    """Return the weights of a Gaussian window, shape (taps,), with the sum 1."""
    offsets = np.arange(taps) - taps // 2
    weights = np.exp(-(offsets**2) / (2 * sigma**2))
    return np.asarray(weights / weights.sum())


def transfer(wave_number: float | NDArray[Any]) -> tuple[Array, Array]:
    """Return the transfer functions of the two filters of the paper.

    The derivative filter multiplies exp(i w n) by i D̂(w), D̂(w) = 2 Σ d_j sin jw; the smoothing filter multiplies it by
    Ŝ(w) = s_0 + 2 Σ s_j cos jw. For a pattern cos(k x) that moves by u per step, the estimated displacement is
    D̂(k u) Ŝ(k) / (D̂(k) Ŝ(k u)).

    ``wave_number``: w in radian per sample, any shape.
    Returns: D̂ and Ŝ, of the same shape.
    """
    derivative, smoothing = PAPER.transfer(np.asarray(wave_number, dtype=np.float64))
    return np.asarray(derivative.imag), np.asarray(smoothing.real)


REACH = len(PAPER.nodes) // 2
"""Half-width of the filters in x and y, in px."""


@dataclass(frozen=True, eq=False)
class AcquisitionAxes:
    """Axes s and t of a recording, with their filters."""

    positions: Array
    """Position of each camera in steps, X_s / V_X; the reference is at 0."""
    centre_s: float
    """Centre of the estimate among the cameras, in steps; 0 unless the cameras are on one side or even in number."""
    over_s: FilterPair
    over_t: FilterPair
    window_t: Array

    @property
    def frames(self) -> int:
        """Number of frames required by one estimate."""
        return len(self.over_t.nodes) + len(self.window_t) - 1

    @property
    def before(self) -> int:
        """Number of these frames before the estimated frame."""
        return (self.frames - 1) // 2

    @property
    def centre_t(self) -> float:
        """Centre of the estimate relative to that frame: 0, or half a frame for two frames."""
        return (self.frames - 1) / 2 - self.before

    @property
    def sees_depth(self) -> bool:
        """Whether there is more than one camera."""
        return len(self.positions) > 1

    @property
    def sees_motion(self) -> bool:
        """Whether there is more than one frame."""
        return self.frames > 1

    def outputs(self, count_t: int) -> NDArray[np.int64]:
        """Return the frames that can be estimated."""
        return np.arange(count_t - self.frames + 1) + self.before


def choose_acquisition_axes(positions: Array, count_t: int, settings: StructureTensorSettings) -> AcquisitionAxes:
    """Return the filters and the window for the cameras and frames of a recording.

    Along s, all cameras contribute to one derivative. It is centred at the reference if the others surround it evenly,
    else at their mean position. Along t, the longest possible filter of 2, 3 or 5 taps is used, then the longest
    possible window up to that of the settings.
    """
    middle = float(positions.mean())
    gap = (positions.max() - positions.min()) / max(len(positions) - 1, 1)
    centre_s = 0.0 if abs(middle) < gap / 4 else middle
    taps = {1: 1, 2: 2, 3: 3, 4: 3}.get(count_t, 5)
    room = count_t - taps + 1 if taps == 5 else 1
    window = min(settings.window_taps_frames, room - (room + 1) % 2)
    return AcquisitionAxes(
        positions=positions,
        centre_s=centre_s,
        over_s=pair_for(positions - centre_s),
        over_t=pair_for(np.arange(taps) - (taps - 1) / 2),
        window_t=gaussian_window(settings.window_sigma_frames, window),
    )


def axis_problems(
    settings: StructureTensorSettings, cameras: int, frames: int, width: int, height: int
) -> list[Problem]:
    """Return the problems of a recording that is too small for the filters and the window, sizes in px."""
    border = 2 * REACH + settings.window_taps_px
    problems = []
    if cameras == 1 and frames == 1:
        message = "one image determines neither depth nor motion; 2 camera positions or 2 frames are required"
        problems.append(Problem("stage.positions", message, cameras))
    for name, size in (("camera.width", width), ("camera.height", height)):
        if size < border:
            problems.append(Problem(name, f"is too small: filters and window require {border} px", size))
    return problems
