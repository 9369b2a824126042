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
from scenetruth.camera.sensor.demosaicing import (
    DEMOSAICING_KERNELS,
    DemosaicingMethod,
    demosaic,
    demosaicing_taps,
    filter_colours,
    mosaic,
)
from scenetruth.camera.sensor.demosaicing_bias import (
    DemosaicedWave,
    demosaic_wave,
    predict_displacement,
    quintic_spline_response,
)
from scenetruth.camera.sensor.effects import (
    BayerFilter,
    BayerOrder,
    ColourFilterArray,
    Demosaicing,
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
    "DEMOSAICING_KERNELS", "PRESETS", "QUANTISATION_VARIANCE", "AnyEffect", "AnySensor", "BayerFilter", "BayerOrder",
    "ColourFilterArray", "DarkCurrent", "DarkSignalNonuniformity", "DemosaicedWave", "Demosaicing",
    "DemosaicingMethod", "Effect", "EmvaSensor", "Exposure", "FullScaleGain", "FullWell", "Gain", "Gamma",
    "GaussianNoise", "GaussianSensor", "ImageLag", "LinearImage", "OpenSensor", "PhotoResponseNonuniformity",
    "PhotonConversion", "PhotonTransfer", "PresetName", "Quantisation", "QuantumEfficiency", "RadiometricScale",
    "ReadoutNoise", "SensorChain", "ShotNoise", "SpectralResponse", "build_sensor_chain", "demosaic", "demosaic_wave",
    "demosaicing_taps", "filter_colours", "fit_response_line", "mosaic", "photon_transfer", "predict_displacement",
    "quintic_spline_response", "spatial_variance", "two_point_correction",
]  # fmt: skip
