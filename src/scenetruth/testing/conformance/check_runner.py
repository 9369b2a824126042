"""Runner of all checks, their registry, and the report."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any, Literal

from scenetruth.errors import EstimateError, EstimateWarning, Problem
from scenetruth.estimators import Estimator
from scenetruth.testing.conformance.bench import ConformanceBench, ConformanceCheck
from scenetruth.testing.conformance.map_comparison import CheckFailure, NotApplicable
from scenetruth.validated_model import FrozenModel
from scenetruth.validation_problems import suggest_word

__all__ = [
    "CheckOutcome",
    "ConformanceError",
    "ConformanceReport",
    "EstimatorCheck",
    "all_checks",
    "check_estimator",
    "estimator_checks",
]


@dataclass(frozen=True)
class CheckOutcome:
    """The outcome of one check: ``"passed"``, ``"failed"`` or ``"skipped"``, and the problem or reason for skipping."""

    name: str
    says: str
    status: Literal["passed", "failed", "skipped"]
    message: str
    seconds: float


@dataclass(frozen=True)
class ConformanceReport:
    """The outcomes of all checks of a method.

    Parameters
    ----------
    method
        Name of the method.
    outcomes
        The checks in the order of their execution.

    See Also
    --------
    scenetruth.testing.check_estimator : Run all checks and return a report.
    scenetruth.testing.ConformanceError : The exception that holds it if a check failed.

    Examples
    --------
    >>> outcome = CheckOutcome("exclusion_mask", "Masked pixels are left out.", "skipped", "refuses masks", 0.1)
    >>> print(ConformanceReport("my_method", (outcome,)))
    my_method: 0 of 1 checks passed, 0 failed, 1 skipped
      skipped exclusion_mask: refuses masks
    """

    method: str
    outcomes: tuple[CheckOutcome, ...]

    @property
    def passed(self) -> tuple[str, ...]:
        """The names of the checks that the method passed."""
        return tuple(item.name for item in self.outcomes if item.status == "passed")

    @property
    def failed(self) -> dict[str, str]:
        """The problems by name of the check."""
        return {item.name: item.message for item in self.outcomes if item.status == "failed"}

    @property
    def skipped(self) -> dict[str, str]:
        """The reasons for skipped checks by name of the check."""
        return {item.name: item.message for item in self.outcomes if item.status == "skipped"}

    def __str__(self) -> str:
        counts = f"{len(self.failed)} failed, {len(self.skipped)} skipped"
        lines = [f"{self.method}: {len(self.passed)} of {len(self.outcomes)} checks passed, {counts}"]
        for item in self.outcomes:
            if item.status == "failed":
                values = item.message.replace("\n", "\n    ")
                lines.append(f"  FAILED {item.name}: {item.says}\n    {values}")
        lines += [f"  skipped {name}: {why}" for name, why in self.skipped.items()]
        return "\n".join(lines)


class ConformanceError(AssertionError):
    """A method that fails a check; lists every failure with its remedy.

    Parameters
    ----------
    report
        The outcomes of all checks.

    See Also
    --------
    scenetruth.testing.check_estimator : The function that raises it.

    Examples
    --------
    A method that returns depth in metres:

    >>> import numpy as np
    >>> from scenetruth.testing import check_estimator
    >>> def mine(recording):
    ...     return {"depth": np.full(recording["image"].shape[-2:], 0.6)}
    >>> try:
    ...     check_estimator(mine, only=["deterministic", "median_accuracy"])
    ... except ConformanceError as error:
    ...     report = error.report
    >>> report.passed, list(report.failed)
    (('deterministic',), ['median_accuracy'])
    >>> found = report.failed["median_accuracy"].splitlines()[2]
    >>> print(found.partition(";")[0])
    found:    depth is 0.6 mm in the median, the truth 600
    """

    def __init__(self, report: ConformanceReport) -> None:
        self.report = report
        super().__init__(report)

    def __str__(self) -> str:
        return str(self.report)


@cache
def all_checks() -> tuple[ConformanceCheck, ...]:
    """Return all checks: of the contract, of inputs, of physics, in the order of the modules.

    A check is a function with the decorator `conformance_check`; the first line of its docstring is the requirement.

    >>> [check.says for check in all_checks() if check.name == "deterministic"]
    ['Two calls with the same recording give the same bytes.']
    """
    modules = [
        import_module(f"scenetruth.testing.conformance.{group}_checks") for group in ("contract", "input", "physics")
    ]
    functions = [function for module in modules for function in vars(module).values()]
    return tuple(function.conformance_check for function in functions if hasattr(function, "conformance_check"))


EstimatorLike = str | Estimator | Callable[..., Any]


@dataclass(frozen=True, eq=False)
class EstimatorCheck:
    """One check of one method, called without arguments; its name is that of the test.

    Parameters
    ----------
    check
        The check.
    bench
        The test bench of the method, shared by all its checks.

    See Also
    --------
    scenetruth.testing.estimator_checks : All checks of a method, as parameters of a test.
    scenetruth.testing.check_estimator : Run all checks of a method.

    Examples
    --------
    A method that subtracts the mean from its input images in place:

    >>> import numpy as np
    >>> from scenetruth.testing import estimator_checks
    >>> def mine(recording):
    ...     recording["image"] -= recording["image"].mean()
    ...     return {"depth": np.full(recording["image"].shape[-2:], 600.0)}
    >>> checks = {str(check): check for check in estimator_checks(mine)}
    >>> checks["deterministic"]()
    >>> try:
    ...     checks["input_unchanged"]()
    ... except AssertionError as error:
    ...     print(error)
    done:     the plain recording was handed over in arrays that can be written to
    expected: the recording as it was
    found:    changed: image
    remedy:   work on copies: recording['image'].values.copy(), dict(recording.attrs)
    """

    check: ConformanceCheck
    bench: ConformanceBench

    @property
    def __name__(self) -> str:
        """The check's name, for test runners."""
        return self.check.name

    id = __name__

    def __str__(self) -> str:
        return self.check.name

    def __call__(self) -> None:
        """Run the check.

        Raises
        ------
        AssertionError
            If the method fails; reports the procedure, the expected and the actual result, and the remedy.
        unittest.SkipTest
            If the check does not apply.
        """
        with warnings.catch_warnings():
            # Warnings that other settings suit the images better are irrelevant here.
            warnings.simplefilter("ignore", EstimateWarning)
            try:
                self.check.run(self.bench)
            except (CheckFailure, NotApplicable):
                raise
            except Exception as error:  # any error of the method
                text = " ".join(f"{type(error).__name__}: {error}".split())
                remedy = "return an estimate, or raise an EstimateError that states the missing requirement"
                raise CheckFailure(self.check.says, "an estimate", f"it raised {text}", remedy) from error


