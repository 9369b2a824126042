"""Bundle adjustment of camera, stage and targets: robust Gauss-Newton with priors, and the whole covariance."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.calibration.rig_model import (
    INTRINSICS,
    CalibrationError,
    Observations,
    RigState,
    TargetView,
    project,
)
from scenetruth.errors import Problem
from scenetruth.threads import with_one_blas_thread

__all__ = ["SCALED_ABOVE", "PoseScatter", "RigFit", "ViewResidual", "adjust", "robust_weights", "solve"]

Array = NDArray[np.float64]

SCALED_ABOVE = 1.1
"""Chi-squared per degree of freedom above which the covariance is scaled by it."""
_HUBER = 3.0
"""Limit in standard deviations beyond which a point loses weight; 1.1 % of exact points lie beyond it."""
_OUTLIER = 6.0
"""Limit beyond which a point is excluded; the probability of an exact point is exp(-18) = 1.5e-8."""
_MEDIAN_SQUARE = 2 * np.log(2)  # of chi-squared with two degrees of freedom
_MOST_ROUNDS = 600
"""Images of a wrong tilt bend a long valley, which takes some 200 rounds; others take 10."""
_SLOW, _NEAR = 20, 0.05
"""If the sum of the steps that are left is below this, in standard deviations, for so many iterations, they end."""
_CONVERGED = 1e-8
"""Squared length of the last step in units of the standard deviations: an error of 1e-4 of the uncertainty. A limit on
the change of chi-squared instead would end while combinations of small effect still lie off by their uncertainty.
"""
_LEAST_EIGENVALUE = 1e-13
_SHARE_OF_VIEW = 0.3
"""An image with more excluded points than this share contradicts the other images as a whole."""
_MOST_DAMPING = 1e8
_MOST_EXCLUSIONS = 8


@dataclass(frozen=True)
class ViewResidual:
    """Residuals of one image.

    ``name``: Image.
    ``points``: Number of points used.
    ``excluded``: Number of points excluded as outliers.
    ``mean_square``: Mean of the squared residuals in units of their standard deviations, 1 if these are right.
    ``rms_px``: Root mean square of the residuals per axis in px.
    ``consistent``: False if the image as a whole contradicts the others, and does not contribute.
    """

    name: str
    points: int
    excluded: int
    mean_square: float
    rms_px: float
    consistent: bool


@dataclass(frozen=True, eq=False)
class PoseScatter:
    """Widening of a covariance by results of single poses that scatter more than it states.

    ``chosen``: Indices of the lens parameters, shape (n,).
    ``transfer``: Matrix M for which M C Mᵀ is the widened covariance of these parameters, shape (n, n).
    ``factors``: Factors of their variances along the axes of the widening, ascending, 1 or more.
    """

    chosen: NDArray[np.int64]
    transfer: Array = field(repr=False)
    factors: Array

    @property
    def mean(self) -> float:
        """Mean factor of the variances."""
        return float(self.factors.mean())

    @property
    def common(self) -> float:
        """Factor of the variances of all parameters, the least of the factors."""
        return float(self.factors[0])

    def widened(self, covariance: Array) -> Array:
        """Return a covariance, shape (P, P), in which the other parameters follow the lens by their regression."""
        inner = covariance[np.ix_(self.chosen, self.chosen)]
        scale = 1 / np.sqrt(np.diag(inner))
        slopes = np.linalg.solve(inner * scale[:, None] * scale, covariance[self.chosen] * scale[:, None])
        excess = self.transfer @ inner @ self.transfer.T - self.common * inner
        wider = self.common * covariance + slopes.T @ (excess * scale[:, None] * scale) @ slopes
        return np.asarray((wider + wider.T) / 2)


@dataclass(frozen=True, eq=False)
class RigFit:
    """Result of a bundle adjustment.

    ``given``: Observations used: without outliers and without inconsistent images.
    ``state``: Parameters at the minimum.
    ``free``: Which parameters are estimated, shape (P,).
    ``data_information``: Information matrix of the observations on the free parameters, without priors.
    ``covariance``: Covariance of all parameters, zero for fixed parameters, shape (P, P); not scaled.
    ``chi2``, ``dof``: Weighted sum of squared residuals including the priors, and its degrees of freedom.
    ``views``: Residuals of every image, also of inconsistent images.
    ``rounds``: Iterations of the last minimisation.
    ``scatter``: Widening where the results of single poses scatter more than the covariance states; else None.
    """

    given: Observations
    state: RigState
    start: Array = field(repr=False)
    free: NDArray[np.bool_] = field(repr=False)
    data_information: Array = field(repr=False)
    covariance: Array = field(repr=False)
    chi2: float = 0.0
    dof: int = 0
    views: tuple[ViewResidual, ...] = ()
    rounds: int = 0
    scatter: PoseScatter | None = None

    @property
    def converged(self) -> bool:
        """Whether the last minimisation has reached a minimum."""
        return self.rounds < _MOST_ROUNDS

    @property
    def variance_factor(self) -> float:
        """Chi-squared per degree of freedom."""
        return self.chi2 / max(self.dof, 1)

    @property
    def scale(self) -> float:
        """Factor of the covariance by chi-squared, 1 where that is not above ``SCALED_ABOVE``."""
        return self.variance_factor if self.variance_factor > SCALED_ABOVE else 1.0

    def widened(self, covariance: Array) -> Array:
        """Return a covariance of these parameters widened by the scatter of the poses."""
        return covariance if self.scatter is None else self.scatter.widened(covariance)

    @cached_property
    def stated_covariance(self) -> Array:
        """Covariance of all parameters, scaled by chi-squared and widened by the scatter of the poses."""
        return self.scale * self.widened(self.covariance)

    @cached_property
    def residuals_px(self) -> Array:
        """Detected minus projected positions of the points used, shape (n, 2)."""
        return self.given.pixels - project(self.given, self.state, derivatives=False)[0]

    @cached_property
    def z(self) -> Array:
        """Residuals in units of their standard deviations, shape (n, 2)."""
        return np.asarray(np.einsum("nij,nj->ni", self.given.whitening, self.residuals_px))

    def std(self, name: str) -> float:
        """Return the standard deviation of a parameter."""
        index = self.state.layout.names.index(name)
        return float(np.sqrt(self.covariance[index, index]))


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations of the free parameters at one state."""

    information: Array
    gradient: Array
    distance: Array
    cost: float
    squares: float


