"""Scenes: shapes, textures, light and motions, and the scene files that describe them."""

from scenetruth.scene.scene_loader import Overrides, SceneLike, load_scene, read_input
from scenetruth.scene.scene_models import Scene

__all__ = ["Overrides", "Scene", "SceneLike", "load_scene", "read_input"]
