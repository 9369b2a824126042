"""What the methods for depth make of stand-ins for real captures, beside OpenCV's matchers at their best settings.

Run it from the top of the repository: ``python -m benchmarks.stand_ins``, or with names: ``... bars painted``;
``--held-out`` takes the sets that are held out instead of all others.
Bad is a pixel whose disparity is off by more than 0.25 px per step, or has no estimate.
"""

from __future__ import annotations

import json
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from benchmarks.stand_in_scenes import SCENES, UNTEXTURED, scene_of
from benchmarks.stand_in_sets import list_sets

BAD_PX = 0.25
# Pixels up to this far from edges are beside an outline.
OUTLINE_PX = 5
METHODS: tuple[tuple[str, dict[str, object]], ...] = (
    ("structure_tensor", {"tau": "auto"}),
    ("plane_sweep", {}),
    ("refined", {"fallback": "none"}),
    ("refined", {"fallback": "plane_sweep"}),
    ("refined", {}),
)
SEMI_GLOBAL = "SGBM"
BLOCKS = "BM"
Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Matcher:
    """One of OpenCV's matchers and its settings."""

    kind: str
    camera: int
    block: int
    # Of SGBM: its mode, and the larger penalty over the block's area.
    ways: str = ""
    penalty: int = 0

    def __str__(self) -> str:
        """Return the settings as the table tells them."""
        return f"s = {self.camera}, blocks of {self.block}" + (f", {self.ways}, P2 {self.penalty}" if self.ways else "")


def matchers(kind: str, cameras: list[int]) -> Iterator[Matcher]:
    """Give all settings that are tried."""
    if kind == BLOCKS:
        for camera, block in product(cameras, (5, 7, 9, 11, 13, 15, 17, 21, 25, 31)):
            yield Matcher(kind, camera, block)
    else:
        for settings in product(cameras, (1, 3, 5, 7, 9, 11), ("3-way", "8-way"), (8, 32, 96)):
            yield Matcher(kind, *settings)


