"""Detection of convention mismatches: wrong sign, unit, origin or order, and shifts by one or half a pixel."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtrit

from scenetruth.errors import Problem, ScoreError
from scenetruth.schema import label, read_intrinsics
from scenetruth.scoring.convention_hypotheses import (
    LEAST_RATIO,
    NO_MISMATCH,
    ConventionMismatch,
    MismatchHypothesis,
    nearest_scale,
    select_meaning_hypotheses,
)
from scenetruth.scoring.convention_samples import (
    POSITION_HYPOTHESES,
    MismatchSamples,
    SamplePositions,
    fit_factor,
    lengths,
    read_mismatch_samples,
    weighted_median,
)

__all__ = ["MismatchVerdict", "ShiftFit", "detect_convention_mismatches", "fit_shift"]


Map = NDArray[np.float64]

LEAST_PIXELS = 50
"""Minimum number of valid pixels; with fewer, a mismatch could be detected by chance."""
_PIXELS = 1500
"""Maximum number of pixels that are evaluated."""
_LEAST_EXPLAINED = 0.6
"""Minimum fraction of the residual that undoing a mismatch removes; undoing an absent mismatch increases it."""
_LEAST_SHARE = 0.75
"""Minimum fraction of the change by a mismatch at pixels closer to the mismatch than to the truth; random: < 0.5."""

_GLANCED = 500
_GLANCED_SHARE = 0.4
"""Of at most ``_GLANCED`` pixels; hypotheses with a smaller fraction are rejected before the full evaluation."""
_GAIN = 0.05
"""Range of method bias, as a fraction of the value, that is evidence neither for nor against a mismatch. Only what a
mismatch explains beyond a gain in this range counts: an approach by 1 % per frame is equivalent to a bias of 1 %."""
_LEAST_CHANGE = 1e-4
"""Smallest change by a mismatch, as a fraction of the values; smaller changes are rounding errors."""
_LARGEST_GAIN = 0.2
"""Largest logarithm of the gain that may remain after a mismatch; a larger gain indicates another mismatch."""
_OF_VALUES = 0.5
"""Largest residual that may remain after a mismatch, as a fraction of the values; noise alone exceeds it."""
_TRUSTED_SCALE = (0.8, 1.25)
"""Range of the ratio of estimate to truth within which the unit is not tested."""
_WINDOW_PX = 16.0
"""Least side of the blocks whose pixels count as one observation: errors of a method correlate within its windows, and
in time."""
_CHANCE = 1e-4
"""Largest probability of a statistic at its limit that holds by chance; some hundred hypotheses are tested."""
_LEAST_SLOPE = 0.5
"""Least change of the estimate, as a fraction of that by a mismatch: beyond, it is closer to the mismatch."""
_OF_SCALE = 0.5
"""Share of the logarithm of a scale beyond which it follows from depth, which velocity is proportional to."""
_EQUAL = 1.1
"""Ratio of residuals up to which the preferred explanation is chosen."""


@dataclass(frozen=True)
class MismatchVerdict:
    """Detected mismatches.

    ``explained``: Fraction of the residual that is removed by undoing them.
    ``errors``: Remaining error at every evaluated pixel, in the units of the truth; NaN where undefined.
    """

    hypothesis: MismatchHypothesis
    explained: float
    errors: Map = field(repr=False)


def search_mismatches(material: MismatchSamples, depth: MismatchSamples | None = None) -> MismatchVerdict | None:
    """Return the mismatches that explain most of an estimate's residual, or None.

    Every combination of one mismatch of position, meaning and scale each is compared with a correct estimate.
    ``depth``: Depth of the same estimate, which velocities are proportional to.
    """
    places = material.drawn(_PIXELS)
    found, truth = material.estimate_at(places), material.truth_at(places)
    if found.shape[1] < LEAST_PIXELS:
        return None
    # The truth, scaled to the size of the estimate: size alone is evidence of a scale mismatch only.
    rescaled = fit_factor(lengths(found)[np.newaxis], lengths(truth)[np.newaxis]) * truth
    right, verdicts = fit_factor(found, truth), []
    for hypothesis, expected in _hypotheses(material, places, found, right):
        verdict = _judged(hypothesis, found, truth, expected, right)
        if verdict is not None and hypothesis.scaled is not None and hypothesis.parts > 1:
            # With flipped maps the best-fitting scale may be an integer by chance.
            verdict = verdict if _judged(hypothesis, found, rescaled, expected, 1.0) is not None else None
        if verdict is not None:
            verdicts.append(verdict)
    verdicts = [verdict for verdict in verdicts if _is_significant(material, places, verdict)]
    return _best([verdict for verdict in verdicts if not _follows_from_depth(verdict, places, depth)], truth)


def _hypotheses(
    material: MismatchSamples, places: SamplePositions, found: Map, right: float
) -> Iterator[tuple[MismatchHypothesis, Map]]:
    """Yield every hypothesis except that of no mismatch, and the values that it predicts for the estimate."""
    low, high = _TRUSTED_SCALE
    suspicious = not low <= right <= high
    for move in (None, *POSITION_HYPOTHESES):
        source = places if move is None else move.source(places, material.grid)
        if source is None:
            continue
        moved, rays = material.truth_at(source), material.rays[source.y, source.x]
        for turn in (None, *select_meaning_hypotheses(material.quantity)):
            expected = moved if turn is None else turn.apply(moved, rays, material.facts)
            if move is not None or turn is not None:
                yield MismatchHypothesis(move, turn), expected
            if suspicious:
                some = expected[:, :: _compute_sample_step(expected)]
                known = np.isfinite(some).all(axis=0)
                factor = fit_factor(found[:, :: _compute_sample_step(expected)][:, known], some[:, known])
                scaled = nearest_scale(material.quantity, factor, material.facts)
                if scaled is not None:
                    yield MismatchHypothesis(move, turn, scaled), scaled.factor * expected


def _judged(
    hypothesis: MismatchHypothesis, found: Map, truth: Map, expected: Map, right: float
) -> MismatchVerdict | None:
    """Return the verdict on a hypothesis, or None if it explains too little; ``right`` is the gain for the truth."""
    if not _is_near(found, truth, expected):
        return None
    known = np.asarray(np.isfinite(expected).all(axis=0))
    errors = np.full(known.shape, np.nan)
    if not known.all():
        found, truth, expected = found[:, known], truth[:, known], expected[:, known]
    change = lengths(expected - truth)
    total = change.sum()
    if not (total > 0 and total**2 >= LEAST_PIXELS * np.square(change).sum()):
        return None
    unit = _unit(expected, truth)
    gain = fit_factor(found, expected)
    if not (gain > 0 and abs(math.log(gain)) <= _LARGEST_GAIN):
        return None
    before = lengths(found - _bias(right) * truth)
    after = lengths(found - _bias(gain) * expected) / unit
    if change[after < before].sum() < _LEAST_SHARE * total:
        return None
    values = weighted_median(lengths(expected), change)
    left = weighted_median(after, change)
    if left * unit > _OF_VALUES * values or weighted_median(change, change) < _LEAST_CHANGE * values:
        return None
    misfit = weighted_median(before, change)
    explained = 1 - left / misfit if misfit > 0 else 0.0
    if explained < _LEAST_EXPLAINED:
        return None
    errors[known] = after
    return MismatchVerdict(hypothesis, float(explained), errors)


def _is_significant(material: MismatchSamples, places: SamplePositions, verdict: MismatchVerdict) -> bool:
    """Return whether a mismatch is significant against the scatter between windows.

    The change of the estimate is projected on that by the mismatch: 1 for the mismatch, 0 for a correct estimate. The
    factor of a scale must be determined to 20 %.
    """
    hypothesis = verdict.hypothesis
    expected = hypothesis.predicted(material, places)
    known = np.isfinite(expected).all(axis=0)
    found, truth, expected = (
        material.estimate_at(places)[:, known],
        material.truth_at(places)[:, known],
        expected[:, known],
    )
    blocks = _block_indices(places, material, _WINDOW_PX)[known]
    change = expected - truth
    weights = lengths(change)
    there = weights > 0
    slopes = np.einsum("cn,cn->n", found - truth, change)[there] / weights[there] ** 2
    middle, error = _mean_of_windows(slopes, weights[there], blocks[there])
    if not middle - error >= _LEAST_SLOPE:
        return False
    if hypothesis.scaled is None:
        return True
    sizes = lengths(expected)
    there = sizes > 0
    gains = np.einsum("cn,cn->n", found, expected)[there] / sizes[there] ** 2
    middle, error = _mean_of_windows(gains, sizes[there], blocks[there])
    return error <= _LARGEST_GAIN * middle


def _follows_from_depth(verdict: MismatchVerdict, places: SamplePositions, depth: MismatchSamples | None) -> bool:
    """Return whether a wrong depth at the same pixels explains most of a scale that is no unit of length."""
    scaled = verdict.hypothesis.scaled
    if depth is None or scaled is None or "depth" in scaled.scale.quantities:
        return False
    found, truth = depth.estimate_at(places)[0], depth.truth_at(places)[0]
    ratios = np.abs(found / truth)[np.isfinite(found) & (found != 0)]
    if not ratios.size:
        return False
    there = math.log(float(np.median(ratios)))
    return there * math.log(scaled.factor) > 0 and abs(there) > _OF_SCALE * abs(math.log(scaled.factor))


def _mean_of_windows(values: Map, weights: Map, blocks: Indices) -> tuple[float, float]:
    """Return the mean of the medians of windows, and its largest error by chance (Student's t); infinite for one."""
    names = np.unique(blocks)
    medians = np.array([weighted_median(values[blocks == name], weights[blocks == name]) for name in names])
    totals = np.array([weights[blocks == name].sum() for name in names])
    middle = float(totals @ medians / totals.sum())
    shares = totals / totals.sum()
    count = 1 / float(shares @ shares)
    if not count > 1 + 1e-9:
        return middle, math.inf
    spread = math.sqrt(float(shares**2 @ (medians - middle) ** 2) * count / (count - 1))
    return middle, float(stdtrit(count - 1, 1 - _CHANCE)) * spread


def _compute_sample_step(values: Map) -> int:
    return max(1, int(values.shape[1]) // _GLANCED)


def _is_near(found: Map, truth: Map, expected: Map) -> bool:
    """Return whether an estimate may be closer to a prediction than to the truth; rejects most hypotheses early."""
    step = _compute_sample_step(found)
    found, truth, expected = found[:, ::step], truth[:, ::step], expected[:, ::step]
    change = lengths(expected - truth)
    if np.isnan(change).any():
        known = ~np.isnan(change)
        found, truth, expected, change = found[:, known], truth[:, known], expected[:, known], change[known]
    nearer = lengths(found - expected) < _unit(expected, truth) * lengths(found - truth)
    return bool(change @ nearer >= _GLANCED_SHARE * change.sum() > 0)


def _unit(expected: Map, truth: Map) -> float:
    """Return the ratio of predicted to true magnitude, which converts errors to the units of the truth."""
    ratio = float(np.abs(expected).sum() / np.abs(truth).sum()) if truth.any() else 1.0
    # Values elsewhere in the scene may be moderately larger.
    return ratio if ratio > 0 and abs(math.log(ratio)) > math.log(LEAST_RATIO) else 1.0


def _bias(gain: float) -> float:
    """Return the part of a gain that is attributed to method bias."""
    return min(max(gain, 1 - _GAIN), 1 + _GAIN) if math.isfinite(gain) else 1.0


def _best(verdicts: Sequence[MismatchVerdict], truth: Map) -> MismatchVerdict | None:
    """Return the verdict with the smallest residual; each further mismatch must explain most of what remains."""
    if len(verdicts) < 2:
        return verdicts[0] if verdicts else None
    errors = np.stack([verdict.errors for verdict in verdicts])
    errors = errors[:, np.isfinite(errors).all(axis=0)]
    if errors.shape[1] < LEAST_PIXELS:
        return max(verdicts, key=lambda verdict: verdict.explained)
    values = lengths(truth)
    # Outliers contribute equally to all.
    errors = np.minimum(errors, 3 * np.median(values[values > 0])) if (values > 0).any() else errors
    apart = np.ptp(errors, axis=0)
    left = errors @ apart / apart.sum() if apart.any() else np.zeros(len(errors))
    rounding = _LEAST_CHANGE * np.median(values)
    best: int | None = None
    for parts in sorted({verdict.hypothesis.parts for verdict in verdicts}):
        level = [place for place, verdict in enumerate(verdicts) if verdict.hypothesis.parts == parts]
        least = min(left[place] for place in level)
        if best is None or least + rounding < (1 - _LEAST_EXPLAINED) * left[best]:
            best = next(place for place in level if left[place] <= _EQUAL * least + rounding)
    return None if best is None else verdicts[best]


Indices = NDArray[np.intp]

_SHIFT_PIXELS = 4000
_SHARE = 1 / 16
"""Number of pixels, or fraction of a map if larger, that are evaluated: larger images have smaller slopes per pixel."""

_LEAST_SHIFT_PIXELS = 200
_LEAST_BLOCKS = 12
"""With fewer blocks the standard error is undefined."""
_BLOCKS = 8
"""Largest number of blocks along each side of the map; method errors correlate within windows, not blocks."""
_LARGEST_STD_PX = 0.06
"""Largest standard error, px; half a pixel is eight times as large."""
_REACH_PX = 0.15
"""Largest deviation of a measured shift from a multiple of half a pixel: 2.5 times the largest standard error."""
_LEAST_SHIFT_EXPLAINED = 0.05
"""Minimum explained fraction of the squared residual; the change by a shift is small compared with noise."""
_LEAST_OWN = 0.01
"""Minimum fraction of a gradient's variance that is independent of offset, gain, blur and the other gradient."""
_FLOOR_PX = 0.02
"""Errors smaller than those of such a shift are treated as equal."""

_ROUNDS = 4
_TUKEY = 4.685
_OF_MEDIAN = 1 / 0.6745
"""Standard deviation of normal errors over their median absolute value; ``_TUKEY`` counts such standard deviations."""


@dataclass(frozen=True)
class ShiftFit:
    """A measured shift: 0, 1/2 or 1 px in either direction, or None where undetermined.

    ``explained``: Fraction of the squared residual in the interior that is removed by undoing the shift.
    ``left``: Median of the remaining error.
    """

    right: float | None
    down: float | None
    explained: float
    left: float

    @property
    def is_slip(self) -> bool:
        """Whether the maps are shifted."""
        return bool(self.right or self.down) and self.explained >= _LEAST_SHIFT_EXPLAINED

    def mismatches(self, quantity: str) -> list[ConventionMismatch]:
        """Return the mismatches of a quantity that the shift implies."""
        if not self.is_slip:
            return []
        ways = [
            f"{abs(length):g} px {words[length > 0]}"
            for length, words in ((self.right, ("left", "right")), (self.down, ("up", "down")))
            if length
        ]
        where = f"the maps of {quantity} are shifted by {' and '.join(ways)}"
        if 0.5 in (abs(self.right or 0), abs(self.down or 0)):
            message = f"{where}, as if sampled at the corners of pixels: pixel centres are at integer x and y here"
            return [ConventionMismatch("half_pixel", quantity, message, self.explained)]
        message = f"{where}, as if pixels were counted from 1: the first pixel is x = 0, y = 0 here; shift them back"
        return [ConventionMismatch("one_pixel", quantity, message, self.explained)]


def fit_shift(material: MismatchSamples, hypothesis: MismatchHypothesis) -> ShiftFit | None:
    """Return the shift that explains most of the residual after other mismatches, or None where undetermined.

    Robust least squares fits the errors by the gradients of the predicted values, together with an offset, a gain and
    a blur (the Laplacian) of every component. On a plane of constant slope no shift is measured. The standard error is
    the jackknife estimate over blocks of the map.
    """
    grid = material.grid
    places = material.drawn(max(_SHIFT_PIXELS, int(_SHARE * grid.rows * grid.columns)), inner=True)
    if len(places.y) < _LEAST_SHIFT_PIXELS:
        return None
    middle, left, right, above, below = (
        hypothesis.predicted(material, places.shifted(down, right))
        for down, right in ((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0))
    )
    gradients = np.stack([0.5 * (left - right), 0.5 * (above - below)])
    blur = left + right + above + below - 4 * middle
    known = np.isfinite(blur).all(axis=0) & np.isfinite(middle).all(axis=0)
    if known.sum() < _LEAST_SHIFT_PIXELS:
        return None
    error = (material.estimate_at(places) - middle)[:, known]
    rows = _Rows.of(error, middle[:, known], gradients[..., known], blur[:, known])
    blocks = _block_indices(places, material)[known]
    return None if rows is None else _measured(rows, blocks)


@dataclass(frozen=True)
class _Rows:
    """The linear model of a quantity's errors.

    ``error``: Errors in units of their spread, shape (n * component,), grouped by pixel.
    ``columns``: Regressors, shape (n * component, k): the two gradients first, then offset, gain and blur.
    ``size``: Spread of every component, shape (component,).
    """

    error: Map
    columns: Map
    size: Map

    @classmethod
    def of(cls, error: Map, middle: Map, gradients: Map, blur: Map) -> _Rows | None:
        """Return the model, or None where all gradients vanish; all arrays have the shape (..., component, n)."""
        steepest = np.median(np.abs(gradients), axis=2).max()
        spread = _OF_MEDIAN * np.median(np.abs(error - np.median(error, axis=1, keepdims=True)), axis=1)
        size = np.maximum(spread, _FLOOR_PX * steepest)
        if not (steepest > 0 and (size > 0).all()):
            return None
        count, n = error.shape
        columns = np.zeros((n, count, 2 + 3 * count))
        columns[..., :2] = gradients.T
        for place in range(count):
            columns[:, place, 2 + 3 * place] = 1.0
            columns[:, place, 3 + 3 * place] = middle[place] - middle[place].mean()
            columns[:, place, 4 + 3 * place] = blur[place]
        columns /= size[:, np.newaxis]
        # Normalised columns keep the normal equations well conditioned.
        lengths_of = np.sqrt(np.square(columns[..., 2:]).sum(axis=(0, 1)))
        columns[..., 2:] /= np.where(lengths_of > 0, lengths_of, 1.0)
        return cls((error.T / size).ravel(), columns.reshape(n * count, -1), size)

    def without(self, dropped: Sequence[int]) -> _Rows:
        """Return the model without some columns."""
        return replace(self, columns=np.delete(self.columns, dropped, axis=1)) if dropped else self

    def normal(self, weights: Map) -> tuple[Map, Map]:
        """Return the matrix and right-hand side of the normal equations with a weight for every pixel."""
        weighted = self.columns * np.repeat(weights, len(self.size))[:, np.newaxis]
        return self.columns.T @ weighted, weighted.T @ self.error

    def left(self, solution: Map) -> Map:
        """Return the residuals of a solution, shape (component, n)."""
        return np.asarray((self.error - self.columns @ solution).reshape(-1, len(self.size)).T)

    def misfit(self, solution: Map) -> float:
        """Return the median residual of a solution, in the units of the quantity."""
        return float(np.median(lengths(self.left(solution) * self.size[:, np.newaxis])))


def _measured(rows: _Rows, blocks: Indices) -> ShiftFit | None:
    weights = _first_weights(rows)
    # A gradient that depends linearly on offset, gain and blur provides no information.
    own = _own_shares(rows, weights)
    axes = [axis for axis in (0, 1) if own[axis] >= _LEAST_OWN]
    if not axes:
        return None
    fitted = rows.without([axis for axis in (0, 1) if axis not in axes])
    solution, last = _fit(fitted, weights)
    left = fitted.misfit(solution)
    shift: list[float | None] = [None, None]
    if np.abs(solution[: len(axes)]).max() < 0.5 - _REACH_PX:
        return ShiftFit(None, None, 0.0, left)
    std = _jackknife(fitted, last, blocks)
    for axis, length, error in zip(axes, solution, std, strict=False):
        if error <= _LARGEST_STD_PX:
            nearest = 0.5 * round(2 * length)
            if abs(nearest) > 1 or abs(length - nearest) > _REACH_PX:
                return ShiftFit(None, None, 0.0, left)
            shift[axis] = nearest
    unshifted = rows.without([0, 1])
    there = unshifted.misfit(_fit(unshifted, weights)[0])
    return ShiftFit(shift[0], shift[1], 1 - (left / there) ** 2 if there > 0 else 0.0, left)


def _first_weights(rows: _Rows) -> Map:
    error = rows.error.reshape(-1, len(rows.size))
    size = np.abs(error - np.median(error, axis=0)).max(axis=1)
    return np.asarray((size <= _TUKEY * max(1.0, _OF_MEDIAN * float(np.median(size)))).astype(np.float64))


def _fit(rows: _Rows, weights: Map) -> tuple[Map, Map]:
    """Return the solution of robust least squares with Tukey's biweight, and its weights."""
    solution = _solved(*rows.normal(weights))
    for _ in range(_ROUNDS):
        size = lengths(rows.left(solution))
        limit = _TUKEY * max(_OF_MEDIAN * float(np.median(size)), 1e-6)
        weights = np.square(np.maximum(1 - np.square(size / limit), 0.0))
        solution = _solved(*rows.normal(weights))
    return solution, weights


def _solved(matrix: Map, side: Map) -> Map:
    """Return the solutions of normal equations of possibly dependent columns; shapes (..., k, k), (..., k)."""
    scale = np.sqrt(np.maximum(np.diagonal(matrix, axis1=-2, axis2=-1), np.finfo(float).tiny))
    ridge = 1e-10 * np.eye(side.shape[-1])
    even = matrix / (scale[..., np.newaxis] * scale[..., np.newaxis, :]) + ridge
    return np.asarray(np.linalg.solve(even, (side / scale)[..., np.newaxis])[..., 0] / scale)


def _own_shares(rows: _Rows, weights: Map) -> list[float]:
    """Return for each axis the fraction of the gradient's sum of squares that is independent of the other columns."""
    matrix, _ = rows.normal(weights)
    scale = np.sqrt(np.diag(matrix))
    shares = []
    for axis in (0, 1):
        others = [place for place in range(len(matrix)) if place != axis and scale[place] > 0]
        if not scale[axis] > 0:
            shares.append(0.0)
            continue
        inner = matrix[np.ix_(others, others)] / np.outer(scale[others], scale[others])
        cross = matrix[others, axis] / (scale[others] * scale[axis])
        shares.append(1 - float(cross @ np.linalg.lstsq(inner, cross, rcond=1e-10)[0]))
    return shares


def _jackknife(rows: _Rows, weights: Map, blocks: Indices) -> Map:
    """Return the jackknife standard errors of a solution, leaving out one block at a time."""
    names = np.unique(blocks[weights > 0])
    if len(names) < _LEAST_BLOCKS:
        return np.full(rows.columns.shape[1], math.inf)
    each = np.repeat(blocks, len(rows.size))
    matrices, sides = [], []
    for name in names:
        part = _Rows(rows.error[each == name], rows.columns[each == name], rows.size)
        matrix, side = part.normal(weights[blocks == name])
        matrices.append(matrix)
        sides.append(side)
    solutions = _solved(np.sum(matrices, axis=0) - matrices, np.sum(sides, axis=0) - sides)
    spread = np.square(solutions - solutions.mean(axis=0)).sum(axis=0)
    return np.asarray(np.sqrt(spread * (len(names) - 1) / len(names)))


def _block_indices(places: SamplePositions, material: MismatchSamples, least_px: float = 0.0) -> Indices:
    """Return the block index of every pixel, by blocks with sides of at least some px; all frames share the blocks."""
    grid, least = material.grid, least_px / material.facts.step_px
    down, across = (max(length / _BLOCKS, least) for length in (grid.rows, grid.columns))
    return np.asarray((places.y // down).astype(np.intp) * _BLOCKS + (places.x // across).astype(np.intp))


_COMPONENTS = {"flow": 2, "velocity": 3}


def detect_convention_mismatches(
    estimate: xr.Dataset | Mapping[str, ArrayLike], truth: xr.Dataset
) -> list[ConventionMismatch]:
    """Return the likely convention mismatches of an estimate: wrong sign, unit, order, origin, frame or pixel shift.

    Every combination of a mismatch of position (maps flipped, mirrored, transposed, of another frame), of meaning
    (signs, order of components, the distance along the ray, disparity for depth) and of scale (units, steps, time) is
    compared with a correct estimate, for each of depth, disparity, flow and velocity. A mismatch is reported where
    undoing it removes most of the residual at the pixels that it changes, beyond the effect of a gain of up to 5 %.
    Errors of a method, such as noise, blur, outliers and bias, are not removed. Of several equivalent
    explanations the simplest is reported. Shifts by one and by half a pixel are measured from the gradients of the
    truth in the interior, and reported where they exceed many standard errors.

    Undetectable mismatches are not reported: the sign of zero motion, a flipped plane that is symmetric. Of large
    data sets, three frames and 1500 to 4000 pixels (1/16 of large maps) are evaluated.

    Parameters
    ----------
    estimate
        The estimate, dimensions (t, y, x); depth and disparity may have either sign. Alternatively a mapping of plain
        arrays, which `make_estimate` may reject: ``depth`` in mm and ``disparity`` in px/step, shape (t, y, x) or
        (y, x); ``flow`` in px/frame and ``velocity`` in mm/frame, shapes (2, ...) and (3, ...); ``t``, their frames,
        default: all frames of the truth if their number agrees, the reference frame for a single one.
    truth
        The truth, dimensions (t, y, x), or (s, t, y, x), of which s = 0 is used; it may have more frames and pixels.

    Returns
    -------
    list of ConventionMismatch
        By quantity; empty if no mismatch is detected.

    Raises
    ------
    ScoreError
        If the data sets cannot be compared; lists every problem.

    See Also
    --------
    make_estimate : Estimate from plain arrays.
    score : Statistics of the errors.

    Examples
    --------
    A tilted plane, and a method that returns depth in metres:

    >>> from scenetruth.schema import Intrinsics, label
    >>> camera = Intrinsics(focal_length_px=100.0, principal_point_px=(15.5, 11.5), baseline_mm=5.0)
    >>> depth = 500.0 + np.mgrid[:24, :32][1:] * 2.0
    >>> still = np.zeros((3, *depth.shape))
    >>> maps = {"depth": depth, "disparity": 500 / depth, "velocity": still, "flow": still[:2], "mixed": depth < 0}
    >>> truth = label("truth", maps, camera, t=[0])
    >>> estimate = label("estimate", {"depth": 0.001 * depth}, camera, t=[0])
    >>> [(mismatch.kind, mismatch.quantity) for mismatch in detect_convention_mismatches(estimate, truth)]
    [('metres', 'depth')]
    >>> [mismatch.kind for mismatch in detect_convention_mismatches({"depth": -depth[0]}, truth)]
    ['sign']
    >>> detect_convention_mismatches(label("estimate", {"depth": 1.01 * depth}, camera, t=[0]), truth)
    []
    """
    if isinstance(estimate, Mapping) and not isinstance(estimate, xr.Dataset):
        estimate = _arrange_arrays(estimate, truth)
    wrong = [
        Problem(name, "must be an xarray.Dataset", type(part).__name__)
        for name, part in (("estimate", estimate), ("truth", truth))
        if not isinstance(part, xr.Dataset)
    ]
    if wrong:
        raise ScoreError(wrong)
    with np.errstate(over="ignore", invalid="ignore"):
        materials = {material.quantity: material for material in read_mismatch_samples(estimate, truth)}
        return [
            mismatch
            for quantity, material in materials.items()
            for mismatch in _detect_in_samples(material, materials.get("depth") if quantity == "velocity" else None)
        ]


_ARRAYS = ("depth", "disparity", "flow", "velocity")


def _arrange_arrays(given: Mapping[str, ArrayLike | None], truth: xr.Dataset) -> xr.Dataset:
    """Return an estimate built from plain arrays."""
    if not isinstance(truth, xr.Dataset):
        raise ScoreError([Problem("truth", "must be an xarray.Dataset", type(truth).__name__)])
    size = tuple(truth.sizes[dim] for dim in ("y", "x") if dim in truth.sizes)
    unknown = sorted(set(given) - {*_ARRAYS, "t"})
    if unknown:
        raise ScoreError([Problem("estimate", f"arrays are {', '.join(_ARRAYS)} and t", unknown)])
    t = given.get("t")
    problems: list[Problem] = []
    arrays: dict[str, NDArray[np.float64]] = {}
    for name in _ARRAYS:
        if (values := given.get(name)) is not None:
            found = _with_frames(values, _COMPONENTS.get(name), size)
            if found is None:
                lead = f"{_COMPONENTS[name]}, " if name in _COMPONENTS else ""
                message = (
                    f"must hold real numbers in the shape ({lead}t, y, x), or the same without t, with (y, x) = {size}"
                )
                problems.append(Problem(name, message, np.shape(values)))
            else:
                arrays[name] = found
    counts = {name: values.shape[-3] for name, values in arrays.items()}
    if not (arrays or problems):
        problems.append(Problem("", "at least one of depth, disparity, flow, velocity is required"))
    if len(set(counts.values())) > 1:
        problems.append(Problem("", "arrays hold different numbers of frames", counts))
    if problems:
        raise ScoreError(problems)
    count = next(iter(counts.values()))
    if t is None:
        frames = np.zeros(1, dtype=np.int64) if count == 1 else truth["t"].values
    else:
        frames = np.atleast_1d(np.asarray(t))
    if len(frames) != count:
        raise ScoreError([Problem("t", f"the arrays hold {count} frames; specify as many with t=", frames.tolist())])
    x, y = (truth[name].values if name in truth.coords else None for name in ("x", "y"))
    return label("estimate", arrays, read_intrinsics(truth), t=frames, x=x, y=y)


def _with_frames(values: ArrayLike, components: int | None, size: tuple[int, ...]) -> NDArray[np.float64] | None:
    """Return an array with a frame axis, or None if its shape or type is invalid."""
    raw = np.asarray(values)
    if raw.dtype.kind not in "fiu" or raw.size == 0:
        return None
    lead = () if components is None else (components,)
    if raw.ndim == len(lead) + 2:
        raw = raw.reshape(*raw.shape[: len(lead)], 1, *raw.shape[len(lead) :])
    if raw.ndim != len(lead) + 3 or raw.shape[: len(lead)] != lead or raw.shape[-2:] != size:
        return None
    return raw.astype(np.float64)


def _detect_in_samples(material: MismatchSamples, depth: MismatchSamples | None) -> list[ConventionMismatch]:
    quantity = material.quantity
    verdict = search_mismatches(material, depth)
    hypothesis = NO_MISMATCH if verdict is None else verdict.hypothesis
    shift = fit_shift(material, hypothesis)
    if verdict is None:
        return [] if shift is None else shift.mismatches(quantity)
    if hypothesis.parts == 1 and hypothesis.move is not None:
        # For a surface that moves by about a pixel per frame, a wrong frame resembles a shift by one pixel.
        alone = fit_shift(material, NO_MISMATCH)
        if alone is not None and alone.is_slip and shift is not None and alone.left < shift.left:
            return alone.mismatches(quantity)
    return hypothesis.mismatches(quantity, verdict.explained) + ([] if shift is None else shift.mismatches(quantity))
