"""The sensor of the EMVA standard 1288: from photons through electrons to digital numbers."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from scenetruth.camera.presets import PRESETS, PresetName
from scenetruth.camera.sensor import FixedPattern, digital_type, digitise
from scenetruth.model import FrozenModel, NonNegative, Positive

__all__ = ["EmvaSensor"]

Share = Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)]

# Which of red, green and blue each pixel of a 2 x 2 block sees.
_BAYER = {"rggb": ((0, 1), (1, 2)), "grbg": ((1, 0), (2, 1)), "gbrg": ((1, 2), (0, 1)), "bggr": ((2, 1), (1, 0))}


def _preset_or_fields(schema: dict[str, Any]) -> None:
    """Say in the JSON Schema that a preset stands for the fields that are required without it."""
    required = schema.pop("required")
    schema["anyOf"] = [{"required": ["kind", "preset"]}, {"required": required}]


class EmvaSensor(FrozenModel):
    """A linear sensor described in the quantities of EMVA 1288.

    A pixel collects electrons with the mean η μ_p (1 + PRNU x) + dark current, Poisson distributed, up to its full
    well; the readout adds the offset DSNU y and noise of σ_d electrons; digital numbers are K electrons + black level,
    rounded and saturated. x and y are standard normal numbers that a pixel keeps over the whole recording.
    """

    model_config = ConfigDict(json_schema_extra=_preset_or_fields)

    kind: Literal["emva1288"]
    """Tells this sensor from the plain one."""
    preset: PresetName | None = None
    """A sensor by name, whose values stand for all fields that are not given; null for none."""
    photon_rate_per_s: Positive
    """Photons that a pixel receives in a second where the radiance is 1."""
    exposure_time_s: Positive
    """Time over which it collects them."""
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)]
    """η, electrons per photon."""
    bit_depth: Annotated[int, Field(ge=1, le=16)]
    """Bits of a digital number."""
    gain_dn_per_e: Positive
    """Overall system gain K, digital numbers per electron."""
    full_well_e: Positive
    """Electrons that a pixel can hold."""
    black_level_dn: NonNegative = 0.0
    """Digital number of a pixel without electrons."""
    temporal_dark_noise_e: NonNegative = 0.0
    """σ_d, standard deviation of the readout noise in electrons, without the shot noise of the dark current."""
    dark_current_e_per_s: NonNegative = 0.0
    """Electrons that a pixel collects in a second without light."""
    dsnu_e: NonNegative = 0.0
    """DSNU_1288, standard deviation of the pixels' dark offsets in electrons."""
    prnu: Share = 0.0
    """PRNU_1288, standard deviation of the pixels' sensitivities, relative to their mean."""
    hot_pixel_share: Share = 0.0
    """Share of pixels with ``hot_pixel_current_e_per_s``."""
    hot_pixel_current_e_per_s: Annotated[NonNegative, Field(validate_default=True)] = 0.0
    """Dark current of hot pixels."""
    gamma: Positive = 1.0
    """Digital numbers are full scale (linear / full scale)^gamma; 1 is linear, as the standard demands."""
    bayer: Literal["rggb", "grbg", "gbrg", "bggr"] | None = None
    """Colour filters on 2 x 2 pixels, row by row from the upper left; null for none."""
    bayer_response: tuple[Positive, Positive, Positive] = (0.7, 1.0, 0.6)
    """What red, green and blue filters let through of a grey scene."""

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, given: Any) -> Any:
        name = given.get("preset") if isinstance(given, dict) else None
        if name is None:
            return given
        # An unknown name is refused by its own field; any values will do to keep the others from being missed as well.
        preset = PRESETS[name] if isinstance(name, str) and name in PRESETS else next(iter(PRESETS.values()))
        return {**preset.values, **given}

    @field_validator("full_well_e")
    @classmethod
    def _reaches_a_number(cls, value: float, info: ValidationInfo) -> float:
        gain = info.data.get("gain_dn_per_e")
        if gain is not None and value * gain < 1:
            msg = (
                f"does not reach one digital number: {value * gain:.3g} at {gain:g} per electron; raise it or the gain"
            )
            raise ValueError(msg)
        return value

    @field_validator("black_level_dn")
    @classmethod
    def _below_full_scale(cls, value: float, info: ValidationInfo) -> float:
        bits = info.data.get("bit_depth")
        if bits is None:
            return value
        if value >= 2**bits - 1:
            msg = f"must be below full scale, {2**bits - 1} at {bits} bits"
            raise ValueError(msg)
        if value > 2**bits - 2:
            msg = f"leaves less than one digital number for light below full scale, {2**bits - 1} at {bits} bits"
            raise ValueError(msg)
        return value

    @field_validator("temporal_dark_noise_e", "dsnu_e")
    @classmethod
    def _leaves_a_signal(cls, value: float, info: ValidationInfo) -> float:
        saturation = _saturation_e(info.data)
        if saturation is not None and value >= saturation:
            msg = f"must be less than what the sensor can say, {saturation:.6g} electrons"
            raise ValueError(msg)
        return value

    @field_validator("dark_current_e_per_s")
    @classmethod
    def _leaves_room_for_light(cls, value: float, info: ValidationInfo) -> float:
        saturation, time = _saturation_e(info.data), info.data.get("exposure_time_s")
        if saturation is not None and time is not None and value * time >= saturation:
            msg = (
                f"saturates the sensor without light: {value * time:.6g} electrons in {time:g} s, and it can say "
                f"{saturation:.6g}; expose for a shorter time"
            )
            raise ValueError(msg)
        return value

    @field_validator("hot_pixel_current_e_per_s")
    @classmethod
    def _hotter_than_the_rest(cls, value: float, info: ValidationInfo) -> float:
        current = info.data.get("dark_current_e_per_s")
        if info.data.get("hot_pixel_share") and current is not None and value < current:
            msg = f"must not be below dark_current_e_per_s, {current:g}, where there are hot pixels"
            raise ValueError(msg)
        return value

    @property
    def saturation_capacity_e(self) -> float:
        """Most electrons above the black level that a digital number can tell: the full well's, or the converter's."""
        return min(self.full_well_e, (self.full_scale - self.black_level_dn) / self.gain_dn_per_e)

    @property
    def full_scale(self) -> float:
        """Largest digital number."""
        return float(2**self.bit_depth - 1)

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """Type of the images that leave the sensor."""
        return digital_type(self.bit_depth)

    @property
    def saturation_radiance(self) -> float:
        """Radiance beyond which images say nothing more: the well is full, or digital numbers end."""
        electrons = min(self.full_well_e, (self.full_scale - self.black_level_dn) / self.gain_dn_per_e)
        return electrons / (self.quantum_efficiency * self.photon_rate_per_s * self.exposure_time_s)

    def fixed_pattern(self, shape: tuple[int, int], generator: np.random.Generator) -> FixedPattern:
        """Draw what distinguishes the pixels of one sensor, and stays the same over all its images.

        Parameters
        ----------
        shape
            Rows and columns.
        generator
            Source of the pattern: the same for all images.
        """
        offset = self.dsnu_e * generator.standard_normal(shape)
        response = 1 + self.prnu * generator.standard_normal(shape)
        hot = generator.random(shape) < self.hot_pixel_share
        current = np.where(hot, self.hot_pixel_current_e_per_s, self.dark_current_e_per_s)
        if self.bayer is not None:
            block = np.array(self.bayer_response)[np.array(_BAYER[self.bayer])]
            repeats = (-(-shape[0] // 2), -(-shape[1] // 2))
            response *= np.tile(block, repeats)[: shape[0], : shape[1]]
        return FixedPattern(offset_e=offset, response=np.maximum(response, 0.0), dark_e=current * self.exposure_time_s)

    def sense(
        self, radiance: NDArray[np.float32], generator: np.random.Generator, pattern: FixedPattern | None = None
    ) -> NDArray[np.generic]:
        """Turn one linear image into digital numbers.

        Parameters
        ----------
        radiance
            Linear image, shape (y, x).
        generator
            Source of the temporal noise: one of its own for every image.
        pattern
            What `fixed_pattern` drew.

        Returns
        -------
        numpy.ndarray
            uint8 or uint16, same shape.

        Raises
        ------
        ValueError
            If there is no pattern.
        """
        if pattern is None:
            msg = "needs the fixed pattern of its pixels"
            raise ValueError(msg)
        photons = self.photon_rate_per_s * self.exposure_time_s * np.maximum(radiance, 0.0).astype(np.float64)
        mean = self.quantum_efficiency * photons * pattern.response + pattern.dark_e
        electrons = np.minimum(_poisson(mean, generator), self.full_well_e)
        electrons = electrons + pattern.offset_e
        if self.temporal_dark_noise_e > 0:
            electrons += self.temporal_dark_noise_e * generator.standard_normal(radiance.shape)
        signal = self.gain_dn_per_e * electrons + self.black_level_dn
        if self.gamma != 1:
            signal = self.full_scale * np.clip(signal / self.full_scale, 0, 1) ** self.gamma
        return digitise(signal, self.bit_depth)


def _saturation_e(valid: dict[str, Any]) -> float | None:
    """Return the saturation capacity from the fields validated so far; None if one of them is wrong."""
    if not {"bit_depth", "gain_dn_per_e", "full_well_e", "black_level_dn"} <= valid.keys():
        return None
    converter: float = (2 ** valid["bit_depth"] - 1 - valid["black_level_dn"]) / valid["gain_dn_per_e"]
    full_well: float = valid["full_well_e"]
    return min(full_well, converter)


def _poisson(mean: NDArray[np.float64], generator: np.random.Generator) -> NDArray[np.float64]:
    """Draw Poisson numbers; beyond a thousand million the normal distribution is the same, and does not overflow."""
    many = mean > 1e9
    drawn = generator.poisson(np.where(many, 0.0, mean)).astype(np.float64)
    return np.where(many, mean + np.sqrt(mean) * generator.standard_normal(mean.shape), drawn) if many.any() else drawn
