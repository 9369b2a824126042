"""Sensor model: a chain of effects from radiance to digital numbers, each with its own random stream."""

from scenetruth.camera.sensor.chain import AnyEffect, OpenSensor, SensorChain
from scenetruth.camera.sensor.characterisation import PhotonTransfer, photon_transfer, two_point_correction
from scenetruth.camera.sensor.effects import Effect, Exposure, LinearImage
from scenetruth.camera.sensor.sensor_types import PRESETS, AnySensor, EmvaSensor, GaussianSensor, build_sensor_chain

__all__ = [
    "PRESETS",
    "AnyEffect",
    "AnySensor",
    "Effect",
    "EmvaSensor",
    "Exposure",
    "GaussianSensor",
    "LinearImage",
    "OpenSensor",
    "PhotonTransfer",
    "SensorChain",
    "build_sensor_chain",
    "photon_transfer",
    "two_point_correction",
]
