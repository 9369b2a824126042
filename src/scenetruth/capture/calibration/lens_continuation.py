"""Lens distortion beyond the outermost points: an additional radial coefficient with a prior that the image sets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from scenetruth.capture.calibration.bundle_adjustment import RigFit
from scenetruth.capture.calibration.rig_model import INTRINSICS, STAGE, RigPriors, RigState
from scenetruth.number_format import format_two_digits, format_with_std

__all__ = ["LensContinuation", "continue_lens", "folding", "is_extrapolated", "is_undetermined", "shortened"]

Array = NDArray[np.float64]

RADIAL = ("k1", "k2", "k3")
"""Coefficients of the radial polynomial in their order."""
_RATIONAL = ("k4", "k5", "k6")
_NEARLY_ALL = 0.6
"""Share of the distance to the image corners that the points must reach; beyond it, the lens is extrapolated."""
_OUTERMOST = 6
"""Number of points that define the radius that they reach: single points do not determine the distortion there."""
_SCALE_STD = 1 / 3
"""Standard deviation of the image scale beyond the points relative to that at the outermost points. That of wide lenses
with barrel distortion falls by a quarter to a third, and a folded image is three standard deviations away.
"""
_LEAST_SLOPE = 0.1
"""Image scale at the outermost points, relative to the centre, below which they lie at the fold."""
_LEAST_PX = 1.0
"""Distortion in the corners that no lens is stated to fall below."""
_ASPECT = len(INTRINSICS) + STAGE.index("aspect")


@dataclass(frozen=True)
class LensContinuation:
    """Prior of the radial coefficient that continues the distortion to the image corners.

    ``name``: Coefficient.
    ``mean``, ``std``: Its prior.
    ``share``: Radius of the outermost points relative to that of the image corners.
    ``corner_px``: Displacement of the farthest corner by a coefficient of 1, in px.
    """

    name: str
    mean: float
    std: float
    share: float
    corner_px: float

    def priors(self, priors: RigPriors) -> RigPriors:
        """Return tolerances with the prior of the coefficient; it is estimated."""
        names = tuple(dict.fromkeys((*priors.free_distortion, self.name)))
        stated = {**priors.intrinsics, self.name: self.std}
        return priors.model_copy(update={"free_distortion": names, "intrinsics": stated})

    def words(self, state: RigState, std: float) -> str:
        """Return what the calibration states about the corners; empty below one pixel, which the covariance states.

        ``std``: Standard deviation of the estimated coefficient.
        """
        if std * self.corner_px < _LEAST_PX:
            return ""
        return (
            f"the outermost points reach {100 * self.share:.0f} % of the distance to the image corners: beyond them, "
            f"the image scale is continued by {self.name} = {format_with_std(state.value(self.name), std)} "
            f"with a prior of {format_with_std(self.mean, self.std)}, "
            f"which leaves {format_two_digits(std * self.corner_px)} px; "
            "show boards in the corners of the image"
        )


def is_extrapolated(fit: RigFit) -> bool:
    """Return whether the image corners lie far beyond the points of the boards."""
    reached, corner = _radii(fit)
    return reached < _NEARLY_ALL * corner


def folding(state: RigState, width: int, height: int) -> str:
    """Return why a state has no camera, because its distortion folds the image; empty if it has a camera."""
    try:
        state.camera(width, height)
    except ValidationError as error:
        return str(error.errors()[0]["msg"]).removeprefix("Value error, ")
    return ""


def shortened(priors: RigPriors, count: int) -> RigPriors:
    """Return tolerances with the first ``count`` coefficients of the radial polynomial, and no rational terms."""
    dropped = (*RADIAL[count:], *_RATIONAL)
    names = tuple(name for name in priors.free_distortion if name not in dropped)
    return priors.model_copy(update={"free_distortion": names})


def is_undetermined(fit: RigFit, name: str) -> bool:
    """Return whether the images determine a radial coefficient less than a continuation without it would state."""
    index = INTRINSICS.index(name)
    without = fit.state.values.copy()
    without[index] = 0.0
    edge = _edge(fit, without)
    if edge is None:
        return False
    std = float(np.sqrt(fit.stated_covariance[index, index]))
    return std * edge.outer ** (2 * RADIAL.index(name) + 3) > _SCALE_STD * edge.missing


def continue_lens(fit: RigFit, count: int) -> LensContinuation | None:
    """Return the prior of the radial coefficient that follows the first ``count``; None if there is none.

    Its mean continues the image scale at the outermost points up to the corners of the image. Its standard deviation is
    a third of that scale between the points and the corners, but no more than the largest term before it is there.
    """
    edge = _edge(fit, fit.state.values) if count < len(RADIAL) else None
    if edge is None:
        return None
    power = edge.outer ** (2 * count + 3)
    terms = [fit.state.value(name) * edge.outer ** (2 * order + 3) for order, name in enumerate(RADIAL[:count])]
    std = _SCALE_STD * edge.missing
    if count:
        # The last term is as uncertain in the corners as its coefficient.
        last = INTRINSICS.index(RADIAL[count - 1])
        own = float(np.sqrt(fit.stated_covariance[last, last])) * edge.outer ** (2 * count + 1)
        std = min(std, max(_LEAST_PX / fit.state.value("f"), *map(abs, terms)) + own)
    mean = (edge.corner - edge.outer - sum(terms)) / power
    return LensContinuation(RADIAL[count], mean, std / power, edge.share, power * fit.state.value("f"))


@dataclass(frozen=True)
class _Edge:
    """The outermost points and the image corners, as tangents of angles to the optical axis.

    ``outer``, ``corner``: Tangent at the farthest corner without distortion, by the image scale at the outermost
      points, and with distortion.
    ``missing``: Distance in the image between the outermost points and the corner.
    ``share``: Radius of the outermost points relative to that of the image corners.
    """

    outer: float
    corner: float
    missing: float
    share: float


def _edge(fit: RigFit, values: Array) -> _Edge | None:
    """Return where the points end; None if the distortion folds there."""
    focal, coefficients = float(values[0]), values[3:]
    seen, corner = (radius / focal for radius in _radii(fit))
    radii = np.linspace(0.0, 3.0 * seen, 3001)
    square = radii**2
    above = 1 + square * (coefficients[0] + square * (coefficients[1] + square * coefficients[4]))
    below = 1 + square * (coefficients[5] + square * (coefficients[6] + square * coefficients[7]))
    with np.errstate(divide="ignore", invalid="ignore"):
        shown = radii * above / below
        slope = np.gradient(shown, radii)
    # The branch that rises from the centre.
    rising = int(np.argmin(np.append(slope > _LEAST_SLOPE, False)))
    if rising < 2 or shown[rising - 1] < seen:
        return None
    place = int(np.searchsorted(shown[:rising], seen))
    outer = float(radii[place] + (corner - seen) / slope[place])
    return _Edge(outer, corner, corner - seen, seen / corner)


def _radii(fit: RigFit) -> tuple[float, float]:
    """Return the distances of the outermost points and of the farthest image corner from the principal point in px."""
    given, centre = fit.given, fit.state.values[1:3]
    squeeze = np.array([1.0, 1.0 + fit.state.values[_ASPECT]])
    pixels = np.concatenate([view.pixels for view in given.views if view.target == 0])
    away = np.sort(np.hypot(*((pixels - centre) / squeeze).T))
    corners = np.array([[x, y] for x in (-0.5, given.width - 0.5) for y in (-0.5, given.height - 0.5)])
    return float(away[-min(_OUTERMOST, len(away))]), float(np.hypot(*((corners - centre) / squeeze).T).max())
