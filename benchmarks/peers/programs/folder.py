"""What the programs of all peers share: images and camera.json of a recording, and maps that are made of points.

It needs NumPy alone (Pillow for images in PNG), so that it works in the environment of every peer.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "SEARCH_PX",
    "Camera",
    "Map",
    "Recording",
    "Region",
    "arguments",
    "between_points",
    "largest_box",
    "planar_maps",
    "run_each",
    "save_images",
    "save_region",
    "seed_points",
    "seen_in_both",
    "whole_shift",
    "write_maps",
]

Map = NDArray[np.float64]
Region = NDArray[np.bool_]
Match = Callable[[tuple[Map, Map], Region, tuple[int, int]], Sequence[Map]]

SEARCH_PX = 64
"""How far points are looked for from frame to frame."""


@dataclass(frozen=True)
class Camera:
    """A camera of a pair beside the reference.

    Parameters
    ----------
    s
        Its number.
    offset_mm
        Where it stands along X, seen from the reference camera.
    """

    s: int
    offset_mm: float


class Recording:
    """A recording as it is handed to a program.

    Parameters
    ----------
    folder
        The folder.
    """

    def __init__(self, folder: str) -> None:
        self._folder = Path(folder)
        self.camera: dict[str, Any] = json.loads((self._folder / "camera.json").read_text(encoding="utf-8"))
        self.shape: tuple[int, int] = (self.camera["height_px"], self.camera["width_px"])
        self._all = (
            np.load(self._folder / "images.npy", mmap_mode="r") if self.camera["image_format"] == "npy" else None
        )

    def image(self, s: int, t: int) -> Map:
        """Return the values of an image, of full scale 1."""
        if self._all is None:
            from PIL import Image

            numbers = np.asarray(Image.open(self._folder / self.camera["image_files"].format(s=s, t=t)))
        else:
            numbers = self._all[self.camera["s"].index(s), self.camera["t"].index(t)]
        numbers = numbers.astype(np.float64).reshape(*self.shape, -1).mean(axis=-1)
        values = self.camera["image_offset"] + self.camera["image_scale"] * numbers
        return np.asarray(values / self.camera["full_scale"])

    def region(self, file: str | None) -> Region:
        """Return the pixels of the reference image that are looked at: those of a file, or all."""
        return np.ones(self.shape, bool) if file is None else np.asarray(np.load(file) != 0)

    def stereo(self, s: int | None) -> tuple[Camera, int]:
        """Return the other camera and the next frame, as stereo correlation needs them.

        Raises
        ------
        SystemExit
            If there are none, or the lens distorts, which is not handed on.
        """
        other, t = self.other(s), self.next_frame()
        if other is None or t is None:
            raise SystemExit("stereo correlation needs two cameras and two frames")
        if any(self.camera["distortion_k1_k2_p1_p2_k3_k4_k5_k6"]):
            raise SystemExit("the distortion of the lens is not handed on: give images of a pinhole")
        return other, t

    def next_frame(self) -> int | None:
        """Return the frame after the reference; None if there is none."""
        return 1 if 1 in self.camera["t"] else None

    def other(self, s: int | None) -> Camera | None:
        """Return the camera that is matched with the reference: the outermost on the right, if none is chosen.

        Where there is none on the right, it is the outermost on the left; None if there is no other.
        """
        places = dict(zip(self.camera["s"], self.camera["stage_x_mm"], strict=True))
        others = {one: x - places[0] for one, x in places.items() if one != 0}
        if not others:
            return None
        chosen = max(others, key=lambda one: (others[one] > 0, abs(others[one]))) if s is None else s
        return Camera(chosen, others[chosen])


def save_region(region: Region, file: Path) -> Path:
    """Write a region as an image of 0 and 255; return the file."""
    from PIL import Image

    Image.fromarray(np.where(region, 255, 0).astype(np.uint8)).save(file)
    return file


def save_images(images: list[Map], folder: Path, stem: str) -> list[Path]:
    """Write images as 16-bit PNG, spread alike from the least to the largest value of all; return the files."""
    from PIL import Image

    low, high = min(one.min() for one in images), max(one.max() for one in images)
    files = [folder / f"{stem}{number}.png" for number in range(len(images))]
    for file, one in zip(files, images, strict=True):
        scaled = (one - low) * (65535 / max(high - low, 1e-12))
        Image.fromarray(np.rint(scaled).astype(np.uint16)).save(file)
    return files


def whole_shift(first: Map, second: Map, region: Region, reach: tuple[int, int]) -> tuple[int, int]:
    """Return (dx, dy) in px by which the region of an image is shifted as a whole in another one.

    The largest zero-mean normalised correlation, over whole pixels, up to ``reach`` = (along x, along y).
    """
    height, width = first.shape
    size = (2 * height, 2 * width)
    mask = region.astype(np.float64)
    template = np.where(region, first - first[region].mean(), 0.0)

    def matched(small: Map, large: Map) -> Map:
        found = np.fft.irfft2(np.conj(np.fft.rfft2(small, size)) * np.fft.rfft2(large, size), size)
        rows, columns = (np.arange(-reach[1], reach[1] + 1), np.arange(-reach[0], reach[0] + 1))
        return np.asarray(found[np.ix_(rows, columns)])

    centred = second - second.mean()
    seen = np.maximum(matched(mask, np.ones_like(second)), 1.0)
    spread = matched(mask, centred**2) - matched(mask, centred) ** 2 / seen
    # What lies outside the image correlates with nothing.
    score = matched(template, centred) / np.sqrt(np.maximum(spread, 1e-9 * spread.max()))
    score[seen < 0.5 * mask.sum()] = -np.inf
    dy, dx = np.unravel_index(int(np.argmax(score)), score.shape)
    return int(dx) - reach[0], int(dy) - reach[1]


def seen_in_both(region: Region, shift: tuple[int, int], margin: int) -> Region:
    """Return the pixels of a region that are so far within both images, when the second is shifted by (dx, dy)."""
    height, width = region.shape
    inside = np.zeros_like(region)
    left, top = (margin + max(0, -one) for one in shift)
    right, bottom = width - margin - max(0, shift[0]), height - margin - max(0, shift[1])
    inside[top:bottom, left:right] = True
    return region & inside


def seed_points(image: Map, region: Region, side: int, count: int) -> list[tuple[int, int]]:
    """Return columns and rows of the middles of squares within a region, those with the strongest gradients first.

    They are a side apart; there are fewer than ``count`` if the region is small.
    """
    down, right = np.gradient(image)
    strength = _box_sums(np.minimum(down**2, right**2), side)
    # Where a region is smaller than a square, what fills most of it will do.
    share = _box_sums(region.astype(np.float64), side)
    strength[share < share.max()] = -1.0
    found: list[tuple[int, int]] = []
    while len(found) < count and (not found or strength.max() >= 0):
        row, column = (int(place) for place in np.unravel_index(int(np.argmax(strength)), strength.shape))
        found.append((column + side // 2, row + side // 2))
        strength[max(0, row - side) : row + side, max(0, column - side) : column + side] = -1.0
    return found


def largest_box(region: Region, step: int) -> tuple[int, int, int, int]:
    """Return first and last column, first and last row of the largest box of whole cells within a region.

    Cells have a side of ``step`` px; a box of them is as many steps wide and high.
    """
    height, width = region.shape
    best, found = 0, (0, 0, 0, 0)
    for left in range(0, width - step, max(1, step // 6)):
        for top in range(0, height - step, max(1, step // 6)):
            across = (width - 1 - left) // step
            for down in range(1, (height - 1 - top) // step + 1):
                strip = region[top : top + down * step + 1, left : left + across * step + 1].all(axis=0)
                gaps = np.flatnonzero(~strip)
                across = (int(gaps[0]) - 1) // step if gaps.size else across
                if across < 1:
                    break
                if across * down > best:
                    best, found = across * down, (left, left + across * step, top, top + down * step)
    return found


def _box_sums(values: Map, side: int) -> Map:
    """Return the sums over all squares of a side, at their first pixels."""
    sums = np.pad(np.cumsum(np.cumsum(values, axis=0), axis=1), ((1, 0), (1, 0)))
    return np.asarray(sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side])


def arguments(description: str | None) -> argparse.ArgumentParser:
    """Return a parser of what all programs take."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", nargs="?", help="folder of images and camera.json")
    parser.add_argument("output", nargs="?", help="folder of results")
    parser.add_argument("--batch", metavar="FILE", help="JSON list of [recording, output]: all in one process")
    parser.add_argument("--camera", type=int, metavar="S", help="the camera that is matched with the reference")
    parser.add_argument(
        "--region", metavar="FILE", help="array of the pixels to look at (.npy, not 0); all if not given"
    )
    parser.add_argument("--points", action="store_true", help="tell the peer's own points alone, nothing between them")
    return parser


