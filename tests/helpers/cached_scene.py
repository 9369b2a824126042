"""A small scene for the cache of recordings."""

from __future__ import annotations

from tests.helpers.small_recipes import SCENE

__all__ = ["SMALL"]


SMALL = {**SCENE, "camera": {"width": 32, "height": 24, "focal_length_px": 60}}
