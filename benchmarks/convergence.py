"""From how far the refined method arrives: starts that are off, and planes at many disparities in fast motion.

Run it from the top of the repository: ``python -m benchmarks.convergence``; ten minutes on one core. Images are made by
formulas: 5 cameras, 9 frames, a tilted plane with 40 waves as texture, contrast 10 %, noise 0.5 % of full scale.

The first two tables start the fit itself (`refine`) from the true fields, 8 px per step and almost no motion, with one
of them off everywhere by the same: 0 to 8 px of disparity per step, or 0 to 16 px of motion per frame. The third runs
the whole method, whose start is its own plane sweep, at disparities of 3 to 30 px per step and motion of 0 to 16 px per
frame, along x and aslant, in images of 200 x 96 pixels. A pixel has arrived if disparity is within 0.05 px per step and
flow within 0.05 px per frame of the truth. Options of all benchmarks: `benchmarks.jobs`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import scenetruth as st
from benchmarks.jobs import arguments, ends, heading, line
from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.protocol import FrameReader
from scenetruth.estimators.refined.fit_maps import STEADY_PLACES
from scenetruth.estimators.refined.image_stack import ImageStack, Splines
from scenetruth.estimators.refined.iterations import refine
from scenetruth.indexing import centred_indices
from tests.helpers.wavy_plane import MovingPlane

Array = NDArray[np.float64]
CAMERAS, FRAMES, NOISE = 5, 9, 0.005
NEAR_PX = 0.05
# Pixels this close to the image's edges lack half of their window.
BORDER_PX = 12
FOCAL_PX, DEPTH_MM = 1000.0, 500.0

# Textures by their wavelengths in px.
TEXTURES = {"5 to 20": (5.0, 20.0), "5 to 60": (5.0, 60.0)}
OFF_DISPARITY = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
OFF_MOTION = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 16.0)
SEEDS = (0,)
# Ways in which the start is off: fields of (d, q_X, q_Y) and their signs.
WAYS = {"disparity": ((0, 1), (0, -1)), "motion": ((1, 1), (1, -1), (2, 1), (2, -1))}

DISPARITIES = (3.0, 10.0, 30.0)
MOTIONS = (0.0, 2.0, 4.0, 8.0, 12.0, 16.0)
DIRECTIONS = ((1.0, 0.0), (0.5**0.5, 0.5**0.5))
# Half of all images must show a pixel for it to count.
SEEN = 0.5


def arrived(disparity: Array, flow: Array, truth: dict[str, Array]) -> NDArray[np.bool_]:
    """Return where disparity and flow are right."""
    off = np.abs(flow - truth["flow"]).max(axis=0)
    return np.asarray((np.abs(disparity - truth["disparity"]) < NEAR_PX) & (off < NEAR_PX))


def from_start(wavelengths: tuple[float, float], what: str, off_px: float) -> float:
    """Return the share in % that arrives from a start that is off, over all ways and seeds."""
    shares = []
    for seed in SEEDS:
        plane = MovingPlane(focal_px=FOCAL_PX, depth_mm=DEPTH_MM, wavelengths_px=wavelengths, seed=seed)
        recording, truth = plane.recording(CAMERAS, FRAMES, noise_std=NOISE), plane.truth()
        splines = Splines(FrameReader(recording), RefinedSettings().spline_order).frames(0, FRAMES)
        across, times = (np.array(centred_indices(count), dtype=np.float64) for count in (CAMERAS, FRAMES))
        places = np.stack([across, np.zeros(CAMERAS)], axis=-1)
        height, width = plane.size
        centre, moved = ((width - 1) / 2, (height - 1) / 2), np.zeros((CAMERAS * FRAMES, 4))
        images = ImageStack(splines, places, times, plane.focal_px, centre, moved)
        x = np.arange(width) - (width - 1) / 2
        y = (np.arange(height) - (height - 1) / 2)[:, None]
        for field, sign in WAYS[what]:
            start = plane.start()
            start[field] += sign * off_px / (1.0 if field == 0 else start[0])
            theta = refine(images, start, RefinedSettings()).fit.theta[list(STEADY_PLACES)]
            # Flow from (d, q): the conventions' u_x = d (q_X - x q_Z / f).
            flow = theta[0] * np.stack([theta[1] - x * theta[3] / FOCAL_PX, theta[2] - y * theta[3] / FOCAL_PX])
            inside = (slice(BORDER_PX, -BORDER_PX),) * 2
            shares.append(arrived(theta[0], flow, truth)[inside].mean())
    return round(100 * float(np.mean(shares)), 1)


def seen_share(plane: MovingPlane) -> Array:
    """Return the share of all images that show what each reference pixel sees."""
    height, width = plane.size
    x = np.arange(width) - (width - 1) / 2
    y = (np.arange(height) - (height - 1) / 2)[:, None]
    d, *q = plane.start()
    shown = np.zeros(plane.size)
    for s in centred_indices(CAMERAS):
        for t in centred_indices(FRAMES):
            nearer = 1 + t * d * q[2] / plane.focal_px
            across, down = (x + d * (t * q[0] - s)) / nearer, (y + d * t * q[1]) / nearer
            shown += (np.abs(across) <= (width - 1) / 2) & (np.abs(down) <= (height - 1) / 2)
    return np.asarray(shown / (CAMERAS * FRAMES))


def of_method(disparity_px: float, motion_px: float) -> list[float]:
    """Return shares in %: arrived, and told, of the pixels that half of the images show; arrived of those told."""
    counts = np.zeros(3)
    for seed, (along, down) in enumerate(DIRECTIONS):
        pixel_mm = DEPTH_MM / FOCAL_PX
        plane = MovingPlane(
            velocity_mm=(motion_px * pixel_mm * along, motion_px * pixel_mm * down, -0.4),
            depth_mm=DEPTH_MM,
            focal_px=FOCAL_PX,
            baseline_mm=disparity_px * pixel_mm,
            size=(96, 200),
            seed=seed,
        )
        found = st.estimate(plane.recording(CAMERAS, FRAMES, noise_std=NOISE), "refined").isel(t=0)
        seen, told = seen_share(plane) >= SEEN, found["status"].values == 2
        right = arrived(found["disparity"].values, found["flow"].values, plane.truth()) & told
        counts += [seen.sum(), (told & seen).sum(), (right & seen).sum()]
    seen_count, told_count, right_count = counts
    return [
        round(100 * float(a / b), 1) if b else float("nan")
        for a, b in ((right_count, seen_count), (told_count, seen_count), (right_count, told_count))
    ]


def main() -> None:
    """Print the tables."""
    given = arguments(__doc__).parse_args()
    if given.set:
        raise SystemExit("--set: there are no scenes")
    for what, steps in (("disparity", OFF_DISPARITY), ("motion", OFF_MOTION)):
        jobs = {
            f"{what} {off:g}, {name}": (wavelengths, what, off)
            for name, wavelengths in TEXTURES.items()
            for off in steps
        }
        shares = dict(ends(from_start, jobs, given))
        if not shares:
            continue
        print(f"\n{heading([f'{what} off by, px', *(f'{off:g}' for off in steps)])}")
        for name in TEXTURES:
            cells = [shares.get(f"{what} {off:g}, {name}", "") for off in steps]
            print(line([f"waves of {name} px", *cells]), flush=True)
    jobs = {f"plane {d:g}, {m:g}": (d, m) for d in DISPARITIES for m in MOTIONS}
    told = dict(ends(of_method, jobs, given))
    if told:
        print(f"\n{heading(['disparity, px per step', *(f'{m:g} px per frame' for m in MOTIONS)])}")
        for d in DISPARITIES:
            cells = [" / ".join(map("{:g}".format, told.get(f"plane {d:g}, {m:g}", ()))) for m in MOTIONS]
            print(line([f"{d:g}", *cells]), flush=True)


if __name__ == "__main__":
    main()
