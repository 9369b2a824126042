"""Variance components of a calibration: boards that bend or are printed inexactly, and corners with more noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.calibration.bundle_adjustment import (
    PoseScatter,
    RigFit,
    adjust,
    prior_information,
    robust_weights,
)
from scenetruth.capture.calibration.rig_model import (
    BENDS,
    INTRINSICS,
    SAME_POINT_MM,
    STAGE,
    Observations,
    RigLayout,
    RigPriors,
    RigState,
    TargetView,
    project,
)
from scenetruth.number_format import format_two_digits
from scenetruth.threads import with_one_blas_thread

__all__ = [
    "VarianceComponents", "carry_start", "carry_state", "estimate_components", "fit_places", "places_of_points",
    "scatter_of_poses",
]  # fmt: skip

Array = NDArray[np.float64]

_ROUNDS = 40
_CHANGE = 0.01
"""Relative change of every component at which the iteration ends: a tenth of what 100 residuals determine."""
_LEAST_SHARE = 0.02
"""Share of parameters that the images determine below which a component is not determined by them."""
_LEAST_FREEDOM = 0.1
_NAMED_ABOVE = 2.0
"""Ratio of the noise of an image to the median beyond which it is named."""
_FEWEST_POSES = 4
_SIGNIFICANT_SCATTER = 0.01
"""Probability of poses without common errors below which their scatter widens the covariance: one exact calibration of
a hundred is then stated about 1.4 times as uncertain, and smaller scatter than by a higher limit stays in the result.
"""
_BEYOND_DOUBT = 1e-6
"""Probability of exact points below which they deviate from their places: no chance in any number of calibrations."""
_DRAWS = 1000
_MOST_LEVERAGE = 0.9
"""Share of the information above which a pose is regarded as no more influential: its absence leaves too little."""
_LENS = np.array([*range(len(INTRINSICS)), len(INTRINSICS) + STAGE.index("aspect")])
_NEGLIGIBLE = 0.1
"""Effect of a component on the image relative to the noise of the corners, below which it is omitted: 0.5 % of the
total standard deviation.
"""


@dataclass(frozen=True)
class VarianceComponents:
    """Standard deviations beyond the stated noise of the corners, common to all images of the board.

    ``noise_px``: Additional noise of the corners of each view, independent from corner to corner.
    ``bend_mm``: Bend of the board that is new in every pose: each quadratic and cubic coefficient at the half width.
    ``point_mm``: Deviations of the points from their places in the plane of the board.
    ``height_mm``: Deviations of the points along the normal of the board.
    """

    noise_px: tuple[float, ...] = ()
    bend_mm: float = 0.0
    point_mm: float = 0.0
    height_mm: float = 0.0

    def applied(self, given: Observations) -> Observations:
        """Return observations of boards with these tolerances; other targets are kept."""
        board = given.targets[0].model_copy(
            update={
                "bend_mm": float(np.hypot(given.targets[0].bend_mm, self.bend_mm)),
                "point_mm": (
                    float(np.hypot(given.targets[0].point_mm[0], self.point_mm)),
                    float(np.hypot(given.targets[0].point_mm[1], self.height_mm)),
                ),
            }
        )
        noise = self.noise_px or (0.0,) * len(given.views)
        views = tuple(
            replace(view, covariance_px2=view.covariance_px2 + extra**2 * np.eye(2)) if extra > 0 else view
            for view, extra in zip(given.views, noise, strict=True)
        )
        return replace(given, targets=(board, *given.targets[1:]), views=views)

    @property
    def usual_noise_px(self) -> float:
        """Median of the additional noise over the views."""
        return float(np.median(self.noise_px)) if self.noise_px else 0.0

    @property
    def structured(self) -> bool:
        """Whether the board bends or its points deviate."""
        return self.bend_mm > 0 or self.point_mm > 0 or self.height_mm > 0

    def words(self, views: Sequence[TargetView]) -> list[str]:
        """Return the components that are not zero, and the images whose corners have the largest noise, in words.

        ``views``: Views with the stated noise of their corners, in the order of ``noise_px``.
        """
        texts = []
        if self.usual_noise_px > 0:
            texts.append(
                f"the corners scatter by {format_two_digits(self.usual_noise_px)} "
                "px more than the noise of the images explains "
                "(compression, sharpening, gamma, reflections, uneven pixels without flat fields)"
            )
        if self.bend_mm > 0:
            texts.append(
                f"the board bends by {format_two_digits(self.bend_mm)} mm from pose to pose: use a stiff board"
            )
        if self.point_mm > 0 or self.height_mm > 0:
            texts.append(
                f"the points of the board deviate by {format_two_digits(self.point_mm)} "
                "mm from their places in its plane and by "
                f"{format_two_digits(self.height_mm)} mm along its normal: use "
                "a board that is printed exactly on a flat plate"
            )
        words = [f"{text}; the stated uncertainty includes it" for text in texts]
        # The noise of an image is all of it: additional noise far below what is stated makes no image worse.
        stated = [float(np.median(np.trace(view.covariance_px2, axis1=1, axis2=2))) / 2 for view in views]
        extra = np.square(self.noise_px) if self.noise_px else np.zeros(len(views))
        whole = np.sqrt(np.array(stated) + extra)
        for view, noise in zip(views, whole, strict=True):
            ratio = float(noise / np.median(whole))
            if ratio > _NAMED_ABOVE:
                words.append(
                    f"{view.name}: residuals are {ratio:.1f} times those of the other images; check its sharpness"
                )
        return words


def carry_state(state: RigState, layout: RigLayout) -> RigState:
    """Return the values of a state in another layout of the same poses; parameters that it lacks are 0."""
    places = {name: index for index, name in enumerate(state.layout.names)}
    chosen = [places.get(name, -1) for name in layout.names]
    values = np.where(np.array(chosen) >= 0, np.append(state.values, 0.0)[chosen], 0.0)
    numbers = {pose: number for number, pose in enumerate(state.layout.poses)}
    return RigState(layout, values, state.turns[[numbers[pose] for pose in layout.poses]])


@with_one_blas_thread
def estimate_components(
    given: Observations, fit: RigFit, priors: RigPriors, *, structured: bool = True
) -> tuple[VarianceComponents, Observations, RigFit]:
    """Return the variance components for which the residuals are as large as stated, and the fit with them.

    Each component is the root of the sum of its squared estimates over the number of them that the images determine
    (restricted maximum likelihood by the fixed point of MacKay 1992).

    ``given``: All observations, also those that ``fit`` has excluded.
    ``structured``: Whether boards may bend or deviate; else there is additional noise of the corners only.
    """
    rms = float(np.sqrt((fit.residuals_px**2).mean()))
    depths = fit.state.values[[fit.state.layout.pose(n) + 5 for n in range(len(fit.state.layout.poses))]]
    mm_per_px = float(np.median(np.abs(depths))) / fit.state.value("f")
    start = rms * mm_per_px if structured else 0.0
    parts = VarianceComponents((rms / 2,) * len(given.views), 2 * start, start, 2 * start)
    changed, state = given, fit.state
    for _ in range(_ROUNDS):
        changed = parts.applied(given)
        layout = RigLayout.from_observations(changed, priors)
        fit = adjust(changed, carry_state(state, layout), carry_start(fit, layout))
        state, before = fit.state, parts
        parts = _updated(parts, changed, fit, mm_per_px)
        one, other = _values(before), _values(parts)
        if (np.abs(one - other) <= _CHANGE * one).all():
            break
    return parts, changed, fit


def places_of_points(fit: RigFit) -> float:
    """Return the standard deviation in mm of the points from their places in the plane of the board; 0 if by chance.

    The scores of each point by its two coordinates, summed over the images of a pose, are noise from pose to pose, and
    have a common part if the point is not at its place (analysis of variance). Neither needs a right noise.
    """
    from scipy.stats import f as distribution

    given = fit.given
    boards = [number for number, view in enumerate(given.views) if view.target == 0]
    if not boards or given.targets[0].point_mm[0] > 0:
        return 0.0
    chosen = np.concatenate([np.arange(given.first[number], given.first[number + 1]) for number in boards])
    poses = np.concatenate([np.full(len(given.views[number].pixels), given.views[number].pose) for number in boards])
    weights = np.sqrt(robust_weights(np.hypot(fit.z[:, 0], fit.z[:, 1])))[chosen, None]
    slopes = project(given, fit.state, derivatives=True)[1][chosen, :, -3:-1]
    slopes = weights[:, :, None] * (given.whitening[chosen] @ slopes)
    places = np.rint(given.points_mm[chosen] / SAME_POINT_MM)
    keys, pairs = np.unique(np.column_stack([places, poses]), axis=0, return_inverse=True)
    score, information = np.zeros((len(keys), 2)), np.zeros((len(keys), 2, 2))
    np.add.at(score, pairs.ravel(), np.einsum("nij,ni->nj", slopes, weights * fit.z[chosen]))
    np.add.at(information, pairs.ravel(), np.einsum("nij,nik->njk", slopes, slopes))
    points, numbers = np.unique(keys[:, :3], axis=0, return_inverse=True)
    common, whole = np.zeros((len(points), 2)), np.zeros((len(points), 2, 2))
    np.add.at(common, numbers.ravel(), score)
    np.add.at(whole, numbers.ravel(), information)
    between = _squares(common, whole)
    within = _squares(score, information) - between
    dof = 2 * len(points)
    rest = 2 * len(keys) - dof - 6 * len(set(poses.tolist()))
    if rest < dof or not distribution.sf(between / dof / (within / rest), dof, rest) < _BEYOND_DOUBT:
        return 0.0
    excess = between - dof * within / rest
    return float(np.sqrt(excess / np.trace(whole, axis1=1, axis2=2).sum()))


def _squares(score: Array, information: Array) -> float:
    """Return the sum of squared scores in units of their covariances."""
    return float(np.einsum("ni,nij,nj->", score, np.linalg.pinv(information, hermitian=True), score))


@with_one_blas_thread
def fit_places(given: Observations, fit: RigFit, priors: RigPriors, point_mm: float) -> RigFit:
    """Return the fit with deviations of the points in the plane of the board."""
    changed = VarianceComponents(point_mm=point_mm).applied(given)
    layout = RigLayout.from_observations(changed, priors)
    return adjust(changed, carry_state(fit.state, layout), carry_start(fit, layout))


@with_one_blas_thread
def scatter_of_poses(fit: RigFit) -> PoseScatter | None:
    """Return by which matrix results without one pose vary more than their covariance states; None if by chance.

    Errors that all points of an image share (light, focus, bends of other form) are no noise of its corners. The
    jackknife over the poses estimates the covariance of the lens parameters (MacKinnon, Nielsen and Webb 2023), by one
    step from the score of each pose. A matrix of a few poses is shrunk to a multiple of the stated covariance (Ledoit
    and Wolf 2004), by the variance that its elements have for that many poses.
    """
    poses = list(dict.fromkeys(view.pose for view in fit.given.views))
    chosen = _LENS[fit.free[_LENS]]
    if len(poses) < _FEWEST_POSES:
        return None
    root = _root(fit.covariance[np.ix_(chosen, chosen)])
    inverse = np.linalg.pinv(root)
    parts = _parts_of_poses(fit, poses, chosen, inverse)
    unit = np.eye(len(chosen))
    by_priors = unit - sum(part.share for part in parts)
    exact = np.array([part.transport @ part.change(part.score[None])[0] for part in parts]) / np.sqrt(fit.scale)
    found = float(((exact.T @ exact + by_priors) ** 2).sum())
    if np.mean(_by_chance(parts, by_priors) >= found) > _SIGNIFICANT_SCATTER:
        return None
    reduced = (len(poses) - 1) / len(poses)
    changes = np.array([part.change(part.score[None])[0] for part in parts]) / np.sqrt(fit.scale)
    jackknife = reduced * changes.T @ changes + by_priors
    mean = float(np.trace(jackknife)) / len(chosen)
    expected = float(sum(np.trace(part.deleted) for part in parts) * reduced + np.trace(by_priors)) / len(chosen)
    squares = reduced**2 * sum(float((part.deleted**2).sum() + np.trace(part.deleted) ** 2) for part in parts)
    departure = float(((jackknife - mean * unit) ** 2).sum())
    share = min((mean / expected) ** 2 * squares / max(departure, 1e-300), 1.0)
    values, vectors = np.linalg.eigh(share * mean * unit + (1 - share) * jackknife)
    factors = np.maximum(values, 1.0)
    transfer = root @ (vectors * np.sqrt(factors)) @ vectors.T @ inverse
    return PoseScatter(chosen, transfer, factors) if factors[-1] > 1 else None


@dataclass(frozen=True, eq=False)
class _PartOfPose:
    """Part of a pose in the equations of the common parameters, in units of their covariance.

    ``values``, ``vectors``: Eigenvalues and eigenvectors of its information H; with C = 1, these are its leverages.
    ``axes``: Changes of the lens parameters, in units of their covariance, along the eigenvectors.
    ``score``: Its score along the eigenvectors.
    """

    values: Array
    vectors: Array
    axes: Array
    score: Array

    @property
    def kept(self) -> Array:
        """Share of the information that the other poses have."""
        return np.asarray(1 - np.minimum(self.values, _MOST_LEVERAGE))

    @property
    def share(self) -> Array:
        """Its share of the covariance of the lens parameters, C H C."""
        return np.asarray((self.axes * self.values) @ self.axes.T)

    @property
    def deleted(self) -> Array:
        """Covariance of the change without this pose."""
        return np.asarray((self.axes * (self.values * (1 - self.values) / self.kept**2)) @ self.axes.T)

    def change(self, scores: Array) -> Array:
        """Return the changes of the lens parameters without this pose, C (1 - H C)⁻¹ g, for scores (n, m)."""
        return np.asarray((scores / self.kept) @ self.axes.T)

    def drawn(self, seed: np.random.SeedSequence) -> Array:
        """Return drawn scores along the eigenvectors, shape (draws, m)."""
        return np.random.default_rng(seed).standard_normal((_DRAWS, len(self.values))) * np.sqrt(self.values)

    @cached_property
    def transport(self) -> Array:
        """Symmetric matrix that gives the change the covariance of the share, whatever the leverage."""
        root, inverse = _power(self.deleted, 0.5), _power(self.deleted, -0.5)
        return np.asarray(inverse @ _power(root @ self.share @ root, 0.5) @ inverse)


def _parts_of_poses(
    fit: RigFit, poses: Sequence[int], chosen: NDArray[np.int64], inverse: NDArray[np.floating]
) -> list[_PartOfPose]:
    """Return the parts of all poses, from whose equations the parameters of one pose alone are eliminated."""
    given, layout = fit.given, fit.state.layout
    groups = [[number for number, view in enumerate(given.views) if view.pose == pose] for pose in poses]
    touched = np.zeros((len(poses), layout.size), dtype=bool)
    for row, numbers in zip(touched, groups, strict=True):
        views = [given.views[number] for number in numbers]
        row[layout.columns(views)] = True
        for view in views:
            row[layout.point_columns(view).ravel()] = True
    alone = touched.sum(axis=0) == 1
    alone[chosen] = False
    common = np.flatnonzero(fit.free & ~alone)
    root = _root(fit.covariance[np.ix_(common, common)])
    to_lens = inverse @ root[np.searchsorted(common, chosen)]
    weights = np.sqrt(robust_weights(np.hypot(fit.z[:, 0], fit.z[:, 1])))[:, None]
    slopes = weights[:, :, None] * (given.whitening @ project(given, fit.state, derivatives=True)[1])
    prior = np.zeros(layout.size)
    prior[fit.free] = prior_information(layout.std, fit.free)
    # Points beyond the limit of the weights determine nothing along their residual (Huber 1981).
    robust = 2 * (weights**2).sum() / (weights**2 * np.where(weights < 1, 1, 2)).sum()
    found = []
    for row, numbers in zip(touched, groups, strict=True):
        part = np.concatenate([np.arange(given.first[number], given.first[number + 1]) for number in numbers])
        seen = given.selected([given.views[number] for number in numbers])
        information = layout.information(seen, slopes[part])
        score = layout.gather(seen, slopes[part], (weights * fit.z)[part][:, :, None])[:, 0]
        own = np.flatnonzero(fit.free & alone & row)
        inner = information[np.ix_(own, own)] + np.diag(prior[own])
        cross = information[np.ix_(own, common)]
        scale = 1 / np.sqrt(np.diag(inner))
        solved = np.linalg.pinv(inner * scale[:, None] * scale, rcond=1e-13, hermitian=True) @ np.column_stack(
            [scale[:, None] * cross, scale * (score[own] - prior[own] * (fit.state.values - fit.start)[own])]
        )
        reduced = information[np.ix_(common, common)] - cross.T @ (scale[:, None] * solved[:, :-1])
        left = score[common] - cross.T @ (scale * solved[:, -1])
        product = root.T @ reduced @ root
        values, vectors = np.linalg.eigh((product + product.T) / 2)
        score = robust * vectors.T @ (root.T @ left)
        found.append(_PartOfPose(np.clip(values, 0.0, 1.0), vectors, to_lens @ vectors, score))
    return found


def _root(covariance: Array) -> Array:
    """Return a matrix R with R Rᵀ equal to a covariance."""
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / scale[:, None] / scale)
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def _power(matrix: Array, exponent: float) -> Array:
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return np.asarray((vectors * np.maximum(values, 1e-12) ** exponent) @ vectors.T)


def _by_chance(parts: Sequence[_PartOfPose], by_priors: Array) -> Array:
    """Return the sums of the squared elements of scatter matrices that the stated covariance explains.

    Scores are drawn with the information of the poses and of the priors as covariances, less what the adjustment of the
    common parameters takes from them.
    """
    seeds = np.random.SeedSequence(0).spawn(len(parts) + 1)
    priors = np.eye(len(parts[0].vectors)) - sum((part.vectors * part.values) @ part.vectors.T for part in parts)
    whole = np.random.default_rng(seeds[-1]).standard_normal((_DRAWS, len(priors))) @ _power(priors, 0.5)
    for part, seed in zip(parts, seeds, strict=False):
        whole += part.drawn(seed) @ part.vectors.T
    total = np.tile(by_priors, (_DRAWS, 1, 1))
    for part, seed in zip(parts, seeds, strict=False):
        left = part.drawn(seed) - part.values * (whole @ part.vectors)
        one = part.change(left) @ part.transport
        total += one[:, :, None] * one[:, None, :]
    return np.asarray((total**2).sum(axis=(1, 2)))


def _values(parts: VarianceComponents) -> Array:
    return np.array([parts.usual_noise_px, parts.bend_mm, parts.point_mm, parts.height_mm])


def carry_start(fit: RigFit, layout: RigLayout) -> Array:
    """Return the prior means in another layout: those of the intrinsic parameters, else 0."""
    means = np.zeros(layout.size)
    means[: layout.first_position] = fit.start[: layout.first_position]
    return means


def _updated(parts: VarianceComponents, given: Observations, fit: RigFit, mm_per_px: float) -> VarianceComponents:
    """Return the components that the estimates of one fit suggest."""
    layout = fit.state.layout
    variance = np.diag(fit.covariance)
    bends = np.concatenate([layout.pose(number) + 6 + np.arange(BENDS) for number in range(len(layout.poses))])
    points = np.arange(layout.first_point, layout.size)
    noise = _noise(parts.noise_px, given, fit, variance)
    floor = _NEGLIGIBLE * mm_per_px * float(np.sqrt(1 / np.mean(fit.given.whitening[:, 0, 0] ** 2)))
    bend = _component(parts.bend_mm, fit, variance, bends, 2 * floor)
    in_plane = _component(parts.point_mm, fit, variance, points[(points - layout.first_point) % 3 < 2], floor)
    height = _component(parts.height_mm, fit, variance, points[(points - layout.first_point) % 3 == 2], 2 * floor)
    return VarianceComponents(noise, bend, in_plane, height)


def _component(before: float, fit: RigFit, variance: Array, where: NDArray[np.int64], floor: float) -> float:
    where = where[fit.free[where]] if before > 0 else where[:0]
    std = fit.state.layout.std[where]
    if not len(where):
        return 0.0
    determined = float((1 - variance[where] / std**2).sum())
    if determined < _LEAST_SHARE * len(where):
        return 0.0
    found = float(np.sqrt((fit.state.values[where] ** 2).sum() / determined))
    return found if found > floor else 0.0


def _noise(before: tuple[float, ...], given: Observations, fit: RigFit, variance: Array) -> tuple[float, ...]:
    """Return the additional noise of each view for which chi-squared equals its degrees of freedom."""
    bounded = fit.free & np.isfinite(fit.state.layout.std)
    parameters = float(fit.free.sum()) - float((variance[bounded] / fit.state.layout.std[bounded] ** 2).sum())
    share = max(1 - parameters / (2 * len(fit.given.pixels)), _LEAST_FREEDOM)
    weights = robust_weights(np.hypot(fit.z[:, 0], fit.z[:, 1]))[:, None]
    found = dict(zip((view.name for view in given.views), before, strict=True))
    for number, view in enumerate(fit.given.views):
        part = slice(fit.given.first[number], fit.given.first[number + 1])
        values, vectors = np.linalg.eigh(view.covariance_px2 - found[view.name] ** 2 * np.eye(2))
        squares = np.einsum("nji,nj->ni", vectors, fit.residuals_px[part]) ** 2 * weights[part]
        found[view.name] = _excess(squares, values, share * squares.size) if view.target == 0 else 0.0
    usual = float(np.median([found[view.name] for view in fit.given.views]))
    return tuple(max(value, usual) for value in found.values())


def _excess(squares: Array, variances: Array, target: float) -> float:
    """Return the standard deviation to add for which the squares in units of their variances have a given sum."""
    if float((squares / variances).sum()) <= target:
        return 0.0
    low, high = 0.0, float(squares.sum()) / target
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if float((squares / (variances + middle)).sum()) > target else (low, middle)
    return float(np.sqrt(high))