def prior_information(std: Array, free: NDArray[np.bool_]) -> Array:
    """Return the inverse prior variances of the free parameters; 0 without a prior."""
    return np.asarray(1 / std[free] ** 2)


def robust_cost(distance: Array) -> float:
    """Return the sum of Huber's function, distance squared within the limit and linear beyond."""
    square = np.where(distance <= _HUBER, distance**2, 2 * _HUBER * distance - _HUBER**2)
    return float(square.sum())


def robust_weights(distance: Array) -> Array:
    """Return Huber's weights: 1 within the limit, and inverse to the distance beyond."""
    return np.asarray(_HUBER / np.maximum(distance, _HUBER))


def prior_cost(state: RigState, start: Array, free: NDArray[np.bool_]) -> float:
    """Return the weighted sum of squared departures from the prior means."""
    return float(((state.values - start)[free] ** 2 * prior_information(state.layout.std, free)).sum())


def build_equations(given: Observations, state: RigState, start: Array, free: NDArray[np.bool_]) -> NormalEquations:
    """Return the normal equations of the observations; gradient and cost also include the priors."""
    pixels, slopes = project(given, state, derivatives=True)
    whitened = given.whitening @ slopes
    residual = np.einsum("nij,nj->ni", given.whitening, given.pixels - pixels)
    distance = np.hypot(residual[:, 0], residual[:, 1])
    root = np.sqrt(robust_weights(distance))[:, None]
    whitened *= root[:, :, None]
    residual = residual * root
    information = state.layout.information(given, whitened)
    gradient = state.layout.gather(given, whitened, residual[:, :, None])[:, 0]
    prior = prior_information(state.layout.std, free)
    departure = (state.values - start)[free]
    squares = float((residual**2).sum()) + float((prior * departure**2).sum())
    cost = robust_cost(distance) + float((prior * departure**2).sum())
    return NormalEquations(information[np.ix_(free, free)], gradient[free] - prior * departure, distance, cost, squares)


