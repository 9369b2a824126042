"""Base class of sensor effects, and the deterministic effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.bands import COLOURS, BandFraction, ByBand, as_number
from scenetruth.camera.sensor.demosaicing import DemosaicingMethod, demosaic, filter_colours, mosaic
from scenetruth.validated_model import FrozenModel, NonNegative, Positive

__all__ = [
    "BayerFilter", "BayerOrder", "ColourFilterArray", "Demosaicing", "Effect", "Exponent", "Exposure", "FilterArray",
    "FullScaleGain", "FullWell", "Gain", "Gamma", "ImageLag", "LinearImage", "PhotonConversion", "Quantisation",
    "QuantumEfficiency", "RadiometricScale", "SpectralResponse", "Unit",
]  # fmt: skip


Unit = Literal[
    "radiance", "share of full scale", "photons", "electrons", "unrounded digital numbers", "digital numbers"
]
"""Unit of a signal per pixel and exposure; radiance is in scene units."""


@dataclass(frozen=True, eq=False)
class LinearImage:
    """Sensor input, shape (y, x[, band]), with row, camera position and frame, 0 at the reference."""

    radiance: NDArray[np.float32]
    s_y: int = 0
    s: int = 0
    t: int = 0


@dataclass(frozen=True, eq=False)
class Exposure:
    """Context of an effect for one image.

    ``s_y``, ``s``, ``t``: Row, camera position and frame, 0 at the reference.
    ``full_scale``: Largest digital number of the chain; 1 without digitisation.
    ``pattern``: Fixed pattern returned by `Effect.draw_pattern`.
    ``previous``: Input signal for the previous image, shape (y, x); None for the first image or without memory.
    ``filter_order``: Order of the colour filters before the effect; empty for none.
    """

    s_y: int
    s: int
    t: int
    full_scale: float
    generator: Callable[[], np.random.Generator]
    pattern: NDArray[np.float64] | None = None
    previous: NDArray[np.float64] | None = None
    filter_order: str = ""


class Effect(FrozenModel):
    """One step of a sensor chain, which converts a signal into the next."""

    takes: ClassVar[Unit]
    """Unit of the input signal."""
    gives: ClassVar[Unit]
    """Unit of the output signal."""
    remembers: ClassVar[bool] = False
    """Whether the effect depends on the previous image."""
    mixes_bands: ClassVar[bool] = False
    """Whether the effect takes all bands together, with signals of shape (y, x, band); others take one at a time."""

    kind: str
    """Type of the effect."""
    name: Annotated[str, Field(pattern=r"^([a-z][a-z0-9_]*)?$")] = ""
    """Name of the random stream, in lower-case letters, digits and underscores; default: ``kind``. Effects of the same
    type require different names.
    """

    @property
    def key(self) -> str:
        """Key of the random streams of the effect."""
        return self.name or self.kind

    def stream(self, s_y: int, s: int, t: int) -> tuple[str | int, ...]:
        """Return the random-stream key for one image."""
        return (self.key, s_y, s, t)

    def channels(self, bands: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of the bands of the output signal; empty for grey."""
        return bands

    def band_problem(self, bands: tuple[str, ...]) -> str:
        """Return a message if the effect cannot be applied to signals of these bands, else an empty string."""
        return ""

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64] | None:
        """Return the fixed pattern of a recording, shape (y, x), in the unit of the effect; None for none."""
        return None

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Return the output signal for an input signal, shape (y, x), float64, which must not be modified."""
        raise NotImplementedError

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the response to a uniform signal, averaged over pixels and images."""
        return signal

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the largest input that saturates neither this effect nor its successors."""
        return largest_output


BayerOrder = Literal["rggb", "grbg", "gbrg", "bggr"]


class FilterArray(Effect):
    """Base class of colour filter arrays, behind which each pixel sees one colour."""

    mixes_bands: ClassVar[bool] = True

    order: BayerOrder
    """Colours of the 2 x 2 pixels in row-major order from the upper left."""

    def channels(self, bands: tuple[str, ...]) -> tuple[str, ...]:
        """Return no bands: the output is one mosaic."""
        return ()

    def band_problem(self, bands: tuple[str, ...]) -> str:
        """Return a message unless the signal is grey or has the colours of the filters."""
        if not bands or bands == COLOURS:
            return ""
        return f"filters red, green and blue, but camera.bands is {', '.join(bands)}: set [{', '.join(COLOURS)}]"

    def _seen(self, signal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the colour of each pixel, shape (y, x); a grey signal is the same in all colours."""
        return signal if signal.ndim == 2 else mosaic(signal, self.order)


