"""Runs a program of `benchmarks.peers` with several settings: ``python rows.py JOBS.json``, in its own environment.

JOBS.json: ``program``, the name of its module in benchmarks/peers/programs; ``jobs``, a list of ``images`` (.npy of two
images of 8 bits), ``output`` (.npy of the rows), ``size`` and ``shape``, and ``rows``: how many rows above and below
the centre row are matched as well. One process, because importing a program takes longer than matching a row.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import traceback
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

PROGRAMS = Path(__file__).parents[1] / "peers" / "programs"
MESHES = ("run_pyxel", "run_mudic")
OF_CENTRES = ("run_sun_dic",)
SEED_COLUMN = 3500
REACH_PX = 16

Row = NDArray[np.float64]


def region_of(program: str, shape: tuple[int, int], size: int, more: int = 0) -> NDArray[np.bool_]:
    """Return the pixels that a program sees: a band of one subset and more rows, or all rows for meshes.

    Subsets must lie within the region, so that a band of their size leaves the centre row alone; SUN-DIC asks for their
    centres. pyvale starts at a point within a larger square, which is added where the periods are long, as its
    documentation advises.
    """
    region = np.ones(shape, bool)
    if program in MESHES:
        return region
    centre = shape[0] // 2
    region[:] = False
    half = more if program in OF_CENTRES else size // 2 + more
    region[centre - half : centre + half + 1] = True
    if program == "run_pyvale":
        half = size + more
        region[max(0, centre - half) : centre + half + 1, SEED_COLUMN - size : SEED_COLUMN + size + 1] = True
    return region


def row_of(points: list[Row], shape: tuple[int, int], *, mesh: bool, below: int = 0) -> Row:
    """Return the displacement along y in the centre row, or in a row below it, of points x, y, u, v.

    Between the nodes of a mesh of rectangles with four nodes, displacements are linear along x and y.
    """
    x, y, _, v = points
    known = np.isfinite(v)
    x, y, v = x[known], y[known], v[known]
    centre, columns = shape[0] // 2 + below, np.arange(shape[1], dtype=np.float64)
    row = np.full(shape[1], np.nan)
    if not mesh:
        inside = np.rint(y) == centre
        row[np.rint(x[inside]).astype(int)] = v[inside]
        return row
    lines = np.unique(np.rint(y))
    if not lines.size or lines[0] > centre or lines[-1] < centre:
        return row
    upper, lower = lines[lines <= centre][-1], lines[lines >= centre][0]
    ends = []
    for line in (upper, lower):
        inside = np.flatnonzero(np.rint(y) == line)
        inside = inside[np.argsort(x[inside])]
        ends.append(np.interp(columns, x[inside], v[inside], left=np.nan, right=np.nan))
    share = 0.0 if upper == lower else (centre - upper) / (lower - upper)
    return np.asarray((1 - share) * ends[0] + share * ends[1])


def main() -> None:
    """Match all jobs, and write a row of each; one that fails is named and omitted."""
    spec: dict[str, Any] = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    program = spec["program"]
    sys.path.insert(0, str(PROGRAMS))
    module = importlib.import_module(program)
    match = module._planar if program == "run_pyvale" else module._matched
    for job in spec["jobs"]:
        first, second = (each.astype(np.float64) / 255 for each in np.load(job["images"]))
        size, more = int(job["size"]), int(job["rows"])
        given = argparse.Namespace(
            mode="2d", subset=size, step=1, shape=job["shape"], precision=1e-5, kernel=5, order=5,
            element=size, rectangle=False, region="given", points=True,
        )  # fmt: skip
        region = region_of(program, first.shape, size, more)
        try:
            points = match(given, (first, second), region, (REACH_PX, REACH_PX))
        except (Exception, SystemExit):
            print(job["output"], traceback.format_exc()[-600:], file=sys.stderr, flush=True)
            continue
        points = [np.asarray(each, dtype=np.float64).ravel() for each in points]
        mesh = program in MESHES
        found = [row_of(points, first.shape, mesh=mesh, below=below) for below in range(-more, more + 1)]
        part = Path(job["output"]).with_suffix(".part.npy")
        np.save(part, np.array(found) if more else found[0])
        part.replace(job["output"])


if __name__ == "__main__":
    main()
