"""Sensor types: ideal, Gaussian, EMVA 1288 with presets, and explicit chains of effects."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    SerializerFunctionWrapHandler,
    Tag,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from scenetruth.camera.sensor.chain import InsertedEffect, SensorChain, check_insertions, insert_effects
from scenetruth.camera.sensor.demosaicing import DemosaicingMethod
from scenetruth.camera.sensor.effects import (
    BayerFilter,
    BayerOrder,
    ColourFilterArray,
    Demosaicing,
    Effect,
    Exponent,
    FullScaleGain,
    FullWell,
    Gain,
    Gamma,
    PhotonConversion,
    Quantisation,
    QuantumEfficiency,
    RadiometricScale,
)
from scenetruth.camera.sensor.noise_sources import (
    DarkCurrent,
    DarkSignalNonuniformity,
    GaussianNoise,
    PhotoResponseNonuniformity,
    ReadoutNoise,
    ShotNoise,
    checked_hot_pixel_current,
)
from scenetruth.discovery import kind_in_lower_case
from scenetruth.validated_model import FrozenModel, NonNegative, Positive, Preset, preset

__all__ = ["PRESETS", "AnySensor", "EmvaSensor", "GaussianSensor", "PresetName", "build_sensor_chain"]


class ColourSensor(FrozenModel):
    """Base class of sensors that may have colour filters; those without keep their values and hashes."""

    demosaicing: DemosaicingMethod | None = None
    """Interpolation of the colours behind a Bayer filter after digitisation, by the method of ``demosaicing``; null for
    images of the mosaic.
    """

    @model_validator(mode="after")
    def _behind_filters(self) -> Self:
        if self.demosaicing and getattr(self, "bayer", None) is None:
            msg = "demosaicing requires the order of the colour filters: specify bayer"
            raise ValueError(msg)
        return self

    @model_serializer(mode="wrap")
    def _write(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit what recent versions added, unless it is used."""
        plain: dict[str, Any] = write(self)
        added = ("demosaicing", *self._added)
        return {name: value for name, value in plain.items() if name not in added or value is not None}

    _added: ClassVar[tuple[str, ...]] = ()

    def _demosaicing_effects(self) -> list[Effect]:
        return [] if self.demosaicing is None else [Demosaicing(kind="demosaicing", method=self.demosaicing)]


class GaussianSensor(ColourSensor):
    """Sensor with temporal Gaussian noise and digitisation."""

    _added: ClassVar[tuple[str, ...]] = ("bayer",)

    kind: Literal["gaussian"] = "gaussian"
    """Sensor type; may be omitted."""
    noise_std: NonNegative = 0.0
    """Standard deviation of the temporal Gaussian noise, as a fraction of full scale."""
    bit_depth: Annotated[int, Field(ge=1, le=16)] | None = 8
    """Bits per digital number; null for floats (no digitisation, no saturation)."""
    full_scale_radiance: Positive = 1.0
    """Radiance at full scale."""
    bayer: BayerOrder | None = None
    """Colours of the 2 x 2 Bayer filter in row-major order from the upper left; null for none."""

    @model_validator(mode="after")
    def _demosaics_numbers(self) -> Self:
        if self.demosaicing and self.bit_depth is None:
            msg = "demosaicing requires digital numbers: specify bit_depth"
            raise ValueError(msg)
        return self

    def chain(self) -> SensorChain:
        """Return the equivalent chain of effects."""
        effects: list[Effect] = []
        if self.bayer is not None:
            effects.append(ColourFilterArray(kind="colour_filter_array", order=self.bayer))
        effects.append(RadiometricScale(kind="full_scale", full_scale_radiance=self.full_scale_radiance))
        if self.noise_std > 0:
            effects.append(GaussianNoise(kind="gaussian_noise", noise_std=self.noise_std))
        if self.bit_depth is not None:
            effects += [
                FullScaleGain(kind="full_range_gain"),
                Quantisation(kind="digitisation", bit_depth=self.bit_depth),
                *self._demosaicing_effects(),
            ]
        return SensorChain(effects=tuple(effects))


PresetName = Literal["scientific_cmos", "industrial_cmos", "ccd_2002"]

TYPICAL = "typical value, not from the source"
"""Source of a preset value without reference: an order of magnitude, not a product specification."""
CHOSEN = "chosen, not from the source"
"""Source of a preset value that is a setting of the camera or the illumination."""

_ZYLA_SHEET = (
    "Andor, Zyla OEM, product sheet, "
    "https://raw.githubusercontent.com/SciCrunch/RRID-Instruments/refs/heads/main/PDF/SCR_021136.pdf"
)
_ZYLA_MANUAL = (
    "Andor, Zyla sCMOS hardware manual 2.0 (2021), table 5, 16-bit (low noise and high well capacity), "
    "https://www.easymanua.ls/andor-technology/zyla-scmos-4-2-plus/manual?p=25"
)
_ALVIUM = (
    "Allied Vision, Alvium 1800 U-507 data sheet (EMVA 1288 release 3.1, monochrome, typical), as quoted in "
    "https://github.com/blitzcolo/Quantiloom-dev, src/libQuantiloom/postprocess/CameraPresets.cpp; the sheet itself "
    "was not read"
)
_SBIG = (
    "SBIG, operating manual of ST-7XE to ST-2000XM, table 4.3, row ST-2000XM, "
    "https://www.easymanua.ls/sbig/st-7xe/manual?p=50"
)
_OFFSET = "usual offset of scientific cameras, https://www.tucsen.com/ja/learning/demystifying-specifications-prnu"

