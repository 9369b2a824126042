"""Numbers that change with time: constant, linear, harmonic, or interpolated between keyframes."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, field_validator, model_validator

from scenetruth.discovery import kind_in_lower_case
from scenetruth.scene.taylor import JetField, compose, strip_derivatives
from scenetruth.validated_model import Finite, FrozenModel, Positive

__all__ = [
    "HarmonicCurve",
    "KeyframeCurve",
    "LinearCurve",
    "SplineThrough",
    "TimeCurve",
    "check_increasing",
    "evaluate_curve",
]


class LinearCurve(FrozenModel):
    """start + rate t."""

    kind: Literal["linear"]
    """``linear``."""
    start: Finite = 0.0
    """Value at t = 0."""
    rate_per_frame: Finite
    """Change per frame."""

    def at(self, t: JetField) -> Any:
        """Return value and, of a jet, derivatives at times t."""
        return self.start + self.rate_per_frame * t


class HarmonicCurve(FrozenModel):
    """mean + amplitude sin(2 π t / period + phase)."""

    kind: Literal["harmonic"]
    """``harmonic``."""
    mean: Finite = 0.0
    """Mean value."""
    amplitude: Finite
    """Largest deviation from the mean."""
    period_frames: Positive
    """Period in frames."""
    phase_deg: Finite = 0.0
    """Phase at t = 0 in degrees; 0 passes the mean while rising."""

    def at(self, t: JetField) -> Any:
        """Return value and, of a jet, derivatives at times t."""
        return self.mean + self.amplitude * np.sin(2 * np.pi / self.period_frames * t + np.deg2rad(self.phase_deg))


class KeyframeCurve(FrozenModel):
    """The cubic spline through keyframes, with a steady second derivative; it goes on beyond the first and the last."""

    kind: Literal["keyframes"]
    """``keyframes``."""
    times_frames: tuple[Finite, ...]
    """Times of the keyframes in frames, increasing; at least two."""
    values: tuple[Finite, ...]
    """Value at each."""

    @field_validator("times_frames")
    @classmethod
    def _in_order(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        return check_increasing(value)

    @model_validator(mode="after")
    def _as_many(self) -> KeyframeCurve:
        if len(self.times_frames) != len(self.values):
            msg = f"needs one of values for each of times_frames: {len(self.values)} for {len(self.times_frames)}"
            raise ValueError(msg)
        return self

    def at(self, t: JetField) -> Any:
        """Return value and, of a jet, derivatives at times t."""
        return SplineThrough(self.times_frames, self.values)(t)


_Curve = Annotated[
    LinearCurve | HarmonicCurve | KeyframeCurve, Field(discriminator="kind"), BeforeValidator(kind_in_lower_case)
]
TimeCurve = Finite | _Curve
"""A number, or a curve of numbers over time in frames."""


def check_increasing(times: tuple[float, ...]) -> tuple[float, ...]:
    """Refuse times of keyframes that are fewer than two, or out of order."""
    if len(times) < 2:
        msg = "needs at least two keyframes"
        raise ValueError(msg)
    wrong = [f"{times[n]:g} after {times[n - 1]:g}" for n in range(1, len(times)) if times[n] <= times[n - 1]]
    if wrong:
        msg = f"keyframes must be in order, each later than the one before (got {', '.join(wrong)})"
        raise ValueError(msg)
    return times


def evaluate_curve(curve: TimeCurve, t: JetField) -> Any:
    """Return a curve at times t."""
    return curve if isinstance(curve, float | int) else curve.at(t)


class SplineThrough:
    """The natural choice of curves through keyframes: cubic, twice continuously differentiable, not-a-knot at the ends.

    ``times``: Increasing times, shape (n,), n >= 2.
    ``values``: A value at each, shape (n,).
    """

    def __init__(self, times: Any, values: Any) -> None:
        # Half a second to import.
        from scipy.interpolate import CubicSpline

        spline = CubicSpline(np.asarray(times, dtype=np.float64), np.asarray(values, dtype=np.float64))
        self._knots, self._coefficients = spline.x, spline.c

    def __call__(self, t: JetField) -> Any:
        """Return the curve at times t, an array of any precision or a jet."""
        at = np.asarray(strip_derivatives(t))
        piece = np.clip(np.searchsorted(self._knots, at, side="right") - 1, 0, len(self._knots) - 2)
        c3, c2, c1, c0 = self._coefficients[:, piece]
        h = at - self._knots[piece]
        return compose(t, ((c3 * h + c2) * h + c1) * h + c0, (3 * c3 * h + 2 * c2) * h + c1, 6 * c3 * h + 2 * c2)
