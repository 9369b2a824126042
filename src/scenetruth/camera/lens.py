"""Lens model: point spread function, defocus and vignetting."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from scenetruth.camera.pinhole import Camera
from scenetruth.discovery import kind_in_lower_case
from scenetruth.validated_model import Finite, FrozenModel, Positive

__all__ = ["AiryPsf", "Defocus", "GaussianPsf", "Optics", "Psf", "Vignetting"]

Array = NDArray[np.float64]

# Margin around the image that contributes light, in standard deviations or Airy-disc radii. The neglected energy is
# 1e-7 for a Gaussian and about 0.09 / 12 for diffraction, which affects only the image border.
_GAUSSIAN_REACH, _AIRY_REACH = 5.5, 12.0


class GaussianPsf(FrozenModel):
    """Gaussian point spread function, a common approximation of a well-corrected lens."""

    kind: Literal["gaussian"]
    """``gaussian``."""
    sigma_px: Positive
    """Standard deviation in px."""

    def transfer(self, frequency_per_px: Array) -> Array:
        """Return the modulation transfer function exp(-2 (π σ f)²) at spatial frequencies f in cycles per px."""
        return np.asarray(np.exp(-2 * (np.pi * self.sigma_px * frequency_per_px) ** 2))

    @property
    def reach_px(self) -> float:
        """Truncation radius of the point spread function in px."""
        return _GAUSSIAN_REACH * self.sigma_px

    @property
    def finest_px(self) -> float:
        """Standard deviation of the point spread function in px."""
        return self.sigma_px


class AiryPsf(FrozenModel):
    """Point spread function of a diffraction-limited lens with a circular aperture."""

    kind: Literal["airy"]
    """``airy``."""
    wavelength_um: Positive
    """Wavelength of the light in µm."""
    f_number: Positive
    """Image-side f-number: focal length over aperture diameter."""
    pixel_pitch_um: Positive
    """Pixel pitch of the sensor in µm."""

    @property
    def cutoff_per_px(self) -> float:
        """Cut-off frequency of the aperture, 1 / (λ N), in cycles per px."""
        return self.pixel_pitch_um / (self.wavelength_um * self.f_number)

    @property
    def radius_px(self) -> float:
        """Radius of the first dark ring, 1.22 λ N, in px."""
        return 1.2196698912665045 / self.cutoff_per_px

    def transfer(self, frequency_per_px: Array) -> Array:
        """Return the modulation transfer function 2/π (arccos ν - ν √(1 - ν²)) at frequencies in cycles per px.

        ν is the frequency relative to the cut-off frequency (Goodman, Introduction to Fourier Optics).
        """
        share = np.minimum(np.abs(frequency_per_px) / self.cutoff_per_px, 1.0)
        return np.asarray(2 / np.pi * (np.arccos(share) - share * np.sqrt(1 - share**2)))

    @property
    def reach_px(self) -> float:
        """Truncation radius of the point spread function in px."""
        return _AIRY_REACH * self.radius_px

    @property
    def finest_px(self) -> float:
        """Standard deviation in px of the Gaussian fitted to the central peak."""
        return 0.345 * self.radius_px


Psf = Annotated[GaussianPsf | AiryPsf, Field(discriminator="kind"), BeforeValidator(kind_in_lower_case)]


class Defocus(FrozenModel):
    """Defocus blur of a thin lens with finite aperture.

    A point at depth Z is imaged as a disc of diameter f A |1/Z - 1/Z_f| px. Rays from the whole aperture are traced, so
    partial occlusion at blurred edges is correct.
    """

    aperture_mm: Positive
    """Diameter A of the aperture (entrance pupil) in mm."""
    focus_distance_mm: Positive
    """Depth Z_f of the focal plane in mm from the entrance pupil."""
    samples: Annotated[int, Field(ge=2, le=4096)] = 48
    """Number of aperture points per image; blur discs larger than about 4 px need more."""

    def blur_diameter_px(self, depth_mm: Array, focal_length_px: float) -> Array:
        """Return the blur-disc diameter f A |1/Z - 1/Z_f| in px for depths Z in mm, any shape."""
        return np.asarray(focal_length_px * self.aperture_mm * np.abs(1 / depth_mm - 1 / self.focus_distance_mm))

    def points_mm(self, count: int) -> Array:
        """Return points in mm that sample the aperture uniformly, shape (count, 2): a golden-angle spiral (Vogel 1979).

        Their mean is zero; with three or more points their variance is that of the disc, A² / 16 per axis.
        """
        number = np.arange(count)
        radius = self.aperture_mm / 2 * np.sqrt((number + 0.5) / count)
        angle = np.pi * (3 - np.sqrt(5)) * number
        points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
        # Normalise mean and variance, whose deviations would shift and scale the blur for small counts.
        points -= points.mean(axis=0)
        spread = points.T @ points / count
        values, axes = np.linalg.eigh(spread)
        if count > 2:
            points = points @ (axes / np.sqrt(values) @ axes.T) * (self.aperture_mm / 4)
        return points


class Vignetting(FrozenModel):
    """Vignetting: radial falloff of the image brightness.

    The factor is cos⁴ of the angle between ray and axis (if ``natural``) times 1 + a1 r² + a2 r⁴ + a3 r⁶, where r is
    the distance from the principal point, 1 at half the image diagonal.
    """

    natural: bool = True
    """Apply the cos⁴ law (natural vignetting)."""
    coefficients: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    """(a1, a2, a3); a1 = -0.2 darkens the corners by 20 %."""

    def factor(self, camera: Camera) -> Array:
        """Return the vignetting factor of every pixel."""
        grid = camera.pixel_grid()
        square = ((grid - camera.principal_point) ** 2).sum(axis=-1) / ((camera.width**2 + camera.height**2) / 4)
        a1, a2, a3 = self.coefficients
        factor = 1 + square * (a1 + square * (a2 + square * a3))
        if self.natural:
            # cos θ = 1 / |(X, Y, 1)|
            factor = factor / (camera.ray_directions(grid) ** 2).sum(axis=-1) ** 2
        return np.asarray(np.maximum(factor, 0.0))


class Optics(FrozenModel):
    """Optical effects of the lens other than distortion; by default none."""

    psf: Psf | None = None
    """Point spread function in focus."""
    defocus: Defocus | None = None
    """Aperture and focus of a thin lens; null for unlimited depth of field."""
    vignetting: Vignetting | None = None
    """Vignetting; null for none."""
