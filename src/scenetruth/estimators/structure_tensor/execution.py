"""Execution of the kernels over registrations, row bands and frames in bounded memory, and resampling of the maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from scenetruth import compilation
from scenetruth.estimators.structure_tensor.estimation_task import (
    EstimationInputs,
    columns_of_s,
    common_area,
    shift_by_subpixels,
    without_support,
)
from scenetruth.estimators.structure_tensor.filters import DERIVATIVE_MOMENT, PAPER, AcquisitionAxes, gaussian_window
from scenetruth.estimators.structure_tensor.maps import STRIDE, BestRegistration, EstimateMaps, Filters
from scenetruth.estimators.structure_tensor.noise_model import texture_transfer
from scenetruth.estimators.structure_tensor.registration import CELL, Rectangle, Registration, split_into_tiles
from scenetruth.progress import Progress
from scenetruth.threads import bands, in_threads

__all__ = [
    "MEMORY_LIMITS", "CandidateRegistration", "MemoryLimits", "carry_to_reference", "forget_second_best",
    "frames_at_a_time", "run", "run_kernel", "step_count",
]  # fmt: skip


_ROUNDS = 4


def carry_to_reference(
    moved: NDArray[np.float64], maps: NDArray[Any], flags: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Resample maps at the pixels of the reference, if the estimate is centred between cameras or frames.

    ``moved``: Offset of the image point in the reference relative to each pixel, right and down, in px, shape
      (2, y, x); NaN where invalid.
    ``maps``: Floating-point maps, shape (n, y, x): interpolated linearly, NaN next to NaN.
    ``flags``: Integer maps, shape (m, y, x): taken from the nearest pixel.
    """
    rows, columns = np.mgrid[: moved.shape[1], : moved.shape[2]].astype(np.float64)
    filled = np.nan_to_num(moved)
    # The pixel q whose point lands on r: q = r - moved(q), a contraction while surfaces do not fold.
    at = np.stack([rows, columns])
    for _ in range(_ROUNDS):
        shift = [map_coordinates(part, at, order=1, mode="nearest") for part in filled]
        at = np.stack([rows - shift[1], columns - shift[0]])
    known = np.isfinite(moved).all(axis=0)
    whole = map_coordinates(known.astype(np.float64), at, order=1, mode="constant") > 1 - 1e-9
    carried = np.stack(
        [np.where(whole, map_coordinates(part, at, order=1, mode="nearest"), np.nan) for part in maps]
    ).astype(maps.dtype)
    nearest = np.rint(at).astype(np.int64)
    nearest[0] = np.clip(nearest[0], 0, moved.shape[1] - 1)
    nearest[1] = np.clip(nearest[1], 0, moved.shape[2] - 1)
    return carried, np.where(whole, flags[:, *nearest], 0).astype(flags.dtype)


_BYTES_PER_PIXEL, _BYTES_PER_PIXEL_OF_MAPS = 112, 84  # of `BestRegistration` and of `EstimateMaps`


@dataclass
class MemoryLimits:
    """Sizes of what is in memory together."""

    scratch_bytes: float = 128e6
    """Size of `BestRegistration` for a band of rows."""
    band_rows: int = 128
    """Smallest number of rows of a band."""
    map_bytes: float = 192e6
    """Size of the maps of all frames that are estimated together."""


MEMORY_LIMITS = MemoryLimits()


class CandidateRegistration(NamedTuple):
    """A registration that competes for the best one of each pixel."""

    number: int
    """Number of the registration in `BestRegistration`."""
    images: NDArray[Any]
    """Images of `shift_by_subpixels` for this registration disparity."""
    weight_t: float
    """Weight of the displacement along t relative to that along s in the selection."""


