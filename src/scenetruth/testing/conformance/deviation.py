"""How a check ends that a method does not pass: with what is wrong, or with why it does not apply."""

from __future__ import annotations

from unittest import SkipTest

__all__ = ["Deviation", "NotApplicable"]


class Deviation(AssertionError):
    """What a method does otherwise than it should.

    Parameters
    ----------
    done
        What was done to the recording or asked of the method.
    expected
        What should have followed.
    found
        What followed, with numbers and units.
    remedy
        What to mend.
    """

    def __init__(self, done: str, expected: str, found: str, remedy: str) -> None:
        self.done, self.expected, self.found, self.remedy = done, expected, found, remedy
        super().__init__(done, expected, found, remedy)

    def __str__(self) -> str:
        parts = (("done", self.done), ("expected", self.expected), ("found", self.found), ("remedy", self.remedy))
        return "\n".join(f"{name + ':':9} {text}" for name, text in parts)


class NotApplicable(SkipTest):
    """Why a check says nothing of a method; runners of tests count it as skipped."""
