"""Independent random streams, keyed by their purpose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

__all__ = ["GeneratorFor", "generator_for"]

GeneratorFor = Callable[..., np.random.Generator]
"""Gives a random generator of its own for every purpose: `generator_for` with a seed, and perhaps a first key."""


def generator_for(seed: int, *purpose: str | int) -> np.random.Generator:
    """Return a random generator of its own for one purpose: independent of every other, and of any order of calls.

    >>> one, same = (generator_for(7, "texture", "cube").random() for _ in range(2))
    >>> one == same, one == generator_for(7, "texture", "box").random()
    (True, False)
    """
    key = "/".join(map(str, purpose)).encode()
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(key)))