def run_kernel(
    task: EstimationInputs,
    registration: Registration,
    candidate: CandidateRegistration,
    tiles: NDArray[np.int64],
    best: BestRegistration,
    first_row: int,
) -> None:
    """Estimate the frames of a task in tiles (first and last + 1 row, then column) at one registration."""
    from scenetruth.estimators.structure_tensor.tensor_kernels import Criteria, Registered, estimate_tile

    if len(tiles) == 0:
        return
    rig, settings = task.rig, task.settings
    filters = _filters_at(task, registration.disparity)
    half = settings.window_taps_px // 2
    criteria = Criteria(
        candidate=candidate.number,
        weight_t=candidate.weight_t,
        tau=float(settings.tau),
        moment_ratio=task.noise.moment_ratio,
        window_moment=float(
            gaussian_window(settings.window_sigma_px, settings.window_taps_px) @ np.arange(-half, half + 1) ** 2
        ),
    )
    # Read-only view, because numba would compile a second time for writeable arrays.
    images = candidate.images.view()
    images.flags.writeable = False
    still = registration.flow == (0, 0)
    # Frames slide through the window; frames that are registered along t are shifted again for every estimate.
    groups = [task.outputs] if still else [task.outputs[n : n + 1] for n in range(len(task.outputs))]
    for index, group in enumerate(groups):
        first = int(group[0]) - rig.before
        view = Registered(
            images=images,
            columns_of_s=columns_of_s(rig, registration.disparity),
            flow=np.array(registration.flow, dtype=np.int64),
            first=first,
            last=first + rig.frames + len(group) - 1,
            centre_t=(rig.frames - 1) / 2,
        )
        in_threads(partial(estimate_tile, view, filters, criteria, best, index, first_row), tiles)


def _filters_at(task: EstimationInputs, disparity: int) -> Filters:
    """Return the kernels of all filters for images registered by a disparity."""
    rig, settings = task.rig, task.settings
    # In the divergence term, x is relative to the principal point of each camera.
    own = -disparity * (rig.positions - rig.centre_s)
    moment = DERIVATIVE_MOMENT[::-1]
    window = gaussian_window(settings.window_sigma_px, settings.window_taps_px)
    local = np.arange(len(window)) - len(window) // 2

    def single(weights: NDArray[np.float64]) -> NDArray[np.float32]:
        return np.ascontiguousarray(weights, dtype=np.float32)

    return Filters(
        smoothing_s=single(task.over_s.smoothing),
        derivative_s=single(task.over_s.derivative),
        moment_s=single(own * task.over_s.smoothing),
        smoothing_t=single(task.over_t.smoothing),
        derivative_t=single(task.over_t.derivative),
        kernels=single(np.stack([PAPER.smoothing, PAPER.derivative, moment, moment - 2 * PAPER.smoothing])),
        window_t=single(rig.window_t),
        channels=single(task.weights),
        windows=single(np.stack([window, window * local, window * local**2, 2 * window * local])),
        with_correction=settings.divergence == "consistent",
    )


def frames_at_a_time(shape: Sequence[int]) -> int:
    """Return the number of frames that are estimated together, which bounds their maps and scratch memory."""
    by_maps = MEMORY_LIMITS.map_bytes / (_BYTES_PER_PIXEL_OF_MAPS * shape[0] * shape[1])
    by_scratch = MEMORY_LIMITS.scratch_bytes / (_BYTES_PER_PIXEL * shape[1] * min(MEMORY_LIMITS.band_rows, shape[0]))
    return max(1, int(min(by_maps, by_scratch)))


def step_count(frames: int, shape: Sequence[int]) -> int:
    """Return the number of row bands that `run` processes in sequence."""
    return len(_bands(frames, shape))


