"""Images of calibration boards by dense sampling, independent of the renderer."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter

from scenetruth.camera import Camera
from scenetruth.capture.calibration import CharucoBoard, Checkerboard, DotGrid, charuco_board

__all__ = ["board_bitmap", "noisy", "render_board", "rendered_noise_variance"]

Array = NDArray[np.float64]

WHITE, BLACK = 3000.0, 400.0
GAIN, READ_DN = 0.1, 2.0
"""Digital numbers per electron, and read noise: about 17 DN of noise at white."""
_PARTS = 4
"""Parts of a pixel, per axis, in which the light is blurred before the pixel integrates it."""
_STRIDE = 7
"""Samples of a pixel form a lattice with one sample per row and column: a square grid would displace edges along the
pixels by up to half its spacing, 0.02 px rms for 16 x 16 samples.
"""
CELL = 40
"""Samples of a bitmap per square; markers of six modules with three quarters of a square then have whole modules."""


def board_bitmap(board: CharucoBoard | Checkerboard) -> NDArray[np.uint8]:
    """Return a board as zeros and ones with `CELL` samples per square."""
    columns, rows = board.squares
    if isinstance(board, CharucoBoard):
        image = charuco_board(board).generateImage((columns * CELL, rows * CELL))
        return np.asarray(np.asarray(image) > 127, dtype=np.uint8)
    y, x = np.mgrid[: rows * CELL, : columns * CELL] // CELL
    return np.asarray((x + y) % 2, dtype=np.uint8)


@numba.njit(cache=True, error_model="numpy")
def _on_board(
    rays: NDArray[np.float64], inverse: NDArray[np.float64], y: int, x: int, number: int, count: int
) -> tuple[float, float]:
    """Return the place on the board of one of several samples of a pixel, in mm."""
    a, b = (number + 0.5) / count, (number * _STRIDE % count + 0.5) / count
    r_x = (1 - b) * ((1 - a) * rays[y, x, 0] + a * rays[y, x + 1, 0])
    r_x += b * ((1 - a) * rays[y + 1, x, 0] + a * rays[y + 1, x + 1, 0])
    r_y = (1 - b) * ((1 - a) * rays[y, x, 1] + a * rays[y, x + 1, 1])
    r_y += b * ((1 - a) * rays[y + 1, x, 1] + a * rays[y + 1, x + 1, 1])
    w = inverse[2, 0] * r_x + inverse[2, 1] * r_y + inverse[2, 2]
    u = (inverse[0, 0] * r_x + inverse[0, 1] * r_y + inverse[0, 2]) / w
    v = (inverse[1, 0] * r_x + inverse[1, 1] * r_y + inverse[1, 2]) / w
    return u, v


@numba.njit(cache=True, error_model="numpy")
def _sample(
    rays: NDArray[np.float64], inverse: NDArray[np.float64], bitmap: NDArray[np.uint8], per_mm: float,
    fine: int, image: NDArray[np.float64],
) -> None:  # fmt: skip
    """Average the bitmap over pixels; rays at the corners of the pixels, (rows + 1, columns + 1, 2)."""
    rows, columns = image.shape
    for y in range(rows):
        for x in range(columns):
            total = 0.0
            for j in range(fine * fine):
                u, v = _on_board(rays, inverse, y, x, j, fine * fine)
                m = math.floor(u * per_mm + 0.5 * bitmap.shape[1])
                n = math.floor(v * per_mm + 0.5 * bitmap.shape[0])
                if m < 0 or n < 0 or m >= bitmap.shape[1] or n >= bitmap.shape[0]:
                    total += 1.0
                else:
                    total += bitmap[n, m]
            image[y, x] = total / (fine * fine)


@numba.njit(cache=True, error_model="numpy")
def _sample_dots(
    rays: NDArray[np.float64], inverse: NDArray[np.float64], centres: NDArray[np.float64], radius: float,
    fine: int, image: NDArray[np.float64],
) -> None:  # fmt: skip
    rows, columns = image.shape
    for y in range(rows):
        for x in range(columns):
            nearest, total = -1, 0.0
            for j in range(fine * fine):
                u, v = _on_board(rays, inverse, y, x, j, fine * fine)
                if nearest < 0:
                    least = 1e30
                    for k in range(centres.shape[0]):
                        square = (centres[k, 0] - u) ** 2 + (centres[k, 1] - v) ** 2
                        if square < least:
                            least, nearest = square, k
                inside = (centres[nearest, 0] - u) ** 2 + (centres[nearest, 1] - v) ** 2 < radius * radius
                total += 0.0 if inside else 1.0
            image[y, x] = total / (fine * fine)


def render_board(
    board: CharucoBoard | Checkerboard | DotGrid, camera: Camera, rotation: Array, translation: Array, *,
    blur_px: float = 0.6, fine: int = 16,
) -> Array:  # fmt: skip
    """Return the noise-free image of a flat board at a pose in the frame of the camera; shape (rows, columns).

    ``fine``: Root of the number of samples per pixel.
    """
    bright = isinstance(board, DotGrid) and not board.dark
    shape = board.model_copy(update={"dark": True}) if bright else board
    image = _sampled(_Pose(shape, camera, rotation, translation), fine // _PARTS)
    image = 1 - image if bright else image
    # The light is blurred before the pixels integrate it.
    image = gaussian_filter(BLACK + (WHITE - BLACK) * image, blur_px * _PARTS, truncate=6.0)
    return np.asarray(image.reshape(camera.height, _PARTS, camera.width, _PARTS).mean(axis=(1, 3)))


class _Pose(NamedTuple):
    """What a board without blur and noise depends on; equal ones share an image."""

    board: CharucoBoard | Checkerboard | DotGrid
    camera: Camera
    rotation: Array
    translation: Array

    def __hash__(self) -> int:
        return hash(self._text())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Pose) and self._text() == other._text()

    def _text(self) -> tuple[object, ...]:
        return repr(self.board), repr(self.camera), self.rotation.tobytes(), self.translation.tobytes()


@lru_cache(maxsize=2)
def _sampled(pose: _Pose, fine: int) -> Array:
    """Return the share of white in each part of the pixels."""
    board, camera, rotation, translation = pose
    rays = _rays(camera)
    inverse = np.linalg.inv(np.column_stack([rotation[:, 0], rotation[:, 1], translation]))
    image = np.empty((camera.height * _PARTS, camera.width * _PARTS))
    if isinstance(board, DotGrid):
        _sample_dots(rays, inverse, board.points_mm[:, :2].copy(), board.diameter_mm / 2, fine, image)
        return image
    _sample(rays, inverse, board_bitmap(board), CELL / board.square_mm, fine, image)
    return image


def _rays(camera: Camera) -> Array:
    """Return the rays through the corners of all parts of pixels, interpolated between every 16th pixel."""
    y, x = (np.linspace(-0.5, size - 0.5, size // 16 + 6) for size in (camera.height, camera.width))
    rays = camera.ray_directions(np.stack(np.meshgrid(x, y), axis=-1))
    fine = [np.arange(size * _PARTS + 1) / _PARTS - 0.5 for size in (camera.height, camera.width)]
    return np.stack([RectBivariateSpline(y, x, rays[..., k], kx=5, ky=5)(*fine) for k in (0, 1)], axis=-1)


def rendered_noise_variance(image: Array) -> Array:
    """Return the variance of the noise that `noisy` adds, rounding included."""
    return np.asarray(GAIN * image + READ_DN**2 + 1 / 12)


def noisy(image: Array, seed: int) -> Array:
    """Return whole digital numbers with shot and read noise."""
    generator = np.random.default_rng([seed, 5])
    signal = GAIN * generator.poisson(image / GAIN) + READ_DN * generator.standard_normal(image.shape)
    return np.rint(signal)
