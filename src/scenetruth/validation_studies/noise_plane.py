"""A plane with a noise texture, as a scene, and its exact image: the mean radiance over every pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from scenetruth.random_streams import generator_for
from scenetruth.scene import Scene
from scenetruth.scene.mesh.sheets import PlaneMesh
from scenetruth.scene.texture.band_limited_noise import make_band_limited_noise
from scenetruth.scene.texture.procedural_textures import NoiseTexture

__all__ = ["DEPTH_MM", "FOCAL_LENGTH_PX", "PlaneImage", "noise_plane", "reference_image"]

FOCAL_LENGTH_PX = 5016.0
DEPTH_MM = 660.0
_MARGIN_PX = 8  # of the plane around the image at every shift, to exclude silhouettes
_PITCH_MM = DEPTH_MM / FOCAL_LENGTH_PX
_OBJECT = "plane"

Field = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlaneImage:
    """The exact image of a plane with a noise texture, seen perpendicularly.

    Band-limited noise on a periodic raster is a finite Fourier series, determined by its samples. Its mean over the
    square footprint of a pixel of pitch p is the series with every wave multiplied by sinc(k_x p) sinc(k_y p), where k
    is in cycles per length; neither quadrature nor interpolation is necessary.

    ``spectrum``: Amplitudes of the waves exp(2πi (k_y Y / P_y + k_x X / P_x)) of the radiance, shape (rows, columns).
    ``wave_numbers``: Integers k_y, shape (rows,), and k_x, shape (columns,).
    ``period_mm``: (P_x, P_y). ``pitch_mm``: Distance of neighbouring pixels on the plane.
    ``first_mm``: Position (X, Y) of the first pixel's centre on the texture, from the corner of its first texel.
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
        """Return the series of noise (mean 0, variance 1) from its values at texels (j + 1/2, i + 1/2), (h, w)."""
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
        """Return the exact image, the mean radiance over the pixel footprints, float64, shape (height, width)."""
        return self._sum(self.spectrum * self._footprint(), shift_px)

    def points(self, shift_px: float = 0.0, offset_px: tuple[float, float] = (0.0, 0.0)) -> Field:
        """Return the radiance at one point of each pixel, float64, shape (height, width)."""
        return self._sum(self.spectrum, shift_px, offset_px)

    def gradient(self, shift_px: float = 0.0) -> tuple[Field, Field]:
        """Return the derivatives of `values` per pixel to the right and downwards, shape (height, width) each."""
        (k_y, k_x), spectrum = self.wave_numbers, self.spectrum * self._footprint()
        across, down = (2j * np.pi * self.pitch_mm / period for period in self.period_mm)
        return self._sum(spectrum * (across * k_x), shift_px), self._sum(spectrum * (down * k_y)[:, None], shift_px)

    def _footprint(self) -> Field:
        (k_y, k_x), pitch = self.wave_numbers, self.pitch_mm
        return np.sinc(k_y * pitch / self.period_mm[1])[:, None] * np.sinc(k_x * pitch / self.period_mm[0])

    def _sum(
        self, spectrum: NDArray[np.complex128], shift_px: float, offset_px: tuple[float, float] = (0.0, 0.0)
    ) -> Field:
        """Return the sum of the waves at all pixels; the pixel grid reduces it to two matrix products."""
        height, width = self.shape
        (k_y, k_x), (period_x, period_y) = self.wave_numbers, self.period_mm
        x = self.first_mm[0] + (np.arange(width) - shift_px + offset_px[0]) * self.pitch_mm
        y = self.first_mm[1] + (np.arange(height) + offset_px[1]) * self.pitch_mm
        waves_x = np.exp(2j * np.pi * np.outer(k_x, x / period_x))
        waves_y = np.exp(2j * np.pi * np.outer(y / period_y, k_y))
        return np.asarray((waves_y @ spectrum @ waves_x).real)


def noise_plane(wavelength_px: tuple[float, float], shape: tuple[int, int]) -> Scene:
    """Return a noise plane at 660 mm that fills the image and moves to the right by one pixel per frame.

    ``wavelength_px``: Shortest and longest wavelength in px of the image.
    """
    height, width = shape
    return Scene.from_dict(
        {
            "camera": {"width": width, "height": height, "focal_length_px": FOCAL_LENGTH_PX},
            "stage": {"positions": 1, "baseline_mm": 1.0},
            "frames": {"count": 1},
            "objects": [
                {
                    "name": _OBJECT,
                    "mesh": {
                        "kind": "plane",
                        "size_mm": [(side + 2 * _MARGIN_PX) * _PITCH_MM for side in (width, height)],
                    },
                    "pose": {"position_mm": [0, 0, DEPTH_MM]},
                    "texture": {"kind": "noise", "wavelength_mm": [length * _PITCH_MM for length in wavelength_px]},
                    "motion": [{"kind": "velocity", "velocity_mm_per_frame": [_PITCH_MM, 0, 0]}],
                }
            ],
            "seed": 2002,
        }
    )


def reference_image(scene: Scene) -> PlaneImage:
    """Return the exact image of a noise plane, from the Fourier series of its noise and the projection.

    The noise is generated from the scene's seed, independent of the splines and texture coordinates of the renderers.
    """
    item = scene.objects[0]
    assert isinstance(item.texture, NoiseTexture)
    assert isinstance(item.mesh, PlaneMesh)
    entry, (plane_width, plane_height) = item.texture, item.mesh.size_mm
    noise = make_band_limited_noise(
        entry.wavelength_mm,
        (plane_width, plane_height),
        generator_for(scene.seed, "texture", item.name),
        exponent=entry.spectrum_exponent,
        peak=entry.peak,
    )
    width, height = scene.camera.width, scene.camera.height
    first = [(plane - (side - 1) * _PITCH_MM) / 2 for plane, side in ((plane_width, width), (plane_height, height))]
    return PlaneImage.of_raster(
        noise.values,
        entry.mean,
        entry.mean * entry.rms_contrast,
        period_mm=noise.period,
        shortest_mm=entry.wavelength_mm[0],
        pitch_mm=_PITCH_MM,
        first_mm=(first[0], first[1]),
        shape=(height, width),
    )
