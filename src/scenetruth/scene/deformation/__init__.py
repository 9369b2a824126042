"""Deformations in an object's own frame: every kind is a module that holds its model and its map."""

from scenetruth.scene.deformation.base import DeformationModel, DeformationStep, OwnFrameModel, Surroundings

__all__ = ["DeformationModel", "DeformationStep", "OwnFrameModel", "Surroundings"]
