"""The pinhole camera: from points to pixels and from pixels to rays."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from scenetruth.model import Finite, FrozenModel, Positive

__all__ = ["Camera"]


class Camera(FrozenModel):
    """A pinhole camera that looks along +Z, with X to the right and Y down.

    The focal length is given in pixels, or in millimetres together with the pixel pitch.
    """

    width: Annotated[int, Field(ge=1, le=32768)]
    """Image width W in px."""
    height: Annotated[int, Field(ge=1, le=32768)]
    """Image height H in px."""
    focal_length_px: Positive | None = None
    """Focal length f in px."""
    focal_length_mm: Positive | None = None
    """Focal length in mm; needs ``pixel_pitch_um``."""
    pixel_pitch_um: Positive | None = None
    """Distance of two pixels on the sensor, in µm."""
    principal_point_px: tuple[Finite, Finite] | None = None
    """(c_x, c_y) in pixel indices; the image's centre ((W-1)/2, (H-1)/2) if not given."""

    @model_validator(mode="after")
    def _one_focal_length(self) -> Camera:
        in_mm = (self.focal_length_mm is not None, self.pixel_pitch_um is not None)
        if self.focal_length_px is not None and any(in_mm):
            msg = "give either focal_length_px, or focal_length_mm with pixel_pitch_um, not both"
            raise ValueError(msg)
        if self.focal_length_px is None and not all(in_mm):
            msg = "give focal_length_px, or focal_length_mm together with pixel_pitch_um"
            raise ValueError(msg)
        return self

    @property
    def focal_px(self) -> float:
        """Focal length f in px, however it was given."""
        if self.focal_length_px is not None:
            return self.focal_length_px
        assert self.focal_length_mm is not None  # the validator holds this
        assert self.pixel_pitch_um is not None
        return self.focal_length_mm * 1000.0 / self.pixel_pitch_um

    @property
    def principal_point(self) -> tuple[float, float]:
        """Principal point (c_x, c_y) in pixel indices."""
        return self.principal_point_px or ((self.width - 1) / 2, (self.height - 1) / 2)

    def project(self, points_mm: ArrayLike, camera_x_mm: float = 0.0) -> NDArray[np.float64]:
        """Project points into the image (paper eq. 3).

        Parameters
        ----------
        points_mm
            World points, shape (..., 3), in front of the camera (Z > 0).
        camera_x_mm
            Position X_s of the camera on the stage.

        Returns
        -------
        numpy.ndarray
            Pixel coordinates (x, y), shape (..., 2), float64; pixel centres are integers.
        """
        points = np.asarray(points_mm, dtype=np.float64)
        c_x, c_y = self.principal_point
        z = points[..., 2]
        x = self.focal_px * (points[..., 0] - camera_x_mm) / z + c_x
        y = self.focal_px * points[..., 1] / z + c_y
        return np.stack([x, y], axis=-1)

    def ray_directions(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Return the direction of the ray through each pixel position, scaled to Z = 1.

        A ray's parameter is therefore the depth Z of the point it reaches.

        Parameters
        ----------
        pixels
            Pixel coordinates (x, y), shape (..., 2).

        Returns
        -------
        numpy.ndarray
            Directions, shape (..., 3), float64.
        """
        positions = np.asarray(pixels, dtype=np.float64)
        c_x, c_y = self.principal_point
        directions = np.ones((*positions.shape[:-1], 3))
        directions[..., 0] = (positions[..., 0] - c_x) / self.focal_px
        directions[..., 1] = (positions[..., 1] - c_y) / self.focal_px
        return directions

    def pixel_grid(self) -> NDArray[np.float64]:
        """Return the coordinates (x, y) of all pixel centres, shape (height, width, 2)."""
        y, x = np.mgrid[: self.height, : self.width].astype(np.float64)
        return np.stack([x, y], axis=-1)
