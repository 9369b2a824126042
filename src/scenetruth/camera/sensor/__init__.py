"""The sensor: a chain of effects from linear light to digital numbers, each with a random stream of its own."""

from scenetruth.camera.sensor.base import Effect, Exposure, LinearImage
from scenetruth.camera.sensor.chain import AnyEffect, OpenSensor, SensorChain
from scenetruth.camera.sensor.choice import AnySensor, chain_of
from scenetruth.camera.sensor.correction import two_point_correction
from scenetruth.camera.sensor.emva1288 import EmvaSensor
from scenetruth.camera.sensor.gaussian import GaussianSensor
from scenetruth.camera.sensor.photon_transfer import PhotonTransfer, photon_transfer
from scenetruth.camera.sensor.presets import PRESETS

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
    "chain_of",
    "photon_transfer",
    "two_point_correction",
]
