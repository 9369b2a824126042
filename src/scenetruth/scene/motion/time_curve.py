"""Time-dependent numbers: constant, linear, harmonic, or interpolated between keyframes."""

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
    """Linear curve: start + rate t."""

    kind: Literal["linear"]
    """``linear``."""
    start: Finite = 0.0
    """Value at t = 0."""
    rate_per_frame: Finite
    """Change per frame."""

    def at(self, t: JetField) -> Any:
        """Return the value at times t, with derivatives for a jet."""
        return self.start + self.rate_per_frame * t


class HarmonicCurve(FrozenModel):
    """Harmonic curve: mean + amplitude sin(2 π t / period + phase)."""

    kind: Literal["harmonic"]
    """``harmonic``."""
    mean: Finite = 0.0
    """Mean value."""
    amplitude: Finite
    """Amplitude about the mean."""
    period_frames: Positive
    """Period in frames."""
    phase_deg: Finite = 0.0
    """Phase at t = 0 in degrees; 0 crosses the mean upwards."""

    def at(self, t: JetField) -> Any:
        """Return the value at times t, with derivatives for a jet."""
        return self.mean + self.amplitude * np.sin(2 * np.pi / self.period_frames * t + np.deg2rad(self.phase_deg))


class KeyframeCurve(FrozenModel):
    """Cubic spline through keyframes with continuous second derivative, extrapolated beyond the ends."""

    kind: Literal["keyframes"]
    """``keyframes``."""
    times_frames: tuple[Finite, ...]
    """Times of the keyframes in frames, increasing; at least two."""
    values: tuple[Finite, ...]
    """Value at each keyframe."""

    @field_validator("times_frames")
    @classmethod
    def _in_order(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        return check_increasing(value)

    @model_validator(mode="after")
    def _as_many(self) -> KeyframeCurve:
        if len(self.times_frames) != len(self.values):
            msg = f"requires one of values for each of times_frames: {len(self.values)} for {len(self.times_frames)}"
            raise ValueError(msg)
        return self

    def at(self, t: JetField) -> Any:
        """Return the value at times t, with derivatives for a jet."""
        return SplineThrough(self.times_frames, self.values)(t)


_Curve = Annotated[
    LinearCurve | HarmonicCurve | KeyframeCurve, Field(discriminator="kind"), BeforeValidator(kind_in_lower_case)
]
TimeCurve = Finite | _Curve
"""A number, or a curve over time in frames."""


def check_increasing(times: tuple[float, ...]) -> tuple[float, ...]:
    """Validate that there are at least two keyframe times, in increasing order."""
    if len(times) < 2:
        msg = "requires at least two keyframes"
        raise ValueError(msg)
    wrong = [f"{times[n]:g} after {times[n - 1]:g}" for n in range(1, len(times)) if times[n] <= times[n - 1]]
    if wrong:
        msg = f"keyframe times must be increasing (got {', '.join(wrong)})"
        raise ValueError(msg)
    return times


def evaluate_curve(curve: TimeCurve, t: JetField) -> Any:
    """Return the value of a curve at times t."""
    return curve if isinstance(curve, float | int) else curve.at(t)


class SplineThrough:
    """Interpolating cubic not-a-knot spline through values, shape (n,), at increasing times, n >= 2."""

    def __init__(self, times: Any, values: Any) -> None:
        # The import takes half a second.
        from scipy.interpolate import CubicSpline

        spline = CubicSpline(np.asarray(times, dtype=np.float64), np.asarray(values, dtype=np.float64))
        self._knots, self._coefficients = spline.x, spline.c

    def __call__(self, t: JetField) -> Any:
        """Return the spline at times t, an array of any precision or a jet."""
        at = np.asarray(strip_derivatives(t))
        piece = np.clip(np.searchsorted(self._knots, at, side="right") - 1, 0, len(self._knots) - 2)
        c3, c2, c1, c0 = self._coefficients[:, piece]
        h = at - self._knots[piece]
        return compose(t, ((c3 * h + c2) * h + c1) * h + c0, (3 * c3 * h + 2 * c2) * h + c1, 6 * c3 * h + 2 * c2)
