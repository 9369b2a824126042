"""The measuring camera: a pinhole on a linear stage, and the sensor behind it."""

from scenetruth.camera.correction import two_point_correction
from scenetruth.camera.distortion import Distortion
from scenetruth.camera.emva import EmvaSensor
from scenetruth.camera.optics import AiryPsf, Defocus, GaussianPsf, Optics, Vignetting
from scenetruth.camera.photon_transfer import PhotonTransfer, photon_transfer
from scenetruth.camera.pinhole import Camera
from scenetruth.camera.presets import PRESETS
from scenetruth.camera.rays import PixelRays, pixel_rays
from scenetruth.camera.schedule import Moment, Schedule
from scenetruth.camera.sensor import Sensor
from scenetruth.camera.shutter import Shutter
from scenetruth.camera.stage import Frames, Stage
from scenetruth.camera.stage_errors import StageErrors
from scenetruth.camera.viewpoint import Viewpoint

__all__ = [
    "PRESETS",
    "AiryPsf",
    "Camera",
    "Defocus",
    "Distortion",
    "EmvaSensor",
    "Frames",
    "GaussianPsf",
    "Moment",
    "Optics",
    "PhotonTransfer",
    "PixelRays",
    "Schedule",
    "Sensor",
    "Shutter",
    "Stage",
    "StageErrors",
    "Viewpoint",
    "Vignetting",
    "photon_transfer",
    "pixel_rays",
    "two_point_correction",
]
