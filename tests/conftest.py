"""What all tests share."""

from __future__ import annotations

from hypothesis import settings

# Kernels are compiled at their first call, and machines are busy: how long an example takes says nothing.
settings.register_profile("without_deadlines", deadline=None)
settings.load_profile("without_deadlines")
