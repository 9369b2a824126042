"""Image correlation of SUN-DIC: ``python run_sun_dic.py RECORDING OUTPUT``, in its own environment.

Two images at a time: flow from the reference to the next frame, disparity from the reference camera to another. Subsets
of 29 px every 5 px, affine, quintic splines, inverse compositional Gauss-Newton, its own start from matched features.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
from folder import Map, Recording, Region, arguments, planar_maps, run_each, save_images, save_region, write_maps


def main() -> None:
    """Match, and write maps."""
    # Its parallel loops are over single subsets: threads cost more than they bring.
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    parser = arguments(__doc__)
    parser.add_argument("--subset", type=int, default=29, metavar="PX", help="side of a subset, odd")
    parser.add_argument("--step", type=int, default=5, metavar="PX", help="distance of two subsets")
    parser.add_argument("--shape", choices=("Affine", "Quadratic"), default="Affine", help="shape function")
    parser.add_argument("--order", type=int, choices=(3, 5), default=5, help="of the splines")
    run_each(parser, _run)


def _run(given: argparse.Namespace) -> None:
    """Match, and write maps."""
    started, recording = time.perf_counter(), Recording(given.recording)
    maps = planar_maps(recording, given, partial(_matched, given))
    write_maps(given.output, "sun-dic", maps, started)


def _matched(given: argparse.Namespace, images: tuple[Map, Map], region: Region, reach: tuple[int, int]) -> list[Map]:
    """Return x, y, u, v of the points of the second image against the first."""
    from sundic.settings import Settings
    from sundic.sundic import CompID, planarDICLocal

    settings, half = Settings(), given.subset // 2
    rows, columns = np.nonzero(region)
    height, width = region.shape
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("images").mkdir()
        save_images(list(images), Path("images"), "image")
        if given.region:
            settings.MaskFile = str(save_region(region, Path(folder) / "mask.png"))
        settings.ImageFolder = "images"
        settings.DebugLevel = 0
        settings.CPUCount = 1
        settings.SubsetSize, settings.StepSize = given.subset, given.step
        settings.ShapeFunctions = given.shape
        settings.InterpolationOrder = given.order
        settings.ReferenceStrategy = "Absolute"
        settings.BackgroundCutoff = 0
        settings.DatumImage, settings.TargetImage, settings.Increment = 0, 1, 1
        # Whole subsets alone.
        left, top = max(int(columns.min()), half), max(int(rows.min()), half)
        right, bottom = min(int(columns.max()), width - 1 - half), min(int(rows.max()), height - 1 - half)
        settings.ROI = [left, top, right - left + 1, bottom - top + 1]
        with open(os.devnull, "w") as nothing, contextlib.redirect_stdout(nothing):
            found = planarDICLocal(settings, "results.sdic")[0]
    # What leaves the second image has been matched with what is beyond its border.
    ends = [
        found[..., CompID.XCoordID] + found[..., CompID.XDispID],
        found[..., CompID.YCoordID] + found[..., CompID.YDispID],
    ]
    beyond = (ends[0] < half) | (ends[0] > width - 1 - half) | (ends[1] < half) | (ends[1] > height - 1 - half)
    found[beyond, CompID.XDispID] = np.nan
    parts = (CompID.XCoordID, CompID.YCoordID, CompID.XDispID, CompID.YDispID)
    return [np.asarray(found[..., part], dtype=np.float64).ravel() for part in parts]


if __name__ == "__main__":
    main()
