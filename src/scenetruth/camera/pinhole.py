"""Pinhole camera with lens distortion: projection, back-projection and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer, model_validator

from scenetruth.bands import BandName
from scenetruth.validated_model import Finite, FrozenModel, Positive

__all__ = ["Camera", "Distortion", "PixelRays", "pixel_rays"]


Array = NDArray[np.float64]

# Block size of Newton's method, chosen to fit into the cache.
_BLOCK = 8192
_MAX_STEPS = 50
# Convergence is quadratic: below this step size, the next iterate is exact.
_CONVERGED = 1e-15
_PATH_FRACTIONS = np.linspace(0.0, 1.0, 17)[1:]


class Distortion(FrozenModel):
    """Rational Brown-Conrady lens distortion.

    Positions are relative to the principal point in units of the focal length (normalised coordinates). With r² = x² +
    y²: x_d = x R + 2 p1 x y + p2 (r² + 2 x²), y_d = y R + p1 (r² + 2 y²) + 2 p2 x y, R = (1 + k1 r² + k2 r⁴ + k3 r⁶) /
    (1 + k4 r² + k5 r⁴ + k6 r⁶) (Brown 1971; OpenCV, module calib3d).
    """

    k1: Finite = 0.0
    """Radial coefficient of r²; negative for barrel distortion."""
    k2: Finite = 0.0
    """Radial coefficient of r⁴."""
    p1: Finite = 0.0
    """First tangential (decentring) coefficient."""
    p2: Finite = 0.0
    """Second tangential coefficient."""
    k3: Finite = 0.0
    """Radial coefficient of r⁶."""
    k4: Finite = 0.0
    """Coefficient of r² in the denominator."""
    k5: Finite = 0.0
    """Coefficient of r⁴ in the denominator."""
    k6: Finite = 0.0
    """Coefficient of r⁶ in the denominator."""

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Coefficients in the order of OpenCV: (k1, k2, p1, p2, k3, k4, k5, k6)."""
        return (self.k1, self.k2, self.p1, self.p2, self.k3, self.k4, self.k5, self.k6)

    def distort(self, points: Array) -> Array:
        """Return distorted positions (x_d, y_d) for positions (x, y) in normalised coordinates, shape (..., 2)."""
        x, y = points[..., 0], points[..., 1]
        return self._image(x, y, self._radial(x, y)[0])

    def jacobian(self, points: Array) -> Array:
        """Return the Jacobian of `distort` at positions of shape (..., 2)."""
        x, y = points[..., 0], points[..., 1]
        a, b, d = self._slopes(x, y, *self._radial(x, y))
        return np.stack([np.stack([a, b], axis=-1), np.stack([b, d], axis=-1)], axis=-2)

    def undistort(self, points: Array) -> Array:
        """Invert `distort` by Newton's method; NaN where the distortion is not uniquely invertible."""
        given = np.asarray(points, dtype=np.float64)
        found = np.empty((given.size // 2, 2))
        for first in range(0, len(found), _BLOCK):
            found[first : first + _BLOCK] = self._undistort_block(given.reshape(-1, 2)[first : first + _BLOCK])
        return found.reshape(given.shape)

    def _undistort_block(self, points: Array) -> Array:
        found = self._solve(points)
        # A positive determinant along the path from the axis ensures a unique solution.
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            for share in _PATH_FRACTIONS:
                x, y = share * found[:, 0], share * found[:, 1]
                a, b, d = self._slopes(x, y, *self._radial(x, y))
                found[~(a * d - b * b > 0)] = np.nan
        return found

    def _solve(self, points: Array) -> Array:
        found = points.copy()
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            for _ in range(_MAX_STEPS):
                x, y = found[:, 0], found[:, 1]
                radial, slope = self._radial(x, y)
                left = self._image(x, y, radial) - points
                a, b, d = self._slopes(x, y, radial, slope)
                step = np.stack([d * left[:, 0] - b * left[:, 1], a * left[:, 1] - b * left[:, 0]], axis=-1)
                step /= (a * d - b * b)[:, None]
                found -= step
                if not (np.abs(step) > _CONVERGED * (1 + np.abs(found))).any():
                    break
            away = ~(np.abs(self.distort(found) - points).max(axis=-1, initial=0.0) < 1e-12)
        found[away] = np.nan
        return found

    def _radial(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return R and dR / d(r²)."""
        square = x * x + y * y
        above, above_slope = _cubic(square, self.k1, self.k2, self.k3)
        below, below_slope = _cubic(square, self.k4, self.k5, self.k6)
        radial = above / below
        return radial, (above_slope - radial * below_slope) / below

    def _image(self, x: Array, y: Array, radial: Array) -> Array:
        square, p1, p2 = x * x + y * y, self.p1, self.p2
        return np.stack(
            [
                x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
                y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
            ],
            axis=-1,
        )

    def _slopes(self, x: Array, y: Array, radial: Array, slope: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives dx_d/dx, dx_d/dy (= dy_d/dx) and dy_d/dy."""
        p1, p2 = self.p1, self.p2
        return (
            radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x,
            2 * x * y * slope + 2 * p1 * x + 2 * p2 * y,
            radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x,
        )


def _cubic(square: Array, a: float, b: float, c: float) -> tuple[Any, Any]:
    return 1 + square * (a + square * (b + square * c)), a + square * (2 * b + square * 3 * c)


_FOCAL_PX = (1e-3, 1e9)
"""Range of the focal length in px, between numerically degenerate fields of view (near 180° and near 0°)."""


class Camera(FrozenModel):
    """Pinhole camera with optional lens distortion, looking along +Z with X to the right and Y down.

    The focal length is specified in pixels, or in millimetres together with the pixel pitch.
    """

    width: Annotated[int, Field(ge=1, le=32768)]
    """Image width W in px."""
    height: Annotated[int, Field(ge=1, le=32768)]
    """Image height H in px."""
    focal_length_px: Positive | None = None
    """Focal length f in px."""
    focal_length_mm: Positive | None = None
    """Focal length in mm; requires ``pixel_pitch_um``."""
    pixel_pitch_um: Positive | None = None
    """Pixel pitch of the sensor, in µm."""
    principal_point_px: tuple[Finite, Finite] | None = None
    """(c_x, c_y) in pixel indices; default: the image centre ((W-1)/2, (H-1)/2)."""
    distortion: Distortion | None = None
    """Lens distortion; null for an ideal pinhole."""
    bands: Annotated[tuple[BandName, ...], Field(max_length=16)] = ()
    """Names of the bands of light that are recorded, such as ``[red, green, blue]`` or ``[red, nir_850]``; empty for a
    grey camera.
    """

    @field_validator("bands")
    @classmethod
    def _unique_bands(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        twice = sorted({name for name in value if value.count(name) > 1})
        if twice:
            msg = f"must be unique; used more than once: {', '.join(twice)}"
            raise ValueError(msg)
        return value

    @model_serializer(mode="wrap")
    def _write(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit the bands of a grey camera, so that the hashes of its scenes remain."""
        plain: dict[str, Any] = write(self)
        if not self.bands:
            plain.pop("bands", None)
        return plain

    @model_validator(mode="after")
    def _one_focal_length(self) -> Camera:
        in_mm = (self.focal_length_mm is not None, self.pixel_pitch_um is not None)
        if self.focal_length_px is not None and any(in_mm):
            msg = "specify either focal_length_px, or focal_length_mm with pixel_pitch_um, not both"
            raise ValueError(msg)
        if self.focal_length_px is None and not all(in_mm):
            msg = "specify focal_length_px, or focal_length_mm together with pixel_pitch_um"
            raise ValueError(msg)
        least, most = _FOCAL_PX
        if not least <= self.focal_px <= most:
            msg = f"the focal length must be between {least:g} and {most:g} px (got {self.focal_px:g} px)"
            raise ValueError(msg)
        return self

    @model_validator(mode="after")
    def _unfolded(self) -> Camera:
        problem = self.folding_problem(0)
        if problem:
            raise ValueError(problem)
        return self

    def folding_problem(self, margin_px: int) -> str:
        """Return a message if the distortion is not invertible in the image and a margin, else an empty string."""
        if self.distortion is None:
            return ""
        # Test the border and an interior grid: the fold is a closed curve around the axis.
        low, high = -0.5 - margin_px, margin_px - 0.5
        x, y = np.meshgrid(np.linspace(low, self.width + high, 33), np.linspace(low, self.height + high, 33))
        pixels = np.stack([x, y], axis=-1)
        folded = ~np.isfinite(self._undistorted(pixels)).all(axis=-1)
        if not folded.any():
            return ""
        px, py = pixels[folded][0]
        return (
            f"distortion is not invertible at pixel ({px:g}, {py:g}): it folds the image; "
            "use smaller coefficients, a smaller image or a longer focal length"
        )

    @property
    def focal_px(self) -> float:
        """Focal length f in px, from either specification."""
        if self.focal_length_px is not None:
            return self.focal_length_px
        assert self.focal_length_mm is not None  # ensured by the validator
        assert self.pixel_pitch_um is not None
        return self.focal_length_mm * 1000.0 / self.pixel_pitch_um

    @property
    def principal_point(self) -> tuple[float, float]:
        """Principal point (c_x, c_y) in pixel indices."""
        return self.principal_point_px or ((self.width - 1) / 2, (self.height - 1) / 2)

    def shrunk_to(self, most_px: int) -> Camera:
        """Return a downscaled camera with the same field of view and at most ``most_px`` along its longer side."""
        share = min(most_px / max(self.width, self.height), 1.0)
        width, height = (max(round(side * share), 1) for side in (self.width, self.height))
        x, y = self.principal_point
        return self.model_copy(
            update={
                "width": width,
                "height": height,
                "focal_length_px": self.focal_px * width / self.width,
                "focal_length_mm": None,
                "pixel_pitch_um": None,
                "principal_point_px": ((x + 0.5) * width / self.width - 0.5, (y + 0.5) * width / self.width - 0.5),
            }
        )

    def without_distortion(self) -> Camera:
        """Return the pinhole camera with the same intrinsics."""
        return self if self.distortion is None else self.model_copy(update={"distortion": None})

    def refined(self, parts: int, margin_px: int) -> Camera:
        """Return the camera with pixels subdivided into ``parts`` and a margin around the image."""
        c_x, c_y = self.principal_point
        # The result may exceed the size limits of scene cameras.
        return self.model_copy(
            update={
                "width": (self.width + 2 * margin_px) * parts,
                "height": (self.height + 2 * margin_px) * parts,
                "focal_length_px": self.focal_px * parts,
                # Pixel centres are integers, so the image starts at -1/2.
                "principal_point_px": tuple((c + margin_px + 0.5) * parts - 0.5 for c in (c_x, c_y)),
            }
        )

    def rows(self, first: int, last: int) -> Camera:
        """Return the camera restricted to a range of image rows."""
        c_x, c_y = self.principal_point
        return self.model_copy(update={"height": last - first, "principal_point_px": (c_x, c_y - first)})

    def project(self, points_mm: ArrayLike, camera_x_mm: float = 0.0) -> NDArray[np.float64]:
        """Project world points in front of the camera, shape (..., 3), to pixel coordinates (x, y) (paper eq. 3)."""
        points = np.asarray(points_mm, dtype=np.float64)
        c_x, c_y = self.principal_point
        z = points[..., 2]
        if self.distortion is None:
            x = self.focal_px * (points[..., 0] - camera_x_mm) / z + c_x
            y = self.focal_px * points[..., 1] / z + c_y
            return np.stack([x, y], axis=-1)
        normalised = np.stack([(points[..., 0] - camera_x_mm) / z, points[..., 1] / z], axis=-1)
        return np.asarray(self.focal_px * self.distortion.distort(normalised) + self.principal_point)

    def compute_flow(self, directions: NDArray[np.float64], rates: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert rates of X / Z and Y / Z, (n, 2), at ray directions, (n, 3), into optical flow in px, distorted."""
        if self.distortion is None:
            return self.focal_px * rates
        slope = self.distortion.jacobian(directions[:, :2])
        return np.asarray(self.focal_px * np.einsum("nij,nj->ni", slope, rates))

    def ray_directions(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Return the ray directions, scaled to Z = 1, of pixels (..., 2); NaN where distortion is not invertible."""
        positions = np.asarray(pixels, dtype=np.float64)
        directions = np.ones((*positions.shape[:-1], 3))
        directions[..., :2] = self._undistorted(positions)
        return directions

    def ray_steps(self, pixels: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the derivatives of the ray direction per pixel to the right and down, shape (n or 1, 3) each."""
        count = 1 if self.distortion is None else len(pixels)
        steps = np.zeros((2, count, 3))
        if self.distortion is None:
            steps[0, 0, 0] = steps[1, 0, 1] = 1 / self.focal_px
        else:
            slope = np.linalg.inv(self.distortion.jacobian(self._undistorted(pixels))) / self.focal_px
            steps[0, :, :2], steps[1, :, :2] = slope[..., 0], slope[..., 1]
        return steps[0], steps[1]

    def pixel_grid(self) -> NDArray[np.float64]:
        """Return the coordinates (x, y) of all pixel centres, shape (height, width, 2)."""
        y, x = np.mgrid[: self.height, : self.width].astype(np.float64)
        return np.stack([x, y], axis=-1)

    def _undistorted(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        c_x, c_y = self.principal_point
        normalised = np.stack([(pixels[..., 0] - c_x) / self.focal_px, (pixels[..., 1] - c_y) / self.focal_px], axis=-1)
        return normalised if self.distortion is None else self.distortion.undistort(normalised)


@dataclass(frozen=True, eq=False)
class PixelRays:
    """Rays through the pixel centres of a camera; the arrays are shared and must not be modified."""

    camera: Camera

    @cached_property
    def directions(self) -> NDArray[np.float64]:
        """Ray directions in row-major order, scaled to Z = 1; shape (n, 3)."""
        return self.camera.ray_directions(self.camera.pixel_grid()).reshape(-1, 3)

    @cached_property
    def steps(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Derivatives of the directions per pixel to the right and down, see `Camera.ray_steps`."""
        return self.camera.ray_steps(self.camera.pixel_grid().reshape(-1, 2))


_rays_by_camera: WeakKeyDictionary[Camera, PixelRays] = WeakKeyDictionary()


def pixel_rays(camera: Camera) -> PixelRays:
    """Return the pixel rays of a camera, cached for its lifetime."""
    rays = _rays_by_camera.get(camera)
    if rays is None:
        # A copy of the camera, because a reference from the value would keep the key alive.
        rays = _rays_by_camera[camera] = PixelRays(camera.model_copy())
    return rays
