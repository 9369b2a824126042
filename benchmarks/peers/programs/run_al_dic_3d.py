"""Stereo correlation of al-dic-3d: ``python run_al_dic_3d.py RECORDING OUTPUT``, in its own environment.

Both cameras and both frames together: depth, and velocity of the points. Windows of 28 px every 8 px, matched between
the cameras in each frame (``stereo_each_frame``), with the global step of the augmented Lagrangian. It is started with
the shift of the whole image from one camera to the other.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from folder import Recording, arguments, between_points, run_each, save_images, save_region, whole_shift, write_maps

MARGIN_PX = 4


def main() -> None:
    """Match, and write maps."""
    parser = arguments(__doc__)
    parser.add_argument("--window", type=int, default=28, metavar="PX", help="side of a window, even")
    parser.add_argument("--step", type=int, default=8, metavar="PX", help="distance of two windows")
    parser.add_argument("--strategy", default="stereo_each_frame", help="stereo_each_frame, track_both or ref_direct")
    parser.add_argument("--search", type=int, default=10, metavar="PX", help="largest displacement of two frames")
    parser.add_argument("--stereo-search", type=int, default=48, metavar="PX", help="around the shift of the image")
    parser.add_argument("--growth", type=int, metavar="N", help="growth of area over N x N points, N odd")
    parser.add_argument("--all", action="store_true", help="keep also what its own quality gates leave out")
    parser.add_argument("--local", action="store_true", help="without the global step")
    run_each(parser, _run)


def _run(given: argparse.Namespace) -> None:
    """Match, and write maps."""
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    from al_dic_3d.calibration import CameraIntrinsics, StereoRig, to_opencv_yaml
    from al_dic_3d.runner import RunConfig, run_pipeline

    started, recording = time.perf_counter(), Recording(given.recording)
    other, t = recording.stereo(given.camera)
    camera, (height, width) = recording.camera, recording.shape
    lens = CameraIntrinsics(
        fx=camera["focal_length_px"],
        fy=camera["focal_length_px"],
        cx=camera["principal_point_px"][0],
        cy=camera["principal_point_px"][1],
        width=width,
        height=height,
    )
    translation = np.array([-other.offset_mm, 0.0, 0.0])
    rig = StereoRig(cameras={"L": lens, "R": lens}, extrinsics={("L", "R"): (np.eye(3), translation)})
    images = {s: [recording.image(s, frame) for frame in (0, t)] for s in (0, other.s)}
    region = recording.region(given.region)
    start = whole_shift(images[0][0], images[other.s][0], region, (width // 2, 2))
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        files = save_images([*images[0], *images[other.s]], work, "image")
        # Both cameras' files have the same names.
        for place, stem in enumerate(("L0", "L1", "R0", "R1")):
            files[place] = files[place].rename(work / f"{stem}.png")
        mask = save_region(region, work / "mask.png") if given.region else None
        rows, columns = np.nonzero(region)
        inset = 0 if given.region else MARGIN_PX + given.window // 2
        result = run_pipeline(
            RunConfig(
                calibration_file=to_opencv_yaml(rig, work / "rig.yaml"),
                calibration_format="opencv_yaml",
                left=[str(file) for file in files[:2]],
                right=[str(file) for file in files[2:]],
                roi=(
                    int(columns.min()) + inset,
                    int(columns.max()) - inset,
                    int(rows.min()) + inset,
                    int(rows.max()) - inset,
                ),
                roi_mask=mask,
                output_dir=work / "results",
                strategy=given.strategy,
                winsize=given.window,
                winstepsize=given.step,
                use_global_step=not given.local,
                fft_search=given.search,
                compute_strain=bool(given.growth),
                strain_size=given.growth or 5,
                quality_gate=not given.all,
                stereo_search=given.stereo_search,
                disparity_offset=(float(start[0]), float(start[1])),
            )
        )
    x, y = result.ref_coords.T
    maps = [
        between_points(x, y, each, recording.shape, points=given.points)
        for each in (result.reconstruction.points[0, :, 2], *result.reconstruction.displacement[1].T)
    ]
    found = {"depth": maps[0], "velocity": np.stack(maps[1:])}
    if given.growth:
        # Green-Lagrange strain in the tangent plane: the area of the deformed unit square.
        exx, eyy, exy = (each[1] for each in (result.strain.exx, result.strain.eyy, result.strain.exy))
        area = np.sqrt((1 + 2 * exx) * (1 + 2 * eyy) - 4 * exy**2) - 1
        found["growth_rate"] = between_points(x, y, area, recording.shape, points=given.points)
    write_maps(given.output, "al-dic-3d", found, started)


if __name__ == "__main__":
    main()