def run_each(parser: argparse.ArgumentParser, run: Callable[[argparse.Namespace], None]) -> None:
    """Run on the recording, or on every recording of a batch.

    In a batch, an error goes into ``further/error.txt`` of its output and the next recording follows; every output has
    ``further/cost.json``: processor time in s, and the peak memory of the process so far in MB.
    """
    given = parser.parse_args()
    if given.batch is None:
        if given.output is None:
            parser.error("needs RECORDING and OUTPUT, or --batch FILE")
        run(given)
        return
    for recording, output in json.loads(Path(given.batch).read_text(encoding="utf-8")):
        further = Path(output) / "further"
        further.mkdir(parents=True, exist_ok=True)
        started = _processor_s()
        try:
            run(argparse.Namespace(**{**vars(given), "recording": recording, "output": output}))
        except (Exception, SystemExit):
            (further / "error.txt").write_text(traceback.format_exc(limit=-2), encoding="utf-8")
        users = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        memory = max(resource.getrusage(who).ru_maxrss for who in users) / 1024
        cost = {"processor_s": _processor_s() - started, "memory_mb": memory}
        (further / "cost.json").write_text(json.dumps(cost), encoding="utf-8")


def _processor_s() -> float:
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in both)


def planar_maps(recording: Recording, given: argparse.Namespace, match: Match) -> dict[str, Map]:
    """Return flow to the next frame, and disparity to another camera, where there are such, by matching two images.

    Parameters
    ----------
    recording
        The recording.
    given
        What `arguments` parsed.
    match
        Takes two images, the region of the first, and how far the second may be shifted along x and y; returns columns
        and rows of points, and their shifts along x and y.
    """
    (height, width), region, first = recording.shape, recording.region(given.region), recording.image(0, 0)
    maps = {}
    if (t := recording.next_frame()) is not None:
        reach = min(SEARCH_PX, height // 2 - 1, width // 2 - 1)
        x, y, *shifts = match((first, recording.image(0, t)), region, (reach, reach))
        made = [between_points(x, y, one, recording.shape, points=given.points) for one in shifts]
        maps["flow"] = np.stack(made)
    if (other := recording.other(given.camera)) is not None:
        x, y, along, _ = match((first, recording.image(other.s, 0)), region, (width // 2 - 1, 2))
        # To the left for a camera on the right: px per step of s.
        per_step = -recording.camera["baseline_mm"] / other.offset_mm
        maps["disparity"] = between_points(x, y, per_step * along, recording.shape, points=given.points)
    return maps


def between_points(x: Map, y: Map, values: Map, shape: tuple[int, int], *, points: bool = False) -> Map:
    """Return a map of values that are known at the points of a grid: linear between four neighbours that are known.

    Parameters
    ----------
    x, y
        Columns and rows of the points, which lie on a grid with equal steps; shape (n,).
    values
        Values there; NaN is unknown.
    shape
        Height and width of the map.
    points
        Whether to tell the pixels of the points alone.
    """
    known = np.isfinite(values) & np.isfinite(x) & np.isfinite(y)
    x, y, values = x[known], y[known], values[known]
    found = np.full(shape, np.nan)
    if not values.size:
        return found
    columns, rows = np.unique(x), np.unique(y)
    if points:
        found[np.rint(y).astype(int), np.rint(x).astype(int)] = values
        return found
    grid = np.full((rows.size, columns.size), np.nan)
    grid[np.searchsorted(rows, y), np.searchsorted(columns, x)] = values
    return _along(_along(grid, columns, shape[1]).T, rows, shape[0]).T


def _along(grid: Map, places: Map, length: int) -> Map:
    """Interpolate linearly along the last axis between neighbours."""
    found = np.full((grid.shape[0], length), np.nan)
    if places.size < 2:
        return found
    step = float(np.min(np.diff(places)))
    wanted = np.arange(length)
    before = np.clip(np.searchsorted(places, wanted, side="right") - 1, 0, places.size - 2)
    gap = places[before + 1] - places[before]
    share = (wanted - places[before]) / gap
    # A grid line without any point is a gap: nothing is told across it.
    inside = (share >= 0) & (share <= 1) & (gap <= 1.5 * step)
    low, high = grid[:, before[inside]], grid[:, before[inside] + 1]
    part = share[inside]
    with np.errstate(invalid="ignore"):
        found[:, inside] = np.where(part == 0, low, np.where(part == 1, high, (1 - part) * low + part * high))
    return found


def write_maps(output: str, method: str, maps: dict[str, Map], started: float) -> None:
    """Write maps of the reference frame, and print how long all took.

    What is no quantity of results goes into a folder ``further``, which is left alone by who reads results.
    """
    for name, values in maps.items():
        place = Path(output) if name in ("depth", "disparity", "flow", "velocity") else Path(output) / "further"
        place.mkdir(exist_ok=True)
        np.save(place / f"{name}_t+0.npy", values.astype(np.float32))
    (Path(output) / "results.json").write_text(json.dumps({"method": method}), encoding="utf-8")
    print(f"{method}: {time.perf_counter() - started:.2f} s for {', '.join(maps)}", file=sys.stderr)
