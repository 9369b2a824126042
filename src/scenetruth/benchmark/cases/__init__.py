"""The cases of the benchmark suite."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.benchmark.cases.case import (
    ALL,
    BOUND,
    COMMON_VALID,
    METHOD_VALID,
    SUITES,
    BenchmarkRecord,
    Case,
    CaseEstimates,
    all_cases,
    select_cases,
)
from scenetruth.benchmark.cases.reference_scene import apply_changes, build_reference_scene
from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.benchmark.cases.scenes import GalleryCase

__all__ = [
    "ALL", "BOUND", "COMMON_VALID", "METHOD_VALID", "SUITES", "BenchmarkRecord", "Case", "CaseEstimates", "GalleryCase",
    "all_cases", "apply_changes", "build_reference_scene", "select_cases",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(__name__, {"scenes": "GalleryCase"})
