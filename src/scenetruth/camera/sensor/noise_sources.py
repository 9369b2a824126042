"""The noise of a sensor: shot noise, dark current, readout noise and fixed patterns."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator

from scenetruth.camera.sensor.effects import Effect, Exposure, Unit
from scenetruth.validated_model import NonNegative, Positive

__all__ = [
    "DarkCurrent",
    "DarkSignalNonuniformity",
    "GaussianNoise",
    "PhotoResponseNonuniformity",
    "ReadoutNoise",
    "ShotNoise",
    "checked_hot_pixel_current",
]


def checked_hot_pixel_current(value: float, info: ValidationInfo) -> float:
    """Check, as a validator of pydantic, that hot pixels have more dark current than the others."""
    current = info.data.get("dark_current_e_per_s")
    if info.data.get("hot_pixel_share") and current is not None and value < current:
        msg = f"must not be below dark_current_e_per_s, {current:g}, where there are hot pixels"
        raise ValueError(msg)
    return value


class DarkCurrent(Effect):
    """Heat frees electrons too: their mean number is added, in hot pixels more than in others.

    It comes before the shot noise in the chain, as dark electrons have shot noise too.
    """

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["dark_current"]
    """This effect."""
    exposure_time_s: Positive
    """Time over which a pixel collects electrons."""
    dark_current_e_per_s: NonNegative = 0.0
    """Electrons that a pixel collects in a second without light."""
    hot_pixel_share: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)] = 0.0
    """Share of pixels with ``hot_pixel_current_e_per_s``."""
    hot_pixel_current_e_per_s: Annotated[NonNegative, Field(validate_default=True)] = 0.0
    """Dark current of hot pixels."""

    _hot_pixel_current = field_validator("hot_pixel_current_e_per_s")(checked_hot_pixel_current)

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64]:
        """Return the mean number of electrons of each pixel."""
        hot = generator.random(shape) < self.hot_pixel_share
        current = np.where(hot, self.hot_pixel_current_e_per_s, self.dark_current_e_per_s)
        return np.asarray(current * self.exposure_time_s, dtype=np.float64)

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Add the electrons."""
        assert exposure.pattern is not None
        return signal + exposure.pattern

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the electrons of a pixel that is not hot."""
        return signal + self.dark_current_e_per_s * self.exposure_time_s

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return what is left for light."""
        return largest_output - self.dark_current_e_per_s * self.exposure_time_s


class DarkSignalNonuniformity(Effect):
    """Every pixel has an offset of its own, normally distributed about 0 and the same in all images."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["dark_signal_nonuniformity"]
    """This effect."""
    dsnu_e: NonNegative
    """DSNU_1288, standard deviation of the pixels' dark offsets in electrons."""

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64]:
        """Return the offsets in electrons."""
        return self.dsnu_e * generator.standard_normal(shape)

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Add the offsets."""
        assert exposure.pattern is not None
        return signal + exposure.pattern


class GaussianNoise(Effect):
    """Gaussian noise of the same strength in all pixels, anew in every image."""

    takes: ClassVar[Unit] = "share of full scale"
    gives: ClassVar[Unit] = "share of full scale"

    kind: Literal["gaussian_noise"]
    """This effect."""
    noise_std: NonNegative
    """Standard deviation, as a fraction of full scale."""

    def stream(self, s_y: int, s: int, t: int) -> tuple[str | int, ...]:
        """Return the key of its random numbers for one image."""
        # Recordings made before sensors were chains keep their bytes: their noise had no name, and no row at the
        # reference row.
        return super().stream(s_y, s, t) if self.name else (*((s_y,) if s_y else ()), s, t)

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Add noise."""
        return signal + self.noise_std * exposure.generator().standard_normal(signal.shape)


class PhotoResponseNonuniformity(Effect):
    """Every pixel has a sensitivity of its own, normally distributed about 1 and the same in all images."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["photo_response_nonuniformity"]
    """This effect."""
    prnu: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)]
    """PRNU_1288, standard deviation of the pixels' sensitivities, relative to their mean."""

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64]:
        """Return the sensitivities; none is below 0."""
        return np.maximum(1 + self.prnu * generator.standard_normal(shape), 0.0)

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by the sensitivities."""
        assert exposure.pattern is not None
        return signal * exposure.pattern


class ReadoutNoise(Effect):
    """Reading a pixel adds Gaussian noise, anew in every image."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["readout_noise"]
    """This effect."""
    temporal_dark_noise_e: NonNegative
    """σ_d, standard deviation in electrons, without the shot noise of the dark current."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Add noise."""
        return signal + self.temporal_dark_noise_e * exposure.generator().standard_normal(signal.shape)


class ShotNoise(Effect):
    """Mean numbers of electrons become Poisson distributed ones.

    Photons arrive one by one and free electrons by chance, so both are Poisson distributed: drawing the electrons is
    enough.
    """

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["shot_noise"]
    """This effect."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Draw the numbers; what is negative by an effect before has none."""
        generator, mean = exposure.generator(), np.maximum(signal, 0.0)
        # Beyond a thousand million the normal distribution is the same, and does not overflow.
        many = mean > 1e9
        drawn = generator.poisson(np.where(many, 0.0, mean)).astype(np.float64)
        if not many.any():
            return drawn
        return np.where(many, mean + np.sqrt(mean) * generator.standard_normal(mean.shape), drawn)
