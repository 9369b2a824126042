"""The type of the fixture that generates data sets."""

from __future__ import annotations

from collections.abc import Callable

from scenetruth.dataset.sampler import Sampler

__all__ = ["Make"]


Make = Callable[..., Sampler]
