"""Conformance of an estimator with the contract of methods and with image-independent requirements."""

from scenetruth.testing.conformance.check_runner import (
    CheckOutcome,
    ConformanceError,
    ConformanceReport,
    EstimatorCheck,
    all_checks,
    check_estimator,
    estimator_checks,
)
from scenetruth.testing.conformance.map_comparison import (
    CheckFailure,
    NotApplicable,
    change_sign,
    compute_magnitude,
    flip_maps,
    list_differing_variables,
    require_agreement,
    require_equal_to_rounding,
    require_median_near,
    scalar_maps,
)
from scenetruth.testing.conformance.synthetic_plane import SyntheticPlane

__all__ = [
    "CheckFailure", "CheckOutcome", "ConformanceError", "ConformanceReport", "EstimatorCheck", "NotApplicable",
    "SyntheticPlane", "all_checks", "change_sign", "check_estimator", "compute_magnitude", "estimator_checks",
    "flip_maps", "list_differing_variables", "require_agreement", "require_equal_to_rounding", "require_median_near",
    "scalar_maps",
]  # fmt: skip
