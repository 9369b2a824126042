"""Scenes: shapes, textures, light and motions, and the scene files that describe them."""

from scenetruth.scene.scene_loader import load_scene, scene_from_plain
from scenetruth.scene.scene_models import Scene

__all__ = ["Scene", "load_scene", "scene_from_plain"]
