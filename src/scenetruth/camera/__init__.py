"""The measuring camera: a pinhole on a linear stage, and the sensor behind it."""

from scenetruth.camera.distortion import Distortion
from scenetruth.camera.optics import AiryPsf, Defocus, GaussianPsf, Optics, Vignetting
from scenetruth.camera.pinhole import Camera
from scenetruth.camera.rays import PixelRays, pixel_rays
from scenetruth.camera.schedule import Moment, Schedule
from scenetruth.camera.sensor import (
    PRESETS,
    AnySensor,
    EmvaSensor,
    GaussianSensor,
    LinearImage,
    PhotonTransfer,
    SensorChain,
    chain_of,
    photon_transfer,
    two_point_correction,
)
from scenetruth.camera.shutter import Shutter
from scenetruth.camera.stage import Frames, Stage
from scenetruth.camera.stage_errors import StageErrors
from scenetruth.camera.viewpoint import Viewpoint

__all__ = [
    "PRESETS",
    "AiryPsf",
    "AnySensor",
    "Camera",
    "Defocus",
    "Distortion",
    "EmvaSensor",
    "Frames",
    "GaussianPsf",
    "GaussianSensor",
    "LinearImage",
    "Moment",
    "Optics",
    "PhotonTransfer",
    "PixelRays",
    "Schedule",
    "SensorChain",
    "Shutter",
    "Stage",
    "StageErrors",
    "Viewpoint",
    "Vignetting",
    "chain_of",
    "photon_transfer",
    "pixel_rays",
    "two_point_correction",
]
