"""Scenes: shapes, textures, lighting and motion, and the scene files that define them."""

from scenetruth.scene.scene_loader import Overrides, SceneLike, load_scene, read_input
from scenetruth.scene.scene_models import Scene

__all__ = ["Overrides", "Scene", "SceneLike", "load_scene", "read_input"]
