"""Error of the depth that a calibration causes, apart by its sources: tolerances, noise of the points, new visits."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.calibration import CommonError, MeasurementSlopes, Moment, RigCalibration, RigFit
from scenetruth.number_format import format_two_digits

__all__ = ["BudgetPart", "DepthBudget", "depth_budget", "depth_grid", "depth_slopes"]

Array = NDArray[np.float64]

_COLUMNS, _ROWS = 9, 7
"""Grid of pixels over the image, on which errors that vary smoothly are computed."""
_BORDERS = (0.0, 0.05, 0.1, 0.2, 0.3)
"""Shares of the image that are omitted at every border, if the lens folds the image there."""
_ROUNDING = 1e-9
"""Share of the variance below which a source is rounding."""
_SOURCES: tuple[tuple[str, str], ...] = (
    ("step length", r"step_scale|backlash"),
    ("size of the board", r"board\.scale"),
    ("size of the strip", r"\w+\.scale"),
    ("flatness of the target", r"\w+\.(warp|bend)_\w+|pose\[\d+\]\.bend_\w+"),
    ("places of the points of the target", r"\w+\.point\[\d+\]\.\w+"),
    ("angles of the stage", r"position\[\d+\]\.(pitch|yaw|roll)"),
    ("straightness of the stage", r"position\[\d+\]\.[xyz]"),
    ("repeatability in the board images", r"visit\[\d+\]\.\w+"),
    ("stated direction of the axis", r"axis_[yz]"),
    ("stated lens", r"f|c_[xy]|[kp]\d"),
)
"""Sources and the parameters whose priors state them; the first that fits."""
CORNERS, VISITS = "noise of the detected points", "repeatability in the measurement"
"""The other sources: the images of the calibration, and the visits of the measurement."""
POSES = "errors that all points of a board image share"
"""The source of scatter of the poses beyond the noise of the points."""


@dataclass(frozen=True)
class BudgetPart:
    """A source and its standard deviations in mm: of the mean depth of all pixels, and of the departure from it.

    ``halved_mm``: Standard deviation of the mean depth of all sources if this one were half as large.
    """

    title: str
    mean_mm: float
    rest_mm: float
    halved_mm: float


@dataclass(frozen=True, eq=False)
class DepthBudget:
    """Error of the depth of a frontal plane that the calibration causes.

    ``depth_mm``: Distance of the plane.
    ``pixels``: Grid of pixels, shape (n, 2).
    ``calibration``: Error by the calibration alone.
    ``total``: Error with new visits of the measurement.
    ``parts``: Sources, the largest first.
    """

    depth_mm: float
    pixels: Array = field(repr=False)
    calibration: CommonError = field(repr=False)
    total: CommonError = field(repr=False)
    parts: tuple[BudgetPart, ...] = ()

    def words(self) -> list[str]:
        """Return the budget as sentences."""
        listed = [part for part in self.parts if part.mean_mm > 0.1 * self.total.mean_std][:4]
        named = ", ".join(f"{part.title} {format_two_digits(part.mean_mm)} mm" for part in listed)
        return [
            f"Calibration and stage shift the depth at {self.depth_mm:.0f} mm of all pixels{self._scan} together, "
            f"with a standard uncertainty of {format_two_digits(self.total.mean_std)} mm (prediction for a frontal "
            f"plane; maps state that of the measured surface). Contributions: {named}.",
            "Depth differences within a map have a standard uncertainty of "
            f"{format_two_digits(self.calibration.rest_rms)} mm by the calibration (RMS over the image).",
        ]

    @property
    def _scan(self) -> str:
        """New visits are new at every scan."""
        return "" if self.total.mean_std == self.calibration.mean_std else " of a single scan"

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the grid."""
        return _ROWS, _COLUMNS


def depth_grid(calibration: RigCalibration) -> Array:
    """Return a grid of pixels over the image, row by row, shape (n, 2), where the distortion is invertible."""
    for border in _BORDERS:
        x = np.linspace(border, 1 - border, _COLUMNS) * (calibration.width - 1)
        y = np.linspace(border, 1 - border, _ROWS) * (calibration.height - 1)
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        if np.isfinite(calibration.camera.ray_directions(grid)).all():
            break
    return grid


def depth_budget(calibration: RigCalibration, depth_mm: float, fit: RigFit | None = None) -> DepthBudget:
    """Return the error of the depth of a frontal plane by source.

    The estimate of a fit with priors is linear in the errors e of the tolerances and n of the corners: its error is
    C (P⁻¹ e + Aᵀ W n) with the covariance C, so that the contributions of independent sources add as variances. If
    the tolerance of some parameters is halved, their prior information grows by 3 P⁻¹, and Woodbury's formula gives the
    new covariance.

    ``fit``: Fit of the calibration, whose covariance includes the poses of the board; None for stated covariances.
    """
    pixels = depth_grid(calibration)
    slopes, fresh = depth_slopes(calibration, pixels, depth_mm)
    names, std, covariance, factor = _covariance(calibration, fit)
    rows = [names.index(name) for name in slopes]
    jacobian = np.array(list(slopes.values()))
    whole = jacobian.T @ covariance[np.ix_(rows, rows)] @ jacobian
    total = whole * factor
    if fit is not None and fit.scatter is not None:
        total = jacobian.T @ fit.stated_covariance[np.ix_(rows, rows)] @ jacobian
    effect = covariance[:, rows] @ jacobian
    members = _members(names, std, calibration)
    parts = _parts(members, std, covariance, effect, whole, factor, fresh, total - factor * whole)
    return DepthBudget(
        depth_mm, pixels, CommonError.from_covariance(total), CommonError.from_covariance(total + fresh), parts
    )