# The photon rates fill 80 % of the saturation capacity at radiance 1 in the exposure time of the preset.
PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "scientific_cmos": preset(
            "Andor Zyla 4.2 (sCMOS, 6.5 µm)",
            photon_rate_per_s=(2.873e6, CHOSEN),
            exposure_time_s=(0.01, CHOSEN),
            quantum_efficiency=(0.82, _ZYLA_SHEET),
            full_well_e=(30000.0, _ZYLA_MANUAL),
            gain_dn_per_e=(2.222, f"1 / (0.45 e-/DN): {_ZYLA_MANUAL}"),
            bit_depth=(16, _ZYLA_MANUAL),
            black_level_dn=(100.0, _OFFSET),
            temporal_dark_noise_e=(0.9, _ZYLA_SHEET),
            dark_current_e_per_s=(0.1, TYPICAL),
            dsnu_e=(0.3, TYPICAL),
            prnu=(0.005, TYPICAL),
        ),
        "industrial_cmos": preset(
            "Allied Vision Alvium 1800 U-507 (Sony IMX264, 3.45 µm)",
            photon_rate_per_s=(1.3e6, CHOSEN),
            exposure_time_s=(0.01, CHOSEN),
            quantum_efficiency=(0.64, f"at 529 nm: {_ALVIUM}"),
            full_well_e=(10400.0, f"saturation capacity: {_ALVIUM}"),
            gain_dn_per_e=(0.39, "follows: the saturation capacity fills the 12 bits above the black level"),
            bit_depth=(12, _ALVIUM),
            black_level_dn=(16.0, TYPICAL),
            temporal_dark_noise_e=(2.1, _ALVIUM),
            dark_current_e_per_s=(5.0, TYPICAL),
            dsnu_e=(0.5, TYPICAL),
            prnu=(0.005, TYPICAL),
        ),
        "ccd_2002": preset(
            "SBIG ST-2000XM (Kodak KAI-2000M, interline CCD, 7.4 µm), read with 12 bits",
            photon_rate_per_s=(7.2e6, CHOSEN),
            exposure_time_s=(0.01, CHOSEN),
            quantum_efficiency=(0.5, TYPICAL),
            full_well_e=(45000.0, _SBIG),
            gain_dn_per_e=(0.09, "follows: the full well fills the 12 bits above the black level"),
            bit_depth=(12, f"{TYPICAL}: what measuring cameras of the time delivered"),
            black_level_dn=(32.0, TYPICAL),
            temporal_dark_noise_e=(15.0, _SBIG),
            dark_current_e_per_s=(50.0, f"{TYPICAL}: without cooling"),
            dsnu_e=(6.0, TYPICAL),
            prnu=(0.01, TYPICAL),
        ),
    }
)


Share = Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)]


def _preset_or_fields(schema: dict[str, Any]) -> None:
    """Declare in the JSON Schema that a preset replaces the required fields."""
    required = schema.pop("required")
    schema["anyOf"] = [{"required": ["kind", "preset"]}, {"required": required}]


