"""The measuring camera: a pinhole on a linear stage, and the sensor behind it."""

from scenetruth.camera.correction import two_point_correction
from scenetruth.camera.distortion import Distortion
from scenetruth.camera.emva import EmvaSensor
from scenetruth.camera.pinhole import Camera
from scenetruth.camera.sensor import Sensor
from scenetruth.camera.stage import Frames, Stage
from scenetruth.camera.viewpoint import Viewpoint

__all__ = ["Camera", "Distortion", "EmvaSensor", "Frames", "Sensor", "Stage", "Viewpoint", "two_point_correction"]
