"""Tests that take long: ``make nightly`` runs them."""

from __future__ import annotations

import os

import pytest

__all__ = ["NIGHTLY", "by_day", "nightly"]

NIGHTLY = os.environ.get("HYPOTHESIS_PROFILE") == "nightly"

nightly = pytest.mark.skipif(not NIGHTLY, reason="takes long: make nightly")
by_day = pytest.mark.skipif(NIGHTLY, reason="the long test does more")
