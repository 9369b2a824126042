"""Selection of the motion model by growth, as by the refined method: isotropic, or affine where growth is anisotropic.

A model with isotropic growth is biased where growth is anisotropic and the surface is inclined: the fit takes part of
the anisotropy for a rotation towards the camera. The affine model has no such bias, and up to ten times the noise.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.fisher_information import GROWTH_BIAS

__all__ = [
    "MapNeighbourhood",
    "Neighbourhood",
    "PointNeighbourhood",
    "combine_motion_models",
    "is_biased",
    "select_affine",
]


Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

# As in the refined method: scales of averaging in window widths, the least noise of the difference of both models
# relative to the variance of the affine one, and the normal deviate of a probability of one in a thousand.
_SCALES = (2.0, 4.0, 8.0)
_LEAST_NOISE = 0.5
_SIGNIFICANT = 3.09
_UNSEEN = 0.01  # a bias below this multiple of the standard deviation of isotropic growth has no effect


class Neighbourhood(ABC):
    """Gaussian averages over the surroundings on the same surface, by scales in window widths."""

    @abstractmethod
    def mean(self, values: Map, scale: float) -> Map:
        """Return the means of values; those that are not finite are omitted."""

    @abstractmethod
    def coverage(self, scale: float) -> Map:
        """Return the fraction of the Gaussian that lies on the surface."""


@dataclass(frozen=True, eq=False)
class MapNeighbourhood(Neighbourhood):
    """Surroundings in a map of surface segments."""

    pieces: NDArray[np.int64]  # labels, -1 outside
    sigma_px: float  # width of a window, in pixels of the map

    def mean(self, values: Map, scale: float) -> Map:
        """Return the means of values."""
        known = np.isfinite(values)
        weights = self._blurred(known.astype(np.float64), scale)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(known, self._blurred(np.where(known, values, 0.0), scale) / weights, np.nan)

    def coverage(self, scale: float) -> Map:
        """Return the fraction of the Gaussian that lies on the surface."""
        return self._blurred(np.ones(self.pieces.shape), scale)

    def _blurred(self, values: Map, scale: float) -> Map:
        from scipy.ndimage import find_objects, gaussian_filter

        found = np.zeros(self.pieces.shape)
        for number, box in enumerate(find_objects(self.pieces + 1)):
            if box is not None:
                own = self.pieces[box] == number
                blurred = gaussian_filter(np.where(own, values[box], 0.0), scale * self.sigma_px, mode="constant")
                found[box] = np.where(own, blurred, found[box])
        return found


@dataclass(frozen=True, eq=False)
class PointNeighbourhood(Neighbourhood):
    """Surroundings among sampled points."""

    x_px: Map
    y_px: Map
    piece: NDArray[np.int64]  # labels of surface segments
    share_px: Map  # number of pixels that a point represents
    sigma_px: float

    @cached_property
    def _distance(self) -> Map:
        """Squared distances in window widths; infinite between surfaces."""
        square = (self.x_px[:, None] - self.x_px) ** 2 + (self.y_px[:, None] - self.y_px) ** 2
        return np.where(self.piece[:, None] == self.piece, square / self.sigma_px**2, np.inf)

    def mean(self, values: Map, scale: float) -> Map:
        """Return the means of values."""
        known = np.isfinite(values)
        weights = self._weights(scale) * known
        with np.errstate(invalid="ignore", divide="ignore"):
            means = weights @ np.where(known, values, 0.0) / weights.sum(axis=1)
        return np.asarray(np.where(known, means, np.nan))

    def coverage(self, scale: float) -> Map:
        """Return the fraction of the Gaussian that lies on the surface."""
        area = 2 * np.pi * (scale * self.sigma_px) ** 2
        return np.asarray(np.minimum(self._weights(scale).sum(axis=1) / area, 1.0))

    def _weights(self, scale: float) -> Map:
        return np.asarray(self.share_px * np.exp(-0.5 * self._distance / scale**2))


def combine_motion_models(
    isotropic: Mapping[str, Map], affine: Mapping[str, Map], around: Neighbourhood
) -> dict[str, Map]:
    """Return the standard deviations of the model that is selected at each point, and of growth with its bias.

    ``isotropic``: Standard deviations with isotropic growth, and its `GROWTH_BIAS`, which is 0 in the result where the
    affine model is selected. The affine model is selected where
    the bias exceeds the noise that it adds, in the means over any of the scales, and significantly so.
    """
    selected = select_affine(isotropic[GROWTH_BIAS], isotropic["growth_rate"], affine["growth_rate"], around)
    found = {
        name: np.where(selected, affine[name], values) for name, values in isotropic.items() if name != GROWTH_BIAS
    }
    bias = np.where(selected, 0.0, np.abs(isotropic[GROWTH_BIAS]))
    return found | {"growth_rate": np.hypot(found["growth_rate"], bias), GROWTH_BIAS: bias}


def is_biased(isotropic: Mapping[str, Map]) -> bool:
    """Return whether the bias of isotropic growth has an effect anywhere."""
    if GROWTH_BIAS not in isotropic or "growth_rate" not in isotropic:
        return False
    with np.errstate(invalid="ignore"):
        return bool((np.abs(isotropic[GROWTH_BIAS]) > _UNSEEN * isotropic["growth_rate"]).any())


def select_affine(bias: Map, isotropic_std: Map, affine_std: Map, around: Neighbourhood) -> Mask:
    """Return where the affine motion model is selected.

    The means of the squared difference of both models over its noise exceed 1 by the squared bias over this noise.
    They are compared with the noise that the affine model adds at the point itself, and with the quantile of χ² / n of
    n = 1 + 2 s² independent windows in a Gaussian of s window widths.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        noise = np.maximum(affine_std**2 - isotropic_std**2, _LEAST_NOISE * affine_std**2)
        ratio = bias**2 / noise
        usual = 1.0 / around.mean(1.0 / noise, _SCALES[0])
        selected = np.zeros(noise.shape, dtype=np.bool_)
        for scale in _SCALES:
            excess = around.mean(ratio, scale)
            count = 1.0 + 2.0 * scale**2 * around.coverage(scale)
            selected |= (excess * usual > noise) & (excess > _excess_by_noise(count))
    return selected


def _excess_by_noise(count: Map) -> Map:
    """Return the excess of χ² / n over 1 that noise reaches once in a thousand, by Wilson and Hilferty."""
    small = 2.0 / (9.0 * count)
    return np.asarray((1.0 - small + _SIGNIFICANT * np.sqrt(small)) ** 3 - 1.0)
