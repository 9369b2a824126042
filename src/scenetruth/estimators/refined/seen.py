"""What every pixel shows by itself: how well the images agree there, and how much texture there is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.bands import Band

__all__ = ["Seen", "local_gradient", "local_means"]

# Pixels are judged with their neighbours, in a Gaussian window of this standard deviation that is cut at 3 px.
_SIGMA_PX, _CUT = 1.0, 2.5
# Of the window, so much is known.
_LEAST = 0.3
_SQUARES, _FREEDOM, _KNOWN, _GRADIENT = 14, 15, 16, 17


def local_means(values: NDArray[Any]) -> NDArray[Any]:
    """Return the means over a pixel and its neighbours.

    Parameters
    ----------
    values
        Values, shape (y, x).
    """
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(values, _SIGMA_PX, truncate=_CUT))


def local_gradient(products: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean square of the texture's gradient over a pixel and its neighbours, 0 where nothing is known.

    Parameters
    ----------
    products
        Normal equations, as of `add_products`.
    """
    known, gradient = local_means(products[_KNOWN]), local_means(products[_GRADIENT])
    return np.asarray(np.where(known > 0, gradient / np.where(known > 0, known, 1.0), 0.0))


@dataclass(frozen=True, eq=False)
class Seen:
    """What every pixel shows by itself."""

    square: NDArray[np.float32]
    """Mean square of what the images leave, per degree of freedom; infinite where they show nothing, shape (y, x)."""
    gradient: NDArray[np.float32]
    """Mean square of the texture's gradient, shape (y, x)."""

    @classmethod
    def blank(cls, shape: tuple[int, int]) -> Seen:
        """Return maps to be written.

        Parameters
        ----------
        shape
            Rows and columns.
        """
        return cls(np.full(shape, np.inf, dtype=np.float32), np.zeros(shape, dtype=np.float32))

    def chosen(self, where: NDArray[np.bool_], seen: Seen) -> Seen:
        """Return what another fit's pixels show where that is chosen, and these elsewhere.

        Parameters
        ----------
        where
            Pixels where it is, shape (y, x).
        seen
            What they show.
        """
        return Seen(np.where(where, seen.square, self.square), np.where(where, seen.gradient, self.gradient))

    def put(self, band: Band) -> None:
        """Write the rows of a band.

        Parameters
        ----------
        band
            Normal equations of its pixels.
        """
        inner = slice(band.top - band.first, band.bottom - band.first)
        squares, freedom, known = (local_means(band.products[n])[inner] for n in (_SQUARES, _FREEDOM, _KNOWN))
        rows = slice(band.top, band.bottom)
        with np.errstate(invalid="ignore", divide="ignore"):
            # Known counts the channels: more than one makes a window fuller than it is, which does no harm.
            self.square[rows] = np.where(known > _LEAST, squares / freedom, np.inf)
        self.gradient[rows] = local_gradient(band.products)[inner]
