"""Detection of convention mismatches in an estimate.

Wrong sign, unit, origin or order, and shifts by a whole or half a pixel.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

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
"""With fewer pixels that tell of a slip, chance may name one."""

_PIXELS = 1500
"""How many pixels are looked at."""

_LEAST_EXPLAINED = 0.6
"""Least share of the misfit that undoing a slip takes away. Where an estimate is right, undoing what is not there adds
to the misfit; only errors that look like the slip itself are taken away, and of the rest there is more than of them."""

_LEAST_SHARE = 0.75
"""Least share of the change that a slip makes at pixels where the estimate is nearer to the slip than to the truth. A
tenth of outliers on each side leaves nine tenths; errors that know nothing of the slip leave less than half."""

_GLANCED = 500
_GLANCED_SHARE = 0.4
"""Of so many pixels, hypotheses with a lesser share are left out before they are looked at closely."""

_GAIN = 0.05
"""Biases of methods, as a share of the value, that say nothing for or against a slip. What a slip explains beyond a
gain in this range is counted: a surface that comes nearer by 1 % per frame is not told from a bias of 1 %."""

_LEAST_CHANGE = 1e-4
"""Least change by a slip, as a share of the values: what changes nothing but the last digits cannot be seen."""

_LARGEST_GAIN = 0.2
"""Largest logarithm of the gain that a slip may leave: if values still are far too large, the slip is another one."""

_OF_VALUES = 0.5
"""Largest misfit that a slip may leave, as a share of the values: an estimate must be more than noise."""

_TRUSTED_SCALE = (0.8, 1.25)
"""Where an estimate is so many times the truth, its unit is not in question."""

_EQUAL = 1.1
"""Up to this ratio of misfits, the explanation that is preferred is taken."""


@dataclass(frozen=True)
class MismatchVerdict:
    """Slips that are likely, and how much they explain.

    ``hypothesis``: The slips.
    ``explained``: Share of the misfit that undoing them takes away.
    ``errors``: What is left at every pixel that was looked at, in the units of the truth; NaN where it is not known.
    """

    hypothesis: MismatchHypothesis
    explained: float
    errors: Map = field(repr=False)


def search_mismatches(material: MismatchSamples) -> MismatchVerdict | None:
    """Return the slips that explain most of an estimate's misfit, or None.

    All combinations of one slip of place, one of meaning and one of scale are compared with the estimate being right,
    with weights: the change that the slips would make.
    """
    places = material.drawn(_PIXELS)
    found, truth = material.estimate_at(places), material.truth_at(places)
    if found.shape[1] < LEAST_PIXELS:
        return None
    # The truth in whatever unit the estimate has: its size alone is no sign of anything but a scale.
    rescaled = fit_factor(lengths(found)[np.newaxis], lengths(truth)[np.newaxis]) * truth
    right, verdicts = fit_factor(found, truth), []
    for hypothesis, expected in _hypotheses(material, places, found, right):
        verdict = _judged(hypothesis, found, truth, expected, right)
        if verdict is not None and hypothesis.scaled is not None and hypothesis.parts > 1:
            # With maps upside down the scale that fits best may happen to be a whole number.
            verdict = verdict if _judged(hypothesis, found, rescaled, expected, 1.0) is not None else None
        if verdict is not None:
            verdicts.append(verdict)
    return _best(verdicts, truth)


def _hypotheses(
    material: MismatchSamples, places: SamplePositions, found: Map, right: float
) -> Iterator[tuple[MismatchHypothesis, Map]]:
    """Give all hypotheses but that of no slip, and what the estimate would show of each."""
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
                some = expected[:, :: _step_of(expected)]
                known = np.isfinite(some).all(axis=0)
                factor = fit_factor(found[:, :: _step_of(expected)][:, known], some[:, known])
                scaled = nearest_scale(material.quantity, factor, material.facts)
                if scaled is not None:
                    yield MismatchHypothesis(move, turn, scaled), scaled.factor * expected


def _judged(
    hypothesis: MismatchHypothesis, found: Map, truth: Map, expected: Map, right: float
) -> MismatchVerdict | None:
    """Return what a hypothesis explains, or None where that is not enough; ``right`` is the gain beside the truth."""
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


def _step_of(values: Map) -> int:
    return max(1, int(values.shape[1]) // _GLANCED)


def _is_near(found: Map, truth: Map, expected: Map) -> bool:
    """Return whether an estimate may be nearer to what is expected than to the truth; most hypotheses end here."""
    step = _step_of(found)
    found, truth, expected = found[:, ::step], truth[:, ::step], expected[:, ::step]
    change = lengths(expected - truth)
    if np.isnan(change).any():
        known = ~np.isnan(change)
        found, truth, expected, change = found[:, known], truth[:, known], expected[:, known], change[known]
    nearer = lengths(found - expected) < _unit(expected, truth) * lengths(found - truth)
    return bool(change @ nearer >= _GLANCED_SHARE * change.sum() > 0)


def _unit(expected: Map, truth: Map) -> float:
    """Return how large values with the slips are beside the true ones: errors are compared in the truth's units."""
    ratio = float(np.abs(expected).sum() / np.abs(truth).sum()) if truth.any() else 1.0
    # Another part of the scene may have somewhat larger values.
    return ratio if ratio > 0 and abs(math.log(ratio)) > math.log(LEAST_RATIO) else 1.0


