"""Patterns to print, for a rig, and what they are worth to it."""

from scenetruth.design.pattern.make import Pattern, make_pattern
from scenetruth.design.pattern.printing import write_pattern
from scenetruth.design.pattern.rig import Rig, rig_of
from scenetruth.design.pattern.worth import Worth, pattern_worth

__all__ = ["Pattern", "Rig", "Worth", "make_pattern", "pattern_worth", "rig_of", "write_pattern"]
