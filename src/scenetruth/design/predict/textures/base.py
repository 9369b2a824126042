"""A texture as a sum of waves, and how each kind of texture tells its own."""

from __future__ import annotations

import pkgutil
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

__all__ = ["TextureSpectrum", "Waves", "ring_waves", "spectra"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Waves:
    """A texture as waves on its surface, whose phases do not matter.

    Parameters
    ----------
    frequencies_per_mm
        Their frequencies along both coordinates of the surface, shape (n, 2).
    variances
        Variance of the radiance by each of them, shape (n,).
    mean
        Mean radiance.
    """

    frequencies_per_mm: Array
    variances: Array
    mean: float

    @property
    def contrast(self) -> float:
        """Standard deviation of the radiance."""
        return float(np.sqrt(self.variances.sum()))

    def joined(self, other: Self) -> Waves:
        """Return both together: independent textures, one painted over the other."""
        frequencies = np.concatenate([self.frequencies_per_mm, other.frequencies_per_mm])
        return Waves(frequencies, np.concatenate([self.variances, other.variances]), self.mean)


class TextureSpectrum(ABC):
    """The waves of one kind of texture; one module of this room each, which is found by itself."""

    kind: ClassVar[str]
    """The texture's kind."""
    exact: ClassVar[bool] = True
    """Whether the waves are all that there is to be seen."""

    @abstractmethod
    def waves(self, texture: Any) -> Waves:
        """Return the waves of a texture of this kind."""


def ring_waves(
    wavelength_mm: tuple[float, float],
    exponent: float,
    variance: float,
    mean: float,
    *,
    radii: int = 8,
    angles: int = 8,
) -> Waves:
    """Return isotropic noise that is limited to a band.

    Parameters
    ----------
    wavelength_mm
        Shortest and longest wavelength.
    exponent
        Its power density is proportional to (spatial frequency) ** exponent.
    variance, mean
        Of the radiance.
    radii, angles
        So many waves stand for it: Gauss-Legendre nodes of the frequency's logarithm, and even angles over half a turn.
    """
    nodes, shares = np.polynomial.legendre.leggauss(radii)
    octaves = np.log(wavelength_mm[1] / wavelength_mm[0])
    share_of_highest = np.exp(0.5 * octaves * (nodes - 1.0))
    frequency = share_of_highest / wavelength_mm[0]
    # A ring of frequencies f has an area in proportion to f, and nodes stand evenly in its logarithm.
    shares = shares * share_of_highest ** (exponent + 2)
    turn = np.pi * (np.arange(angles) + 0.5) / angles
    grid = frequency[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    variances = np.repeat(variance * shares / (shares.sum() * angles), angles)
    return Waves(grid.reshape(-1, 2), variances, mean)


@cache
def spectra() -> dict[str, TextureSpectrum]:
    """Return all kinds of textures whose waves follow from their definition."""
    from scenetruth.design.predict import textures

    found = {}
    for entry in pkgutil.iter_modules(textures.__path__):
        module = import_module(f"{textures.__name__}.{entry.name}")
        for one in vars(module).values():
            # What a module imports is another module's.
            own = isinstance(one, type) and issubclass(one, TextureSpectrum) and one.__module__ == module.__name__
            if own and one is not TextureSpectrum:
                found[one.kind] = one()
    return found
