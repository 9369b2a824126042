"""Printed patterns for a rig, and their assessment."""

from scenetruth.design.patterns.assessment import PatternAssessment, assess_pattern
from scenetruth.design.patterns.generation import Pattern, generate_pattern
from scenetruth.design.patterns.pattern_rig import PatternRig
from scenetruth.design.patterns.printing import export_pattern

__all__ = [
    "Pattern",
    "PatternAssessment",
    "PatternRig",
    "assess_pattern",
    "export_pattern",
    "generate_pattern",
]
