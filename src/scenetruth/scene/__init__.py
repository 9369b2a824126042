"""Scenes: shapes, textures, lighting and motion, and the scene files that define them."""

from scenetruth.scene.leaf_spectra import LEAF_SPECTRA, LEAF_WAVELENGTHS_NM, BladeSpectrum, leaf_material
from scenetruth.scene.scene_loader import (
    Overrides,
    SceneLike,
    join_override_problems,
    load_scene,
    override,
    read_input,
    read_scene,
)
from scenetruth.scene.scene_models import Scene

__all__ = [
    "LEAF_SPECTRA", "LEAF_WAVELENGTHS_NM", "BladeSpectrum", "Overrides", "Scene", "SceneLike", "join_override_problems",
    "leaf_material", "load_scene", "override", "read_input", "read_scene",
]  # fmt: skip
