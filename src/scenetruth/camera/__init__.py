"""The measuring camera: a pinhole on a linear stage, and the sensor behind it."""

from scenetruth.camera.correction import two_point_correction
from scenetruth.camera.emva import EmvaSensor
from scenetruth.camera.pinhole import Camera
from scenetruth.camera.sensor import Sensor
from scenetruth.camera.stage import Frames, Stage

__all__ = ["Camera", "EmvaSensor", "Frames", "Sensor", "Stage", "two_point_correction"]
