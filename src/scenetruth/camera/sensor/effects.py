"""The sensor effect as a base class, and the effects without randomness: conversion, gain, saturation, quantisation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.validated_model import FrozenModel, NonNegative, Positive

__all__ = [
    "BayerFilter",
    "BayerOrder",
    "Effect",
    "Exponent",
    "Exposure",
    "FullScaleGain",
    "FullWell",
    "Gain",
    "Gamma",
    "ImageLag",
    "LinearImage",
    "PhotonConversion",
    "Quantisation",
    "QuantumEfficiency",
    "RadiometricScale",
    "Unit",
]


Unit = Literal[
    "radiance", "share of full scale", "photons", "electrons", "unrounded digital numbers", "digital numbers"
]
"""What the values of a signal are: all are per pixel and exposure, radiance in units of the scene."""


@dataclass(frozen=True, eq=False)
class LinearImage:
    """A linear image, and which one of the recording it is.

    ``radiance``: What the sensor is given, shape (y, x).
    ``s_y``, ``s``, ``t``: Row, camera position and frame, 0 the reference.
    """

    radiance: NDArray[np.float32]
    s_y: int = 0
    s: int = 0
    t: int = 0


@dataclass(frozen=True, eq=False)
class Exposure:
    """The image that an effect works on, and what it may use for it.

    ``s_y``, ``s``, ``t``: Row, camera position and frame, 0 the reference.
    ``full_scale``: Largest digital number of the chain; 1 if it does not digitise.
    ``generator``: Makes the effect's own source of random numbers for this image.
    ``pattern``: What `Effect.draw_pattern` returned for the recording.
    ``previous``: The signal, shape (y, x), that entered the effect when the sensor took the image before; None if the
      effect does not remember, and for the first image.
    """

    s_y: int
    s: int
    t: int
    full_scale: float
    generator: Callable[[], np.random.Generator]
    pattern: NDArray[np.float64] | None = None
    previous: NDArray[np.float64] | None = None


class Effect(FrozenModel):
    """One step of a sensor's chain: it takes a signal, and gives the next one."""

    takes: ClassVar[Unit]
    """Unit of the signal that it needs."""
    gives: ClassVar[Unit]
    """Unit of the signal that it makes."""
    remembers: ClassVar[bool] = False
    """Whether it needs the signal of the image before."""

    kind: str
    """Which effect."""
    name: Annotated[str, Field(pattern=r"^([a-z][a-z0-9_]*)?$")] = ""
    """Keys its random numbers, in small letters, digits and underscores; the kind if empty. Effects of one kind in one
    sensor need different names."""

    @property
    def key(self) -> str:
        """What keys its random numbers."""
        return self.name or self.kind

    def stream(self, s_y: int, s: int, t: int) -> tuple[str | int, ...]:
        """Return the key of its random numbers for one image."""
        return (self.key, s_y, s, t)

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64] | None:
        """Return the fixed pattern: how pixels differ from each other in all images of a recording.

        Returns: One value for each pixel, shape (y, x), in the unit that the effect needs; None if all pixels are
        alike.
        """
        return None

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Return the next signal.

        ``signal``: In the unit that it takes, shape (y, x); not to be changed in place.
        Returns: In the unit that the effect gives, shape (y, x), float64.
        """
        raise NotImplementedError

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the mean response, over pixels and images, to a uniform signal."""
        return signal

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the largest signal that does not saturate the effect, or those behind it."""
        return largest_output


BayerOrder = Literal["rggb", "grbg", "gbrg", "bggr"]

# Places of the colours in `BayerFilter.response`.
_COLOURS = "rgb"


class BayerFilter(Effect):
    """Colour filters on 2 x 2 pixels let through a part of the photons of a grey scene."""

    takes: ClassVar[Unit] = "photons"
    gives: ClassVar[Unit] = "photons"

    kind: Literal["bayer_filter"]
    """This effect."""
    order: BayerOrder
    """Colours of the 2 x 2 pixels, row by row from the upper left."""
    response: tuple[Positive, Positive, Positive] = (0.7, 1.0, 0.6)
    """What red, green and blue filters let through of a grey scene."""

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64]:
        """Return what each pixel's filter lets through."""
        block = np.array([self.response[_COLOURS.index(colour)] for colour in self.order]).reshape(2, 2)
        repeats = (-(-shape[0] // 2), -(-shape[1] // 2))
        return np.asarray(np.tile(block, repeats)[: shape[0], : shape[1]])

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Let a part of the photons through."""
        assert exposure.pattern is not None
        return signal * exposure.pattern

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the photons behind the brightest filter."""
        return signal * max(self.response)

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the photons before the brightest filter, whose pixels saturate first."""
        return largest_output / max(self.response)


class Quantisation(Effect):
    """Digital numbers are rounded, and end at 0 and at the largest that so many bits hold."""

    takes: ClassVar[Unit] = "unrounded digital numbers"
    gives: ClassVar[Unit] = "digital numbers"

    kind: Literal["digitisation"]
    """This effect."""
    bit_depth: Annotated[int, Field(ge=1, le=16)] = 8
    """Bits of a digital number."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Round, and saturate."""
        return np.clip(np.rint(signal), 0, 2**self.bit_depth - 1)

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the digital number before it is rounded."""
        return min(max(signal, 0.0), float(2**self.bit_depth - 1))

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the largest digital number."""
        return min(largest_output, float(2**self.bit_depth - 1))


class FullScaleGain(Effect):
    """Shares of full scale become digital numbers: 1 the largest that the digitisation knows, 0 none."""

    takes: ClassVar[Unit] = "share of full scale"
    gives: ClassVar[Unit] = "unrounded digital numbers"

    kind: Literal["full_range_gain"]
    """This effect."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by the largest digital number."""
        return signal * exposure.full_scale

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the digital number."""
        return signal * full_scale

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the share of full scale."""
        return largest_output / full_scale


class RadiometricScale(Effect):
    """Radiance becomes a share of that which gives full scale."""

    takes: ClassVar[Unit] = "radiance"
    gives: ClassVar[Unit] = "share of full scale"

    kind: Literal["full_scale"]
    """This effect."""
    full_scale_radiance: Positive = 1.0
    """Radiance that gives full scale."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Divide by the radiance of full scale."""
        return signal / self.full_scale_radiance

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the share of full scale."""
        return signal / self.full_scale_radiance

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the radiance of that share."""
        return largest_output * self.full_scale_radiance


class FullWell(Effect):
    """A pixel holds so many electrons and no more."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["full_well"]
    """This effect."""
    full_well_e: Positive
    """Electrons that a pixel can hold."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Cut off at the full well."""
        return np.minimum(signal, self.full_well_e)

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the electrons, at most the full well's."""
        return min(signal, self.full_well_e)

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the full well, if what follows tells so much."""
        return min(largest_output, self.full_well_e)


class Gain(Effect):
    """Electrons become digital numbers, not yet rounded."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "unrounded digital numbers"

    kind: Literal["gain"]
    """This effect."""
    gain_dn_per_e: Positive
    """Overall system gain K, digital numbers per electron."""
    black_level_dn: NonNegative = 0.0
    """Digital number of a pixel without electrons."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by K, and add the black level."""
        return self.gain_dn_per_e * signal + self.black_level_dn

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the digital number."""
        return self.gain_dn_per_e * signal + self.black_level_dn

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the electrons of that digital number."""
        return (largest_output - self.black_level_dn) / self.gain_dn_per_e


Exponent = Annotated[Positive, Field(le=100)]
"""Beyond, almost all of the response is one digital number."""


class Gamma(Effect):
    """Digital numbers are full scale (linear / full scale)^gamma."""

    takes: ClassVar[Unit] = "unrounded digital numbers"
    gives: ClassVar[Unit] = "unrounded digital numbers"

    kind: Literal["gamma"]
    """This effect."""
    gamma: Exponent
    """The exponent; 1 is linear."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Bend the response between 0 and full scale, where it ends."""
        return exposure.full_scale * np.clip(signal / exposure.full_scale, 0, 1) ** self.gamma

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the bent digital number."""
        return full_scale * float(min(max(signal / full_scale, 0.0), 1.0) ** self.gamma)

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the linear digital number of a bent one."""
        return full_scale * float(min(largest_output / full_scale, 1.0) ** (1 / self.gamma))


class PhotonConversion(Effect):
    """Radiance becomes the mean number of photons that a pixel receives during the exposure."""

    takes: ClassVar[Unit] = "radiance"
    gives: ClassVar[Unit] = "photons"

    kind: Literal["photon_conversion"]
    """This effect."""
    photon_rate_per_s: Positive
    """Photons that a pixel receives in a second where the radiance is 1."""
    exposure_time_s: Positive
    """Time over which it collects them."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by the photons of radiance 1; what rendering made negative is dark."""
        return self._photons * np.maximum(signal, 0.0)

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the number of photons."""
        return self._photons * max(signal, 0.0)

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the radiance of so many photons."""
        return largest_output / self._photons

    @property
    def _photons(self) -> float:
        return self.photon_rate_per_s * self.exposure_time_s


class QuantumEfficiency(Effect):
    """Photons become the mean number of electrons that they free."""

    takes: ClassVar[Unit] = "photons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["quantum_efficiency"]
    """This effect."""
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)]
    """η, electrons per photon."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by η."""
        return self.quantum_efficiency * signal

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the number of electrons."""
        return self.quantum_efficiency * signal

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the photons that free so many electrons."""
        return largest_output / self.quantum_efficiency


class ImageLag(Effect):
    """A share of the electrons stays in the pixel, and is read with the next image.

    That is the one which the camera takes next, at whatever position of its stage. No electron is lost: what an image
    lacks, the next one has too many. Nothing is left in the pixels before the first image.
    """

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"
    remembers: ClassVar[bool] = True

    kind: Literal["readout_lag"]
    """This effect."""
    lag: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)]
    """Share of the electrons that stays behind."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Return what is read: what does not stay behind, and what the image before has left."""
        read = (1 - self.lag) * signal
        return read if exposure.previous is None else read + self.lag * exposure.previous
