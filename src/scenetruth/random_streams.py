"""Independent random streams, identified by purpose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

__all__ = ["GeneratorFor", "generator_for"]

GeneratorFor = Callable[..., np.random.Generator]
"""Type of functions that return an independent random generator per purpose: `generator_for` with a seed."""


def generator_for(seed: int, *purpose: str | int) -> np.random.Generator:
    """Return the random generator of one purpose, independent of all others and of the order of calls.

    >>> one, same = (generator_for(7, "texture", "cube").random() for _ in range(2))
    >>> one == same, one == generator_for(7, "texture", "box").random()
    (True, False)
    """
    key = "/".join(map(str, purpose)).encode()
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(key)))
