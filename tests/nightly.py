"""Tests that take long: ``make nightly`` runs them, and ``make accuracy`` those of the suite's core."""

from __future__ import annotations

import os

import pytest

__all__ = ["NIGHTLY", "by_day", "nightly", "whole_core"]

NIGHTLY = os.environ.get("HYPOTHESIS_PROFILE") == "nightly"

nightly = pytest.mark.skipif(not NIGHTLY, reason="takes long: make nightly")
by_day = pytest.mark.skipif(NIGHTLY, reason="the long test does more")
whole_core = pytest.mark.skipif(
    not (NIGHTLY or os.environ.get("SCENETRUTH_CORE")), reason="takes more than a minute: make accuracy"
)
