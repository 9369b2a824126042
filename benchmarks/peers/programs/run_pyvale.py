"""Image correlation of pyvale on a recording: ``python run_pyvale.py RECORDING OUTPUT``, in its own environment.

Two images at a time (``--mode 2d``): flow from the reference to the next frame, disparity from the reference camera to
another; or both cameras and both frames together (``--mode stereo``): depth, and velocity of the points.

Subsets of 29 px (2D) or 31 px (stereo) every 5 px, affine, cubic B-splines, zero-mean normalised squared differences,
images smoothed by a Gaussian of 1 px before: pyvale's own defaults, but for size, step and, in stereo, precision.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from folder import (
    SEARCH_PX,
    Map,
    Recording,
    Region,
    arguments,
    between_points,
    planar_maps,
    run_each,
    seed_points,
    seen_in_both,
    whole_shift,
    write_maps,
)
from numpy.typing import NDArray

Seed = tuple[int, int]
SUBSET_PX = {"2d": 29, "stereo": 31}
SEEDS = 8
# Room around what both images show.
MARGIN_PX = 4
PRECISION = {"2d": 1e-3, "stereo": 1e-5}


def main() -> None:
    """Match, and write maps."""
    parser = arguments(__doc__)
    parser.add_argument("--mode", choices=("2d", "stereo"), default="2d")
    parser.add_argument("--subset", type=int, metavar="PX", help="side of a subset, odd")
    parser.add_argument("--step", type=int, default=5, metavar="PX", help="distance of two subsets")
    parser.add_argument("--shape", choices=("RIGID", "AFFINE", "QUAD"), default="AFFINE", help="shape function")
    parser.add_argument("--precision", type=float, help="of the iteration")
    parser.add_argument("--epipolar", type=int, default=200, metavar="PX", help="largest disparity, in stereo")
    parser.add_argument("--growth", type=int, metavar="N", help="growth of area over N x N points, in stereo")
    parser.add_argument("--share", type=float, default=0.25, help="of these points that must be there")
    parser.add_argument("--kernel", type=int, default=5, metavar="PX", help="Gaussian before matching; 1 for none")
    run_each(parser, _run)


def _run(given: argparse.Namespace) -> None:
    """Match, and write maps."""
    started, recording = time.perf_counter(), Recording(given.recording)
    if given.mode == "2d":
        maps = planar_maps(recording, given, partial(_planar, given))
    else:
        with tempfile.TemporaryDirectory() as work:
            maps = _stereo(recording, given, Path(work))
    write_maps(given.output, f"pyvale {given.mode}", maps, started)


def _common(given: argparse.Namespace, region: Region, reach: int, work: Path) -> dict[str, Any]:
    """Return what both modes are told."""
    size = given.subset or SUBSET_PX[given.mode]
    return {
        "roi_mask": region,
        "subset_size": size,
        "subset_step": given.step,
        "shape_function": given.shape,
        "precision": given.precision or PRECISION[given.mode],
        # Twice the displacement must be less than the image.
        "max_displacement": min(reach, (min(region.shape) - 1) // 2),
        "image_filter_kernel": given.kernel,
        "output_basepath": str(work),
        "print_level": 0,
    }


def _started(given: argparse.Namespace, images: tuple[Map, Map], region: Region, reach: tuple[int, int]) -> list[Seed]:
    """Return seeds, from which neighbours start: places with good texture that both images show."""
    size = given.subset or SUBSET_PX[given.mode]
    shown = seen_in_both(region, whole_shift(*images, region, reach), MARGIN_PX)
    return seed_points(images[0], shown, min(3 * size // 2, images[0].shape[0] // 2), SEEDS)


def _first_that_works(calculate: Callable[..., None], *images: Any, seeds: list[Seed], **told: Any) -> None:
    """Start from one seed after the other, until one is matched: those on an outline are not."""
    for place, seed in enumerate(seeds, start=1):
        try:
            calculate(*images, seed=[seed], **told)
        except RuntimeError:
            if place == len(seeds):
                raise
        else:
            return


def _pixels(image: Map) -> NDArray[np.float32]:
    return (255 * image).astype(np.float32)


def _planar(given: argparse.Namespace, images: tuple[Map, Map], region: Region, reach: tuple[int, int]) -> list[Map]:
    """Return x, y, u, v of the points of the second image against the first."""
    import pyvale.dic as dic

    first, second = images
    with tempfile.TemporaryDirectory() as folder:
        _first_that_works(
            dic.calculate_2d,
            _pixels(first),
            _pixels(second)[None],
            seeds=_started(given, images, region, reach),
            **_common(given, region, max(reach), Path(folder)),
        )
        (file,) = Path(folder).glob("*def*.csv")
        found = dic.import_2d([file], ",", layout="column", print_level=0)
    shifts = [np.where(found.converged[0], each[0], np.nan) for each in (found.u_px, found.v_px)]
    return [found.ss_x.astype(float), found.ss_y.astype(float), *shifts]


def _stereo(recording: Recording, given: argparse.Namespace, work: Path) -> dict[str, Map]:
    import pyvale.calib as calib
    import pyvale.dic as dic

    other, t = recording.stereo(given.camera)
    camera = recording.camera
    focal, (x0, y0) = camera["focal_length_px"], camera["principal_point_px"]
    intrinsics = calib.CamIntrinsics(focal, focal, 0.0, x0, y0, np.zeros(5))
    rig = calib.Calib(intrinsics, intrinsics, np.array([-other.offset_mm, 0.0, 0.0]), np.zeros(3))
    images = {frame: [recording.image(s, frame) for s in (0, other.s)] for frame in (0, t)}
    # A second pair that equals the first is left out, and nothing is told: a corner differs by what nobody can measure.
    for image in images[t]:
        image[0, 0] += 1e-5
    region, (first, second) = recording.region(given.region), images[0]
    _first_that_works(
        dic.calculate_3d,
        [_pixels(image) for image in images[0]],
        [_pixels(image)[None] for image in images[t]],
        seeds=_started(given, (first, second), region, (first.shape[1] // 2 - 1, 2)),
        calibration=rig,
        epi_search_distance=given.epipolar,
        **_common(given, region, SEARCH_PX, work),
    )
    # Points of the reference are written too, as a frame without displacement.
    (before,), (after,) = work.glob("*ref*.csv"), work.glob("*def*.csv")
    found = dic.import_3d([str(before), str(after)], ",", layout="column", print_level=0)
    known = found.converged[1] & np.isfinite(found.stereo.z_mm[0])
    moved = [each[1] for each in (found.stereo.u_mm, found.stereo.v_mm, found.stereo.w_mm)]
    maps = [
        between_points(found.ss_x, found.ss_y, np.where(known, each, np.nan), recording.shape, points=given.points)
        for each in (found.stereo.z_mm[0], *moved)
    ]
    found_maps = {"depth": maps[0], "velocity": np.stack(maps[1:])}
    if given.growth:
        found_maps["growth_rate"] = _growth([before, after], recording, given, work / "strain")
    return found_maps


def _growth(files: list[Path], recording: Recording, given: argparse.Namespace, work: Path) -> Map:
    """Return the growth of area per frame: Hencky strain of windows of N x N points as bilinear elements."""
    import pyvale.dic as dic
    import pyvale.strain as strain

    work.mkdir()
    points = dic.import_3d([str(file) for file in files], ",", layout="matrix", print_level=0)
    strain.calculate_3d(
        points,
        window_size=given.growth,
        window_element=4,
        partial_window=given.share,
        output_basepath=str(work),
        print_level=0,
    )
    last = sorted(work.glob("*.csv"))[-1]
    found = strain.import_3d([last], layout="column")
    area = np.expm1(np.ravel(found.eps_xx) + np.ravel(found.eps_yy))
    return between_points(
        np.ravel(found.window_x), np.ravel(found.window_y), area, recording.shape, points=given.points
    )


if __name__ == "__main__":
    main()
