"""Variance components of a calibration: boards that bend or are printed inexactly, and corners with more noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.calibration.bundle_adjustment import RigFit, adjust, robust_weights
from scenetruth.capture.calibration.rig_model import (
    BENDS,
    INTRINSICS,
    CalibrationError,
    Observations,
    RigLayout,
    RigPriors,
    RigState,
    TargetView,
)
from scenetruth.threads import with_one_blas_thread

__all__ = ["VarianceComponents", "carry_state", "estimate_components", "scatter_of_poses"]

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
_SIGNIFICANT = 1e-3
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
                f"the corners scatter by {self.usual_noise_px:.2g} px more than the noise of the images explains "
                "(compression, sharpening, gamma, reflections, uneven pixels without flat fields)"
            )
        if self.bend_mm > 0:
            texts.append(f"the board bends by {self.bend_mm:.2g} mm from pose to pose: use a stiff board")
        if self.point_mm > 0 or self.height_mm > 0:
            texts.append(
                f"the points of the board deviate by {self.point_mm:.2g} mm from their places in its plane and by "
                f"{self.height_mm:.2g} mm along its normal: use a board that is printed exactly on a flat plate"
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
        fit = adjust(changed, carry_state(state, layout), _start(fit, layout))
        state, before = fit.state, parts
        parts = _updated(parts, changed, fit, mm_per_px)
        one, other = _values(before), _values(parts)
        if (np.abs(one - other) <= _CHANGE * one).all():
            break
    return parts, changed, fit


@with_one_blas_thread
def scatter_of_poses(fit: RigFit, priors: RigPriors) -> float:
    """Return by which factor results without one pose vary more than their covariance states; 1 if not significantly.

    Errors that all points of an image share (light, focus, bends of other form) are no noise of its corners. The
    intrinsic parameters without a pose less those with it have the difference of both covariances as theirs.
    """
    from scipy.stats import chi2

    poses = list(dict.fromkeys(view.pose for view in fit.given.views))
    chosen = [index for index in range(len(INTRINSICS)) if fit.free[index]]
    shape = (len(chosen), len(chosen))
    found, stated, count = np.zeros(shape), np.zeros(shape), 0
    for omitted in poses:
        rest = fit.given.selected([view for view in fit.given.views if view.pose != omitted])
        try:
            layout = RigLayout.from_observations(rest, priors)
            part = adjust(rest, carry_state(fit.state, layout), _start(fit, layout))
        except CalibrationError:
            continue
        change = part.state.values[chosen] - fit.state.values[chosen]
        found += np.outer(change, change)
        stated += part.covariance[np.ix_(chosen, chosen)] - fit.covariance[np.ix_(chosen, chosen)]
        count += 1
    if count < _FEWEST_POSES:
        return 1.0
    scale = np.sqrt(np.maximum(np.diag(stated), 1e-300))
    relative = np.linalg.pinv(stated / scale[:, None] / scale, rcond=1e-6, hermitian=True)
    ratio = float((relative * (found / scale[:, None] / scale)).sum()) / len(chosen)
    # The changes of all poses add up to about zero, and those of neighbours are not independent.
    dof = len(chosen) * (count - 1) / 2
    return ratio if chi2.sf(ratio * dof, dof) < _SIGNIFICANT else 1.0


def _values(parts: VarianceComponents) -> Array:
    return np.array([parts.usual_noise_px, parts.bend_mm, parts.point_mm, parts.height_mm])


def _start(fit: RigFit, layout: RigLayout) -> Array:
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
