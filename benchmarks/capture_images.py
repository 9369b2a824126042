"""Calibration from whole images of boards: accuracy of the corners, and coverage of the stated uncertainty.

Run it from the top of the repository:
``python -m benchmarks.capture_images [--captures N] [--poses N] [--board charuco|dots] [--blur PX] [--light SHARE]
[--bits N]``.
Each capture has a new rig, drawn from its prior distribution, and new poses, which are fixed before any image is made;
none is excluded. Images are sampled densely (`tests.helpers.rendered_boards`), with shot and read noise of 12 bits.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.calibration import (
    BoardImage,
    CharucoBoard,
    DotGrid,
    RigCalibration,
    RigState,
    calibrate,
    detect_board,
    disc_bias,
    refine_points,
    rotation_matrix,
)
from tests.helpers.drawn_rigs import SIZE, DrawnRig, depth_errors, draw_rig
from tests.helpers.rendered_boards import noisy, render_board, rendered_noise_variance

__all__ = ["main"]

CHARUCO = CharucoBoard(kind="charuco", squares=(12, 9), square_mm=6.0, marker_mm=4.5, scale_std=1e-4, warp_mm=0.0)
# All dots must be visible from all positions.
DOTS = DotGrid(kind="dots", dots=(11, 8), spacing_mm=5.0, diameter_mm=2.4, scale_std=1e-4, warp_mm=0.0)
Array = NDArray[np.float64]


def poses_in_camera(rig: DrawnRig, view: int) -> tuple[Array, Array]:
    """Return the rotation and translation of the board in the frame of the camera of a view."""
    truth, given = rig.truth, rig.observations
    layout, values = truth.layout, truth.values
    position, visit, _, pose = layout.offsets(given.views)[view]
    shown = given.views[view]
    turn = rotation_matrix(values[position : position + 3] + values[visit : visit + 3])
    along = given.positions_mm[shown.position] * (1 + values[13]) + values[visit + 3]
    centre = along * np.array([1.0, values[11], values[12]]) + values[position + 3 : position + 6]
    board = truth.turns[layout.poses.index(shown.pose)]
    return turn.T @ board, turn.T @ (values[pose + 3 : pose + 6] - centre)


def run_capture(seed: int, given: argparse.Namespace) -> dict[str, Any]:
    """Return errors in units of their stated standard deviation, and the accuracy of the corners."""
    board = CHARUCO if given.board == "charuco" else DOTS
    target = board.target
    # The board is flat and of its nominal size: its scale error is drawn with the size of the squares instead.
    rig = draw_rig(seed, poses=given.poses, board=target)
    scale = float(rig.truth.values[rig.truth.layout.first_target])
    sized = {"square_mm": 6.0 * (1 + scale), "marker_mm": 4.5 * (1 + scale)}
    if isinstance(board, DotGrid):
        sized = {name: getattr(board, name) * (1 + scale) for name in ("spacing_mm", "diameter_mm")}
    real = board.model_copy(update=sized)
    camera = rig.truth.camera(*SIZE)
    images, errors, stated = [], [], []
    for number, view in enumerate(rig.observations.views):
        rotation, translation = poses_in_camera(rig, number)
        clean = given.light * render_board(real, camera, rotation, translation, blur_px=given.blur, fine=16)
        image, variance = noisy(clean, 1000 * seed + number), rendered_noise_variance(clean)
        if given.bits < 12:
            step = 2.0 ** (12 - given.bits)
            image, variance = np.rint(image / step), variance / step**2 + 1 / 12
        images.append(BoardImage(image, view.position, view.pose, view.visit, name=view.name, variance=variance))
        detection = detect_board(image, board)
        if detection.reason:
            continue
        points = refine_points(image, variance, board, detection)
        true = camera.project(real.points_mm[points.ids] @ rotation.T + translation)
        if isinstance(real, DotGrid):
            true = true + disc_bias(camera, rotation, translation, real.points_mm[points.ids], real.diameter_mm / 2)
        errors.append(points.pixels - true)
        white = np.linalg.inv(np.linalg.cholesky(points.covariance_px2))
        stated.append(float(np.sqrt((np.einsum("nij,nj->ni", white, errors[-1]) ** 2).mean())))
    begin = time.process_time()
    found = calibrate(images, board, positions_mm=rig.observations.positions_mm, priors=rig.priors)
    spent = time.process_time() - begin
    return {**assess(rig, found), "rms": rms(errors), "corner z": stated, "factor": found.variance_factor,
            "warnings": found.warnings, "seconds": spent, "images": len(images), "detected": len(errors)}  # fmt: skip


def rms(errors: list[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def assess(rig: DrawnRig, found: RigCalibration) -> dict[str, Any]:
    """Return z of the focal length and of the mean depth at 660 mm."""
    state = RigState(found.layout, found.values, np.empty((0, 3, 3)))
    x, y = np.linspace(0, SIZE[0] - 1, 5), np.linspace(0, SIZE[1] - 1, 4)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    depth = depth_errors(rig.truth, state, rig.observations, grid, 660.0)
    stated = found.point_errors(grid, 660.0, visit_std=np.zeros(6))[2]
    figures = {
        f"z {name}": (found.value(name) - rig.truth.value(name)) / found.std(name) for name in ("f", "c_x", "c_y")
    }
    weights = np.eye(len(grid))[0] - 1 / len(grid)
    return {
        **figures, "z depth": depth.mean() / stated.mean_std, "depth mm": depth.mean(), "stated mm": stated.mean_std,
        "z corner less mean": float(weights @ depth) / stated.contrast(weights),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--captures", type=int, default=10)
    parser.add_argument("--first", type=int, default=5000, help="first seed")
    parser.add_argument("--poses", type=int, default=8)
    parser.add_argument("--board", choices=("charuco", "dots"), default="charuco")
    parser.add_argument("--blur", type=float, default=0.6, help="standard deviation of the blur, px")
    parser.add_argument("--light", type=float, default=1.0, help="share of the light; 1 is 3000 DN at white")
    parser.add_argument("--bits", type=int, default=12, choices=(8, 10, 12))
    given = parser.parse_args()
    rows = []
    for seed in range(given.first, given.first + given.captures):
        row = run_capture(seed, given)
        rows.append(row)
        print(
            f"{seed}: corners {row['rms']:.4f} px rms, z by image {np.mean(row['corner z']):.2f} "
            f"({min(row['corner z']):.2f} to {max(row['corner z']):.2f}), chi2/dof {row['factor']:.2f}, "
            f"z of f {row['z f']:+.2f}, depth {row['depth mm']:+.3f} at {row['stated mm']:.3f} mm, "
            f"{row['detected']} of {row['images']} images, {row['seconds']:.1f} s {list(row['warnings'])}",
            flush=True,
        )
    for name in ("z f", "z c_x", "z c_y", "z depth", "z corner less mean"):
        print(f"{name:20} rms {np.sqrt(np.mean([row[name] ** 2 for row in rows])):.2f}")


if __name__ == "__main__":
    main()
