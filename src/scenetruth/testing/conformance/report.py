"""What checks have told of a method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["ConformanceError", "ConformanceReport", "Outcome"]


@dataclass(frozen=True)
class Outcome:
    """How one check ended.

    Parameters
    ----------
    name, says
        The check, and what it demands.
    status
        ``"passed"``, ``"failed"`` or ``"skipped"``.
    told
        What is wrong, or why it was skipped.
    seconds
        How long it took.
    """

    name: str
    says: str
    status: Literal["passed", "failed", "skipped"]
    told: str
    seconds: float


@dataclass(frozen=True)
class ConformanceReport:
    """How all checks of a method ended.

    Parameters
    ----------
    method
        Its name.
    outcomes
        The checks in the order in which they ran.

    See Also
    --------
    scenetruth.testing.check_estimator : Tries a method, and returns one.
    scenetruth.testing.ConformanceError : Holds it if a check failed.

    Examples
    --------
    >>> told = Outcome("mask", "Masked pixels are left out.", "skipped", "refuses masks", 0.1)
    >>> print(ConformanceReport("my_method", (told,)))
    my_method: 0 of 1 checks passed, 0 failed, 1 skipped
      skipped mask: refuses masks
    """

    method: str
    outcomes: tuple[Outcome, ...]

    @property
    def passed(self) -> tuple[str, ...]:
        """The names of the checks that the method passed."""
        return tuple(item.name for item in self.outcomes if item.status == "passed")

    @property
    def failed(self) -> dict[str, str]:
        """What is wrong, by the name of the check."""
        return {item.name: item.told for item in self.outcomes if item.status == "failed"}

    @property
    def skipped(self) -> dict[str, str]:
        """Why a check says nothing of the method, by its name."""
        return {item.name: item.told for item in self.outcomes if item.status == "skipped"}

    def __str__(self) -> str:
        counts = f"{len(self.failed)} failed, {len(self.skipped)} skipped"
        lines = [f"{self.method}: {len(self.passed)} of {len(self.outcomes)} checks passed, {counts}"]
        for item in self.outcomes:
            if item.status == "failed":
                told = item.told.replace("\n", "\n    ")
                lines.append(f"  FAILED {item.name}: {item.says}\n    {told}")
        lines += [f"  skipped {name}: {why}" for name, why in self.skipped.items()]
        return "\n".join(lines)


class ConformanceError(AssertionError):
    """A method that does not pass all checks; says which, and what to mend.

    Parameters
    ----------
    report
        How all checks ended.

    See Also
    --------
    scenetruth.testing.check_estimator : Raises it.

    Examples
    --------
    A method that tells depth in metres:

    >>> import numpy as np
    >>> from scenetruth.testing import check_estimator
    >>> def mine(recording):
    ...     return {"depth": np.full(recording["image"].shape[-2:], 0.6)}
    >>> try:
    ...     check_estimator(mine, only=["deterministic", "truth_in_the_middle"])
    ... except ConformanceError as error:
    ...     report = error.report
    >>> report.passed, list(report.failed)
    (('deterministic',), ['truth_in_the_middle'])
    >>> found = report.failed["truth_in_the_middle"].splitlines()[2]
    >>> print(found.partition(";")[0])
    found:    depth is 0.6 mm in the median, the truth 600
    """

    def __init__(self, report: ConformanceReport) -> None:
        self.report = report
        super().__init__(report)

    def __str__(self) -> str:
        return str(self.report)
