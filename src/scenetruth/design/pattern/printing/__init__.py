"""Patterns on paper at true scale: pages, rulers, SVG, PDF."""

from scenetruth.design.pattern.printing.layout import pages_of
from scenetruth.design.pattern.printing.write import scene_lines, write_image, write_pattern

__all__ = ["pages_of", "scene_lines", "write_image", "write_pattern"]
