"""A program that knows nothing of scenetruth: block matching with NumPy alone, as ``python program.py IN OUT``."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from numpy.typing import NDArray

Map = NDArray[np.float64]

LARGEST_PX = 8
RADIUS_PX = 3


def matched(left: Map, right: Map) -> Map:
    """Return the shift in px at which blocks around every pixel of the left image suit the right one best."""
    costs = np.full((LARGEST_PX + 1, *left.shape), np.inf)
    for shift in range(1, LARGEST_PX + 1):
        costs[shift, :, shift:] = block_sums(np.abs(left[:, shift:] - right[:, :-shift]))
    best: Map = costs.argmin(axis=0).astype(np.float64)
    best[:, :LARGEST_PX] = np.nan
    return best


def block_sums(values: Map) -> Map:
    """Return the sums over squares around every pixel."""
    size = 2 * RADIUS_PX + 1
    for axis in (0, 1):
        padded = np.pad(values, [(RADIUS_PX + 1, RADIUS_PX) if n == axis else (0, 0) for n in (0, 1)], mode="edge")
        total = padded.cumsum(axis=axis)
        last = total.take(range(size, total.shape[axis]), axis=axis)
        values = last - total.take(range(total.shape[axis] - size), axis=axis)
    return values


def main(recording: Path, output: Path) -> None:
    camera = json.loads((recording / "camera.json").read_text())
    found = []
    for t in camera["estimate_t"]:
        left, right = (imageio.imread(recording / f"s{s:+d}_t{t:+d}.png").astype(np.float64) for s in (0, 1))
        scale, offset = camera["image_scale"], camera["image_offset"]
        found.append(matched(offset + scale * left, offset + scale * right))
    np.save(output / "disparity.npy", np.array(found, dtype=np.float32))
    # Memory is measured some ten times a second: on a loaded machine, a shorter life may pass unseen.
    time.sleep(0.5)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