def estimator_checks(
    method: EstimatorLike,
    settings: FrozenModel | Mapping[str, Any] | None = None,
    *,
    size: tuple[int, int] | None = None,
    cameras: int | None = None,
    frames: int | None = None,
) -> list[EstimatorCheck]:
    """Return all checks of a method, for ``pytest.mark.parametrize``.

    Parameters
    ----------
    method
        A method as for `scenetruth.estimate`: a name, ``"module:function"``, a function, a method.
    settings
        Settings of the method, as in `scenetruth.estimate`.
    size
        Height and width of the test images in px, if the method requires larger images.
    cameras, frames
        Number of camera positions and frames; default: three, or the next odd number that the method requires.

    Returns
    -------
    list of EstimatorCheck
        Each is called without arguments, and carries the name of its test.

    See Also
    --------
    check_estimator : Run all checks of a method.

    Examples
    --------
    >>> from unittest import SkipTest
    >>> checks = {str(check): check for check in estimator_checks("plane_sweep")}
    >>> try:
    ...     checks["exclusion_mask"]()
    ... except SkipTest as reason:
    ...     print(reason)
    the method refuses recordings with a mask: it has no Needs(exclusion_mask=True)
    """
    bench = ConformanceBench(method, settings, size=size, cameras=cameras, frames=frames)
    return [EstimatorCheck(check, bench) for check in all_checks()]


def check_estimator(
    method: EstimatorLike,
    *,
    settings: FrozenModel | Mapping[str, Any] | None = None,
    only: str | Iterable[str] | None = None,
    skip: str | Iterable[str] = (),
    size: tuple[int, int] | None = None,
    cameras: int | None = None,
    frames: int | None = None,
) -> ConformanceReport:
    """Check that a method conforms to the contract and to image-independent requirements.

    Parameters
    ----------
    method
        A method as for `scenetruth.estimate`: a name, ``"module:function"``, a function, a method.
    settings
        Settings of the method, as in `scenetruth.estimate`.
    only, skip
        Names of the checks to run, and of those to omit.
    size
        Height and width of the test images in px, if the method requires larger images.
    cameras, frames
        Number of camera positions and frames; default: three, or the next odd number that the method requires.

    Returns
    -------
    ConformanceReport
        The passed checks, and those that do not apply with the reasons.

    Raises
    ------
    ConformanceError
        An AssertionError with every failed check: procedure, expected and actual result with the deviation, remedy.
    EstimateError
        If the method is unknown, its settings are invalid, or a name of a check is unknown.

    See Also
    --------
    estimator_checks : One test for each check.

    Examples
    --------
    >>> print(check_estimator("plane_sweep", only=["deterministic", "exclusion_mask"]))
    plane_sweep: 1 of 2 checks passed, 0 failed, 1 skipped
      skipped exclusion_mask: the method refuses recordings with a mask: it has no Needs(exclusion_mask=True)
    """
    made = estimator_checks(method, settings, size=size, cameras=cameras, frames=frames)
    checks = {str(check): check for check in made}
    chosen = list(checks) if only is None else _names("only", only)
    left_out = _names("skip", skip)
    unknown = [("only", name) for name in chosen] + [("skip", name) for name in left_out]
    problems = [Problem(path, _unknown(name, checks), name) for path, name in unknown if name not in checks]
    if problems:
        raise EstimateError(problems, source="checks of an estimator")
    bench = made[0].bench
    name, _ = bench.method.name, bench.settings
    running = [check for name, check in checks.items() if name in chosen and name not in left_out]
    outcomes = tuple(_outcome(check) for check in running)
    report = ConformanceReport(name, outcomes)
    if report.failed:
        raise ConformanceError(report)
    return report


def _outcome(check: EstimatorCheck) -> CheckOutcome:
    start = time.perf_counter()
    status: Literal["passed", "failed", "skipped"] = "passed"
    text = ""
    try:
        check()
    except NotApplicable as reason:
        status, text = "skipped", str(reason)
    except CheckFailure as error:
        status, text = "failed", str(error)
    return CheckOutcome(check.check.name, check.check.says, status, text, time.perf_counter() - start)


def _names(path: str, given: str | Iterable[str]) -> list[str]:
    if isinstance(given, str):
        return [given]
    if not isinstance(given, Iterable):
        raise EstimateError([Problem(path, "must be names of checks", given)], source="checks of an estimator")
    return [str(name) for name in given]


def _unknown(name: str, checks: Mapping[str, EstimatorCheck]) -> str:
    return "no such check" + (suggest_word(name, checks) or f"; available: {', '.join(sorted(checks))}")
