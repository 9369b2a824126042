"""The lens: point spread function, defocus and vignetting."""

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

# Surroundings of the image that spread light into it, in standard deviations or in radii of Airy's disc. Beyond, a
# Gaussian holds 1e-7 of the light; diffraction about 0.09 / 12 of it, of which the image's border misses a part.
_GAUSSIAN_REACH, _AIRY_REACH = 5.5, 12.0


class GaussianPsf(FrozenModel):
    """A Gaussian point spread function, the usual stand-in for a good lens."""

    kind: Literal["gaussian"]
    """``gaussian``."""
    sigma_px: Positive
    """Standard deviation in px."""

    def transfer(self, frequency_per_px: Array) -> Array:
        """Return the modulation transfer function exp(-2 (π σ f)²).

        ``frequency_per_px``: Spatial frequencies f in periods per px, any shape.
        Returns: Contrast that is left, from 0 to 1, of the same shape.
        """
        return np.asarray(np.exp(-2 * (np.pi * self.sigma_px * frequency_per_px) ** 2))

    @property
    def reach_px(self) -> float:
        """Radius in px beyond which the spread light is neglected."""
        return _GAUSSIAN_REACH * self.sigma_px

    @property
    def finest_px(self) -> float:
        """Standard deviation in px, or what compares to it."""
        return self.sigma_px


class AiryPsf(FrozenModel):
    """The diffraction at a circular aperture, all that a perfect lens does."""

    kind: Literal["airy"]
    """``airy``."""
    wavelength_um: Positive
    """Wavelength of the light in µm."""
    f_number: Positive
    """Focal length over aperture, as seen from the image."""
    pixel_pitch_um: Positive
    """Distance of two pixels on the sensor in µm."""

    @property
    def cutoff_per_px(self) -> float:
        """Highest spatial frequency that the aperture lets through, 1 / (λ N), in periods per px."""
        return self.pixel_pitch_um / (self.wavelength_um * self.f_number)

    @property
    def radius_px(self) -> float:
        """Radius of the first dark ring, 1.22 λ N, in px."""
        return 1.2196698912665045 / self.cutoff_per_px

    def transfer(self, frequency_per_px: Array) -> Array:
        """Return the modulation transfer function 2/π (arccos ν - ν √(1 - ν²)).

        ν is the frequency over the cut-off frequency (Goodman, Introduction to Fourier Optics).

        ``frequency_per_px``: Spatial frequencies in periods per px, any shape.
        Returns: Contrast that is left, from 0 to 1, of the same shape.
        """
        share = np.minimum(np.abs(frequency_per_px) / self.cutoff_per_px, 1.0)
        return np.asarray(2 / np.pi * (np.arccos(share) - share * np.sqrt(1 - share**2)))

    @property
    def reach_px(self) -> float:
        """Radius in px beyond which the spread light is neglected."""
        return _AIRY_REACH * self.radius_px

    @property
    def finest_px(self) -> float:
        """Standard deviation in px of the Gaussian that fits its core."""
        return 0.345 * self.radius_px


Psf = Annotated[GaussianPsf | AiryPsf, Field(discriminator="kind"), BeforeValidator(kind_in_lower_case)]


class Defocus(FrozenModel):
    """A thin lens with an open aperture: sharp at one distance only.

    A point at depth Z is imaged as a disc with the diameter f A |1/Z - 1/Z_f| px. Rays from points all over the
    aperture are followed, so that blurred edges hide and show what they should.
    """

    aperture_mm: Positive
    """Diameter A of the aperture (the entrance pupil) in mm."""
    focus_distance_mm: Positive
    """Depth Z_f that is sharp, in mm from the entrance pupil."""
    samples: Annotated[int, Field(ge=2, le=4096)] = 48
    """Points on the aperture from which an image is rendered; discs of more than about 4 px need more."""

    def blur_diameter_px(self, depth_mm: Array, focal_length_px: float) -> Array:
        """Return the diameter of the blur disc.

        ``depth_mm``: Depths Z of points, any shape.
        Returns: f A |1/Z - 1/Z_f| in px, of the same shape.
        """
        return np.asarray(focal_length_px * self.aperture_mm * np.abs(1 / depth_mm - 1 / self.focus_distance_mm))

    def points_mm(self, count: int) -> Array:
        """Return points that cover the aperture evenly: a spiral with the golden angle (Vogel 1979).

        Their mean is zero, and from three points on, their mean square is that of the disc, A² / 16 along each axis.

        Returns: Offsets (X, Y) from the centre in mm, shape (count, 2).
        """
        number = np.arange(count)
        radius = self.aperture_mm / 2 * np.sqrt((number + 0.5) / count)
        angle = np.pi * (3 - np.sqrt(5)) * number
        points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
        # The moments of few points are a little off, which would shift and stretch blurred points.
        points -= points.mean(axis=0)
        spread = points.T @ points / count
        values, axes = np.linalg.eigh(spread)
        if count > 2:
            points = points @ (axes / np.sqrt(values) @ axes.T) * (self.aperture_mm / 4)
        return points


class Vignetting(FrozenModel):
    """How the image darkens away from its centre.

    The factor is cos⁴ of the ray's angle to the axis (if ``natural``) times 1 + a1 r² + a2 r⁴ + a3 r⁶, where r is the
    distance from the principal point, 1 at half the image's diagonal.
    """

    natural: bool = True
    """Whether the cos⁴ law of a lens without vignetting of its own holds."""
    coefficients: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    """(a1, a2, a3); a1 = -0.2 darkens the corners by 20 %."""

    def factor(self, camera: Camera) -> Array:
        """Return the factor by which every pixel is darkened."""
        grid = camera.pixel_grid()
        square = ((grid - camera.principal_point) ** 2).sum(axis=-1) / ((camera.width**2 + camera.height**2) / 4)
        a1, a2, a3 = self.coefficients
        factor = 1 + square * (a1 + square * (a2 + square * a3))
        if self.natural:
            # cos θ = 1 / |(X, Y, 1)|
            factor = factor / (camera.ray_directions(grid) ** 2).sum(axis=-1) ** 2
        return np.asarray(np.maximum(factor, 0.0))


class Optics(FrozenModel):
    """What the lens does besides distorting; nothing of it unless given."""

    psf: Psf | None = None
    """Point spread function in focus."""
    defocus: Defocus | None = None
    """Aperture and focus of a thin lens; without, everything is sharp."""
    vignetting: Vignetting | None = None
    """Darkening towards the corners."""