class ColourFilterArray(FilterArray):
    """Bayer colour filters of ideal transmittance: each pixel keeps the radiance of one band."""

    takes: ClassVar[Unit] = "radiance"
    gives: ClassVar[Unit] = "radiance"

    kind: Literal["colour_filter_array"]
    """Type of the effect."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Keep one band in each pixel."""
        return self._seen(signal)


class BayerFilter(FilterArray):
    """Bayer colour filters, which transmit a fraction of the photons: of their band, or of a grey scene."""

    takes: ClassVar[Unit] = "photons"
    gives: ClassVar[Unit] = "photons"

    kind: Literal["bayer_filter"]
    """Type of the effect."""
    response: tuple[Positive, Positive, Positive] = (0.7, 1.0, 0.6)
    """Transmittance of the red, green and blue filters, for a grey scene or for the bands red, green and blue."""

    def draw_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float64]:
        """Return the transmittance of each pixel."""
        repeats = (-(-shape[0] // 2), -(-shape[1] // 2))
        colours = np.tile(filter_colours(self.order), repeats)[: shape[0], : shape[1]]
        return np.array(self.response)[colours]

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Keep one band in each pixel and multiply by the transmittance."""
        assert exposure.pattern is not None
        return self._seen(signal) * exposure.pattern

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the photons behind the filter of highest transmittance."""
        return signal * max(self.response)

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the photons in front of the filter of highest transmittance, whose pixels saturate first."""
        return largest_output / max(self.response)


class Demosaicing(Effect):
    """Interpolation of the two missing colours of each pixel behind colour filters, as in cameras."""

    takes: ClassVar[Unit] = "digital numbers"
    gives: ClassVar[Unit] = "digital numbers"
    mixes_bands: ClassVar[bool] = True

    kind: Literal["demosaicing"]
    """Type of the effect."""
    method: DemosaicingMethod = "malvar"
    """``bilinear``: mean of the nearest pixels of the colour; ``malvar``: with a correction by the gradient of the
    other colours (Malvar, He and Cutler 2004); ``binomial``: bilinear and a binomial filter of 5 pixels along x and y,
    which removes aliases, for displacements with the least bias.
    """

    def channels(self, bands: tuple[str, ...]) -> tuple[str, ...]:
        """Return red, green and blue."""
        return COLOURS

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Interpolate, round and clip."""
        colours = demosaic(signal, exposure.filter_order, self.method)
        return np.clip(np.rint(colours), 0, exposure.full_scale)


class SpectralResponse(Effect):
    """Fraction of the photons that the sensor responds to, such as filter transmittance or relative efficiency."""

    takes: ClassVar[Unit] = "photons"
    gives: ClassVar[Unit] = "photons"

    kind: Literal["spectral_response"]
    """Type of the effect."""
    response: BandFraction
    """Fraction, for all bands or for each."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by the fraction."""
        return signal * as_number(self.response)

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the photons of the band of the highest response."""
        return signal * self._highest

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the photons in the band of the highest response, which saturates first."""
        return largest_output / self._highest if self._highest > 0 else np.inf

    @property
    def _highest(self) -> float:
        return max(self.response.values()) if isinstance(self.response, ByBand) else self.response


class Quantisation(Effect):
    """Rounding to digital numbers and clipping to the range of the bit depth."""

    takes: ClassVar[Unit] = "unrounded digital numbers"
    gives: ClassVar[Unit] = "digital numbers"

    kind: Literal["digitisation"]
    """Type of the effect."""
    bit_depth: Annotated[int, Field(ge=1, le=16)] = 8
    """Bits per digital number."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Round and clip."""
        return np.clip(np.rint(signal), 0, 2**self.bit_depth - 1)

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the digital number before rounding."""
        return min(max(signal, 0.0), float(2**self.bit_depth - 1))

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the largest digital number."""
        return min(largest_output, float(2**self.bit_depth - 1))


class FullScaleGain(Effect):
    """Conversion of fractions of full scale into digital numbers: 1 maps to the largest digital number."""

    takes: ClassVar[Unit] = "share of full scale"
    gives: ClassVar[Unit] = "unrounded digital numbers"

    kind: Literal["full_range_gain"]
    """Type of the effect."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by the largest digital number."""
        return signal * exposure.full_scale

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the digital number."""
        return signal * full_scale

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the fraction of full scale."""
        return largest_output / full_scale


class RadiometricScale(Effect):
    """Conversion of radiance into a fraction of full scale."""

    takes: ClassVar[Unit] = "radiance"
    gives: ClassVar[Unit] = "share of full scale"

    kind: Literal["full_scale"]
    """Type of the effect."""
    full_scale_radiance: Positive = 1.0
    """Radiance at full scale."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Divide by the radiance at full scale."""
        return signal / self.full_scale_radiance

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the fraction of full scale."""
        return signal / self.full_scale_radiance

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the radiance of a fraction of full scale."""
        return largest_output * self.full_scale_radiance


class FullWell(Effect):
    """Saturation at the full-well capacity."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["full_well"]
    """Type of the effect."""
    full_well_e: Positive
    """Full-well capacity in electrons."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Clip at the full-well capacity."""
        return np.minimum(signal, self.full_well_e)

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the electrons, clipped at the full-well capacity."""
        return min(signal, self.full_well_e)

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the smaller of the full-well capacity and the limit of the successors."""
        return min(largest_output, self.full_well_e)


class Gain(Effect):
    """Conversion of electrons into unrounded digital numbers."""

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "unrounded digital numbers"

    kind: Literal["gain"]
    """Type of the effect."""
    gain_dn_per_e: Positive
    """Overall system gain K in digital numbers per electron."""
    black_level_dn: NonNegative = 0.0
    """Digital number of a pixel without electrons."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by K and add the black level."""
        return self.gain_dn_per_e * signal + self.black_level_dn

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the digital number."""
        return self.gain_dn_per_e * signal + self.black_level_dn

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the electrons of a digital number."""
        return (largest_output - self.black_level_dn) / self.gain_dn_per_e


Exponent = Annotated[Positive, Field(le=100)]
"""Exponent of a gamma curve, bounded because larger values collapse the response."""


class Gamma(Effect):
    """Gamma curve: output = full scale (input / full scale)^gamma."""

    takes: ClassVar[Unit] = "unrounded digital numbers"
    gives: ClassVar[Unit] = "unrounded digital numbers"

    kind: Literal["gamma"]
    """Type of the effect."""
    gamma: Exponent
    """Exponent; 1 is linear."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Apply the gamma curve, clipped to [0, full scale]."""
        return exposure.full_scale * np.clip(signal / exposure.full_scale, 0, 1) ** self.gamma

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the digital number after the gamma curve."""
        return full_scale * float(min(max(signal / full_scale, 0.0), 1.0) ** self.gamma)

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the digital number before the gamma curve."""
        return full_scale * float(min(largest_output / full_scale, 1.0) ** (1 / self.gamma))


class PhotonConversion(Effect):
    """Conversion of radiance into the mean number of photons per pixel and exposure."""

    takes: ClassVar[Unit] = "radiance"
    gives: ClassVar[Unit] = "photons"

    kind: Literal["photon_conversion"]
    """Type of the effect."""
    photon_rate_per_s: Positive
    """Photons per pixel and second at a radiance of 1."""
    exposure_time_s: Positive
    """Exposure time in s."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by the photons at radiance 1; negative rendered values are clipped to 0."""
        return self._photons * np.maximum(signal, 0.0)

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the number of photons."""
        return self._photons * max(signal, 0.0)

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the radiance of a number of photons."""
        return largest_output / self._photons

    @property
    def _photons(self) -> float:
        return self.photon_rate_per_s * self.exposure_time_s


class QuantumEfficiency(Effect):
    """Conversion of photons into the mean number of electrons."""

    takes: ClassVar[Unit] = "photons"
    gives: ClassVar[Unit] = "electrons"

    kind: Literal["quantum_efficiency"]
    """Type of the effect."""
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)]
    """η, electrons per photon."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Multiply by η."""
        return self.quantum_efficiency * signal

    def mean_response(self, signal: float, full_scale: float) -> float:
        """Return the number of electrons."""
        return self.quantum_efficiency * signal

    def largest_input(self, largest_output: float, full_scale: float) -> float:
        """Return the photons of a number of electrons."""
        return largest_output / self.quantum_efficiency


class ImageLag(Effect):
    """Image lag: a fraction of the electrons is read out with the next image.

    The next image is the next in acquisition order, at any stage position. Charge is conserved, and pixels are empty
    before the first image.
    """

    takes: ClassVar[Unit] = "electrons"
    gives: ClassVar[Unit] = "electrons"
    remembers: ClassVar[bool] = True

    kind: Literal["readout_lag"]
    """Type of the effect."""
    lag: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)]
    """Fraction of the electrons left for the next image."""

    def apply(self, signal: NDArray[np.float64], exposure: Exposure) -> NDArray[np.float64]:
        """Return the electrons read out: the current image minus its lag plus the lag of the previous image."""
        read = (1 - self.lag) * signal
        return read if exposure.previous is None else read + self.lag * exposure.previous
