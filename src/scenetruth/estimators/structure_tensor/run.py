"""Running the kernels over registrations, bands of rows and frames, in bounded scratch memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.structure_tensor.carry import carry_to_reference
from scenetruth.estimators.structure_tensor.filters import DERIVATIVE_MOMENT, PAPER, gaussian_window
from scenetruth.estimators.structure_tensor.registration import CELL, Registration
from scenetruth.estimators.structure_tensor.rig import Rig
from scenetruth.estimators.structure_tensor.shift import registered
from scenetruth.estimators.structure_tensor.task import Task, columns_of_s, common_area
from scenetruth.estimators.structure_tensor.tiling import Rectangle, tiles_of
from scenetruth.estimators.structure_tensor.uncertainty import STRIDE, texture_transfer
from scenetruth.estimators.threads import bands, in_threads, thread_count

__all__ = ["Maps", "Progress", "Scratch", "run", "run_kernel"]

Progress = Callable[[str, int, int], None]
Array = NDArray[np.float64]

# What is kept for a pixel between the kernels, and how much of that at a time.
_BYTES_PER_PIXEL, _SCRATCH_BYTES, _BAND_ROWS = 112, 192e6, 128
_FOUND = 14


@dataclass(frozen=True, eq=False)
class Maps:
    """The estimate, as plain arrays (see `to_world`)."""

    floats: NDArray[np.float32]
    moved: NDArray[np.float32]
    singles: NDArray[np.float32]
    flags: NDArray[np.uint8]
    eigenvalues: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Scratch:
    """What the kernels leave for a band of rows, see `estimate_tile`."""

    best: NDArray[np.float32]
    found: NDArray[np.float32]
    solved: Array
    kinds: NDArray[np.uint8]
    choice: NDArray[np.int16]

    @classmethod
    def empty(cls, frames: int, rows: int, columns: int) -> Scratch:
        """Return scratch in which no registration has been tried."""
        shape = (frames, rows, columns)
        return cls(
            best=np.full((2, *shape), np.inf, dtype=np.float32),
            found=np.empty((_FOUND, *shape), dtype=np.float32),
            solved=np.empty((5, *shape)),
            kinds=np.empty((3, *shape), dtype=np.uint8),
            choice=np.full(shape, -1, dtype=np.int16),
        )

    def clear(self) -> None:
        """Forget what has been tried."""
        self.best.fill(np.inf)
        self.choice.fill(-1)


def run_kernel(
    task: Task,
    registration: Registration,
    tiles: NDArray[np.int64],
    scratch: Scratch,
    first_row: int,
    candidate: int,
    images: NDArray[Any],
    weight_t: float,
) -> None:
    """Estimate the frames of a task in some tiles at one registration.

    Parameters
    ----------
    task, registration
        What to estimate, and at which working point.
    tiles
        First and last + 1 row, then column, of every tile, shape (n, 4).
    scratch, first_row
        What is known so far of the rows from the first on; tiles must lie in them.
    candidate
        Number under which the scratch remembers this registration.
    images
        The images as `registered` returns them for this working point.
    weight_t
        What motion along t counts beside that along s in the choice between registrations.
    """
    from scenetruth.estimators.structure_tensor.tensor_kernels import estimate_tile

    if len(tiles) == 0:
        return
    rig, settings = task.rig, task.settings
    # The divergence term counts x from each camera's own principal point.
    own = -registration.disparity * (rig.positions - rig.centre_s)
    over_s = np.array([task.over_s.smoothing, task.over_s.derivative, own * task.over_s.smoothing])
    over_xy = np.array([PAPER.smoothing, PAPER.derivative, DERIVATIVE_MOMENT[::-1]])
    over_xy = np.vstack([over_xy, over_xy[2] - 2 * over_xy[0]])
    window = gaussian_window(settings.window_sigma_px, settings.window_taps_px)
    local = np.arange(len(window)) - len(window) // 2
    still = registration.flow == (0, 0)
    # Frames slide through the window; frames that are registered in t stand elsewhere for every estimate.
    groups = [task.outputs] if still else [task.outputs[n : n + 1] for n in range(len(task.outputs))]
    for index, group in enumerate(groups):
        first = int(group[0]) - rig.before
        arguments = (
            images,
            (first, first + rig.frames + len(group) - 1, index),
            columns_of_s(rig, registration.disparity),
            np.array(registration.flow, dtype=np.int64),
            (rig.frames - 1) / 2,
            first_row,
            over_s.astype(np.float32),
            np.array([task.over_t.smoothing, task.over_t.derivative], dtype=np.float32),
            over_xy.astype(np.float32),
            rig.window_t.astype(np.float32),
            np.array([window, window * local, window * local**2, 2 * window * local], dtype=np.float32),
            settings.divergence == "consistent",
            np.array([weight_t, float(settings.tau), task.noise.moment_ratio, window @ local**2]),
            scratch.best,
            scratch.found,
            scratch.solved,
            scratch.kinds,
            scratch.choice,
            candidate,
        )
        in_threads(partial(estimate_tile, *arguments), tiles)


def run(task: Task, registrations: Sequence[Registration], progress: Progress | None) -> Maps:
    """Estimate all frames, a band of rows and some frames at a time, so that scratch memory stays bounded."""
    height, width = task.images.shape[-2:]
    frames = len(task.outputs)
    shape = (frames, height, width)
    elsewhere = task.rig.centre_s != 0 or task.rig.centre_t != 0
    maps = Maps(
        floats=np.empty((8, *shape), dtype=np.float32),
        moved=np.empty((2, *shape) if elsewhere else (2, 1, 0, 0), dtype=np.float32),
        singles=np.empty((7, *shape), dtype=np.float32),
        flags=np.empty((4, *shape), dtype=np.uint8),
        eigenvalues=np.empty((5, *shape), dtype=np.float32),
    )
    at_a_time = int(_SCRATCH_BYTES / (_BYTES_PER_PIXEL * width))
    group = max(1, min(frames, at_a_time // _BAND_ROWS))
    rows = max(_BAND_ROWS, at_a_time // group // STRIDE * STRIDE)
    parts = [
        (first, min(first + group, frames), top, min(top + rows, height))
        for first in range(0, frames, group)
        for top in range(0, height, rows)
    ]
    areas = [common_area(task, item) for item in registrations]
    only = registered(task, registrations[0].disparity) if len(registrations) == 1 else None
    steps = len(parts) * len(registrations)
    # Where registrations differ in flow, what they leave to move along t counts too.
    weight_t = float(len({item.flow for item in registrations}) > 1)
    if progress is not None:
        progress("estimate", 0, steps)
    scratch: Scratch | None = None
    for done, (first, last, top, bottom) in enumerate(parts):
        part = replace(task, outputs=task.outputs[first:last])
        if scratch is None or scratch.choice.shape[:2] != (last - first, bottom - top):
            scratch = Scratch.empty(last - first, bottom - top, width)
        else:
            scratch.clear()
        for number, (item, area) in enumerate(zip(registrations, areas, strict=True)):
            inside = (max(area[0], top), min(area[1], bottom), area[2], area[3])
            tiles = tiles_of(inside, item.cells, thread_count())
            images = registered(task, item.disparity) if only is None else only
            run_kernel(part, item, tiles, scratch, top, number, images, weight_t)
            if progress is not None:
                progress("estimate", done * len(registrations) + number + 1, steps)
        _forget_second_best(scratch.choice, registrations, areas, top)
        for index in range(last - first):
            _to_world(part, registrations, scratch, maps, index, first + index, top, bottom)
    if elsewhere:
        for index in range(frames):
            _carry(maps, index, task.rig)
    return maps


def _forget_second_best(
    choice: NDArray[np.int16], registrations: Sequence[Registration], areas: Sequence[Rectangle], first_row: int
) -> None:
    """Take back choices, shape (t, y, x), where a disparity that fits could not be tried.

    Beside the border of the image, large disparities leave the common view first. Those that are left are false there,
    and may look right: they are off by more than filters can tell.
    """
    _, rows, columns = choice.shape
    flows = [item.flow for item in registrations]
    # Registrations by another flow have a view of their own.
    chosen = np.array([*map(flows.index, flows), -1], dtype=np.int16)[choice]
    for item, (top, bottom, left, right) in zip(registrations, areas, strict=True):
        if item.fits is None:
            continue
        fits = item.fits.repeat(CELL, axis=0)[first_row : first_row + rows].repeat(CELL, axis=1)[:, :columns]
        top, bottom, every = max(top - first_row, 0), max(bottom - first_row, 0), slice(None)
        if bottom > top and right > left:
            outside = [
                (every, slice(left)),
                (every, slice(right, None)),
                (slice(top), every),
                (slice(bottom, None), every),
            ]
        else:
            outside = [(every, every)]
        for part in outside:
            choice[:, *part][fits[part] & (chosen[:, *part] == flows.index(item.flow))] = -1


def _to_world(
    task: Task,
    registrations: Sequence[Registration],
    scratch: Scratch,
    maps: Maps,
    index: int,
    frame: int,
    top: int,
    bottom: int,
) -> None:
    from scenetruth.estimators.structure_tensor.world_kernels import to_world

    rig, intrinsics, model = task.rig, task.intrinsics, task.noise
    camera = int(np.argmin(np.abs(rig.positions)))
    # A few rows more than the band, for the window over the texture.
    border = 2 * STRIDE * (task.settings.window_taps_px // STRIDE + 1)
    start = max(top - border, 0) // STRIDE * STRIDE
    image = task.images[:, camera, task.outputs[index], start : bottom + border].astype(np.float32)
    texture = texture_transfer(image, task.settings)[:, (top - start) // STRIDE :]
    sigma = task.settings.noise_std
    points = np.array([(item.disparity, *item.flow) for item in registrations], dtype=np.float64)
    arguments = (
        (intrinsics.focal_length_px, *intrinsics.principal_point_px, intrinsics.baseline_mm),
        (rig.centre_s, rig.centre_t),
        task.scales,
        (rig.sees_depth, rig.sees_motion),
        points,
        tuple(bool(np.ptp(points[:, k]) > 0) for k in range(3)),
        top,
        scratch.kinds[:, index],
        scratch.solved[:, index],
        scratch.found[:, index],
        scratch.choice[index],
        (
            np.nan if sigma == "auto" else float(sigma) ** 2,
            *model.residual_s,
            *model.residual_t,
            model.window,
            model.motion_s,
        ),
        np.array([model.phases, model.disparity_s, model.disparity_t, model.motion_t]),
        texture,
        STRIDE,
        maps.floats[:, frame, top:bottom],
        maps.moved[:, frame if maps.moved.size else 0, top:bottom],
        maps.singles[:, frame, top:bottom],
        maps.flags[:, frame, top:bottom],
        maps.eigenvalues[:, frame, top:bottom],
    )
    in_threads(partial(to_world, *arguments), bands(bottom - top))


def _carry(maps: Maps, index: int, rig: Rig) -> None:
    moved = maps.moved[:, index].astype(np.float64)
    singles = maps.singles[:, index]
    together = np.concatenate([maps.floats[:, index], singles[:6], maps.eigenvalues[:, index]])
    flags = np.concatenate([maps.flags[:, index].astype(np.int64), np.nan_to_num(singles[6:]).astype(np.int64)])
    carried, kinds = carry_to_reference(moved, together, flags)
    maps.floats[:, index] = carried[:8]
    singles[:6] = carried[8:14]
    singles[5] = np.nan_to_num(singles[5])
    maps.eigenvalues[:, index] = carried[14:]
    maps.flags[:, index] = kinds[:4]
    # What is interpolated from pixels of which not all had a value has none; its kind says so.
    floats = maps.floats[:, index]
    for flag, parts in ((1, [0, 4]), (2, [5, 6, 7])):
        lost = ~np.isfinite(floats[parts]).all(axis=0)
        maps.flags[flag, index][lost] = 0
        floats[[*parts, 1, 2, 3]] = np.where(lost, np.nan, floats[[*parts, 1, 2, 3]])
    lesser = np.minimum if rig.sees_depth and rig.sees_motion else np.maximum
    maps.flags[0, index] = lesser(maps.flags[1, index], maps.flags[2, index])
    singles[6] = np.where(maps.flags[0, index] > 0, kinds[4], np.nan)
