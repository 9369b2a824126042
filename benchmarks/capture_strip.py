"""Depth error of a rig whose measuring visits are seen with a fiducial strip: the strip is detected in whole images.

Run it from the top of the repository: ``python -m benchmarks.capture_strip [--rigs N] [--visits fresh|knocked]``.
Boards are drawn as corners (noise 0.01 px); the strip, two rows of 17 dots, is rendered exactly at five new visits,
with shot and read noise of 12 bits. ``fresh``: 20 µrad of pitch and yaw, new at every visit of boards and strip.
``knocked``: 1 mrad and 50 µm at the visits of the strip, after boards at a precise stage. ``loose``: the same at all
visits.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import StageErrors, Viewpoint
from scenetruth.capture.board_artwork import draw_dots
from scenetruth.capture.board_rendering import BoardLight, BoardRenderer, PlacedBoard
from scenetruth.capture.calibration import (
    BoardImage,
    CalibrationTarget,
    RigGeometry,
    RigPriors,
    calibrate,
    observe_strip,
    rotation_matrix,
    triangulate,
)
from tests.helpers.drawn_rigs import SIZE, draw_rig
from tests.helpers.rendered_boards import noisy, rendered_noise_variance

__all__ = ["main"]

Array = NDArray[np.float64]
STRIP = CalibrationTarget(name="strip", half_width_mm=36.0, scale_std=1e-4, warp_mm=0.0)
SCREW = StageErrors(preset="screw_stage", backlash_um=0.0)
KNOCK = StageErrors(pitch_urad=1000, yaw_urad=1000, roll_urad=1000, straightness_um=50, repeatability_um=50)
PRIORS = {
    "fresh": RigPriors(errors=SCREW, visit_errors=StageErrors(pitch_urad=20, yaw_urad=20)),
    "knocked": RigPriors(errors=SCREW, strip_errors=KNOCK),
    "loose": RigPriors(errors=SCREW, visit_errors=KNOCK),
}
DOT_MM, DEPTH_MM = 1.7, 655.0


def measure(seed: int, priors: RigPriors, poses: int) -> tuple[float, float, float]:
    """Return the error of the depth at 660 mm, its stated deviation, and that without a strip at new visits, in mm."""
    rig = draw_rig(seed, poses=poses, priors=priors)
    layout, values = rig.truth.layout, rig.truth.values
    generator = np.random.default_rng([seed, 99])
    motions = np.array(priors.strip_visit_std) * generator.standard_normal((5, 6))
    u, v = np.meshgrid(np.linspace(-30, 30, 17), [-26.0, 26.0])
    points = np.column_stack([u.ravel(), v.ravel(), np.zeros(u.size)])
    artwork = draw_dots(points[:, :2], DOT_MM, 2 * DOT_MM)
    strip = PlacedBoard(
        artwork, rotation_matrix(np.array([0.03, -0.02, 0.01])), np.array([0.0, 1.0, DEPTH_MM]),
        1e-4 * float(generator.standard_normal()),
    )  # fmt: skip
    camera, given = rig.truth.camera(*SIZE), rig.observations
    renderer, images = BoardRenderer(camera, strip, BoardLight(300, 3000, 1500)), []
    first = max(layout.visits) + 1
    for s, x_mm in enumerate(given.positions_mm):
        start = layout.first_position + 6 * s
        systematic = values[start : start + 6]
        along = x_mm * (1 + values[13]) + motions[s, 3]
        centre = along * np.array([1.0, values[11], values[12]]) + systematic[3:] + [0, *motions[s, 4:]]
        view = Viewpoint(centre, rotation_matrix(systematic[:3] + motions[s, :3]))
        clean = renderer.render(0.0, view).astype(np.float64)
        image, variance = noisy(clean, 100 * seed + s), rendered_noise_variance(clean)
        images.append(BoardImage(image, s, 1000, first + s, name=f"strip {s}", variance=variance))
    views = observe_strip(images, points, given.positions_mm)
    found = calibrate(given, guess=5040.0, priors=priors, strip=STRIP, strip_views=views)
    exact = RigGeometry.from_values(values, layout, found.positions_mm, found.reference, motions)
    seen = exact.project(exact.to_stage(np.array([[0.0, 0.0, 660.0]])))
    start = found.layout.first_visit + 6 * found.visits.index(first)
    fitted = RigGeometry.from_values(
        found.values, found.layout, found.positions_mm, found.reference, found.values[start : start + 30].reshape(5, 6)
    )
    error = float(triangulate(fitted, seen, np.array([660.0]))[0, 2] - 660)
    pixels = seen[found.reference]
    stated = float(found.point_errors(pixels, 660.0, visits=[list(range(first, first + 5))])[2].std[0])
    without = calibrate(replace(given), guess=5040.0, priors=priors)
    return error, stated, float(without.point_errors(pixels, 660.0)[2].std[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=10)
    parser.add_argument("--first", type=int, default=7000, help="first seed")
    parser.add_argument("--poses", type=int, default=8)
    parser.add_argument("--visits", choices=tuple(PRIORS), default="fresh")
    given = parser.parse_args()
    rows = np.array([measure(given.first + n, PRIORS[given.visits], given.poses) for n in range(given.rigs)])
    z = rows[:, 0] / rows[:, 1]
    inside = 100 * np.mean(np.abs(z) < 1.96)
    print(f"depth error {np.sqrt((rows[:, 0] ** 2).mean()):.3f} mm rms, stated {rows[:, 1].mean():.3f} mm, "
          f"z {np.sqrt((z**2).mean()):.2f}, ± {np.sqrt(0.5 / given.rigs):.2f}, {inside:.0f} % within 95 % bars; "
          f"without strip, at visits like those of boards, {rows[:, 2].mean():.2f} mm ({given.rigs} rigs)")  # fmt: skip


if __name__ == "__main__":
    main()
