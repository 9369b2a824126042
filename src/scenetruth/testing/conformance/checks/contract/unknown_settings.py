"""Settings that the method does not have are refused."""

from __future__ import annotations

from scenetruth.errors import EstimateError
from scenetruth.estimators import validate_settings
from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.deviation import Deviation

__all__ = ["NEEDS", "check"]

NEEDS = Need(plain=False)
_NAME = "no_such_setting_of_any_method"


def check(bench: Bench) -> None:
    """Misspell one."""
    try:
        validate_settings(bench.method, {**bench.settings.model_dump(), _NAME: 1})
    except EstimateError as error:
        if any(_NAME in problem.path for problem in error.problems):
            return
        raise
    raise Deviation(
        f"the settings were given '{_NAME}'",
        "an EstimateError that names it",
        "it was taken, so that a misspelled setting has no effect and nobody is told",
        "derive settings from scenetruth.estimators.MethodSettings, without extra='allow' or 'ignore'",
    )
