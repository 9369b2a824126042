"""Images of boards: exact means over pixels, against integrals, brute force and formulas written again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenetruth.camera import Camera, Distortion, GaussianPsf, Optics, Shutter, Viewpoint
from scenetruth.capture import (
    BoardArtwork,
    BoardLight,
    BoardPrint,
    BoardRenderer,
    PlacedBoard,
    draw_board,
    open_board_renderer,
    project_points,
)
from scenetruth.errors import SceneError
from tests.helpers.blurred_edges import blurred_edge, displacement_from, edge_normal
from tests.helpers.nightly import nightly

Array = NDArray[np.float64]

SIZE, FOCAL_PX, DEPTH_MM = 24, 400.0, 100.0
LIGHT = BoardLight(0.0, 1.0, 1.0)
CAMERA = Camera(width=SIZE, height=SIZE, focal_length_px=FOCAL_PX)
PX_MM = DEPTH_MM / FOCAL_PX


def straight_edge(angle_deg: float, distance_px: float) -> tuple[PlacedBoard, Array]:
    """Return a board that is black on one side of a line through the image, and the normal of the line."""
    normal = edge_normal(angle_deg)
    along = np.array([-normal[1], normal[0]])
    near, far = distance_px * normal, (distance_px - 200) * normal
    corners = PX_MM * np.array([far - 100 * along, near - 100 * along, near + 100 * along, far + 100 * along])
    box = (-60.0, -60.0, 60.0, 60.0)
    artwork = BoardArtwork((corners[None],), np.array([[-30.0, -30.0], [30.0, 30.0]]), box)
    return PlacedBoard(artwork, np.eye(3), np.array([0, 0, DEPTH_MM])), normal


@pytest.mark.parametrize("sigma_px", [0.2, 0.3, 0.6, 1.0])
@pytest.mark.parametrize("angle_deg", [0.0, 0.3, 1.0, 3.0, 20.0, 45.0, 90.0, 180.0, 269.5])
def test_edges_are_in_their_place(sigma_px: float, angle_deg: float) -> None:
    for distance in np.linspace(-0.5, 0.5, 7) + 0.013:
        board, normal = straight_edge(angle_deg, distance)
        optics = Optics(psf=GaussianPsf(kind="gaussian", sigma_px=sigma_px))
        image = open_board_renderer(CAMERA, optics, Shutter(), 1.0, board, LIGHT).render(0.0, Viewpoint.on_axis(0.0))
        mean, slope = blurred_edge(normal, distance, sigma_px, SIZE)
        assert abs(displacement_from(image.astype(np.float64), mean, slope)) < 6e-4
        # The rest is aliasing by subpixels, antisymmetric about the edge.
        assert np.abs(image - mean).max() < 3e-3


@given(angle_deg=some.floats(0, 360), distance=some.floats(-9, 9))
def test_sharp_edges_are_exact(angle_deg: float, distance: float) -> None:
    board, normal = straight_edge(angle_deg, distance)
    image = BoardRenderer(CAMERA, board, LIGHT).render(0.0, Viewpoint.on_axis(0.0))
    y, x = np.mgrid[:SIZE, :SIZE] - (SIZE - 1) / 2
    # The part of a unit square beyond a line at signed distance d from its centre, with (a, b) the absolute normal:
    # a combination of squares of the distances from its corners (the Heaviside function, integrated twice).
    d = normal[0] * x + normal[1] * y - distance
    a, b = np.abs(normal)
    corners = [(1, (a + b) / 2), (-1, (a - b) / 2), (-1, (b - a) / 2), (1, -(a + b) / 2)]
    if min(a, b) > 1e-3:
        white = sum(sign * np.maximum(d + shift, 0) ** 2 for sign, shift in corners) / (2 * a * b)
        # The division by a b ≥ 1e-3 amplifies rounding errors of numbers of about 300.
        np.testing.assert_allclose(image, white, rtol=0, atol=1e-7)
    assert image.min() > -1e-6
    assert image.max() < 1 + 1e-6


LENS = Distortion(k1=-0.6, k2=8.0, p1=1e-3, p2=-8e-4)
RIG = Camera(
    width=48, height=36, focal_length_px=90.0, principal_point_px=(25.2, 16.1), distortion=Distortion(k1=-0.25, p1=0.01)
)


def undistorted(distortion: Distortion, points: Array) -> Array:
    """Invert the distortion by iterating its formula."""
    found = points.copy()
    for _ in range(200):
        x, y = found[..., 0], found[..., 1]
        square = x * x + y * y
        radial = 1 + distortion.k1 * square + distortion.k2 * square**2
        shift = np.stack(
            [
                2 * distortion.p1 * x * y + distortion.p2 * (square + 2 * x * x),
                distortion.p1 * (square + 2 * y * y) + 2 * distortion.p2 * x * y,
            ],
            axis=-1,
        )
        found = (points - shift) / radial[..., None]
    return found


@nightly
def test_tilted_boards_behind_a_lens_agree_with_brute_force() -> None:
    board = draw_board(BoardPrint(kind="checkerboard", squares=(6, 5), square_mm=7))
    rotation = Rotation.from_rotvec([0.5, -0.35, 0.2])
    placed = PlacedBoard(board, rotation.as_matrix(), np.array([1.0, -0.5, 80.0]))
    turn = Rotation.from_rotvec([0.02, -0.03, 0.05])
    viewpoint = Viewpoint(np.array([2.0, 0.3, -1.0]), turn.as_matrix())
    image = BoardRenderer(RIG, placed, BoardLight(0.1, 0.9, 0.3)).render(0.0, viewpoint)
    parts = 24
    steps = (np.arange(parts) + 0.5) / parts - 0.5
    x = (np.arange(48)[:, None] + steps).ravel()
    y = (np.arange(36)[:, None] + steps).ravel()
    pixels = np.stack(np.meshgrid(x, y), axis=-1)
    assert RIG.distortion is not None
    seen = undistorted(RIG.distortion, (pixels - (25.2, 16.1)) / 90.0)
    rays = turn.apply(np.concatenate([seen, np.ones((*seen.shape[:-1], 1))], axis=-1).reshape(-1, 3))
    # Intersection with the plane of the board, in its own frame with the origin at the corner of the squares.
    start, direction = rotation.inv().apply(viewpoint.position_mm - placed.position_mm), rotation.inv().apply(rays)
    u, v = ((start - direction * (start[2] / direction[:, 2])[:, None])[:, :2] + (21.0, 17.5)).T
    on_plate = (u > -7) & (u < 49) & (v > -7) & (v < 42)
    on_squares = (u > 0) & (u < 42) & (v > 0) & (v < 35)
    black = on_squares & ((np.floor(u / 7) + np.floor(v / 7)) % 2 == 0)
    values = np.where(black, 0.1, np.where(on_plate, 0.9, 0.3))
    expected = values.reshape(36, parts, 48, parts).mean(axis=(1, 3))
    error = image - expected
    # An edge through a pixel changes the count of 576 samples by at most about 24 x 0.8; their mean error is far less.
    assert np.abs(error).max() < 1.5 * 0.8 / parts
    assert np.sqrt(np.mean(error**2)) < 0.2 * 0.8 / parts
    assert abs(error.mean()) < 2e-4
    assert expected.std() > 0.2


@given(
    turn=some.tuples(*[some.floats(-0.5, 0.5)] * 3),
    camera_turn=some.tuples(*[some.floats(-0.05, 0.05)] * 3),
    scale=some.floats(-1e-3, 1e-3),
    warp=some.tuples(*[some.floats(-0.5, 0.5)] * 3),
)
def test_points_are_projected_by_the_formulas(
    turn: tuple[float, ...], camera_turn: tuple[float, ...], scale: float, warp: tuple[float, float, float]
) -> None:
    board = draw_board(BoardPrint(kind="dots", dots=(5, 4), spacing_mm=9, diameter_mm=4))
    camera = Camera(
        width=640, height=480, focal_length_px=5016.0, principal_point_px=(331.7, 228.4), distortion=LENS
    )  # fmt: skip
    rotation, axes = Rotation.from_rotvec(turn).as_matrix(), Rotation.from_rotvec(camera_turn).as_matrix()
    placed = PlacedBoard(board, rotation, np.array([3.0, -2.0, 650.0]), scale, warp)
    viewpoint = Viewpoint(np.array([-10.0, 0.02, 0.01]), axes)
    for number, (column, row) in enumerate((c, r) for r in range(4) for c in range(5)):
        u, v = 9.0 * column - 18.0, 9.0 * row - 13.5
        w = (warp[0] * u * u + warp[1] * u * v + warp[2] * v * v) / 18.0**2
        world = rotation @ np.array([(1 + scale) * u, (1 + scale) * v, w]) + [3.0, -2.0, 650.0]
        x, y, z = axes.T @ (world - [-10.0, 0.02, 0.01])
        x, y = x / z, y / z
        square = x * x + y * y
        radial = 1 - 0.6 * square + 8.0 * square**2
        x_d = x * radial + 2 * 1e-3 * x * y - 8e-4 * (square + 2 * x * x)
        y_d = y * radial + 1e-3 * (square + 2 * y * y) - 2 * 8e-4 * x * y
        expected = [5016.0 * x_d + 331.7, 5016.0 * y_d + 228.4]
        np.testing.assert_allclose(project_points(camera, viewpoint, placed)[number], expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.65, 0.2, 0.1), (0.1, -0.6, 0.3)])
def test_dots_have_their_centroid_where_analysis_puts_it(turn: tuple[float, float, float]) -> None:
    board = draw_board(BoardPrint(kind="dots", dots=(3, 2), spacing_mm=20, diameter_mm=5))
    placed = PlacedBoard(board, Rotation.from_rotvec(turn).as_matrix(), np.array([1.0, 2.0, 660.0]))
    camera = Camera(
        width=520, height=380, focal_length_px=5016.0, principal_point_px=(271.7, 178.4), distortion=LENS
    )  # fmt: skip
    view = Viewpoint.on_axis(0.0)
    # Blur of 1 px leaves 1e-8 of the spectrum beyond the pixels: sums over pixels are integrals.
    optics = Optics(psf=GaussianPsf(kind="gaussian", sigma_px=1.0))
    image = 1 - open_board_renderer(camera, optics, Shutter(), 1.0, placed, LIGHT).render(0.0, view).astype(np.float64)
    y, x = np.mgrid[:380, :520]

    def project(points_mm: Array) -> Array:
        return camera.project(view.to_camera(placed.to_world(points_mm)))

    # The centroid of a projected disc is the mean of its points, weighted with the determinant of the projection.
    nodes, weights = np.polynomial.legendre.leggauss(20)
    radius, angle = 2.5 * (nodes[:, None] + 1) / 2, 2 * np.pi * np.arange(64) / 64
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    step = 1e-4
    for centre in board.points_mm:
        across, down = (
            (project(centre + disc + shift) - project(centre + disc - shift)) / (2 * step)
            for shift in (np.array([step, 0]), np.array([0, step]))
        )
        share = np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0]) * radius * weights[:, None]
        expected = (project(centre + disc) * share[..., None]).sum(axis=(0, 1)) / share.sum()
        near = np.hypot(*(np.stack([x, y]) - expected[:, None, None])) < 34
        found = np.array([(image * x)[near].sum(), (image * y)[near].sum()]) / image[near].sum()
        # Outlines are polygons of 512 corners, whose chords are 0.0004 px from the circle.
        np.testing.assert_allclose(found, expected, rtol=0, atol=3e-5)


def test_boards_behind_the_camera_are_rejected() -> None:
    board = draw_board(BoardPrint(kind="checkerboard", squares=(5, 4), square_mm=10))
    placed = PlacedBoard(board, np.eye(3), np.array([0.0, 0.0, -50.0]))
    with pytest.raises(SceneError, match="must lie in front of the camera"):
        BoardRenderer(CAMERA, placed, LIGHT).render(0.0, Viewpoint.on_axis(0.0))