class EmvaSensor(ColourSensor):
    """Linear sensor specified by EMVA 1288 parameters.

    The electrons of a pixel are Poisson distributed with mean η μ_p (1 + PRNU x) + dark current, clipped at the full
    well. Readout adds the offset DSNU y and noise of σ_d electrons. Digital numbers are K electrons + black level,
    rounded and clipped. x and y are standard normal and fixed per pixel over the recording.
    """

    model_config = ConfigDict(json_schema_extra=_preset_or_fields)

    kind: Literal["emva1288"]
    """Sensor type."""
    preset: PresetName | None = None
    """Preset sensor that supplies the default values; null for none."""
    photon_rate_per_s: Positive
    """Photons per pixel and second at a radiance of 1."""
    exposure_time_s: Positive
    """Exposure time in s."""
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)]
    """η, electrons per photon."""
    bit_depth: Annotated[int, Field(ge=1, le=16)]
    """Bits per digital number."""
    gain_dn_per_e: Positive
    """Overall system gain K in digital numbers per electron."""
    full_well_e: Positive
    """Full-well capacity in electrons."""
    black_level_dn: NonNegative = 0.0
    """Digital number of a pixel without electrons."""
    temporal_dark_noise_e: NonNegative = 0.0
    """σ_d, standard deviation of the readout noise in electrons, without the shot noise of the dark current."""
    dark_current_e_per_s: NonNegative = 0.0
    """Dark current in electrons per pixel and second."""
    dsnu_e: NonNegative = 0.0
    """DSNU_1288, standard deviation of the dark offsets in electrons."""
    prnu: Share = 0.0
    """PRNU_1288, standard deviation of the pixel sensitivities relative to their mean."""
    hot_pixel_share: Share = 0.0
    """Fraction of pixels with ``hot_pixel_current_e_per_s``."""
    hot_pixel_current_e_per_s: Annotated[NonNegative, Field(validate_default=True)] = 0.0
    """Dark current of hot pixels in electrons per pixel and second."""
    gamma: Exponent = 1.0
    """Exponent of the gamma curve, full scale (linear / full scale)^gamma; 1 is linear, as required by the standard."""
    bayer: BayerOrder | None = None
    """Colours of the 2 x 2 Bayer filter in row-major order from the upper left; null for none."""
    bayer_response: tuple[Positive, Positive, Positive] = (0.7, 1.0, 0.6)
    """Transmittance of the red, green and blue filters, for a grey scene or for the bands red, green and blue."""
    insert: tuple[InsertedEffect, ...] = ()
    """Additional effects, each inserted after an effect of the sensor."""

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, given: Any) -> Any:
        name = given.get("preset") if isinstance(given, dict) else None
        if name is None:
            return given
        # An unknown name is rejected by its field validator; other values only prevent additional missing-field errors.
        preset = PRESETS[name] if isinstance(name, str) and name in PRESETS else next(iter(PRESETS.values()))
        return {**preset.values, **given}

    @field_validator("full_well_e")
    @classmethod
    def _reaches_a_number(cls, value: float, info: ValidationInfo) -> float:
        gain = info.data.get("gain_dn_per_e")
        if gain is not None and value * gain < 1:
            msg = f"does not reach one digital number: {value * gain:.3g} at {gain:g} per electron; increase either"
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
            msg = f"must be less than the saturation capacity, {saturation:.6g} electrons"
            raise ValueError(msg)
        return value

    @field_validator("dark_current_e_per_s")
    @classmethod
    def _leaves_room_for_light(cls, value: float, info: ValidationInfo) -> float:
        saturation, time = _saturation_e(info.data), info.data.get("exposure_time_s")
        if saturation is not None and time is not None and value * time >= saturation:
            msg = (
                f"saturates the sensor without light: {value * time:.6g} electrons in {time:g} s, capacity "
                f"{saturation:.6g}; reduce the exposure time"
            )
            raise ValueError(msg)
        return value

    _hot_pixel_current = field_validator("hot_pixel_current_e_per_s")(checked_hot_pixel_current)

    @model_validator(mode="after")
    def _insertions_fit(self) -> Self:
        problems = check_insertions(self._own_effects(), self.insert, "insert")
        if problems:
            raise ValidationError.from_exception_data(type(self).__name__, problems)
        return self

    @property
    def saturation_capacity_e(self) -> float:
        """Saturation capacity in electrons above the black level, limited by the full well or the converter."""
        largest_dn = float(2**self.bit_depth - 1)
        return min(self.full_well_e, (largest_dn - self.black_level_dn) / self.gain_dn_per_e)

    def chain(self) -> SensorChain:
        """Return the equivalent chain of effects, without effects of strength 0."""
        return SensorChain(effects=insert_effects(self._own_effects(), self.insert))

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
            Quantisation(kind="digitisation", bit_depth=self.bit_depth),
            *self._demosaicing_effects(),
        ]
        return tuple(effect for effect in effects if effect is not None)


def _saturation_e(valid: dict[str, Any]) -> float | None:
    """Return the saturation capacity from the fields validated so far, or None if a field is invalid."""
    if not {"bit_depth", "gain_dn_per_e", "full_well_e", "black_level_dn"} <= valid.keys():
        return None
    converter: float = (2 ** valid["bit_depth"] - 1 - valid["black_level_dn"]) / valid["gain_dn_per_e"]
    full_well: float = valid["full_well_e"]
    return min(full_well, converter)


def _in_lower_case(value: Any) -> Any:
    return value.lower() if isinstance(value, str) else kind_in_lower_case(value)


def _sensor_kind(value: object) -> str:
    """Return the type of a sensor; default: Gaussian."""
    if isinstance(value, str):
        return "ideal"
    kind = value.get("kind", "gaussian") if isinstance(value, dict) else getattr(value, "kind", "gaussian")
    return str(kind)


AnySensor = Annotated[
    Annotated[Literal["ideal"], Tag("ideal")]
    | Annotated[GaussianSensor, Tag("gaussian")]
    | Annotated[EmvaSensor, Tag("emva1288")]
    | Annotated[SensorChain, Tag("chain")],
    Discriminator(_sensor_kind),
    BeforeValidator(_in_lower_case),
]
"""Sensor as specified in a scene."""


def build_sensor_chain(sensor: Literal["ideal"] | GaussianSensor | EmvaSensor | SensorChain) -> SensorChain:
    """Return the equivalent chain of effects of a sensor."""
    if isinstance(sensor, str):
        return SensorChain()
    return sensor if isinstance(sensor, SensorChain) else sensor.chain()
