"""Plants: every kind is a module that holds its model and where its leaves stand."""

from scenetruth.scene.plant.base import LeafPlace, PlantModel

__all__ = ["LeafPlace", "PlantModel"]
