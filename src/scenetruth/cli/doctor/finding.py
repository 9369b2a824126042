"""One thing that was looked at, and how it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

__all__ = ["Finding", "State", "is_fit"]

State = Literal["ok", "missing", "broken"]
"""``missing`` is what something could be had by; ``broken`` is there, or needed, and does not work."""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Parameters
    ----------
    group
        What it belongs to: rendering, packages, ...
    name
        What it is.
    state
        How it is.
    told
        What was found.
    remedy
        What to do about it; empty if nothing.
    needed
        Whether `scenetruth run` needs it.
    """

    group: str
    name: str
    state: State
    told: str
    remedy: str = ""
    needed: bool = False


def is_fit(findings: Sequence[Finding]) -> bool:
    """Tell whether nothing that `scenetruth run` needs is missing or broken."""
    return not any(one.needed and one.state != "ok" for one in findings)
