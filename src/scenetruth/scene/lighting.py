"""The light on a scene: ambient, lamps that may move, shadows, and how brightness changes in time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from scenetruth.kinds import one_of
from scenetruth.model import Finite, FrozenModel, NonNegative, Positive
from scenetruth.scene.light import Lamp, LightModel

__all__ = ["Flicker", "Light", "Lighting"]

if TYPE_CHECKING:
    Light = LightModel
else:
    Light = one_of(LightModel, "scenetruth.scene.light")


class Flicker(FrozenModel):
    """A periodic change of brightness, as of lamps on the mains."""

    amplitude: Annotated[float, Field(ge=0, lt=1)]
    """Amplitude, relative to the mean brightness."""
    period_frames: Positive
    """Period in frames."""
    phase_deg: Finite = 0.0
    """Phase at t = 0 in degrees."""


class Lighting(FrozenModel):
    """The light on the objects.

    A surface has the radiance ``texture (ambient + sum of E falloff max(0, n l) over the lights that reach it)``, with
    its texture as albedo; π is left out, so that irradiance 1 gives the texture's own value. Everything that is seen is
    then multiplied by the brightness of the time. Without ambient and lights, the scene is unlit: radiance is the
    texture's, times the brightness.
    """

    ambient: NonNegative | None = None
    """Irradiance that comes from everywhere alike; 0 if there are lights, unlit if there are none either."""
    lights: tuple[Light, ...] = ()
    """The lamps."""
    shadows: bool = True
    """Whether objects take light from what is behind them."""
    drift_per_frame: Finite = 0.0
    """Brightness at time t is 1 + drift_per_frame t + flicker, of all that is seen, background included."""
    flicker: Flicker | None = None
    """A periodic part of it: amplitude sin(2π t / period + phase)."""

    @property
    def lit(self) -> bool:
        """Whether surfaces are shaded at all."""
        return self.ambient is not None or bool(self.lights)

    def brightness(self, t: float) -> float:
        """Return the factor of everything that is seen at time t (in frames); exactly 1 where nothing changes."""
        factor = 1.0 + self.drift_per_frame * t
        if self.flicker is not None:
            phase = 2 * np.pi * t / self.flicker.period_frames + np.deg2rad(self.flicker.phase_deg)
            factor += self.flicker.amplitude * float(np.sin(phase))
        return factor

    def lamps_at(self, t: float) -> list[Lamp]:
        """Return the lights at time t (in frames), in the scene's order."""
        return [light.lamp(t) for light in self.lights]