def _bands(frames: int, shape: Sequence[int]) -> list[tuple[int, int]]:
    """Return the first row and the last + 1 of every band."""
    height, width = shape
    at_a_time = int(MEMORY_LIMITS.scratch_bytes / (_BYTES_PER_PIXEL * width))
    rows = max(MEMORY_LIMITS.band_rows, at_a_time // frames // STRIDE * STRIDE)
    return [(top, min(top + rows, height)) for top in range(0, height, rows)]


def run(task: EstimationInputs, registrations: Sequence[Registration], progress: Progress | None) -> EstimateMaps:
    """Estimate the frames of a task, one row band at a time, which bounds the scratch memory."""
    height, width = task.images.shape[-2:]
    frames = len(task.outputs)
    elsewhere = task.rig.centre_s != 0 or task.rig.centre_t != 0
    maps = EstimateMaps.invalid(frames, height, width, shifted=elsewhere)
    parts = _bands(frames, (height, width))
    areas = [common_area(task, item) for item in registrations]
    only = shift_by_subpixels(task, registrations[0].disparity) if len(registrations) == 1 else None
    steps = len(parts) * len(registrations)
    # If registrations differ in flow, the residual displacement along t is included.
    weight_t = float(len({item.flow for item in registrations}) > 1)
    if progress is not None:
        progress("estimate", 0, steps)
    best: BestRegistration | None = None
    for done, (top, bottom) in enumerate(parts):
        if best is None or best.choice.shape[1] != bottom - top:
            best = BestRegistration.empty(frames, bottom - top, width)
        else:
            best.clear()
        for number, (item, area) in enumerate(zip(registrations, areas, strict=True)):
            inside = Rectangle(max(area.top, top), min(area.bottom, bottom), area.left, area.right)
            tiles = split_into_tiles(inside, item.cells, compilation.thread_count())
            images = shift_by_subpixels(task, item.disparity) if only is None else only
            run_kernel(task, item, CandidateRegistration(number, images, weight_t), tiles, best, top)
            if progress is not None:
                progress("estimate", done * len(registrations) + number + 1, steps)
        forget_second_best(best.choice, registrations, areas, top)
        if task.invalid is not None:
            _forget_beside_invalid(task, best.choice, registrations, (top, bottom))
        for index in range(frames):
            _to_world(task, registrations, best, maps, index, (top, bottom))
    if elsewhere:
        for index in range(frames):
            _carry(maps, index, task.rig)
    return maps


def forget_second_best(
    choice: NDArray[np.int16], registrations: Sequence[Registration], areas: Sequence[Rectangle], first_row: int
) -> None:
    """Discard choices, shape (t, y, x), where a better disparity could not be tried.

    Near the image border, large disparities leave the common view first. The remaining disparities are wrong by more
    than the filters can measure, but may seem plausible.
    """
    chosen, flows = _chosen_flows(choice, registrations)
    for item, area in zip(registrations, areas, strict=True):
        if item.fits is None:
            continue
        fits = _fitting_pixels(item.fits, first_row, choice.shape)
        top, bottom, every = max(area.top - first_row, 0), max(area.bottom - first_row, 0), slice(None)
        if bottom > top and not area.is_empty:
            outside = [
                (every, slice(area.left)),
                (every, slice(area.right, None)),
                (slice(top), every),
                (slice(bottom, None), every),
            ]
        else:
            outside = [(every, every)]
        for part in outside:
            choice[:, *part][fits[part] & (chosen[:, *part] == flows.index(item.flow))] = -1


def _chosen_flows(
    choice: NDArray[np.int16], registrations: Sequence[Registration]
) -> tuple[NDArray[np.int16], list[tuple[int, int]]]:
    """Return the index of the flow chosen at every pixel, -1 for none, and the flows of all registrations.

    Registrations with another flow have another common view.
    """
    flows = [item.flow for item in registrations]
    return np.array([*map(flows.index, flows), -1], dtype=np.int16)[choice], flows


def _fitting_pixels(fits: NDArray[np.bool_], first_row: int, shape: Sequence[int]) -> NDArray[np.bool_]:
    """Return the pixels of the cells in which a registration fits, of a row band of shape (t, y, x)."""
    _, rows, columns = shape
    return fits.repeat(CELL, axis=0)[first_row : first_row + rows].repeat(CELL, axis=1)[:, :columns]


def _forget_beside_invalid(
    task: EstimationInputs, choice: NDArray[np.int16], registrations: Sequence[Registration], band: tuple[int, int]
) -> None:
    """Discard choices as `forget_second_best`, where a better registration touches invalid pixels."""
    chosen, flows = _chosen_flows(choice, registrations)
    for item in registrations:
        if item.fits is None:
            continue
        fits = _fitting_pixels(item.fits, band[0], choice.shape)
        for index in range(len(choice)):
            touched = without_support(task, item, index, band)
            if touched is not None:
                choice[index][touched & fits & (chosen[index] == flows.index(item.flow))] = -1


def _to_world(
    task: EstimationInputs,
    registrations: Sequence[Registration],
    best: BestRegistration,
    maps: EstimateMaps,
    index: int,
    rows: tuple[int, int],
) -> None:
    """Write one frame of the row band of a task, specified by its index in the task."""
    from scenetruth.estimators.structure_tensor.world_coordinate_kernels import (
        Axes,
        NoisePower,
        WorkingPoints,
        to_world,
    )

    rig, intrinsics, model, (top, bottom) = task.rig, task.intrinsics, task.noise, rows
    camera = int(np.argmin(np.abs(rig.positions)))
    # The band plus the rows required by the window over the texture.
    border = 2 * STRIDE * (task.settings.window_taps_px // STRIDE + 1)
    start = max(top - border, 0) // STRIDE * STRIDE
    image = task.images[:, camera, task.outputs[index], start : bottom + border].astype(np.float32)
    if np.any(task.weights != 1.0):
        image *= np.sqrt(task.weights).astype(np.float32)[:, None, None]
    texture = texture_transfer(image, task.settings).cropped(slice((top - start) // STRIDE, None))
    sigma = task.settings.noise_std
    axes = Axes(
        intrinsics.focal_length_px,
        *intrinsics.principal_point_px,
        baseline_mm=intrinsics.baseline_mm,
        centre_s=rig.centre_s,
        centre_t=rig.centre_t,
        scale_s=task.scales[0],
        scale_t=task.scales[1],
        sees_depth=rig.sees_depth,
        sees_motion=rig.sees_motion,
    )
    whole = np.array([(item.disparity, *item.flow) for item in registrations], dtype=np.float64).T.copy()
    points = WorkingPoints(*whole, *(bool(np.ptp(values) > 0) for values in whole))
    noise = NoisePower(
        power=np.nan if sigma == "auto" else float(sigma) ** 2,
        residual_s=model.residual_s,
        residual_t=model.residual_t,
        window=model.window,
        motion_s=model.motion_s,
        phases=model.phases,
        disparity_s=model.disparity_s,
        disparity_t=model.disparity_t,
        motion_t=model.motion_t,
    )
    in_threads(partial(to_world, axes, points, noise, texture, best, maps, index, top), bands(bottom - top))


def _carry(maps: EstimateMaps, index: int, rig: AcquisitionAxes) -> None:
    """Resample one frame of the maps at the pixels of the reference camera and frame."""
    shift = maps.shift[:, index].astype(np.float64)
    interpolated = (
        *(maps.depth[None], maps.velocity, maps.disparity[None], maps.flow, maps.divergence[None]),
        *(maps.depth_std[None], maps.velocity_std, maps.disparity_std[None], maps.confidence[None], maps.eigenvalues),
    )
    # Registration disparities are integers.
    whole = np.nan_to_num(maps.working_point[index]).astype(np.int64)
    flags = (maps.kind, maps.kind_disparity, maps.kind_motion, maps.model_violation)
    carried, kinds = carry_to_reference(
        shift,
        np.concatenate([part[:, index] for part in interpolated]),
        np.stack([*(part[index].astype(np.int64) for part in flags), whole]),
    )
    first = 0
    for part in interpolated:
        part[:, index] = carried[first : first + len(part)]
        first += len(part)
    for flag, values in zip(flags, kinds, strict=False):
        flag[index] = values
    maps.confidence[index] = np.nan_to_num(maps.confidence[index])
    # A value interpolated between pixels of which one is invalid is NaN, and its status is invalid.
    disparity_known = np.isfinite(maps.depth[index]) & np.isfinite(maps.disparity[index])
    motion_known = np.isfinite(maps.flow[:, index]).all(axis=0) & np.isfinite(maps.divergence[index])
    for kind, known, lost in (
        (maps.kind_disparity, disparity_known, (maps.depth[index], maps.disparity[index])),
        (maps.kind_motion, motion_known, (*maps.flow[:, index], maps.divergence[index])),
    ):
        kind[index][~known] = 0
        for values in (*lost, *maps.velocity[:, index]):
            values[~known] = np.nan
    lesser = np.minimum if rig.sees_depth and rig.sees_motion else np.maximum
    maps.kind[index] = lesser(maps.kind_disparity[index], maps.kind_motion[index])
    maps.working_point[index] = np.where(maps.kind[index] > 0, kinds[len(flags)], np.nan)