def _bias(gain: float) -> float:
    """Return the part of a gain that may be a method's bias."""
    return min(max(gain, 1 - _GAIN), 1 + _GAIN) if math.isfinite(gain) else 1.0


def _best(verdicts: Sequence[MismatchVerdict], truth: Map) -> MismatchVerdict | None:
    """Return the one that leaves the least misfit where they differ; a further slip must explain most of the rest."""
    if len(verdicts) < 2:
        return verdicts[0] if verdicts else None
    errors = np.stack([verdict.errors for verdict in verdicts])
    errors = errors[:, np.isfinite(errors).all(axis=0)]
    if errors.shape[1] < LEAST_PIXELS:
        return max(verdicts, key=lambda verdict: verdict.explained)
    values = lengths(truth)
    # Outliers count alike for all.
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
"""So many pixels, or this share of a map if that is more, are looked at: in larger images slopes per pixel are less."""

_LEAST_SHIFT_PIXELS = 200
_LEAST_BLOCKS = 12
"""With fewer, the standard error is not known."""

_BLOCKS = 8
"""Blocks along each side of the map, for the standard error; errors of methods reach over windows, not over blocks."""

_LARGEST_STD_PX = 0.06
"""Largest standard error: half a pixel is eight of it from zero."""

_REACH_PX = 0.15
"""How far a measured shift may be from a half or a whole pixel: 2.5 of the largest standard errors."""

_LEAST_SHIFT_EXPLAINED = 0.05
"""Least share of the squared misfit away from edges. A shift changes little there beside a method's noise, so that its
standard error decides; this leaves out what explains nothing to speak of."""

_LEAST_OWN = 0.01
"""Least share of a gradient's variance that an offset, a gain, blur and the other gradient do not account for."""

_FLOOR_PX = 0.02
"""Errors smaller than those of such a shift are taken as equally good."""

_ROUNDS = 4
_TUKEY = 4.685
_OF_MEDIAN = 1 / 0.6745
"""Standard deviation of normal errors over the median of their absolute values; Tukey's limit of outliers in it."""


