"""Sensor model: a chain of effects from radiance to digital numbers, each with its own random stream."""

from scenetruth.camera.sensor.chain import AnyEffect, OpenSensor, SensorChain
from scenetruth.camera.sensor.characterisation import (
    QUANTISATION_VARIANCE,
    PhotonTransfer,
    fit_response_line,
    photon_transfer,
    spatial_variance,
    two_point_correction,
)
from scenetruth.camera.sensor.effects import (
    BayerFilter,
    BayerOrder,
    ColourFilterArray,
    Effect,
    Exposure,
    FullScaleGain,
    FullWell,
    Gain,
    Gamma,
    ImageLag,
    LinearImage,
    PhotonConversion,
    Quantisation,
    QuantumEfficiency,
    RadiometricScale,
    SpectralResponse,
)
from scenetruth.camera.sensor.noise_sources import (
    DarkCurrent,
    DarkSignalNonuniformity,
    GaussianNoise,
    PhotoResponseNonuniformity,
    ReadoutNoise,
    ShotNoise,
)
from scenetruth.camera.sensor.sensor_types import (
    PRESETS,
    AnySensor,
    EmvaSensor,
    GaussianSensor,
    PresetName,
    build_sensor_chain,
)

__all__ = [
    "PRESETS", "QUANTISATION_VARIANCE", "AnyEffect", "AnySensor", "BayerFilter", "BayerOrder", "ColourFilterArray",
    "DarkCurrent", "DarkSignalNonuniformity", "Effect", "EmvaSensor", "Exposure", "FullScaleGain", "FullWell", "Gain",
    "Gamma", "GaussianNoise", "GaussianSensor", "ImageLag", "LinearImage", "OpenSensor", "PhotoResponseNonuniformity",
    "PhotonConversion", "PhotonTransfer", "PresetName", "Quantisation", "QuantumEfficiency", "RadiometricScale",
    "ReadoutNoise", "SensorChain", "ShotNoise", "SpectralResponse", "build_sensor_chain", "fit_response_line",
    "photon_transfer", "spatial_variance", "two_point_correction",
]  # fmt: skip
