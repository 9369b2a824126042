"""Estimation of depth and scene flow from a recording by any method; independent of the scene and the ground truth."""

from scenetruth.estimators.estimation import EstimationTask, estimate, prepare, requirements
from scenetruth.estimators.method_specs import MethodLike, MethodSpec
from scenetruth.estimators.protocol import Estimator, Method, MethodSettings, Needs, StreamingMethod
from scenetruth.estimators.registry import (
    DEFAULT_METHOD,
    MethodChoice,
    MethodEntry,
    choose,
    find_method,
    list_methods,
    offered,
    validate_settings,
)

__all__ = [
    "DEFAULT_METHOD", "EstimationTask", "Estimator", "Method", "MethodChoice", "MethodEntry", "MethodLike",
    "MethodSettings", "MethodSpec", "Needs", "StreamingMethod", "choose", "estimate", "find_method", "list_methods",
    "offered", "prepare", "requirements", "validate_settings",
]  # fmt: skip