def solve(
    given: Observations, state: RigState, start: Array, free: NDArray[np.bool_], most_rounds: int = _MOST_ROUNDS
) -> tuple[RigState, NormalEquations, int]:
    """Minimise the robust cost over the free parameters; return the state, its equations and the iterations."""
    damping = 0.0
    prior = np.diag(prior_information(state.layout.std, free))
    equations = build_equations(given, state, start, free)
    rounds, length, near = 0, np.inf, 0
    while rounds < most_rounds and not ((length < _CONVERGED and damping < 1e-3) or near >= _SLOW):
        rounds += 1
        total = equations.information + prior
        scale = 1 / np.sqrt(np.maximum(np.diag(total), 1e-300))
        scaled = total * scale[:, None] * scale
        step = np.zeros(state.layout.size)
        while True:
            shift = scale * _solve_scaled(scaled, damping, equations.gradient * scale)
            step[free] = shift
            candidate = state.moved(step)
            cost = _cost(given, candidate, start, free)
            if cost <= equations.cost * (1 + 1e-12) or damping > _MOST_DAMPING:
                break
            damping = max(10 * damping, 1e-6)
        before, length = length, float(shift @ total @ shift)
        # Outliers may slow the steps down to a geometric sequence, whose sum is the distance from the minimum.
        ratio = np.sqrt(length / before)
        near = near + 1 if damping < 1e-7 and ratio < 1.0 and np.sqrt(length) < _NEAR * (1.0 - ratio) else 0
        state, damping = candidate, 0.1 * damping if damping > 1e-7 else 0.0
        equations = build_equations(given, state, start, free)
    return state, equations, rounds


def _solve_scaled(matrix: Array, damping: float, right: Array) -> Array:
    """Solve scaled normal equations; a singular matrix is regularised by its smallest eigenvalues."""
    from scipy.linalg import LinAlgError, cho_factor, cho_solve

    # The least damping is that of rounding.
    damped = matrix + (damping + 1e-14) * np.eye(len(matrix))
    try:
        return np.asarray(cho_solve(cho_factor(damped), right))
    except LinAlgError:
        return np.asarray(np.linalg.lstsq(damped, right, rcond=1e-12)[0])


def _cost(given: Observations, state: RigState, start: Array, free: NDArray[np.bool_]) -> float:
    residual = given.pixels - project(given, state, derivatives=False)[0]
    white = np.einsum("nij,nj->ni", given.whitening, residual)
    cost = robust_cost(np.hypot(white[:, 0], white[:, 1])) + prior_cost(state, start, free)
    return cost if np.isfinite(cost) else np.inf


@with_one_blas_thread
def adjust(given: Observations, state: RigState, start: Array | None = None, *, must_converge: bool = True) -> RigFit:
    """Estimate all parameters that are not fixed, exclude outliers, and return the fit with its covariance.

    ``state``: Start values.
    ``start``: Prior means, shape (P,); default: the intrinsic parameters of ``state``, and 0 for all others.
    ``must_converge``: Raise if the iterations reach no minimum; else see ``RigFit.converged``.
    """
    layout = state.layout
    if start is None:
        start = np.zeros(layout.size)
        start[: len(INTRINSICS)] = state.values[: len(INTRINSICS)]
    free = layout.std > 0
    used, points = given, [np.zeros(len(view.pixels), dtype=bool) for view in given.views]
    whole = np.ones(len(given.views), dtype=bool)
    state, equations, rounds = solve(used, state, start, free)
    for _ in range(_MOST_EXCLUSIONS):
        if not _exclude(given, state, points, whole):
            break
        used = _selection(given, points, whole)
        state, equations, rounds = solve(used, state, start, _estimable(layout.std, used, state))
    if must_converge and rounds >= _MOST_ROUNDS:
        raise not_converged()
    free = _estimable(layout.std, used, state)
    covariance = np.zeros((layout.size, layout.size))
    covariance[np.ix_(free, free)] = _invert(equations.information, layout.std, free, layout.names)
    dof = 2 * len(used.pixels) + int(np.isfinite(layout.std[free]).sum()) - int(free.sum())
    return RigFit(
        given=used, state=state, start=start, free=free, data_information=equations.information,
        covariance=covariance, chi2=equations.squares, dof=dof,
        views=tuple(_view_residuals(given, state, points, whole)), rounds=rounds,
    )  # fmt: skip


