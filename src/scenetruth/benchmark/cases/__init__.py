"""The cases of the benchmark suite."""

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

__all__ = [
    "ALL",
    "BOUND",
    "COMMON_VALID",
    "METHOD_VALID",
    "SUITES",
    "BenchmarkRecord",
    "Case",
    "CaseEstimates",
    "all_cases",
    "apply_changes",
    "build_reference_scene",
    "select_cases",
]
