"""The plain sensor: Gaussian noise that does not depend on the signal, and digitisation."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from scenetruth.camera.sensor.base import Effect
from scenetruth.camera.sensor.chain import SensorChain
from scenetruth.camera.sensor.effects.digitisation import Digitisation
from scenetruth.camera.sensor.effects.full_range_gain import FullRangeGain
from scenetruth.camera.sensor.effects.full_scale import FullScale
from scenetruth.camera.sensor.noises.gaussian_noise import GaussianNoise
from scenetruth.model import FrozenModel, NonNegative, Positive

__all__ = ["GaussianSensor"]


class GaussianSensor(FrozenModel):
    """A sensor with Gaussian noise and digitisation."""

    kind: Literal["gaussian"] = "gaussian"
    """Tells this sensor from others; may be left out."""
    noise_std: NonNegative = 0.0
    """Standard deviation of the temporal Gaussian noise, as a fraction of full scale."""
    bit_depth: Annotated[int, Field(ge=1, le=16)] | None = 8
    """Bits of a digital number; null keeps floats (no digitisation, no saturation)."""
    full_scale_radiance: Positive = 1.0
    """Radiance that gives full scale."""

    def chain(self) -> SensorChain:
        """Return the chain of effects that models this sensor."""
        effects: list[Effect] = [FullScale(kind="full_scale", full_scale_radiance=self.full_scale_radiance)]
        if self.noise_std > 0:
            effects.append(GaussianNoise(kind="gaussian_noise", noise_std=self.noise_std))
        if self.bit_depth is not None:
            effects += [
                FullRangeGain(kind="full_range_gain"),
                Digitisation(kind="digitisation", bit_depth=self.bit_depth),
            ]
        return SensorChain(effects=tuple(effects))