def not_converged() -> CalibrationError:
    """Return the error of an adjustment whose iterations reach no minimum."""
    msg = f"have no solution that {_MOST_ROUNDS} iterations reach: check the start values, the board and its poses"
    return CalibrationError([Problem("observations", msg)])


def _estimable(std: Array, used: Observations, state: RigState) -> NDArray[np.bool_]:
    """Return the free parameters, without poses and visits that no remaining image shows."""
    free = std > 0
    touched = np.zeros(len(std), dtype=bool)
    touched[state.layout.columns(used.views)] = True
    return free & (touched | np.isfinite(std))


def _selection(given: Observations, points: list[NDArray[np.bool_]], whole: NDArray[np.bool_]) -> Observations:
    views: list[TargetView] = []
    for view, excluded, consistent in zip(given.views, points, whole, strict=True):
        if consistent:
            views.append(view.without(excluded) if excluded.any() else view)
    return given.selected(views)


def _distances(given: Observations, state: RigState) -> list[Array]:
    """Return the distance of every point from its projection in standard deviations, by image."""
    residual = given.pixels - project(given, state, derivatives=False)[0]
    white = np.einsum("nij,nj->ni", given.whitening, residual)
    return np.split(np.hypot(white[:, 0], white[:, 1]), given.first[1:-1])


def _exclude(given: Observations, state: RigState, points: list[NDArray[np.bool_]], whole: NDArray[np.bool_]) -> bool:
    """Mark outliers and inconsistent images; return whether there is a change."""
    distances = _distances(given, state)
    medians = np.array([np.median(distance) for distance in distances])
    # Understated covariances do not make outliers.
    scale = max(1.0, float(np.median(medians[whole])) / np.sqrt(_MEDIAN_SQUARE))
    limit = _OUTLIER * scale
    worst = float(medians[whole].max())
    before = (sum(int(each.sum()) for each in points), int(whole.sum()))
    if worst > limit:
        # A single wrong image pulls others: the images with the largest residuals are excluded first.
        whole &= medians < max(limit, worst / 3)
    else:
        for number, distance in enumerate(distances):
            points[number] = distance > limit
            if whole[number] and points[number].mean() > _SHARE_OF_VIEW:
                whole[number] = False
    if not whole.any():
        whole |= True
    return before != (sum(int(each.sum()) for each in points), int(whole.sum()))


def _view_residuals(
    given: Observations, state: RigState, points: list[NDArray[np.bool_]], whole: NDArray[np.bool_]
) -> list[ViewResidual]:
    residual = np.split(given.pixels - project(given, state, derivatives=False)[0], given.first[1:-1])
    found = []
    for number, (view, distance) in enumerate(zip(given.views, _distances(given, state), strict=True)):
        kept = ~points[number] if whole[number] else np.ones(len(distance), dtype=bool)
        found.append(
            ViewResidual(
                name=view.name,
                points=int(kept.sum()) if whole[number] else 0,
                excluded=int((~kept).sum()) if whole[number] else len(kept),
                mean_square=float((distance[kept] ** 2).mean() / 2),
                rms_px=float(np.sqrt((residual[number][kept] ** 2).mean())),
                consistent=bool(whole[number]),
            )
        )
    return found


def _invert(information: Array, std: Array, free: NDArray[np.bool_], names: tuple[str, ...]) -> Array:
    """Return the inverse of the information with priors, from eigenvalues of the scaled matrix."""
    total = information + np.diag(prior_information(std, free))
    scale = 1 / np.sqrt(np.maximum(np.diag(total), 1e-300))
    values, vectors = np.linalg.eigh(total * scale[:, None] * scale)
    if values[0] < _LEAST_EIGENVALUE:
        free_names = [name for name, is_free in zip(names, free, strict=True) if is_free]
        order = np.argsort(-np.abs(vectors[:, 0]))[:3]
        listed = ", ".join(free_names[index] for index in order)
        msg = f"do not determine the parameters {listed}: add poses with a tilt of 35 to 40° about both axes"
        raise CalibrationError([Problem("observations", msg)])
    root = vectors / np.sqrt(values) * scale[:, None]
    return np.asarray(root @ root.T)
