"""The sensor of the EMVA standard 1288: from photons through electrons to digital numbers."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, ValidationError, ValidationInfo, field_validator, model_validator

from scenetruth.camera.sensor.base import Effect
from scenetruth.camera.sensor.chain import SensorChain
from scenetruth.camera.sensor.effects.bayer_filter import BayerFilter, BayerOrder
from scenetruth.camera.sensor.effects.digitisation import Digitisation
from scenetruth.camera.sensor.effects.full_well import FullWell
from scenetruth.camera.sensor.effects.gain import Gain
from scenetruth.camera.sensor.effects.gamma import Exponent, Gamma
from scenetruth.camera.sensor.effects.photon_conversion import PhotonConversion
from scenetruth.camera.sensor.effects.quantum_efficiency import QuantumEfficiency
from scenetruth.camera.sensor.insertion import Insertion, inserted, misplaced
from scenetruth.camera.sensor.noises.dark_current import DarkCurrent, checked_hot_pixel_current
from scenetruth.camera.sensor.noises.dark_signal_nonuniformity import DarkSignalNonuniformity
from scenetruth.camera.sensor.noises.photo_response_nonuniformity import PhotoResponseNonuniformity
from scenetruth.camera.sensor.noises.readout_noise import ReadoutNoise
from scenetruth.camera.sensor.noises.shot_noise import ShotNoise
from scenetruth.camera.sensor.presets import PRESETS, PresetName
from scenetruth.model import FrozenModel, NonNegative, Positive

__all__ = ["EmvaSensor"]

Share = Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)]


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
    """Tells this sensor from others."""
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
    gamma: Exponent = 1.0
    """Digital numbers are full scale (linear / full scale)^gamma; 1 is linear, as the standard demands."""
    bayer: BayerOrder | None = None
    """Colour filters on 2 x 2 pixels, row by row from the upper left; null for none."""
    bayer_response: tuple[Positive, Positive, Positive] = (0.7, 1.0, 0.6)
    """What red, green and blue filters let through of a grey scene."""
    insert: tuple[Insertion, ...] = ()
    """More effects, each behind one that the sensor has."""

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

    _hot_pixel_current = field_validator("hot_pixel_current_e_per_s")(checked_hot_pixel_current)

    @model_validator(mode="after")
    def _insertions_fit(self) -> Self:
        problems = misplaced(self._own_effects(), self.insert, "insert")
        if problems:
            raise ValidationError.from_exception_data(type(self).__name__, problems)
        return self

    @property
    def saturation_capacity_e(self) -> float:
        """Most electrons above the black level that a digital number can tell: the full well's, or the converter's."""
        largest_dn = float(2**self.bit_depth - 1)
        return min(self.full_well_e, (largest_dn - self.black_level_dn) / self.gain_dn_per_e)

    def chain(self) -> SensorChain:
        """Return the chain of effects that models this sensor; effects of strength 0 are left out."""
        return SensorChain(effects=inserted(self._own_effects(), self.insert))

    def _own_effects(self) -> tuple[Effect, ...]:
        time = self.exposure_time_s
        effects: list[Effect | None] = [
            PhotonConversion(kind="photon_conversion", photon_rate_per_s=self.photon_rate_per_s, exposure_time_s=time),
            BayerFilter(kind="bayer_filter", order=self.bayer, response=self.bayer_response) if self.bayer else None,
            QuantumEfficiency(kind="quantum_efficiency", quantum_efficiency=self.quantum_efficiency),
            PhotoResponseNonuniformity(kind="photo_response_nonuniformity", prnu=self.prnu) if self.prnu else None,
            DarkCurrent(
                kind="dark_current",
                exposure_time_s=time,
                dark_current_e_per_s=self.dark_current_e_per_s,
                hot_pixel_share=self.hot_pixel_share,
                hot_pixel_current_e_per_s=self.hot_pixel_current_e_per_s,
            )
            if self.dark_current_e_per_s or self.hot_pixel_share
            else None,
            ShotNoise(kind="shot_noise"),
            FullWell(kind="full_well", full_well_e=self.full_well_e),
            DarkSignalNonuniformity(kind="dark_signal_nonuniformity", dsnu_e=self.dsnu_e) if self.dsnu_e else None,
            ReadoutNoise(kind="readout_noise", temporal_dark_noise_e=self.temporal_dark_noise_e)
            if self.temporal_dark_noise_e
            else None,
            Gain(kind="gain", gain_dn_per_e=self.gain_dn_per_e, black_level_dn=self.black_level_dn),
            Gamma(kind="gamma", gamma=self.gamma) if self.gamma != 1 else None,
            Digitisation(kind="digitisation", bit_depth=self.bit_depth),
        ]
        return tuple(effect for effect in effects if effect is not None)


def _saturation_e(valid: dict[str, Any]) -> float | None:
    """Return the saturation capacity from the fields validated so far; None if one of them is wrong."""
    if not {"bit_depth", "gain_dn_per_e", "full_well_e", "black_level_dn"} <= valid.keys():
        return None
    converter: float = (2 ** valid["bit_depth"] - 1 - valid["black_level_dn"]) / valid["gain_dn_per_e"]
    full_well: float = valid["full_well_e"]
    return min(full_well, converter)