@dataclass(frozen=True)
class ShiftFit:
    """What a shift explains.

    ``right``, ``down``: By how many pixels the maps are shifted: 0, 1/2 or 1 in both directions, or None where that is
      not known.
    ``explained``: Share of the squared misfit away from edges that undoing the shift takes away.
    ``left``: Median of the misfit that is left.
    """

    right: float | None
    down: float | None
    explained: float
    left: float

    @property
    def is_slip(self) -> bool:
        """Whether the maps are shifted."""
        return bool(self.right or self.down) and self.explained >= _LEAST_SHIFT_EXPLAINED

    def slips(self, quantity: str) -> list[ConventionMismatch]:
        """Return what is told of a quantity."""
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
    """Return the shift that explains most of what slips leave, or None where it cannot be measured.

    Errors are fitted by the gradients of the truth with its slips, by robust least squares together with an offset, a
    gain and blur (the Laplacian) of every component, which thus are never taken for a shift. On a plane of constant
    slope an offset looks like a shift, so that none is measured there. The standard error is that of the jackknife
    over blocks of the map.
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

    ``error``: Errors in units of their spread, shape (n * component,): those of a pixel follow each other.
    ``columns``: What they may follow from, shape (n * component, k): the two gradients, then what is no shift.
    ``size``: The units, shape (component,).
    """

    error: Map
    columns: Map
    size: Map

    @classmethod
    def of(cls, error: Map, middle: Map, gradients: Map, blur: Map) -> _Rows | None:
        """Return the model, or None where nothing has a gradient; all arrays have the shape (..., component, n)."""
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
        # Columns of one size: products of small and large ones would be lost in rounding.
        lengths_of = np.sqrt(np.square(columns[..., 2:]).sum(axis=(0, 1)))
        columns[..., 2:] /= np.where(lengths_of > 0, lengths_of, 1.0)
        return cls((error.T / size).ravel(), columns.reshape(n * count, -1), size)

    def without(self, dropped: Sequence[int]) -> _Rows:
        """Return the model without some columns."""
        return replace(self, columns=np.delete(self.columns, dropped, axis=1)) if dropped else self

    def normal(self, weights: Map) -> tuple[Map, Map]:
        """Return matrix and right side of the normal equations, with a weight for every pixel."""
        weighted = self.columns * np.repeat(weights, len(self.size))[:, np.newaxis]
        return self.columns.T @ weighted, weighted.T @ self.error

    def left(self, solution: Map) -> Map:
        """Return what a solution leaves, shape (component, n)."""
        return np.asarray((self.error - self.columns @ solution).reshape(-1, len(self.size)).T)

    def misfit(self, solution: Map) -> float:
        """Return the median of what a solution leaves, in the units of the quantity."""
        return float(np.median(lengths(self.left(solution) * self.size[:, np.newaxis])))


def _measured(rows: _Rows, blocks: Indices) -> ShiftFit | None:
    weights = _first_weights(rows)
    # A gradient that follows from offset, gain and blur tells nothing.
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
    """Return the solution of robust least squares (Tukey's weights), and its weights."""
    solution = _solved(*rows.normal(weights))
    for _ in range(_ROUNDS):
        size = lengths(rows.left(solution))
        limit = _TUKEY * max(_OF_MEDIAN * float(np.median(size)), 1e-6)
        weights = np.square(np.maximum(1 - np.square(size / limit), 0.0))
        solution = _solved(*rows.normal(weights))
    return solution, weights


def _solved(matrix: Map, side: Map) -> Map:
    """Return the solutions of normal equations whose columns may depend on each other; shapes (..., k, k), (..., k)."""
    scale = np.sqrt(np.maximum(np.diagonal(matrix, axis1=-2, axis2=-1), np.finfo(float).tiny))
    ridge = 1e-10 * np.eye(side.shape[-1])
    even = matrix / (scale[..., np.newaxis] * scale[..., np.newaxis, :]) + ridge
    return np.asarray(np.linalg.solve(even, (side / scale)[..., np.newaxis])[..., 0] / scale)


def _own_shares(rows: _Rows, weights: Map) -> list[float]:
    """Return by axis the share of the gradient's square that no other column accounts for."""
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
    """Return the standard errors of a solution, from leaving out one block after the other."""
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


