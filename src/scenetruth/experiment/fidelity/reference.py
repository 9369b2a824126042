"""The exact image of a fronto-parallel plane with band-limited noise, from its Fourier series."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import fft

__all__ = ["PlaneImage"]

Field = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlaneImage:
    """A noise texture on a plane as a camera in front of it sees it.

    Band-limited noise on a periodic raster is a finite Fourier series, which its samples determine. Its mean over the
    square footprint of a pixel of pitch p is that series with every wave times sinc(k_x p) sinc(k_y p), where k counts
    cycles per length: no quadrature is needed, and no interpolation.

    Parameters
    ----------
    spectrum
        Amplitudes of the waves exp(2πi (k_y Y / P_y + k_x X / P_x)) of the radiance, shape (rows, columns), complex128.
    wave_numbers
        Whole numbers k_y, shape (rows,), and k_x, shape (columns,).
    period_mm
        (P_x, P_y).
    pitch_mm
        Distance of two pixels on the plane, in X as in Y.
    first_mm
        Where the first pixel's centre lies on the texture, (X, Y) from the corner of the raster's first texel.
    shape
        (height, width) of the image.
    """

    spectrum: NDArray[np.complex128]
    wave_numbers: tuple[Field, Field]
    period_mm: tuple[float, float]
    pitch_mm: float
    first_mm: tuple[float, float]
    shape: tuple[int, int]

    @classmethod
    def of_raster(
        cls,
        values: NDArray[np.float32],
        mean: float,
        std: float,
        *,
        period_mm: tuple[float, float],
        shortest_mm: float,
        pitch_mm: float,
        first_mm: tuple[float, float],
        shape: tuple[int, int],
    ) -> Self:
        """Find the Fourier series of noise from its values on a raster.

        Parameters
        ----------
        values
            Noise of zero mean and unit variance at texels (j + 1/2, i + 1/2), shape (h, w).
        mean, std
            Radiance is ``mean`` + ``std`` times the noise.
        shortest_mm
            Shortest wavelength; what the raster holds beyond is rounding, and left out.
        period_mm, pitch_mm, first_mm, shape
            See the class.
        """
        rows, columns = values.shape
        k_y, k_x = fft.fftfreq(rows, 1 / rows), fft.fftfreq(columns, 1 / columns)
        inside = [np.abs(k) <= np.floor(p / shortest_mm) for k, p in ((k_y, period_mm[1]), (k_x, period_mm[0]))]
        k_y, k_x = k_y[inside[0]], k_x[inside[1]]
        spectrum = std * fft.fft2(values.astype(np.float64))[np.ix_(*inside)] / values.size
        # The first sample is half a texel from the corner.
        spectrum *= np.exp(-1j * np.pi * k_y / rows)[:, None] * np.exp(-1j * np.pi * k_x / columns)
        spectrum[np.ix_(k_y == 0, k_x == 0)] = mean
        return cls(spectrum, (k_y, k_x), period_mm, pitch_mm, first_mm, shape)

    def values(self, shift_px: float = 0.0) -> Field:
        """Return the exact image: means over the pixels' footprints.

        Parameters
        ----------
        shift_px
            How far the plane has moved to the right.

        Returns
        -------
        numpy.ndarray
            Radiance, shape (height, width), float64.
        """
        return self._sum(self.spectrum * self._footprint(), shift_px)

    def points(self, shift_px: float = 0.0, offset_px: tuple[float, float] = (0.0, 0.0)) -> Field:
        """Return the radiance at one point of each pixel.

        Parameters
        ----------
        shift_px
            How far the plane has moved to the right.
        offset_px
            Offset (x, y) of the point from the pixel's centre.

        Returns
        -------
        numpy.ndarray
            Radiance, shape (height, width), float64.
        """
        return self._sum(self.spectrum, shift_px, offset_px)

    def gradient(self, shift_px: float = 0.0) -> tuple[Field, Field]:
        """Return the derivatives of `values`.

        Parameters
        ----------
        shift_px
            How far the plane has moved to the right.

        Returns
        -------
        tuple of numpy.ndarray
            Derivatives per pixel to the right, and per pixel down, shape (height, width) each.
        """
        (k_y, k_x), spectrum = self.wave_numbers, self.spectrum * self._footprint()
        across, down = (2j * np.pi * self.pitch_mm / period for period in self.period_mm)
        return self._sum(spectrum * (across * k_x), shift_px), self._sum(spectrum * (down * k_y)[:, None], shift_px)

    def _footprint(self) -> Field:
        (k_y, k_x), pitch = self.wave_numbers, self.pitch_mm
        return np.sinc(k_y * pitch / self.period_mm[1])[:, None] * np.sinc(k_x * pitch / self.period_mm[0])

    def _sum(
        self, spectrum: NDArray[np.complex128], shift_px: float, offset_px: tuple[float, float] = (0.0, 0.0)
    ) -> Field:
        """Add up the waves at all pixels: their grid makes this two products of matrices."""
        height, width = self.shape
        (k_y, k_x), (period_x, period_y) = self.wave_numbers, self.period_mm
        x = self.first_mm[0] + (np.arange(width) - shift_px + offset_px[0]) * self.pitch_mm
        y = self.first_mm[1] + (np.arange(height) + offset_px[1]) * self.pitch_mm
        waves_x = np.exp(2j * np.pi * np.outer(k_x, x / period_x))
        waves_y = np.exp(2j * np.pi * np.outer(y / period_y, k_y))
        return np.asarray((waves_y @ spectrum @ waves_x).real)
