"""Finite-element image correlation of pyxel: ``python run_pyxel.py RECORDING OUTPUT``, in its own environment.

Two images at a time: flow from the reference to the next frame, disparity from the reference camera to another.
Quadrilaterals of 24 px, cubic splines, started at coarser scales and with the shift of the whole image, solved
directly, without regularisation in the last step. Nodes on the outline of the mesh are left out.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import time
from functools import partial

import numpy as np
from folder import (
    Map,
    Recording,
    Region,
    arguments,
    largest_box,
    planar_maps,
    run_each,
    seen_in_both,
    whole_shift,
    write_maps,
)

# How far the mesh stays within both images.
MARGIN_PX = 3


def main() -> None:
    """Match, and write maps."""
    parser = arguments(__doc__)
    parser.add_argument("--element", type=int, default=24, metavar="PX", help="side of an element")
    parser.add_argument("--rectangle", action="store_true", help="one rectangle, the largest within the region")
    run_each(parser, _run)


def _run(given: argparse.Namespace) -> None:
    """Match, and write maps."""
    started, recording = time.perf_counter(), Recording(given.recording)
    with open(os.devnull, "w") as nothing, contextlib.redirect_stdout(nothing):
        maps = planar_maps(recording, given, partial(_matched, given))
    write_maps(given.output, "pyxel", maps, started)


def _matched(given: argparse.Namespace, images: tuple[Map, Map], region: Region, reach: tuple[int, int]) -> list[Map]:
    """Return x, y, u, v of the inner nodes of the second image against the first."""
    import pyxel

    shift = whole_shift(*images, region, reach)
    pair = [pyxel.Image("pixels"), pyxel.Image("pixels")]
    for image, values in zip(pair, images, strict=True):
        # Its own stopping rules count in grey values of 8 bits.
        image.pix = 255 * values
    region, side = seen_in_both(region, shift, MARGIN_PX), given.element
    rows, columns = np.nonzero(region)
    left, top = int(columns.min()), int(rows.min())
    across, down = (int(columns.max()) - left) // side, (int(rows.max()) - top) // side
    box = np.array([[left, top], [left + across * side, top + down * side]])
    if given.rectangle:
        left, right, top, bottom = largest_box(region, side)
        box = np.array([[left, top], [right, bottom]])
    mesh, camera = pyxel.MeshFromROI(box, side, 3)
    (kind,) = mesh.e
    x, y = (np.rint(each).astype(int) for each in camera.P(mesh.n[:, 0], mesh.n[:, 1]))
    inside = region[y, x][mesh.e[kind]].all(axis=1)
    mesh.e[kind] = mesh.e[kind][inside]
    count = np.bincount(mesh.e[kind].ravel(), minlength=len(mesh.n))
    used = np.flatnonzero(count)
    renumbered = np.full(len(mesh.n), -1)
    renumbered[used] = np.arange(used.size)
    mesh.n, mesh.e[kind], inner = mesh.n[used], renumbered[mesh.e[kind]], count[used] == 4
    mesh.Connectivity()
    first = np.stack(camera.P(mesh.n[:, 0], mesh.n[:, 1]))
    start = np.zeros(mesh.ndof)
    start[mesh.conn[: len(mesh.n)]] = np.stack(camera.Pinv(*(first + np.array(shift)[:, None])), axis=-1) - mesh.n
    start = pyxel.MultiscaleInit(*pair, mesh, camera, scales=[3, 2, 1], U0=start, disp=False)
    found, _ = pyxel.Correlate(*pair, mesh, camera, U0=start, direct=True, disp=False)
    moved = mesh.n + found[mesh.conn[: len(mesh.n)]]
    second = np.stack(camera.P(moved[:, 0], moved[:, 1]))
    return [each[inner] for each in (*first, *(second - first))]


if __name__ == "__main__":
    main()
