"""Tests that take long: ``make nightly`` runs them, and ``make accuracy`` those of the suite's core."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from _pytest.mark import ParameterSet

__all__ = ["NIGHTLY", "by_day", "by_night", "nightly", "whole_core"]

NIGHTLY = os.environ.get("HYPOTHESIS_PROFILE") == "nightly"

nightly = pytest.mark.skipif(not NIGHTLY, reason="takes long: make nightly")
by_day = pytest.mark.skipif(NIGHTLY, reason="the long test does more")
whole_core = pytest.mark.skipif(
    not (NIGHTLY or os.environ.get("SCENETRUTH_CORE")), reason="takes more than a minute: make accuracy"
)


def by_night(*values: Any) -> list[ParameterSet]:
    """Return values of a parameter, or tuples of several, that are only tried by night, beside those of the day."""
    return [pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=nightly) for value in values]