def matched(recording: xr.Dataset, settings: Matcher, range_px: tuple[float, float]) -> Map:
    """Return what a matcher finds in px per step; NaN where it finds nothing.

    Parameters
    ----------
    recording
        A recording of one frame.
    settings
        Matcher and camera.
    range_px
        Least and largest disparity that there is, in px per step.
    """
    import cv2

    pair = [np.ascontiguousarray(recording["image"].sel(s=s).values[0]) for s in (0, settings.camera)]
    if settings.camera < 0:
        # Seen in a mirror, the camera on the left stands on the right.
        pair = [np.ascontiguousarray(image[:, ::-1]) for image in pair]
    steps = abs(settings.camera)
    least = int(range_px[0] * steps) - 1
    span = -(-(int(np.ceil(range_px[1] * steps)) + 2 - least) // 16) * 16
    pad = least + span
    padded = [cv2.copyMakeBorder(image, 0, 0, pad, 0, cv2.BORDER_REPLICATE) for image in pair]
    matcher: cv2.StereoMatcher
    if settings.kind == BLOCKS:
        # What is told but wrong is no worse than what is not told: nothing is kept back.
        blocks = cv2.StereoBM.create(span, settings.block)
        blocks.setTextureThreshold(0)
        blocks.setUniquenessRatio(0)
        matcher = blocks
        matcher.setMinDisparity(least)
    else:
        mode = cv2.STEREO_SGBM_MODE_SGBM_3WAY if settings.ways == "3-way" else cv2.STEREO_SGBM_MODE_HH
        area = settings.block**2
        matcher = cv2.StereoSGBM.create(
            least, span, settings.block, P1=settings.penalty * area // 4, P2=settings.penalty * area, mode=mode
        )
    found = np.asarray(matcher.compute(*padded)[:, pad:], dtype=np.float64) / 16
    found[(found < least) | (np.arange(found.shape[1]) < found)] = np.nan
    return (found[:, ::-1] if settings.camera < 0 else found) / steps


def bad(found: Map, truth: Map) -> Mask:
    """Return where an estimate is missing or wrong."""
    return ~(np.abs(found - truth) <= BAD_PX)


def best(kind: str, recording: xr.Dataset, truth: Map) -> Matcher:
    """Return the settings that leave the fewest bad pixels."""
    known = np.isfinite(truth)
    range_px = (float(truth[known].min()), float(truth[known].max()))

    def share(settings: Matcher) -> float:
        return float(bad(matched(recording, settings, range_px), truth)[known].mean())

    others = [s for s in recording["s"].values.tolist() if s != 0]
    return min(matchers(kind, others), key=share)


def timed(function: Callable[[], Map]) -> tuple[Map, float]:
    """Return a result and its seconds."""
    start = time.perf_counter()
    return function(), time.perf_counter() - start


def told(recording: xr.Dataset, name: str, settings: dict[str, object]) -> Map:
    """Return the disparity that a method of the package tells, NaN elsewhere; rough ones where it fits nothing, too."""
    found = st.estimate(recording, name, settings).isel(t=0)
    least = 1 if name == "refined" else 2
    return np.where(found["status"].values >= least, found["disparity"].values, np.nan)


def estimates(recording: xr.Dataset, truth: Map) -> Iterator[tuple[str, Map, float]]:
    """Give name, disparity (NaN is unknown) and seconds of every method."""
    for name, settings in METHODS:
        # What is compiled on first use is no part of the time.
        told(recording.isel(y=slice(0, 100), x=slice(0, 140)), name, settings)
        spelled = ", ".join([name, *(f"{key}: {value}" for key, value in settings.items() if key != "tau")])
        yield spelled, *timed(lambda name=name, settings=settings: told(recording, name, settings))
    range_px = (float(np.nanmin(truth)), float(np.nanmax(truth)))
    for kind in (SEMI_GLOBAL, BLOCKS):
        chosen = best(kind, recording, truth)
        disparity, seconds = timed(lambda chosen=chosen: matched(recording, chosen, range_px))
        yield f"OpenCV's {kind} ({chosen})", disparity, seconds


def row(found: Map, truth: xr.Dataset) -> list[str]:
    """Return shares in %: bad, beside outlines, beyond, without texture; missing; told wrongly."""
    disparity = truth["disparity"].values
    known = np.isfinite(disparity)
    names = json.loads(truth.attrs["object_names"])
    bare = np.isin(truth["object_id"].values, [n for n, name in enumerate(names) if name.startswith(UNTEXTURED)])
    beside = truth["boundary_distance"].values < OUTLINE_PX
    wrong = bad(found, disparity)
    missing = ~np.isfinite(found)

    def share(what: Mask, where: Mask) -> str:
        return f"{100 * what[known & where].mean():.2f}" if (known & where).any() else "-"

    everywhere = np.ones_like(known)
    regions = [share(wrong, where) for where in (everywhere, beside & ~bare, ~beside & ~bare, bare)]
    return [*regions, share(missing, everywhere), share(wrong & ~missing, everywhere)]


def main() -> None:
    """Print the table, row by row."""
    warnings.simplefilter("ignore")
    given = set(sys.argv[1:])
    held_out = "--held-out" in given
    scenes = list_sets(held_out=held_out) | ({} if held_out else {name: scene_of(name) for name in SCENES})
    chosen = {name: scene for name, scene in scenes.items() if name in given or not given - {"--held-out"}}
    head = f"scene | method | bad, % | up to {OUTLINE_PX} px from edges | farther | untextured | missing | wrong | s"
    print(f"| {head} |\n|{9 * '---|'}")
    for name, scene in chosen.items():
        recording, truth = st.simulate(st.Scene.from_dict(scene))
        one = truth.sel(t=0)
        for method, found, seconds in estimates(recording, one["disparity"].values):
            print(f"| {' | '.join([name, method, *row(found, one), f'{seconds:.2f}'])} |", flush=True)


if __name__ == "__main__":
    main()
