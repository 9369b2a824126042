"""Names of what a simulation leaves in its folder."""

from __future__ import annotations

__all__ = ["RECORDING", "SCENE", "TRUTH"]

SCENE = "scene.yaml"
"""The scene with all defaults and overrides."""

RECORDING = "recording.zarr"
"""The images."""

TRUTH = "truth.zarr"
"""The exact maps."""
