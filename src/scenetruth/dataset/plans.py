"""Uniform numbers for every sample: its own random ones, or points that fill the space evenly over all samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scenetruth.dataset.distributions.base import Plan, Random
from scenetruth.randomness import generator_for

__all__ = ["Uniforms"]

# More are a sequence that SciPy cannot go forward in.
_BITS = 32
# Points of Sobol's sequence that are made, and kept, together.
_BLOCK = 4096


class Uniforms:
    """Uniform numbers between 0 and 1 for the random values of a recipe.

    Each number depends on the seed, the value's key, the sample and the draw alone. A plan adds that those of the
    first draws of all samples lie evenly; what is drawn again lies in the same stratum of a Latin hypercube, and
    anywhere in place of a point of Sobol's sequence.

    Parameters
    ----------
    seed
        Seed of the recipe.
    samples
        How many samples a Latin hypercube has to fill.
    fields
        The random values by key, in the order of the recipe: the order of the dimensions of Sobol's sequence.
    """

    def __init__(self, seed: int, samples: int, fields: Mapping[str, Random]) -> None:
        self._seed, self._samples = seed, samples
        self._sobol: dict[str, int] = {}
        dimensions = 0
        for key, field in fields.items():
            if field.plan == "sobol":
                self._sobol[key] = dimensions
                dimensions += field.uniforms

    def of(self, key: str, field: Random, sample: int, attempt: int) -> list[float]:
        """Return the numbers of one value of one draw of a sample, each above 0 and below 1."""
        own = generator_for(self._seed, "value", sample, attempt, key).random(field.uniforms)
        plan: Plan = field.plan
        if plan == "sobol" and attempt == 0:
            return [self._shifted(key, number, sample) for number in range(field.uniforms)]
        if plan == "latin_hypercube":
            strata = [_strata(self._seed, key, number, self._samples)[sample] for number in range(field.uniforms)]
            return _open([(stratum + u) / self._samples for stratum, u in zip(strata, own.tolist(), strict=True)])
        return _open(own.tolist())

    def _shifted(self, key: str, number: int, sample: int) -> float:
        """Return a point of Sobol's sequence with a random digital shift of its own, which keeps it even."""
        block, place = divmod(sample, _BLOCK)
        point = int(_sobol_block(self._sobol[key] + number, block)[place] * 2**_BITS)
        shift = int(generator_for(self._seed, "sobol", key, number).integers(2**_BITS))
        return ((point ^ shift) + 0.5) / float(1 << _BITS)


def _open(numbers: Sequence[float]) -> list[float]:
    """Keep numbers off both ends, where some distributions are infinite."""
    return [min(max(number, 2.0**-60), 1 - 2.0**-53) for number in numbers]


@lru_cache(maxsize=256)
def _sobol_block(dimension: int, block: int) -> NDArray[np.float64]:
    """Return some points along one dimension of Sobol's sequence; they depend on no other dimension."""
    from scipy.stats import qmc

    engine = qmc.Sobol(dimension + 1, scramble=False, bits=_BITS)
    if block:
        engine.fast_forward(block * _BLOCK)
    found: NDArray[np.float64] = engine.random(_BLOCK)[:, dimension]
    return found


@lru_cache(maxsize=64)
def _strata(seed: int, key: str, number: int, samples: int) -> NDArray[np.int64]:
    """Return which of as many strata as samples each sample lies in."""
    return generator_for(seed, "latin_hypercube", key, number).permutation(samples)
