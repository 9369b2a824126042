"""What stands before the camera: shapes, textures, motions, and the scene files that describe them."""

from scenetruth.scene.load import load_scene, scene_from_plain
from scenetruth.scene.spec import Scene

__all__ = ["Scene", "load_scene", "scene_from_plain"]
