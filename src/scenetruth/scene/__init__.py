"""Scenes: shapes, textures, lighting and motion, and the scene files that define them."""

from scenetruth.scene.leaf_spectra import LEAF_SPECTRA, LEAF_WAVELENGTHS_NM, BladeSpectrum, leaf_material
from scenetruth.scene.scene_loader import Overrides, SceneLike, load_scene, read_input
from scenetruth.scene.scene_models import Scene

__all__ = [
    "LEAF_SPECTRA", "LEAF_WAVELENGTHS_NM", "BladeSpectrum", "Overrides", "Scene", "SceneLike", "leaf_material",
    "load_scene", "read_input",
]  # fmt: skip
