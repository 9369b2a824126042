"""Lights: every kind is a module that holds its model and where it shines at a time."""

from scenetruth.scene.light.base import Lamp, LightModel

__all__ = ["Lamp", "LightModel"]
