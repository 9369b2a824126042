"""The sensor: from linear light to digital numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.model import FrozenModel, NonNegative, Positive

__all__ = ["FixedPattern", "Sensor", "digital_type", "digitise"]


@dataclass(frozen=True, eq=False)
class FixedPattern:
    """What distinguishes the pixels of one sensor from each other, the same in all its images; arrays (y, x)."""

    offset_e: NDArray[np.float64]
    """Dark offset in electrons."""
    response: NDArray[np.float64]
    """Sensitivity, 1 in the mean, times the transmission of a colour filter."""
    dark_e: NDArray[np.float64]
    """Mean number of electrons that the dark current collects."""


def digital_type(bit_depth: int) -> np.dtype[np.generic]:
    """Return the type that holds digital numbers of so many bits."""
    return np.dtype(np.uint8) if bit_depth <= 8 else np.dtype(np.uint16)


def digitise(signal_dn: NDArray[np.float64], bit_depth: int) -> NDArray[np.generic]:
    """Round to digital numbers of so many bits, and saturate."""
    return np.clip(np.rint(signal_dn), 0, 2**bit_depth - 1).astype(digital_type(bit_depth))


class Sensor(FrozenModel):
    """A sensor with Gaussian noise and digitisation."""

    kind: Literal["gaussian"] = "gaussian"
    """Tells this sensor from others; may be left out."""
    noise_std: NonNegative = 0.0
    """Standard deviation of the temporal Gaussian noise, as a fraction of full scale."""
    bit_depth: Annotated[int, Field(ge=1, le=16)] | None = 8
    """Bits of a digital number; null keeps floats (no digitisation, no saturation)."""
    full_scale_radiance: Positive = 1.0
    """Radiance that gives full scale."""

    @property
    def full_scale(self) -> float:
        """Largest value of an image: the largest digital number, or 1 without digitisation."""
        return 1.0 if self.bit_depth is None else float(2**self.bit_depth - 1)

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """Type of the images that leave the sensor."""
        return np.dtype(np.float32) if self.bit_depth is None else digital_type(self.bit_depth)

    @property
    def saturation_radiance(self) -> float:
        """Radiance beyond which images say nothing more."""
        return self.full_scale_radiance

    def fixed_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> None:
        """Return None: all pixels are alike."""

    def sense(
        self, radiance: NDArray[np.float32], generator: np.random.Generator, pattern: FixedPattern | None = None
    ) -> NDArray[np.generic]:
        """Turn one linear image into what the camera delivers.

        Parameters
        ----------
        radiance
            Linear image, any shape.
        generator
            Source of the noise: one of its own for every image, so that no two images share noise.
        pattern
            Not used: this sensor has none.

        Returns
        -------
        numpy.ndarray
            Same shape: digital numbers (uint8 or uint16, rounded and saturated), or float32, 1 for full scale.
        """
        signal = np.asarray(radiance, dtype=np.float64) / self.full_scale_radiance
        if self.noise_std > 0:
            signal = signal + self.noise_std * generator.standard_normal(signal.shape)
        if self.bit_depth is None:
            return signal.astype(np.float32)
        return digitise(signal * self.full_scale, self.bit_depth)
