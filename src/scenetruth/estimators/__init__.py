"""From a recording to depth and motion, by any method; knows nothing of the scene or the truth."""

from scenetruth.estimators.choice import MethodChoice, choose, validate_settings
from scenetruth.estimators.estimation import Estimation, estimate, prepare, requirements
from scenetruth.estimators.protocol import Estimator, Method, MethodSettings, Needs, StreamingMethod
from scenetruth.estimators.registry import DEFAULT_METHOD, MethodEntry, find_method, method_entries, offered

__all__ = [
    "DEFAULT_METHOD",
    "Estimation",
    "Estimator",
    "Method",
    "MethodChoice",
    "MethodEntry",
    "MethodSettings",
    "Needs",
    "StreamingMethod",
    "choose",
    "estimate",
    "find_method",
    "method_entries",
    "offered",
    "prepare",
    "requirements",
    "validate_settings",
]
