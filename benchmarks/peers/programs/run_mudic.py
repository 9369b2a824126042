"""Finite-element image correlation of muDIC: ``python run_mudic.py RECORDING OUTPUT``, in its own environment.

Two images at a time: flow from the reference to the next frame, disparity from the reference camera to another. One
rectangle of quadrilaterals of 24 px, the largest within the region, cubic splines, started with the shift of the whole
image. Nodes on the outline of the rectangle are left out.
"""

from __future__ import annotations

import argparse
import logging
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

# What it cuts out around the mesh, which must lie within both images.
PAD_PX = 10


def main() -> None:
    """Match, and write maps."""
    parser = arguments(__doc__)
    parser.add_argument("--element", type=int, default=24, metavar="PX", help="side of an element")
    run_each(parser, _run)


def _run(given: argparse.Namespace) -> None:
    """Match, and write maps."""
    started, recording = time.perf_counter(), Recording(given.recording)
    maps = planar_maps(recording, given, partial(_matched, given))
    write_maps(given.output, "muDIC", maps, started)


def _matched(given: argparse.Namespace, images: tuple[Map, Map], region: Region, reach: tuple[int, int]) -> list[Map]:
    """Return x, y, u, v of the inner nodes of the second image against the first."""
    import muDIC

    shift = whole_shift(*images, region, reach)
    logging.getLogger().setLevel(logging.WARNING)
    stack = muDIC.image_stack_from_list([255 * one for one in images])
    side = given.element
    left, right, top, bottom = largest_box(seen_in_both(region, shift, PAD_PX + 3), side)
    if right - left < 2 * side or bottom - top < 2 * side:
        raise SystemExit("no rectangle of elements fits into both images")
    cells = ((right - left) // side, (bottom - top) // side)
    mesh = muDIC.Mesher(type="q4").mesh(
        stack, float(left), float(right), float(top), float(bottom), cells[0], cells[1], GUI=False
    )
    nodes = np.array([mesh.xnodes, mesh.ynodes])
    start = np.stack([nodes, nodes + np.array(shift)[:, None]], axis=-1)
    wanted = muDIC.DICInput(mesh, stack, ref_update_frames=[], maxit=60, pad=PAD_PX, node_hist=list(start))
    found = muDIC.DICAnalysis(wanted).run()
    moved = np.array([found.xnodesT[:, 1], found.ynodesT[:, 1]]) - nodes
    x, y = nodes
    inner = (x > x.min()) & (x < x.max()) & (y > y.min()) & (y < y.max())
    return [each[inner] for each in (x, y, *moved)]


if __name__ == "__main__":
    main()
