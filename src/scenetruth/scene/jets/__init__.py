"""Second-order Taylor arithmetic: one formula gives values and all derivatives."""

from scenetruth.scene.jets.jet import Field, Jet, compose, values_of, where

__all__ = ["Field", "Jet", "compose", "values_of", "where"]
