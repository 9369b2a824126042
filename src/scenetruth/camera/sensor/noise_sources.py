"""Sensor noise: shot noise, dark current, readout noise and fixed-pattern noise."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator

from scenetruth.camera.sensor.effects import Effect, Exposure, Unit
from scenetruth.validated_model import NonNegative, Positive

__all__ = [
    "DarkCurrent", "DarkSignalNonuniformity", "GaussianNoise", "PhotoResponseNonuniformity", "ReadoutNoise",
    "ShotNoise", "checked_hot_pixel_current",
]  # fmt: skip


def checked_hot_pixel_current(value: float, info: ValidationInfo) -> float:
    """Validate that hot pixels have at least the dark current of normal pixels (pydantic validator)."""
    current = info.data.get("dark_current_e_per_s")
    if info.data.get("hot_pixel_share") and current is not None and value < current:
        msg = f"must not be below dark_current_e_per_s, {current:g}, if there are hot pixels"
        raise ValueError(msg)
    return value


class DarkCurrent(Effect):
    """Dark current: thermal electrons with shot noise, therefore before it in the chain; more in hot pixels."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["dark_current"]
    """Type of the effect."""
    exposure_time_s: Positive
    """Exposure time in s."""
    dark_current_e_per_s: NonNegative = 0.0
    """Dark current in electrons per pixel and second."""
    hot_pixel_share: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)] = 0.0
    """Fraction of pixels with ``hot_pixel_current_e_per_s``."""
    hot_pixel_current_e_per_s: Annotated[NonNegative, Field(validate_default=True)] = 0.0
    """Dark current of hot pixels in electrons per pixel and second."""

    _hot_pixel_current = field_validator("hot_pixel_current_e_per_s")(checked_hot_pixel_current)

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64]:
        """Return the mean dark electrons of each pixel."""
        hot = generator.random(shape) < self.hot_pixel_share
        current = np.where(hot, self.hot_pixel_current_e_per_s, self.dark_current_e_per_s)
        return np.asarray(current * self.exposure_time_s, dtype=np.float64)

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Add the electrons."""
        assert exposure.pattern is not None
        return signal + exposure.pattern

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the electrons of a normal pixel."""
        return signal + self.dark_current_e_per_s * self.exposure_time_s

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the capacity left for light."""
        return largest_output - self.dark_current_e_per_s * self.exposure_time_s


class DarkSignalNonuniformity(Effect):
    """Fixed, normally distributed offset of every pixel (DSNU)."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["dark_signal_nonuniformity"]
    """Type of the effect."""
    dsnu_e: NonNegative
    """DSNU_1288, standard deviation of the dark offsets in electrons."""

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64]:
        """Return the offsets in electrons."""
        return self.dsnu_e * generator.standard_normal(shape)

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Add the offsets."""
        assert exposure.pattern is not None
        return signal + exposure.pattern


class GaussianNoise(Effect):
    """Temporal Gaussian noise of uniform standard deviation."""

    takes: ClassVar[Unit] = "share of full scale"
    gives: ClassVar[Unit] = "share of full scale"

    kind: Literal["gaussian_noise"]
    """Type of the effect."""
    noise_std: NonNegative
    """Standard deviation, as a fraction of full scale."""

    def stream(self, s_y: int, s: int, t: int) -> tuple[str | int, ...]:
        """Return the random-stream key for one image."""
        # Unnamed noise keeps the key of earlier versions, without a name and without the reference row, for identical
        # recordings.
        return super().stream(s_y, s, t) if self.name else (*((s_y,) if s_y else ()), s, t)

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Add noise."""
        return signal + self.noise_std * exposure.generator().standard_normal(signal.shape)


class PhotoResponseNonuniformity(Effect):
    """Fixed, normally distributed sensitivity of every pixel about 1 (PRNU)."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["photo_response_nonuniformity"]
    """Type of the effect."""
    prnu: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)]
    """PRNU_1288, standard deviation of the pixel sensitivities relative to their mean."""

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64]:
        """Return the sensitivities, clipped at 0."""
        return np.maximum(1 + self.prnu * generator.standard_normal(shape), 0.0)

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by the sensitivities."""
        assert exposure.pattern is not None
        return signal * exposure.pattern


class ReadoutNoise(Effect):
    """Temporal Gaussian readout noise."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["readout_noise"]
    """Type of the effect."""
    temporal_dark_noise_e: NonNegative
    """σ_d, standard deviation in electrons, without the shot noise of the dark current."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Add noise."""
        return signal + self.temporal_dark_noise_e * exposure.generator().standard_normal(signal.shape)


class ShotNoise(Effect):
    """Poisson noise of the electrons, which includes that of the photons."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["shot_noise"]
    """Type of the effect."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Draw Poisson numbers; negative means from preceding effects are clipped to 0."""
        generator, mean = exposure.generator(), np.maximum(signal, 0.0)
        # Above 1e9 the normal approximation is exact to rounding and does not overflow.
        many = mean > 1e9
        drawn = generator.poisson(np.where(many, 0.0, mean)).astype(np.float64)
        if not many.any():
            return drawn
        return np.where(many, mean + np.sqrt(mean) * generator.standard_normal(mean.shape), drawn)
