"""Input of an export: a recording with its truth or an estimate.

Conventions are those of public data sets: positive disparities of a camera pair, displacements between frames.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.schema import Intrinsics, compute_pixel_grid, read_intrinsics, read_scene

__all__ = ["CameraPair", "ExportSource", "FlowKind"]

_COLOURS = ("red", "green", "blue")

Map = NDArray[np.float64]
FlowKind = Literal["finite", "instantaneous"]
"""``finite``: displacement to the next frame; ``instantaneous``: the derivative dx/dt, per frame."""


@dataclass(frozen=True)
class CameraPair:
    """Positions s of two neighbouring cameras, and the distance from the left to the right camera, positive."""

    left: int
    right: int
    baseline_mm: float


@dataclass(frozen=True)
class ExportSource:
    """A validated recording without rows (``s_y``), with the maps of its truth or of an estimate."""

    recording: xr.Dataset
    maps: xr.Dataset
    is_truth: bool = True

    @cached_property
    def cameras(self) -> list[int]:
        """Positions s of the recording."""
        return [int(s) for s in self.recording["s"].values]

    @cached_property
    def views(self) -> list[int]:
        """Positions s with maps: all, or the reference only."""
        everywhere = any("s" in item.dims for name, item in self.maps.data_vars.items() if name in _SURFACE)
        return [int(s) for s in self.maps["s"].values] if everywhere else [0]

    @cached_property
    def frames(self) -> list[int]:
        """Frames t with both images and maps."""
        recorded = set(self.recording["t"].values.tolist())
        return [int(t) for t in self.maps["t"].values if int(t) in recorded]

    @cached_property
    def pairs_of_frames(self) -> list[int]:
        """Frames t with maps whose next frame is recorded."""
        recorded = set(self.recording["t"].values.tolist())
        return [t for t in self.frames if t + 1 in recorded]

    @cached_property
    def size(self) -> tuple[int, int]:
        """Height and width of the images, in rows and columns."""
        return self.recording.sizes["y"], self.recording.sizes["x"]

    @cached_property
    def intrinsics(self) -> Intrinsics:
        """Focal length and principal point in columns and rows of the images."""
        return compute_pixel_grid(self.recording).in_columns(read_intrinsics(self.recording))

    @property
    def step_px(self) -> float:
        """Camera pixels per column."""
        return compute_pixel_grid(self.recording).step_px

    @cached_property
    def distortion(self) -> dict[str, float]:
        """Nonzero lens coefficients k1 to k6, p1, p2; empty for a pinhole."""
        camera = (read_scene(self.recording) or {}).get("camera") or {}
        lens = camera.get("distortion") or {}
        return {name: float(value) for name, value in lens.items() if isinstance(value, int | float) and value != 0}

    @property
    def has_colours(self) -> bool:
        """Whether images have channels."""
        return "channel" in self.recording["image"].dims

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels of colour images in the order of `image`; red, green and blue first to last."""
        if not self.has_colours:
            return ()
        if "channel" in self.recording.coords:
            names = [str(name) for name in self.recording["channel"].values]
            return _COLOURS if set(names) == set(_COLOURS) else tuple(names)
        count = self.recording.sizes["channel"]
        return _COLOURS if count == len(_COLOURS) else tuple(f"channel_{number}" for number in range(count))

    def picture_problems(self) -> Iterator[Problem]:
        """Yield the reason why images are neither grey nor red, green and blue."""
        if self.channels not in ((), _COLOURS):
            message = "are neither grey nor red, green and blue, as pictures must be; use exr, npz or tiff"
            yield Problem("channel", message, ", ".join(self.channels))

    def image(self, s: int, t: int) -> Map:
        """Return an image with full scale 1, shape (y, x), colour images (y, x, channel) in the order of `channels`."""
        image = self.recording["image"]
        if self.has_colours and "channel" in image.coords:
            image = image.sel(channel=list(self.channels))
        values = image.sel(s=s, t=t).values
        return np.asarray(values, dtype=np.float64) / float(self.recording.attrs["full_scale"])

    def raw(self, name: str, s: int, t: int) -> NDArray[Any]:
        """Return a map with its stored type, shape (..., y, x)."""
        values = self.maps[name]
        return np.asarray((values.sel(s=s, t=t) if "s" in values.dims else values.sel(t=t)).values)

    def map(self, name: str, s: int, t: int) -> Map:
        """Return a map in float64, shape (..., y, x)."""
        return self.raw(name, s, t).astype(np.float64)

    def flow(self, s: int, t: int, kind: FlowKind, way: Literal["next", "previous"] = "next") -> Map:
        """Return the flow to the next (previous) frame in columns and rows, shape (2, y, x).

        An instantaneous flow is assumed constant: the flow to the previous frame is its negative.
        """
        if kind == "finite":
            return np.asarray(self.map(f"flow_{way}", s, t) / self.step_px)
        return np.asarray(self.map("flow", s, t) / (self.step_px if way == "next" else -self.step_px))

    def depth(self, s: int, t: int) -> Map:
        """Return the depth in mm, shape (y, x)."""
        if "depth" in self.maps:
            return self.map("depth", s, t)
        own = read_intrinsics(self.recording)
        with np.errstate(divide="ignore"):
            depth = own.focal_length_px * own.baseline_mm / self.map("disparity", s, t)
        return np.where(np.isfinite(depth) & (depth > 0), depth, np.nan)

    def depth_then(self, s: int, t: int, kind: FlowKind, way: Literal["next", "previous"] = "next") -> Map:
        """Return the depth of the points of frame t in the next (previous) frame, at their pixels of frame t."""
        if kind == "finite":
            return np.asarray(self.depth(s, t) + self.map(f"displacement_{way}", s, t)[2])
        return np.asarray(self.depth(s, t) + (1 if way == "next" else -1) * self.map("velocity", s, t)[2])

    def disparity(self, depth_mm: Map, pair: CameraPair) -> Map:
        """Return f B / Z of the points for a pair: x in the left minus x in the right image, in columns."""
        with np.errstate(divide="ignore", invalid="ignore"):
            found = self.intrinsics.focal_length_px * pair.baseline_mm / depth_mm
        # Points behind the camera have no disparity.
        return np.where(depth_mm > 0, found, np.nan)

    def pair(self, left: int) -> CameraPair | Problem:
        """Return a camera with its right neighbour, or the problem."""
        if left not in self.views:
            alone = self.is_truth and len(self.views) <= 1
            remedy = "; render with `--truth-views all` for the others" if alone else ""
            return Problem("left", f"must be a position with maps, one of {self.views}{remedy}", left)
        place = dict(zip(self.cameras, self.recording["stage_x_mm"].values.tolist(), strict=True))
        apart = {s: place[s] - place[left] for s in (left - 1, left + 1) if s in place}
        for right, apart_mm in sorted(apart.items()):
            if apart_mm > 0:
                return CameraPair(left, right, float(apart_mm))
        others = [s for s in self.cameras if any(place[n] > place[s] for n in (s - 1, s + 1) if n in place)]
        fit = [s for s in others if s in self.views]
        remedy = f"use one of {fit}" if fit else "render with two cameras or more, or with `--truth-views all`"
        return Problem("left", f"has no right neighbour, but a pair needs two neighbouring cameras; {remedy}", left)


_SURFACE = frozenset({"depth", "disparity", "flow", "velocity"})
