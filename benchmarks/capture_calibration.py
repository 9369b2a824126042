"""Coverage of the stated uncertainty of a calibration: rigs drawn from their priors, corners with Gaussian noise.

Run it from the top of the repository:
``python -m benchmarks.capture_calibration [--draws N] [--poses N] [--noise PX]``.
Each draw has a new stage, board, set of poses and noise; errors are stated in units of their standard deviation (z).
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from scenetruth.capture.calibration import scatter_of_poses
from tests.helpers.drawn_rigs import assess_draw, draw_rig, fit_draw, summarise

__all__ = ["main"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--poses", type=int, default=12)
    parser.add_argument("--noise", type=float, default=0.01)
    given = parser.parse_args()
    begin, found, factors, widened = time.process_time(), [], [], 0
    for seed in range(given.first, given.first + given.draws):
        rig = draw_rig(seed, poses=given.poses, noise_px=given.noise)
        fit = fit_draw(rig)
        fit = replace(fit, scatter=scatter_of_poses(fit))
        widened += fit.scatter is not None
        factors.append(fit.variance_factor)
        found.append(assess_draw(rig, fit))
    print(
        f"{given.draws} draws, {given.poses} poses, {given.noise} px; chi2/dof {np.mean(factors):.3f}; "
        f"{widened} widened by the scatter of the poses"
    )
    print(
        f"std of z is uncertain by {1 / np.sqrt(2 * given.draws):.3f}, the share by {np.sqrt(0.0475 / given.draws):.3f}"
    )
    print(f"{'quantity':32} {'rms z':>6} {'in 95 %':>8} {'stated':>10}")
    for name, spread, share, std in summarise(found):
        print(f"{name:32} {spread:6.2f} {100 * share:7.1f}% {std:10.3g}")
    print(f"{(time.process_time() - begin) / given.draws:.2f} processor seconds per draw")


if __name__ == "__main__":
    main()