def _covariance(calibration: RigCalibration, fit: RigFit | None) -> tuple[list[str], Array, Array, float]:
    """Return names, prior standard deviations and covariance of all parameters, and the factor of a covariance."""
    if fit is None:
        return list(calibration.names), calibration.prior_std, calibration.covariance, 1.0
    layout = fit.state.layout
    # A covariance that was scaled by chi-squared, because the tolerances or the noise are understated.
    place = int(np.argmax(np.diag(calibration.covariance)))
    factor = float(calibration.covariance[place, place] / fit.covariance[place, place])
    return list(layout.names), layout.std, fit.covariance, factor if fit.scatter is None else fit.scale


def depth_slopes(calibration: RigCalibration, pixels: Array, depth_mm: float) -> tuple[dict[str, Array], Array]:
    """Return the derivatives of the depth of a frontal plane at pixels by name of the parameter, each of shape (n,).

    With a strip, they include those by the visits of the measurement, of which all frames together have the mean. The
    covariance by the repeatability of new visits, shape (n, n), is 0 with a strip.
    """
    points = calibration.camera.ray_directions(pixels) * depth_mm
    slopes = MeasurementSlopes(
        calibration.values, calibration.layout, calibration.positions_mm, calibration.reference, [Moment(points)]
    )
    found = {
        name: slopes.of_parameter(index)[:, 2]
        for index, name in enumerate(calibration.names[: calibration.layout.first_visit])
        if calibration.covariance[index, index] > 0
    }
    fresh = np.zeros((len(pixels), len(pixels)))
    deviations = calibration.visit_std
    for position, (motion, name) in product(range(len(calibration.positions_mm)), enumerate(_MOTIONS)):
        if calibration.measured_visits:
            each = slopes.of_visit(0, position, motion)[:, 2]
            visits = calibration.measured_visits[position]
            found |= {f"visit[{visit}].{name}": each / len(visits) for visit in visits}
        elif deviations[motion] > 0:
            each = deviations[motion] * slopes.of_visit(0, position, motion)[:, 2]
            fresh += np.outer(each, each)
    return found, fresh


_MOTIONS = ("pitch", "yaw", "roll", "x", "y", "z")


def _parts(
    members: dict[str, list[int]], std: Array, covariance: Array, effect: Array, whole: Array, factor: float,
    fresh: Array, scatter: Array,
) -> tuple[BudgetPart, ...]:  # fmt: skip
    """Return the contributions of all sources to the variance of the depth.

    ``effect``: Covariance of all parameters with the depth, shape (P, n). ``whole``: Covariance of the depth.
    ``scatter``: Covariance of the depth by the scatter of the poses.
    """
    usable = np.sort([index for rows in members.values() for index in rows])
    visits, shared = _moments(fresh), _moments(scatter)
    others = visits[0] + shared[0]
    total = factor * _moments(whole)[0] + others
    found, rest = [], whole
    for title, rows in members.items():
        # The error of the depth by one standard deviation of the prior of each parameter.
        by_prior = effect[rows] / std[rows][:, None]
        own = by_prior.T @ by_prior
        rest = rest - own
        inner = covariance[np.ix_(rows, rows)] + np.diag(std[rows] ** 2 / 3)
        less = effect[rows].T @ np.linalg.solve(inner, effect[rows])
        mean, other = (factor * value for value in _moments(own))
        found.append(_part(title, mean, other, total - factor * _moments(less)[0]))
    mean, other = (factor * value for value in _moments(rest))
    quiet = factor * _moments(whole / 4 + _gain_of_quiet_corners(covariance, std, usable, effect))[0] + others
    found.append(_part(CORNERS, mean, other, quiet))
    if shared[0] > _ROUNDING * total:
        found.append(_part(POSES, *shared, total - 0.75 * shared[0]))
    if visits[0] > 0:
        found.append(_part(VISITS, *visits, total - 0.75 * visits[0]))
    return tuple(sorted(found, key=lambda part: -part.mean_mm))


def _gain_of_quiet_corners(covariance: Array, std: Array, rows: NDArray[np.int64], effect: Array) -> Array:
    """Return what the covariance of the depth with half the noise exceeds a quarter of that with the whole noise.

    With half the noise the information is 4 (C⁻¹ - P⁻¹) + P⁻¹, whose inverse Woodbury's formula gives.
    """
    inner = np.diag(std[rows] ** 2 / 3) - covariance[np.ix_(rows, rows)] / 4
    return np.asarray(effect[rows].T @ np.linalg.solve(inner, effect[rows]) / 16)


def _part(title: str, mean: float, rest: float, halved: float) -> BudgetPart:
    return BudgetPart(title, *(float(np.sqrt(max(value, 0.0))) for value in (mean, rest, halved)))


def _moments(covariance: Array) -> tuple[float, float]:
    """Return the variance of the mean, and the mean variance of the departure from it."""
    mean = float(covariance.mean())
    return mean, float(np.diag(covariance).mean()) - mean


def _members(names: Sequence[str], std: Array, calibration: RigCalibration) -> dict[str, list[int]]:
    """Return the indices of the parameters of each source, for parameters with a prior."""
    measured = {f"visit[{visit}]" for each in calibration.measured_visits for visit in each}
    found: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        if np.isfinite(std[index]) and std[index] > 0:
            title = next((title for title, pattern in _SOURCES if re.fullmatch(pattern, name)), "other tolerances")
            if name.rpartition(".")[0] in measured:
                title = VISITS
            found.setdefault(title, []).append(index)
    return found