def _block_indices(places: SamplePositions, material: MismatchSamples) -> Indices:
    """Return the number of the block of the map that every pixel lies in; frames share them."""
    grid = material.grid
    return np.asarray((places.y * _BLOCKS // grid.rows) * _BLOCKS + places.x * _BLOCKS // grid.columns)


_COMPONENTS = {"flow": 2, "velocity": 3}


def detect_convention_mismatches(
    estimate: xr.Dataset | Mapping[str, ArrayLike], truth: xr.Dataset
) -> list[ConventionMismatch]:
    """Return the likely slips of convention in an estimate: signs, units, order, origin, one frame or pixel off.

    Every combination of a slip of place (maps upside down, mirrored, transposed, of another frame), one of meaning
    (signs, order of components, the distance along the ray, disparity for depth) and one of scale (units, steps, time)
    is compared with the estimate being right, for each of depth, disparity, flow and velocity. One is named where
    undoing it takes away most of the misfit at the pixels that it changes, beyond what a gain of up to 5 % does: errors
    of a method, as noise, blur, outliers and bias, are not taken away so. Of several that explain alike the simplest is
    named. Shifts by one and by half a pixel are measured from the gradients of the truth away from edges, and named
    where they are many standard errors from zero.

    What does not show is not named: the sign of a motion that is zero, a plane that is the same upside down. Of large
    data sets, three frames and some thousand pixels are looked at.

    Parameters
    ----------
    estimate
        The estimate, dimensions (t, y, x); the sign of depth and disparity may be any. Or plain arrays, which
        `make_estimate` may refuse, by name: ``depth`` in mm and ``disparity`` in px per step of s, shape (t, y, x) or
        (y, x); ``flow`` in px and ``velocity`` in mm per frame, shapes (2, ...) and (3, ...); ``t``, their frames. If
        frames are not given: all of the truth if there are as many, the reference frame for a single one.
    truth
        The truth, dimensions (t, y, x), or (s, t, y, x), of which s = 0 is taken; it may have more frames and pixels.

    Returns
    -------
    list of Slip
        By quantity; empty if the estimate shows none.

    Raises
    ------
    ScoreError
        If the data sets cannot be compared; lists what is wrong.

    See Also
    --------
    make_estimate : An estimate from plain arrays.
    score : How large the errors are.

    Examples
    --------
    A tilted plane, and a method that tells depth in metres:

    >>> from scenetruth.schema import Intrinsics, label
    >>> camera = Intrinsics(focal_length_px=100.0, principal_point_px=(15.5, 11.5), baseline_mm=5.0)
    >>> depth = 500.0 + np.mgrid[:24, :32][1:] * 2.0
    >>> still = np.zeros((3, *depth.shape))
    >>> maps = {"depth": depth, "disparity": 500 / depth, "velocity": still, "flow": still[:2], "mixed": depth < 0}
    >>> truth = label("truth", maps, camera, t=[0])
    >>> estimate = label("estimate", {"depth": 0.001 * depth}, camera, t=[0])
    >>> [(slip.kind, slip.quantity) for slip in detect_convention_mismatches(estimate, truth)]
    [('metres', 'depth')]
    >>> [slip.kind for slip in detect_convention_mismatches({"depth": -depth[0]}, truth)]
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
        return [slip for material in read_mismatch_samples(estimate, truth) for slip in _detect_in_samples(material)]


_ARRAYS = ("depth", "disparity", "flow", "velocity")


def _arrange_arrays(given: Mapping[str, ArrayLike | None], truth: xr.Dataset) -> xr.Dataset:
    """Return an estimate of plain arrays, however they are."""
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
                    f"must hold real numbers in the shape ({lead}t, y, x), or that without t, with (y, x) = {size}"
                )
                problems.append(Problem(name, message, np.shape(values)))
            else:
                arrays[name] = found
    counts = {name: values.shape[-3] for name, values in arrays.items()}
    if not (arrays or problems):
        problems.append(Problem("", "at least one of depth, disparity, flow, velocity is needed"))
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
        raise ScoreError([Problem("t", f"the arrays hold {count} frames, not these: say which by t=", frames.tolist())])
    x, y = (truth[name].values if name in truth.coords else None for name in ("x", "y"))
    return label("estimate", arrays, read_intrinsics(truth), t=frames, x=x, y=y)


def _with_frames(values: ArrayLike, components: int | None, size: tuple[int, ...]) -> NDArray[np.float64] | None:
    """Return an array with its frames, or None if it has another shape, or holds no real numbers."""
    raw = np.asarray(values)
    if raw.dtype.kind not in "fiu" or raw.size == 0:
        return None
    lead = () if components is None else (components,)
    if raw.ndim == len(lead) + 2:
        raw = raw.reshape(*raw.shape[: len(lead)], 1, *raw.shape[len(lead) :])
    if raw.ndim != len(lead) + 3 or raw.shape[: len(lead)] != lead or raw.shape[-2:] != size:
        return None
    return raw.astype(np.float64)


def _detect_in_samples(material: MismatchSamples) -> list[ConventionMismatch]:
    quantity = material.quantity
    verdict = search_mismatches(material)
    hypothesis = NO_MISMATCH if verdict is None else verdict.hypothesis
    shift = fit_shift(material, hypothesis)
    if verdict is None:
        return [] if shift is None else shift.slips(quantity)
    if hypothesis.parts == 1 and hypothesis.move is not None:
        # Of a surface that moves by a pixel per frame, one frame off looks nearly as one pixel off.
        alone = fit_shift(material, NO_MISMATCH)
        if alone is not None and alone.is_slip and shift is not None and alone.left < shift.left:
            return alone.slips(quantity)
    return hypothesis.slips(quantity, verdict.explained) + ([] if shift is None else shift.slips(quantity))
