"""Deformations that are given vertex by vertex: arrays of solvers, series of mesh files, morph targets."""

from scenetruth.scene.nodal.base import NodalModel, NodalStart

__all__ = ["NodalModel", "NodalStart"]
