"""The points of bodies before anything moves them, and the derivatives along their surfaces."""

from scenetruth.scene.surface.start import RestStart, SheetStart, SmoothStart, Start

__all__ = ["RestStart", "SheetStart", "SmoothStart", "Start"]
