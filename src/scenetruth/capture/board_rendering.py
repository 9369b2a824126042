"""Rendering of calibration boards by the exact area of their ink in every pixel, and projection of their points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera, Optics, Shutter, Viewpoint
from scenetruth.capture.board_artwork import BoardArtwork
from scenetruth.capture.coverage_kernels import add_edges
from scenetruth.errors import Problem, SceneError
from scenetruth.render.lens_and_shutter import open_behind_lens
from scenetruth.render.renderer import Renderer

__all__ = ["BoardLight", "BoardRenderer", "InkRenderer", "PlacedBoard", "open_board_renderer", "project_points"]

Array = NDArray[np.float64]

# Largest deviation of an edge in the image from its chords, in px of the rendered image.
_CHORD_PX = 1e-5
_MOST_PIECES = 256
_BORDER_PIECES = 64
# Subpixels per standard deviation of the point spread function: aliasing then shifts edges along the pixel grid, the
# worst direction, by at most 0.0004 px (tests/capture/test_board_rendering.py).
_PARTS_PER_SIGMA, _LEAST_PARTS, _MOST_PARTS = 2.4, 4, 16
_MARGIN = 0.02  # relative margin of the field of view, for polygons at its border


@dataclass(frozen=True, eq=False)
class PlacedBoard:
    """A board in the world.

    ``rotation``: Matrix whose columns are the axes u, v and w of the board in world coordinates, shape (3, 3).
    ``position_mm``: Position of the centre of the calibration points, shape (3,).
    ``scale``: Relative error q of all lengths: a length L of the artwork is (1 + q) L.
    ``warp_mm``: (a, b, c) of the height (a u² + b u v + c v²) / h², with u and v from the centre and half width h.
    """

    artwork: BoardArtwork
    rotation: Array
    position_mm: Array
    scale: float = 0.0
    warp_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def to_world(self, points_mm: Array) -> Array:
        """Return the world positions of points of the artwork, shape (..., 2), in mm."""
        u, v = np.moveaxis(points_mm - self.artwork.centre_mm, -1, 0)
        a, b, c = self.warp_mm
        height = (a * u * u + b * u * v + c * v * v) / self.artwork.half_width_mm**2
        flat = np.stack([(1 + self.scale) * u, (1 + self.scale) * v, height], axis=-1)
        return np.asarray(flat @ self.rotation.T + self.position_mm)


@dataclass(frozen=True)
class BoardLight:
    """Radiances of ink, paper and the background of a board."""

    ink: float
    paper: float
    background: float


def project_points(camera: Camera, viewpoint: Viewpoint, board: PlacedBoard) -> Array:
    """Return the pixel coordinates (x, y) of the calibration points of a board, shape (n, 2)."""
    return camera.project(viewpoint.to_camera(board.to_world(board.artwork.points_mm)))


class BoardRenderer(Renderer):
    """Renderer of one board in front of a uniform background.

    Every pixel is the exact mean over its footprint: edges are projected as curves with deviations below 1e-5 px, and
    the areas that they enclose in each pixel are computed analytically.
    """

    def __init__(self, camera: Camera, board: PlacedBoard, light: BoardLight) -> None:
        self.name = "board"
        self._camera, self._board, self._light = camera, board, light

    def render(self, t: float, viewpoint: Viewpoint) -> NDArray[np.float32]:
        """Return the image, see `Renderer.render`; the board is at rest."""
        light, artwork = self._light, self._board.artwork
        plate = _coverage(self._camera, viewpoint, self._board, (artwork.plate,))
        ink = _coverage(self._camera, viewpoint, self._board, artwork.rings)
        image = light.background + (light.paper - light.background) * plate + (light.ink - light.paper) * ink
        return np.asarray(image, dtype=np.float32)

    def close(self) -> None:
        """Free nothing."""


class InkRenderer(Renderer):
    """Renderer that prints the ink of boards on their plates in the images of another renderer, under any light.

    ``contrast``: Reflectance of ink less that of the plate, relative to the plate.
    """

    def __init__(self, base: Renderer, camera: Camera, boards: Sequence[PlacedBoard], contrast: float) -> None:
        self.name = base.name
        self._base, self._camera, self._boards, self._contrast = base, camera, tuple(boards), contrast

    def render(self, t: float, viewpoint: Viewpoint) -> NDArray[np.float32]:
        """Return the image, see `Renderer.render`; the boards are at rest and must not be occluded."""
        image = self._base.render(t, viewpoint).astype(np.float64)
        for board in self._boards:
            image *= 1 + self._contrast * _coverage(self._camera, viewpoint, board, board.artwork.rings)
        return np.asarray(image, dtype=np.float32)

    def close(self) -> None:
        """Close the other renderer."""
        self._base.close()


@dataclass(frozen=True)
class _AtRest:
    """A board at rest as the vertices of its plate."""

    vertices_mm: Array = field(repr=False)

    def at(self, t: float) -> _AtRest:
        return self


def open_board_renderer(
    camera: Camera, optics: Optics, shutter: Shutter, frame_interval_s: float, board: PlacedBoard, light: BoardLight
) -> Renderer:
    """Open the renderer of a board with lens and shutter."""
    still = _AtRest(board.to_world(board.artwork.plate[0]))

    def open_renderer(fine: Camera, samples: int) -> Renderer:
        return BoardRenderer(fine, board, light)

    return open_behind_lens(camera, optics, shutter, still, frame_interval_s, 1, open_renderer, edge_parts(optics))


def edge_parts(optics: Optics) -> int:
    """Return the number of subpixels per axis that edges require before the point spread function."""
    finest = np.inf if optics.psf is None else optics.psf.finest_px
    return int(np.clip(np.ceil(_PARTS_PER_SIGMA / finest), _LEAST_PARTS, _MOST_PARTS))


def _coverage(camera: Camera, viewpoint: Viewpoint, board: PlacedBoard, groups: Iterable[Array]) -> Array:
    """Return the share of every pixel that polygons of a board cover, shape (height, width)."""
    area = np.zeros((camera.height, camera.width + 1))
    low, high = _field_of_view(camera)
    for rings in groups:
        seen = _normalised(viewpoint, board, rings)
        beyond = (seen.max(axis=1) < low) | (seen.min(axis=1) > high)
        kept = rings[~beyond.any(axis=1)]
        if len(kept):
            starts = _subdivide(camera, viewpoint, board, kept)
            add_edges(starts.reshape(-1, 2), np.roll(starts, -1, axis=1).reshape(-1, 2), area)
    return np.cumsum(area, axis=1)[:, :-1]


def _normalised(viewpoint: Viewpoint, board: PlacedBoard, points_mm: Array) -> Array:
    """Return X / Z and Y / Z of points of a board in the camera frame."""
    in_camera = viewpoint.to_camera(board.to_world(points_mm))
    if not (in_camera[..., 2] > 0).all():
        message = "must lie in front of the camera with all its points"
        raise SceneError([Problem("board", message)])
    return np.asarray(in_camera[..., :2] / in_camera[..., 2:])


def _field_of_view(camera: Camera) -> tuple[Array, Array]:
    """Return the least and largest X / Z and Y / Z in the image, with a margin."""
    left, top, right, bottom = -0.5, -0.5, camera.width - 0.5, camera.height - 0.5
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom], [left, top]])
    share = np.linspace(0, 1, _BORDER_PIECES)[:, None]
    border = np.concatenate([one + share * (other - one) for one, other in pairwise(corners)])
    seen = camera.ray_directions(border)[:, :2]
    margin = _MARGIN * np.ptp(seen, axis=0)
    return np.asarray(seen.min(axis=0) - margin), np.asarray(seen.max(axis=0) + margin)


def _subdivide(camera: Camera, viewpoint: Viewpoint, board: PlacedBoard, rings: Array) -> Array:
    """Return the image of polygons as polygons that follow curved edges, with pixel (0, 0) covering [0, 1] x [0, 1]."""
    following = np.roll(rings, -1, axis=1)
    ends = _to_image(camera, viewpoint, board, rings)
    middle = _to_image(camera, viewpoint, board, (rings + following) / 2)
    # Height of the middle of an edge above its chord, which falls with the square of the number of pieces.
    chord, rise = np.roll(ends, -1, axis=1) - ends, middle - ends
    length = np.maximum(np.hypot(chord[..., 0], chord[..., 1]), 1e-12)
    deviation = float((np.abs(chord[..., 0] * rise[..., 1] - chord[..., 1] * rise[..., 0]) / length).max())
    pieces = int(np.clip(np.ceil(np.sqrt(deviation / _CHORD_PX)), 1, _MOST_PIECES))
    if pieces == 1:
        return ends
    share = np.arange(pieces)[:, None] / pieces
    points = rings[:, :, None] + share * (following - rings)[:, :, None]
    return _to_image(camera, viewpoint, board, points.reshape(len(rings), -1, 2))


def _to_image(camera: Camera, viewpoint: Viewpoint, board: PlacedBoard, points_mm: Array) -> Array:
    seen = _normalised(viewpoint, board, points_mm)
    if camera.distortion is not None:
        slope = camera.distortion.jacobian(seen)
        if not (slope[..., 0, 0] * slope[..., 1, 1] - slope[..., 0, 1] * slope[..., 1, 0] > 0).all():
            message = "the distortion folds points of the board outside the image; use a smaller board"
            raise SceneError([Problem("camera.distortion", message)])
    points = np.concatenate([seen, np.ones((*seen.shape[:-1], 1))], axis=-1)
    return camera.project(points) + 0.5
