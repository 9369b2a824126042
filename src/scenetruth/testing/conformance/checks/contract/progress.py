"""Progress may be told or not; telling it changes nothing, and an exception raised in it comes out."""

from __future__ import annotations

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import near_to_rounding, scalar_maps
from scenetruth.testing.conformance.deviation import Deviation, NotApplicable

__all__ = ["NEEDS", "check"]

NEEDS = Need()


class _Interruption(Exception):
    pass


def check(bench: Bench) -> None:
    """Listen, then interrupt."""
    told: list[tuple[object, object, object]] = []

    def listen(what: object, done: object, total: object) -> None:
        told.append((what, done, total))

    found = bench.estimate(bench.recording(), listen)
    near_to_rounding(
        scalar_maps(found),
        scalar_maps(bench.plain),
        done="progress was listened to",
        expectation="the same estimate",
        remedy="tell of progress only: nothing may depend on whether anyone listens",
    )
    if not told:
        msg = "the method tells of no progress"
        raise NotApplicable(msg)
    wrong = [item for item in told if not _is_right(*item)]
    if wrong:
        raise Deviation(
            "progress was listened to",
            "calls with (what: str, done: int, total: int), 0 <= done <= total",
            f"called with {wrong[0]}",
            "call progress(what, done, total) with whole numbers",
        )

    def interrupt(what: object, done: object, total: object) -> None:
        raise _Interruption

    try:
        bench.estimate(bench.recording(), interrupt)
    except _Interruption:
        return
    except Exception as error:
        if isinstance(error.__cause__ or error.__context__, _Interruption):
            came_out = f"{type(error).__name__} instead, which hides it"
        else:
            raise
    else:
        came_out = "the method went on to its end"
    raise Deviation(
        "an exception was raised in progress, as interrupting does",
        "the same exception comes out",
        came_out,
        "do not catch what progress raises",
    )


def _is_right(what: object, done: object, total: object) -> bool:
    return isinstance(what, str) and isinstance(done, int) and isinstance(total, int) and 0 <= done <= total
