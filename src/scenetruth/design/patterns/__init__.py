"""Printed patterns for a rig, and their assessment."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.design.patterns.assessment import (
    PatternAssessment,
    assess_pattern,
    assessments_to_dataframe,
    compute_size_table,
    compute_theoretical_statistics,
    describe_assessments,
)
from scenetruth.design.patterns.generation import Pattern, generate_pattern
from scenetruth.design.patterns.page_layout import lay_out_pages
from scenetruth.design.patterns.pattern_model import GreyPicture, InkAreas, InkDots
from scenetruth.design.patterns.pattern_rig import (
    PatternRig,
    compute_contrast_transfer,
    compute_grey_level,
    find_grey_level,
)
from scenetruth.design.patterns.pattern_spectrum import PatternSpectrum, compute_pattern_statistics, compute_spectrum
from scenetruth.design.patterns.printing import export_pattern, format_scene_lines, write_texture_image
from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.design.patterns.board_patterns import BoardPattern, export_board, generate_board
    from scenetruth.design.patterns.pattern_types import (
        GreyNoisePattern,
        NoisePattern,
        SpecklePattern,
        compute_boolean_covariance,
        compute_clipped_covariance,
    )

__all__ = [
    "BoardPattern", "GreyNoisePattern", "GreyPicture", "InkAreas", "InkDots", "NoisePattern", "Pattern",
    "PatternAssessment", "PatternRig", "PatternSpectrum", "SpecklePattern", "assess_pattern",
    "assessments_to_dataframe", "compute_boolean_covariance", "compute_clipped_covariance",
    "compute_contrast_transfer", "compute_grey_level", "compute_pattern_statistics", "compute_size_table",
    "compute_spectrum", "compute_theoretical_statistics", "describe_assessments", "export_board", "export_pattern",
    "find_grey_level", "format_scene_lines", "generate_board", "generate_pattern", "lay_out_pages",
    "write_texture_image",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "board_patterns": "BoardPattern export_board generate_board",
        "pattern_types": (
            "GreyNoisePattern NoisePattern SpecklePattern compute_boolean_covariance compute_clipped_covariance"
        ),
    },
)
