"""From a recording to depth and motion, by any method; knows nothing of the scene or the truth."""

from scenetruth.estimators.choice import MethodChoice, choose, validate_settings
from scenetruth.estimators.estimation import estimate, requirements
from scenetruth.estimators.protocol import Estimator, Method, MethodSettings, Needs
from scenetruth.estimators.registry import DEFAULT_METHOD, MethodEntry, find_method, method_entries

__all__ = [
    "DEFAULT_METHOD",
    "Estimator",
    "Method",
    "MethodChoice",
    "MethodEntry",
    "MethodSettings",
    "Needs",
    "choose",
    "estimate",
    "find_method",
    "method_entries",
    "requirements",
    "validate_settings",
]
