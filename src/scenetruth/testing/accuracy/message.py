"""What a failed assertion says: every limit, where to look, and what slips are likely."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scenetruth.testing.accuracy.outcomes import Outcome
from scenetruth.testing.table import aligned, times_over

__all__ = ["failure_message"]

_HEADS = ("", "quantity", "statistic", "found", "limit", "times", "density", "pixels")


def failure_message(
    outcomes: Sequence[Outcome],
    *,
    method: str,
    region: str,
    pixels: int,
    pictures: Sequence[Path] | str,
    slips: Sequence[str],
) -> str:
    """Return the text of a failure.

    Parameters
    ----------
    outcomes
        Of all limits, kept ones too.
    method
        Who estimated.
    region, pixels
        The region, and how many pixels it has.
    pictures
        The files, or why there are none; nothing if nobody asked for any.
    slips
        What may have been mixed up.
    """
    broken = sum(not outcome.kept for outcome in outcomes)
    head = f"{broken} of {len(outcomes)} limit{'s' * (len(outcomes) != 1)} broken by the estimate of '{method}'"
    lines = [f"{head} in the region '{region}' of {pixels} pixels:", *_table(outcomes)]
    if slips:
        lines += ["likely slips:", *(f"  - {slip}" for slip in slips)]
    if pictures:
        shown = [pictures] if isinstance(pictures, str) else [f"  {file}" for file in pictures]
        lines += shown if isinstance(pictures, str) else ["estimate, truth and error:", *shown]
    look = "scenetruth.write_report(recording, estimate, truth, folder=...) draws everything; "
    lines.append(f"look further: {look}scenetruth.score(estimate, truth, recording).to_frame() has all regions")
    return "\n".join(lines)


def _table(outcomes: Sequence[Outcome]) -> list[str]:
    rows = [_HEADS]
    for outcome in outcomes:
        limit = outcome.limit
        density = "-" if outcome.density is None else f"{100 * outcome.density:.3g} %"
        rows.append(
            (
                "kept" if outcome.kept else "BROKEN",
                limit.quantity,
                limit.statistic,
                outcome.shown_found,
                outcome.shown_limit,
                times_over(outcome.times),
                density,
                str(outcome.count),
            )
        )
    return [f"  {line}" for line in aligned(rows)]
