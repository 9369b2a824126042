"""Camera model: pinhole camera with lens, linear stage and sensor."""

from scenetruth.camera.acquisition_schedule import ImageAcquisition, Schedule, Shutter, Viewpoint
from scenetruth.camera.lens import AiryPsf, Defocus, GaussianPsf, Optics, Vignetting
from scenetruth.camera.pinhole import Camera, Distortion, PixelRays, pixel_rays
from scenetruth.camera.sensor import (
    PRESETS,
    AnySensor,
    EmvaSensor,
    GaussianSensor,
    LinearImage,
    PhotonTransfer,
    SensorChain,
    build_sensor_chain,
    demosaic,
    mosaic,
    photon_transfer,
    two_point_correction,
)
from scenetruth.camera.stage import Frames, PoseOffset, Stage, StageErrors, StagePose

__all__ = [
    "PRESETS", "AiryPsf", "AnySensor", "Camera", "Defocus", "Distortion", "EmvaSensor", "Frames", "GaussianPsf",
    "GaussianSensor", "ImageAcquisition", "LinearImage", "Optics", "PhotonTransfer", "PixelRays", "PoseOffset",
    "Schedule", "SensorChain", "Shutter", "Stage", "StageErrors", "StagePose", "Viewpoint", "Vignetting",
    "build_sensor_chain", "demosaic", "mosaic", "photon_transfer", "pixel_rays", "two_point_correction",
]  # fmt: skip
