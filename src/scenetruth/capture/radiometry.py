"""Radiometry from frames: photon transfer, fixed patterns, defective pixels, linearity and gamma."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from scenetruth.camera.sensor import QUANTISATION_VARIANCE, fit_response_line
from scenetruth.capture.image_reading import FrameMoments, frame_moments
from scenetruth.errors import ArgumentError, Problem
from scenetruth.number_format import format_with_std

__all__ = [
    "GammaFit",
    "Linearity",
    "SensorNoise",
    "compare_exposures",
    "find_defects",
    "fit_gamma",
    "measure_linearity",
    "measure_noise",
]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Frames = FrameMoments | ArrayLike

_BLOCKS = 8  # blocks along either axis for standard uncertainties (jackknife)
_DEGREE, _FITTED_PIXELS = 4, 100_000
_BINS = 24
_LEAST_BIN = 50
_SMALLEST_VARIANCE = 0.24
"""Temporal variance in DN² below which rounding hides the noise (EMVA 1288, release 3.1, section 2.3)."""
_MOST_CLIPPED = 0.01
_LEAST_RANGE = 2.0  # ratio of the brightest to the darkest bin for a fit of gamma


@dataclass(frozen=True)
class SensorNoise:
    """Noise of a sensor, measured from frames; each value has its standard uncertainty, NaN where it is not measured.

    ``gain_dn_per_e``: K, overall system gain.
    ``black_level_dn``: Mean dark frame.
    ``dark_noise_dn``: Temporal noise without light, in DN, with quantisation.
    ``temporal_dark_noise_e``: σ_d in electrons, without quantisation noise.
    ``dsnu_e``: Standard deviation between the pixels of the mean dark frame, in electrons.
    ``prnu``: Standard deviation of the sensitivities of pixels, relative to a smooth field of degree 4.
    ``notes``: Why values are missing or uncertain.

    See Also
    --------
    measure_noise : Measures it.

    Examples
    --------
    >>> noise = SensorNoise(0.4, 0.001, 16, 0.01, 0.9, 0.01, 2.1, 0.03, 0.5, 0.01, 0.005, 0.0001)
    >>> round(float(noise.variance_dn2(1016.0)), 2), noise.describe()[0]
    (400.81, 'gain K: 0.4000 ± 0.0010 DN per electron')
    """

    gain_dn_per_e: float
    gain_std: float
    black_level_dn: float
    black_level_std: float
    dark_noise_dn: float
    dark_noise_std: float
    temporal_dark_noise_e: float
    temporal_dark_noise_std: float
    dsnu_e: float
    dsnu_std: float
    prnu: float
    prnu_std: float
    notes: tuple[str, ...] = ()

    def variance_dn2(self, values: ArrayLike) -> Floats:
        """Return the temporal variance in DN² of digital numbers: K (value - black level) + σ² of the dark frame."""
        light = np.asarray(values, dtype=np.float64) - self.black_level_dn
        return np.asarray(self.gain_dn_per_e * np.maximum(light, 0.0) + self.dark_noise_dn**2)

    def describe(self) -> list[str]:
        """Return one line for each measured value."""
        rows = (
            ("gain K", self.gain_dn_per_e, self.gain_std, "DN per electron", 1.0),
            ("black level", self.black_level_dn, self.black_level_std, "DN", 1.0),
            ("dark noise", self.temporal_dark_noise_e, self.temporal_dark_noise_std, "electrons", 1.0),
            ("DSNU", self.dsnu_e, self.dsnu_std, "electrons", 1.0),
            ("PRNU", self.prnu, self.prnu_std, "%", 100.0),
        )
        return [
            f"{name}: {format_with_std(k * value, k * std, 8) if value else f'under {2 * k * std:.2g}'} {unit}"
            for name, value, std, unit, k in rows
            if np.isfinite(value)
        ] + list(self.notes)


def measure_noise(
    dark: Frames, flat: Frames | None = None, *, static: Frames | None = None, full_scale: float
) -> SensorNoise:
    """Measure gain, noise and fixed patterns of a sensor from dark frames and flat fields, or frames of a static scene.

    Parameters
    ----------
    dark
        Frames without light, shape (n, y, x), in digital numbers, or their moments; two at least.
    flat
        Frames of a uniformly bright surface at 20 to 80 % of full scale; two at least. A smooth fall-off is permitted.
    static
        Frames of any textured scene at rest, with the camera at rest, used for the gain where there are no flats;
        three at least.
    full_scale
        Largest digital number.

    Returns
    -------
    SensorNoise
        Values and standard uncertainties; NaN with a note where the frames do not determine a value.

    Raises
    ------
    ArgumentError
        If there are too few frames, or they do not fit together; lists every problem.

    See Also
    --------
    scenetruth.camera.photon_transfer : The complete measurement of EMVA 1288, with photon counts.
    find_defects : Defective pixels from the same frames.

    Notes
    -----
    The gain is the mean temporal variance over the mean, both less those of the dark frames. A flicker of the light
    between frames is taken out by the variance of the means of frames. The temporal variance of dark frames contains
    1/12 DN² of rounding; below 0.24 DN² rounding hides the noise, which is then not stated. Standard uncertainties are
    those of a jackknife over 64 blocks of the image.

    Examples
    --------
    >>> draw = np.random.default_rng(1)
    >>> dark = np.rint(16 + 2 * draw.standard_normal((8, 100, 120)))
    >>> flat = np.rint(16 + 0.5 * draw.poisson(2000, (16, 100, 120)) + 2 * draw.standard_normal((16, 100, 120)))
    >>> noise = measure_noise(dark, flat, full_scale=4095)
    >>> abs(noise.gain_dn_per_e - 0.5) < 3 * noise.gain_std, round(noise.temporal_dark_noise_e, 1)
    (True, 4.0)
    """
    problems: list[Problem] = []
    without = _moments("dark", dark, 2, problems)
    lit = None if flat is None else _moments("flat", flat, 2, problems)
    still = None if static is None else _moments("static", static, 3, problems)
    for name, moments in (("flat", lit), ("static", still)):
        if moments is not None and without is not None and moments.mean.shape != without.mean.shape:
            message = f"must have the shape {without.mean.shape} of the dark frames"
            problems.append(Problem(name, message, moments.mean.shape))
    if lit is not None and without is not None and not problems and lit.mean.mean() <= without.mean.mean():
        problems.append(Problem("flat", "is not brighter than the dark frames: are they exchanged?"))
    if problems or without is None:
        raise ArgumentError(problems, source="measure_noise")
    notes = []
    clipped = float(np.mean(without.lowest <= 0))
    if clipped > _MOST_CLIPPED:
        notes.append(f"{100 * clipped:.3g} % of the dark pixels reach 0: the black level is too low, noise is cut off")
    blocks = _block_numbers(without.mean.shape)
    good = without.highest < full_scale
    if not good.any():
        message = f"reaches the full scale of {full_scale:g} everywhere: it has light, or the full scale is another"
        raise ArgumentError([Problem("dark", message)], source="measure_noise")
    black = _jackknife(lambda means: means[0], blocks, good, without.mean)
    dark_variance = _jackknife(lambda means: means[0], blocks, good, without.variance)
    gain, prnu = (np.nan, np.nan), (np.nan, np.nan)
    if lit is not None:
        unsaturated = good & (lit.highest < full_scale)
        saturated = 1 - float(unsaturated.mean())
        if saturated > _MOST_CLIPPED:
            notes.append(f"{100 * saturated:.3g} % of the pixels are saturated in a flat field, and excluded")
        if unsaturated.mean() > 0.5:
            gain, prnu = _from_flats(without, lit, unsaturated, blocks)
        else:
            notes.append("flat fields are saturated: gain and PRNU are not determined")
    elif still is not None:
        gain = _from_static(without, still, full_scale, notes)
    else:
        notes.append("gain and PRNU need flat fields, or for the gain alone frames of a static scene")
    noise_dn = float(np.sqrt(dark_variance[0]))
    noise_dn_std = dark_variance[1] / (2 * noise_dn) if noise_dn > 0 else np.nan
    temporal = (np.nan, np.nan)
    if dark_variance[0] < _SMALLEST_VARIANCE:
        notes.append("rounding to digital numbers hides the dark noise, which is below 0.4 DN")
    elif clipped <= _MOST_CLIPPED:
        noise_e = float(np.sqrt(dark_variance[0] - QUANTISATION_VARIANCE)) / gain[0]
        relative = np.hypot(0.5 * dark_variance[1] / (dark_variance[0] - QUANTISATION_VARIANCE), gain[1] / gain[0])
        temporal = (noise_e, noise_e * float(relative))
    dsnu = _root(_spatial_variance(without.mean - black[0], without.variance / without.count, blocks, good))
    dsnu_e = dsnu[0] / gain[0]
    dsnu_std = dsnu_e * float(np.hypot(dsnu[1] / dsnu[0], gain[1] / gain[0])) if dsnu[0] > 0 else np.nan
    return SensorNoise(
        *gain, *black, noise_dn, noise_dn_std, *temporal, dsnu_e, dsnu_std, *prnu, notes=tuple(notes)
    )  # fmt: skip


def _moments(name: str, frames: Any, least: int, problems: list[Problem]) -> FrameMoments | None:
    if isinstance(frames, FrameMoments):
        found = frames
    else:
        values = np.asarray(frames)
        if values.ndim != 3 or values.dtype.kind not in "iuf":
            problems.append(Problem(name, "must be frames of numbers, shape (n, y, x)", values.shape))
            return None
        found = frame_moments(values)
    if found.count < least:
        problems.append(Problem(name, f"must have {least} frames at least", found.count))
        return None
    if found.mean.ndim != 2 or min(found.mean.shape) < _BLOCKS:
        problems.append(Problem(name, f"must have grey frames of {_BLOCKS} x {_BLOCKS} px at least", found.mean.shape))
        return None
    return found


def _block_numbers(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the number of the block of every pixel."""
    row, column = (np.arange(size) * _BLOCKS // size for size in shape)
    return np.asarray(row[:, None] * _BLOCKS + column)


def _jackknife(
    function: Callable[[Floats], Any], blocks: NDArray[np.int64], good: Mask, *maps: Floats
) -> tuple[float, float]:
    """Return a statistic of the means of maps over the good pixels, and its standard uncertainty.

    ``function``: Statistic of the means, one for each map.

    The uncertainty follows from leaving out one block at a time.
    """
    numbers = blocks[good]
    counts = np.bincount(numbers, minlength=_BLOCKS**2)
    sums = np.stack([np.bincount(numbers, each[good], minlength=_BLOCKS**2) for each in maps])
    whole = function(sums.sum(axis=1) / counts.sum())
    rest = counts.sum() - counts
    without = (sums.sum(axis=1)[:, None] - sums) / np.maximum(rest, 1)
    parts = np.array([float(function(without[:, number])) for number in np.flatnonzero((counts > 0) & (rest > 0))])
    count = len(parts)
    spread = np.sqrt((count - 1) / count * np.sum((parts - parts.mean()) ** 2)) if count else np.nan
    return float(whole), float(spread)


def _spatial_variance(
    values: Floats, noise: Floats, blocks: NDArray[np.int64], good: Mask
) -> tuple[float, float]:  # fmt: skip
    """Return the variance between pixels of values near 0, less that of their noise, and its standard uncertainty."""
    return _jackknife(lambda means: means[1] - means[0] ** 2 - means[2], blocks, good, values, values**2, noise)


def _root(value: tuple[float, float]) -> tuple[float, float]:
    """Return the square root of a variance, 0 of a negative one, with its standard uncertainty."""
    if value[0] <= 0:
        return 0.0, float(np.sqrt(value[1]))
    return float(np.sqrt(value[0])), value[1] / (2 * float(np.sqrt(value[0])))


def _from_flats(
    dark: FrameMoments, flat: FrameMoments, good: Mask, blocks: NDArray[np.int64]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return gain and PRNU with their standard uncertainties."""
    light = flat.mean - dark.mean
    variance = flat.variance - _flicker(flat, dark) * light**2
    gain = _jackknife(lambda means: (means[0] - means[1]) / means[2], blocks, good, variance, dark.variance, light)
    smooth = _smooth_field(light, good)
    # Noise that remains in the means of the frames.
    rest = (variance / flat.count + dark.variance / dark.count) / smooth**2
    return gain, _root(_spatial_variance(light / smooth - 1, rest, blocks, good))


def _flicker(flat: FrameMoments, dark: FrameMoments) -> float:
    """Return the relative variance of the light from frame to frame."""
    means = flat.frame_means - dark.mean.mean()
    expected = float(flat.variance.mean()) / flat.mean.size
    return max(float(np.var(means, ddof=1)) - expected, 0.0) / float(means.mean()) ** 2


def _smooth_field(values: Floats, good: Mask) -> Floats:
    """Return the polynomial of degree 4 in both coordinates that fits the good pixels, of which 10⁵ are enough."""
    y, x = (np.linspace(-1, 1, size) for size in values.shape)
    powers = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
    step = max(int(np.sqrt(values.size / _FITTED_PIXELS)), 1)
    used = good[::step, ::step]
    rows, columns = (np.broadcast_to(each, used.shape)[used] for each in (y[::step, None], x[::step]))
    matrix = np.stack([columns**i * rows**j for i, j in powers], axis=1)
    found = np.linalg.solve(matrix.T @ matrix, matrix.T @ values[::step, ::step][used])
    weights = np.zeros((_DEGREE + 1, _DEGREE + 1))
    for (i, j), weight in zip(powers, found, strict=True):
        weights[j, i] = weight
    return np.asarray(
        np.vander(y, _DEGREE + 1, increasing=True) @ weights @ np.vander(x, _DEGREE + 1, increasing=True).T
    )


@dataclass(frozen=True, eq=False)
class _Bins:
    """Temporal variance over mean, of pixels grouped by their mean."""

    mean: Floats
    variance: Floats
    std: Floats


_CLEAR_OF_ZERO = 4.0  # least mean of a pixel in standard deviations of the noise about 0


def _binned(moments: FrameMoments, full_scale: float) -> _Bins:
    """Group pixels that are neither saturated nor at 0 by their mean.

    Where noise reaches 0, pixels that are never at 0 are a selection: all near 0 are omitted.
    """
    good, cut = (moments.highest < full_scale) & (moments.lowest > 0), moments.lowest <= 0
    if cut.any():
        # Noise about 0 that is cut off has half of its mean square.
        noise = np.sqrt(2 * np.median(moments.mean[cut] ** 2 + moments.variance[cut]))
        good &= moments.mean > _CLEAR_OF_ZERO * noise
    mean, variance = moments.mean[good], moments.variance[good]
    order = np.argsort(mean, kind="stable")
    groups = [group for group in np.array_split(order, _BINS) if len(group) >= _LEAST_BIN]
    rows = [
        (mean[group].mean(), variance[group].mean(), variance[group].std() / np.sqrt(len(group))) for group in groups
    ]
    return _Bins(*(np.array([row[n] for row in rows]) for n in range(3)))


def _from_static(dark: FrameMoments, static: FrameMoments, full_scale: float, notes: list[str]) -> tuple[float, float]:
    """Return the gain from the line of variance over mean that passes through the dark frames."""
    bins = _binned(static, full_scale)
    light = bins.mean - dark.mean.mean()
    use = light > 0.02 * full_scale
    if use.sum() < 3:
        notes.append("the static frames are too dark or saturated: the gain is not determined")
        return np.nan, np.nan
    light, more = light[use], bins.variance[use] - float(dark.variance.mean())
    weight = 1 / np.maximum(bins.std[use], 1e-12) ** 2
    gain = float(np.sum(weight * light * more) / np.sum(weight * light**2))
    misfit = float(np.sum(weight * (more - gain * light) ** 2) / (use.sum() - 1))
    if misfit > _MOST_MISFIT:
        notes.append(
            f"variance over mean of the static frames is no line (χ² of {misfit:.3g} per degree of freedom): the scene "
            "or the camera moved, the light flickered, or the values are not linear"
        )
    return gain, float(np.sqrt(max(misfit, 1.0) / np.sum(weight * light**2)))


_MOST_MISFIT = 3.0


@dataclass(frozen=True)
class GammaFit:
    """Exponent of the response, from the temporal noise: 1 for linear values, 0.45 for values encoded for a display.

    ``exponent``, ``std``: Exponent of digital number over light, and its standard uncertainty.

    See Also
    --------
    fit_gamma : Fits it.

    Examples
    --------
    >>> GammaFit(0.45, 0.02).linear, GammaFit(1.02, 0.02).linear, GammaFit(0.8, 0.3).linear
    (False, True, None)
    """

    exponent: float
    std: float

    @property
    def linear(self) -> bool | None:
        """Whether the values are linear; None if the frames do not decide."""
        if not np.isfinite(self.exponent) or self.std > _MOST_GAMMA_STD:
            return None
        return bool(abs(self.exponent - 1) < max(_LEAST_GAMMA, 4 * self.std))


_MOST_GAMMA_STD, _LEAST_GAMMA = 0.1, 0.1


def fit_gamma(frames: Frames, *, full_scale: float, dark: Frames | None = None) -> GammaFit:
    """Fit the exponent of the response from the temporal noise of frames at rest.

    Parameters
    ----------
    frames
        Frames of a static scene or of a flat field with fall-off, shape (n, y, x), or their moments; three at least.
    full_scale
        Largest digital number.
    dark
        Frames without light, which extend the range.

    Returns
    -------
    GammaFit
        The exponent; NaN if the frames do not cover a ratio of 2 in brightness.

    Raises
    ------
    ArgumentError
        If there are too few frames; lists every problem.

    See Also
    --------
    measure_linearity : The exponent from flat fields of several exposures.

    Notes
    -----
    With y = F (x / F)^γ and shot noise, the variance of y is (γ (y / F)^(1 - 1/γ))² (K x + c) + 1/12, which is fitted
    for γ, K and c to the variance of 24 groups of pixels of equal mean. Linear values have a variance that is linear in
    the mean; encoded values have nearly the same noise at all brightnesses. Exponents from 0.25 to 1.4 are considered:
    cameras encode with less than 1. Without dark frames an exponent of 0.45 with shot noise cannot be distinguished
    from 0.9 with noise that does not depend on light; the standard uncertainty then covers both.

    Examples
    --------
    >>> draw = np.random.default_rng(1)
    >>> light = 20 + draw.poisson(np.broadcast_to(np.linspace(100, 9000, 120), (9, 100, 120)))
    >>> dark = 20 + draw.poisson(4, (9, 100, 120))
    >>> frames = {gamma: [np.rint(4095 * (each / 10000) ** gamma) for each in (light, dark)] for gamma in (1.0, 0.45)}
    >>> [fit_gamma(bright, full_scale=4095, dark=without).linear for bright, without in frames.values()]
    [True, False]
    """
    from scipy.optimize import least_squares

    problems: list[Problem] = []
    found = _moments("frames", frames, 3, problems)
    without = None if dark is None else _moments("dark", dark, 2, problems)
    if problems or found is None:
        raise ArgumentError(problems, source="fit_gamma")
    bins = _binned(found, full_scale)
    use = bins.variance > _SMALLEST_VARIANCE
    means, variances, stds = bins.mean[use], bins.variance[use], bins.std[use]
    if len(means) < _LEAST_BINS:
        return GammaFit(np.nan, np.nan)
    # Noise without light is positive, which the black level places on the scale of digital numbers.
    dark_share, hidden = means[0] / full_scale, False
    if without is not None and without.mean.mean() > 0:
        dark_share = float(without.mean.mean()) / full_scale
        hidden = bool(without.variance.mean() <= _SMALLEST_VARIANCE)
        if not hidden:
            means = np.append(without.mean.mean(), means)
            variances = np.append(without.variance.mean(), variances)
            stds = np.append(without.variance.std() / np.sqrt(without.variance.size), stds)
    if means[-1] < _LEAST_RANGE * means[0]:
        return GammaFit(np.nan, np.nan)
    share = means / full_scale
    relative = np.maximum(stds / variances, _LEAST_RELATIVE)

    def model(values: Floats) -> Floats:
        # The noise of light is a line through its values without light and at the brightest group.
        gamma, low, high = np.exp(values)
        light, none = share ** (1 / gamma), dark_share ** (1 / gamma)
        noise = low + (high - low) * (light - none) / (light[-1] - none)
        return np.asarray((gamma * share ** (1 - 1 / gamma)) ** 2 * np.maximum(noise, 1e-12) + QUANTISATION_VARIANCE)

    def residuals(values: Floats) -> Floats:
        found = (np.log(model(values)) - np.log(variances)) / relative
        if not hidden:
            return np.asarray(found)
        # Noise that rounding hides is small.
        dark_noise = 2 * (values[0] + (1 - np.exp(-values[0])) * np.log(dark_share)) + values[1]
        return np.append(found, max(dark_noise - np.log(_SMALLEST_VARIANCE), 0.0) / _HIDDEN_STD)

    fits = []
    for start in _GAMMA_STARTS:
        ends = variances[[0, -1]] / (start * share[[0, -1]] ** (1 - 1 / start)) ** 2
        guess = np.append(np.log(start), np.log(ends))
        bounds = (
            np.append(np.log(_GAMMA_RANGE[0]), guess[1:] - 20),
            np.append(np.log(_GAMMA_RANGE[1]), guess[1:] + 20),
        )
        fits.append(least_squares(residuals, guess, bounds=bounds))
    best = min(fits, key=lambda fit: fit.cost)
    scale = max(2 * best.cost / max(len(means) - 3, 1), 1.0)
    try:
        std = float(np.sqrt(np.linalg.inv(best.jac.T @ best.jac)[0, 0] * scale))
    except np.linalg.LinAlgError:
        return GammaFit(np.nan, np.nan)
    # Another minimum that the noise does not exclude makes the exponent uncertain by its distance.
    others = [fit.x[0] - best.x[0] for fit in fits if 2 * (fit.cost - best.cost) < _SURE * scale]
    std = max(std, max(map(abs, others)) / 2)
    exponent = float(np.exp(best.x[0]))
    if not 1.01 * _GAMMA_RANGE[0] < exponent < 0.99 * _GAMMA_RANGE[1]:
        return GammaFit(np.nan, np.nan)
    return GammaFit(exponent, exponent * std)


_GAMMA_STARTS, _SURE, _HIDDEN_STD = (0.4, 0.55, 0.75, 1.0), 25.0, 0.2
_LEAST_BINS, _GAMMA_RANGE = 5, (0.25, 1.4)
_LEAST_RELATIVE = 1e-3


@dataclass(frozen=True)
class Linearity:
    """Linearity of the response from flat fields of several exposure times.

    ``error``: Largest relative deviation of the mean from a fitted line.
    ``exponent``, ``exponent_std``: Exponent of the mean over the exposure time, 1 if linear.

    See Also
    --------
    measure_linearity : Measures it.

    Examples
    --------
    >>> Linearity(0.001, 1.0, 0.002).error
    0.001
    """

    error: float
    exponent: float
    exponent_std: float


def measure_linearity(
    exposure_times_s: Sequence[float], means_dn: Sequence[float], *, std_dn: Sequence[float] | float = 0.0
) -> Linearity:
    """Measure the linearity of the response from flat fields of several exposure times.

    Parameters
    ----------
    exposure_times_s
        Exposure times in s, of which two differ at least.
    means_dn
        Means of the flat fields less the dark frames, in digital numbers, positive and below saturation.
    std_dn
        Standard uncertainties of the means.

    Returns
    -------
    Linearity
        Deviation from a line (three levels or more, else from proportionality), and exponent.

    Raises
    ------
    ArgumentError
        If the numbers do not fit together; lists every problem.

    See Also
    --------
    fit_gamma : The exponent from the noise, without a series of exposures.

    Examples
    --------
    >>> linear = measure_linearity([0.001, 0.002, 0.004], [500, 1000, 2000])
    >>> round(linear.error, 6), round(linear.exponent, 6)
    (0.0, 1.0)
    """
    times, means = (np.asarray(each, dtype=np.float64) for each in (exposure_times_s, means_dn))
    problems = []
    if times.ndim != 1 or times.shape != means.shape or len(np.unique(times)) < 2:
        problems.append(Problem("exposure_times_s", "must hold two different times at least, one for each mean"))
    elif not ((times > 0).all() and np.isfinite(times).all()):
        problems.append(Problem("exposure_times_s", "must be positive", times.tolist()))
    elif not ((means > 0).all() and np.isfinite(means).all()):
        problems.append(
            Problem("means_dn", "must be positive: subtract the dark frames of each exposure", means.tolist())
        )
    if problems:
        raise ArgumentError(problems, source="measure_linearity")
    log_times, log_means = np.log(times), np.log(means)
    centred = log_times - log_times.mean()
    exponent = float(np.sum(centred * log_means) / np.sum(centred**2))
    relative = np.broadcast_to(np.asarray(std_dn, dtype=np.float64), means.shape) / means
    std = float(np.sqrt(np.sum((centred * relative) ** 2)) / np.sum(centred**2))
    if len(times) > 2:
        _, error = fit_response_line(times, means)
    else:
        rates = means / times
        error = float(abs(rates[0] - rates[1]) / rates.sum())
    return Linearity(float(error), exponent, std)


@cache
def _largest_variance_ratio(count: int) -> float:
    """Return the ratio to its mean that a variance of ``count`` normal values exceeds once in 10⁹ draws."""
    from scipy.stats import chi2

    return float(chi2.isf(1e-9, count - 1) / (count - 1))


def find_defects(dark: Frames, flat: Frames | None = None, *, threshold: float = 8.0) -> Mask:
    """Mark defective pixels: bright or noisy without light, or of unusual sensitivity.

    Parameters
    ----------
    dark
        Frames without light, shape (n, y, x), or their moments; two at least.
    flat
        Frames of a uniformly bright surface; default: sensitivities are not tested.
    threshold
        Number of robust standard deviations (from the median absolute deviation) at which a pixel is unusual.

    Returns
    -------
    numpy.ndarray
        Boolean, shape (y, x), True where a pixel is defective; an argument ``defects`` of `correct_images`.

    Raises
    ------
    ArgumentError
        If there are too few frames, or they do not fit together; lists every problem.

    See Also
    --------
    scenetruth.correct_images : Marks these pixels as invalid.

    Examples
    --------
    >>> dark = 16 + np.random.default_rng(1).normal(0, 2, (8, 40, 50))
    >>> dark[:, 7, 9] += 300
    >>> np.argwhere(find_defects(dark)).tolist()
    [[7, 9]]
    """
    problems: list[Problem] = []
    without = _moments("dark", dark, 2, problems)
    lit = None if flat is None else _moments("flat", flat, 2, problems)
    if lit is not None and without is not None and lit.mean.shape != without.mean.shape:
        message = f"must have the shape {without.mean.shape} of the dark frames"
        problems.append(Problem("flat", message, lit.mean.shape))
    if not threshold > 0:
        problems.append(Problem("threshold", "must be positive", threshold))
    if problems or without is None:
        raise ArgumentError(problems, source="find_defects")
    temporal = float(np.median(without.variance))
    floor = float(np.sqrt((temporal + QUANTISATION_VARIANCE) / without.count))
    bad = np.abs(without.mean - np.median(without.mean)) > threshold * max(_robust_std(without.mean), floor)
    # Averages over pixels of chi-squared variables: the median is below the mean for few frames.
    typical = max(float(np.mean(np.minimum(without.variance, 20 * temporal))), QUANTISATION_VARIANCE)
    bad |= without.variance > max(_largest_variance_ratio(without.count), threshold) * typical
    if lit is not None:
        light = lit.mean - without.mean
        ratio = light / _smooth_field(light, ~bad)
        bad |= np.abs(ratio - 1) > max(threshold * _robust_std(ratio[~bad]), _LEAST_RESPONSE)
    return np.asarray(bad)


_LEAST_RESPONSE = 0.1


def _robust_std(values: Floats) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def compare_exposures(recording: xr.Dataset, *, black_level_dn: float = 0.0) -> xr.DataArray:
    """Return the brightness of every image relative to the other frames of its position.

    Parameters
    ----------
    recording
        Recording of linear images.
    black_level_dn
        Digital number without light; 0 for corrected images.

    Returns
    -------
    xarray.DataArray
        Median grey value less the black level, over its median along t, dimensions ([s_y, ]s, t); NaN for missing
        images. 1 where light, exposure and scene do not change.

    Raises
    ------
    ArgumentError
        If an image is not brighter than the black level.

    See Also
    --------
    scenetruth.estimate : Methods that model changes of brightness.

    Examples
    --------
    >>> import scenetruth as st
    >>> images = np.full((2, 5, 20, 30), 100, dtype=np.uint8)
    >>> images[1, 3] = 104
    >>> compare_exposures(st.make_recording(images, 100, 5)).values[1].tolist()
    [1.0, 1.0, 1.0, 1.04, 1.0]
    """
    image = recording["image"]
    leading = [dim for dim in image.dims if dim in ("s_y", "s", "t")]
    medians = np.full([image.sizes[dim] for dim in leading], np.nan)
    for index in np.ndindex(*medians.shape):
        values = image.isel(dict(zip(leading, index, strict=True))).values
        values = values[np.isfinite(values)]
        if values.size:
            medians[index] = float(np.median(values)) - black_level_dn
    if (medians <= 0).any():
        message = "must be below the median of every image"
        raise ArgumentError([Problem("black_level_dn", message, black_level_dn)], source="compare_exposures")
    known = np.isfinite(medians).any(axis=-1)
    usual = np.full(medians.shape[:-1], np.nan)
    usual[known] = np.nanmedian(medians[known], axis=-1)
    coordinates = {dim: recording[dim].values for dim in leading if dim in recording.coords}
    return xr.DataArray(
        medians / usual[..., None], coordinates, leading, "relative_exposure", {"units": "1", "long_name": "brightness"}
    )
