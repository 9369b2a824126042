"""Checks run on a method: all at once, or one by one under a runner of tests."""

from __future__ import annotations

import difflib
import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from scenetruth.errors import EstimateError, EstimateWarning, Problem
from scenetruth.estimators import Estimator
from scenetruth.model import FrozenModel
from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Check
from scenetruth.testing.conformance.deviation import Deviation, NotApplicable
from scenetruth.testing.conformance.registry import all_checks
from scenetruth.testing.conformance.report import ConformanceError, ConformanceReport, Outcome

__all__ = ["EstimatorCheck", "check_estimator", "estimator_checks"]

Given = str | Estimator | Callable[..., Any]


@dataclass(frozen=True, eq=False)
class EstimatorCheck:
    """One check of one method: call it to try; its name is that of the test.

    Parameters
    ----------
    check
        The check.
    bench
        Where the method is tried, shared by all its checks.

    See Also
    --------
    scenetruth.testing.estimator_checks : All checks of a method, as parameters of a test.
    scenetruth.testing.check_estimator : All of them at once.

    Examples
    --------
    A method that takes the mean from the very images that it was given:

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

    check: Check
    bench: Bench

    @property
    def __name__(self) -> str:
        """The check's name, which runners of tests show."""
        return self.check.name

    id = __name__

    def __str__(self) -> str:
        return self.check.name

    def __call__(self) -> None:
        """Try the method.

        Raises
        ------
        AssertionError
            If it does not pass: what was done, what was expected, what was found, what to mend.
        unittest.SkipTest
            If the check says nothing of it.
        """
        with warnings.catch_warnings():
            # That settings suit other images better is no matter here.
            warnings.simplefilter("ignore", EstimateWarning)
            try:
                self.check.run(self.bench)
            except (Deviation, NotApplicable):
                raise
            except Exception as error:  # whatever the method raises
                told = " ".join(f"{type(error).__name__}: {error}".split())
                remedy = "let it estimate, or raise an EstimateError that says what the recording lacks"
                raise Deviation(self.check.says, "an estimate", f"it raised {told}", remedy) from error


def estimator_checks(
    method: Given,
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
        What `scenetruth.estimate` takes: a name, ``"module:function"``, a function, a method.
    settings
        Settings of the method, as of `scenetruth.estimate`.
    size
        Height and width in px of the images on which it is tried, if it needs larger ones.
    cameras, frames
        Number of camera positions and frames; three if not given, or the next odd number that it needs.

    Returns
    -------
    list of EstimatorCheck
        Each is called without arguments, and named as its test is to be.

    See Also
    --------
    check_estimator : All of them at once.

    Examples
    --------
    >>> from unittest import SkipTest
    >>> checks = {str(check): check for check in estimator_checks("plane_sweep")}
    >>> try:
    ...     checks["mask"]()
    ... except SkipTest as reason:
    ...     print(reason)
    the method refuses recordings with a mask: it has no Needs(mask=True)
    """
    bench = Bench(method, settings, size=size, cameras=cameras, frames=frames)
    return [EstimatorCheck(check, bench) for check in all_checks()]


def check_estimator(
    method: Given,
    *,
    settings: FrozenModel | Mapping[str, Any] | None = None,
    only: str | Iterable[str] | None = None,
    skip: str | Iterable[str] = (),
    size: tuple[int, int] | None = None,
    cameras: int | None = None,
    frames: int | None = None,
) -> ConformanceReport:
    """Check that a method keeps to the contract, and to what must hold for any images.

    Parameters
    ----------
    method
        What `scenetruth.estimate` takes: a name, ``"module:function"``, a function, a method.
    settings
        Settings of the method, as of `scenetruth.estimate`.
    only, skip
        Names of the checks to run, and of those not to run.
    size
        Height and width in px of the images on which it is tried, if it needs larger ones.
    cameras, frames
        Number of camera positions and frames; three if not given, or the next odd number that it needs.

    Returns
    -------
    ConformanceReport
        Which checks it passed, and which do not apply, with the reasons.

    Raises
    ------
    ConformanceError
        An AssertionError with every check that failed: what was done, what was expected, how far off it is, and what
        to mend.
    EstimateError
        If there is no such method, its settings are wrong, or there is no check of a name.

    See Also
    --------
    estimator_checks : One test for each check.

    Examples
    --------
    >>> print(check_estimator("plane_sweep", only=["deterministic", "mask"]))
    plane_sweep: 1 of 2 checks passed, 0 failed, 1 skipped
      skipped mask: the method refuses recordings with a mask: it has no Needs(mask=True)
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


def _outcome(check: EstimatorCheck) -> Outcome:
    start = time.perf_counter()
    status: Literal["passed", "failed", "skipped"] = "passed"
    told = ""
    try:
        check()
    except NotApplicable as reason:
        status, told = "skipped", str(reason)
    except Deviation as error:
        status, told = "failed", str(error)
    return Outcome(check.check.name, check.check.says, status, told, time.perf_counter() - start)


def _names(path: str, given: str | Iterable[str]) -> list[str]:
    if isinstance(given, str):
        return [given]
    if not isinstance(given, Iterable):
        raise EstimateError([Problem(path, "must be names of checks", given)], source="checks of an estimator")
    return [str(name) for name in given]


def _unknown(name: str, checks: Mapping[str, EstimatorCheck]) -> str:
    near = difflib.get_close_matches(name, checks, n=1)
    hint = f"did you mean '{near[0]}'?" if near else f"there are {', '.join(sorted(checks))}"
    return f"no such check; {hint}"
