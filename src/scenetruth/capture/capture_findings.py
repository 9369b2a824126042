"""Findings of the check of a capture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["CaptureFinding", "Severity"]

Severity = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class CaptureFinding:
    """A single result of a check.

    ``mistake``: Name of the mistake: ``files``, ``missing_image``, ``turned``, ``saturated``, ``gamma``, ``dark``,
    ``flat``, ``exposure``, ``blurred``, ``bit_depth``, ``board``, ``units``.
    ``severity``: ``error`` where results would be wrong, ``warning`` where they are impaired, ``note`` otherwise.
    ``message``: Path, what was measured, and what to do.

    See Also
    --------
    check_capture : Returns it.

    Examples
    --------
    >>> str(CaptureFinding("gamma", "error", "the response has an exponent of 0.45"))
    'error: gamma: the response has an exponent of 0.45'
    """

    mistake: str
    severity: Severity
    message: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.mistake}: {self.message}"
