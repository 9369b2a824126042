"""Structure tensor over the frames of a recording: noise threshold, registrations, and maps of the estimate."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import DTypeLike, NDArray
from scipy.ndimage import correlate1d

from scenetruth.errors import EstimateError, EstimateWarning, Problem
from scenetruth.estimators.channel_noise import compute_channel_weights, read_demosaicing
from scenetruth.estimators.method_settings import StructureTensorSettings
from scenetruth.estimators.protocol import FrameReader
from scenetruth.estimators.structure_tensor.estimation_task import (
    EstimationInputs,
    check_common_view,
    common_area,
    largest_disparity,
    make_inputs,
    shift_by_subpixels,
)
from scenetruth.estimators.structure_tensor.execution import (
    CandidateRegistration,
    frames_at_a_time,
    run,
    run_kernel,
    step_count,
)
from scenetruth.estimators.structure_tensor.filters import (
    PAPER,
    AcquisitionAxes,
    axis_problems,
    choose_acquisition_axes,
)
from scenetruth.estimators.structure_tensor.maps import BestRegistration, EstimateMaps
from scenetruth.estimators.structure_tensor.registration import (
    Registration,
    find_working_point,
    find_working_point_of_flow,
    registrations_along_surfaces,
    registrations_from_coarse,
)
from scenetruth.progress import Progress
from scenetruth.schema import (
    REASONS,
    STATUS_NORMAL,
    STATUS_VALID,
    PixelGrid,
    Put,
    blank_map,
    compute_pixel_grid,
    label,
    read_intrinsics,
)
from scenetruth.schema.validity import compute_validity

__all__ = ["LowTextureCount", "blank_estimate", "fill_estimate"]


# Eigenvalues of pure noise scatter around their mean; those of texture must be clearly larger.
_TAU_OVER_NOISE = 5.0
_EPSILON = float(np.finfo(np.float32).eps)
_LEAST_NOISE = 10 * _EPSILON  # rounding of grey values in [-1, 1] and of their filtered sums, with a margin
_SAMPLES = 9  # rows and columns of pixels at which noise is estimated
# Texture is distinguishable from noise if the third eigenvalue exceeds the fourth by the first factor and the largest
# by the second, below which it is due to rounding and to the filter response to texture in one direction.
_CLEAR, _LEAST_SHARE = 10.0, 1e-4
_MANY = 0.1  # fraction of pixels with such texture below τ that causes a warning
_CALLER = 7  # frames of the call stack up to the caller of `scenetruth.estimate`, to whose line the warning refers


def with_channel_weights(task: EstimationInputs, registrations: Sequence[Registration]) -> EstimationInputs:
    """Return the inputs with channels weighted by the inverse of their noise power, if it differs between them.

    The uncertainties assume equal noise in all channels, which the weights restore. The contrast of all channels
    together is unchanged, and with it the meaning of a threshold τ.
    """
    count = len(task.images)
    if count == 1 or task.settings.noise_std != "auto":
        return task
    found = np.array([_sample(replace(task, weights=alone), registrations) for alone in np.eye(count)])
    power = np.maximum(found[:, 0], _LEAST_NOISE**2)
    weights = compute_channel_weights(power)
    if np.all(weights == 1.0):
        return task
    # The noise of the channel alone, which the sample ascribes to all channels, is in its largest eigenvalue.
    contrast = np.maximum(found[:, 1] - _TAU_OVER_NOISE * power * task.noise.gradient, 0.0)
    if not contrast.any():
        return replace(task, weights=weights)
    weighted = weights * contrast
    share = float(weighted.mean() / weighted.max())
    return replace(task, weights=weights * contrast.sum() / weighted.sum(), contrast_share=share)


def with_threshold(task: EstimationInputs, registrations: Sequence[Registration]) -> tuple[EstimationInputs, float]:
    """Return the inputs with a numeric threshold τ, estimated from the image noise for ``"auto"``, and the noise."""
    settings = task.settings
    if settings.tau != "auto":
        return task, float(settings.noise_std) if settings.noise_std != "auto" else float("nan")
    if settings.noise_std == "auto":
        power, largest = _sample(task, registrations)
    else:
        power, largest = float(settings.noise_std) ** 2, 0.0
    # For images without noise, the limit is the float32 resolution of the largest eigenvalue and of the grey values.
    power = max(power, _LEAST_NOISE**2)
    # Channels without contrast add noise to all eigenvalues alike, which raises the threshold by its mean only.
    over_noise = 1.0 + (_TAU_OVER_NOISE - 1.0) * task.contrast_share
    tau = max(over_noise * power * task.noise.gradient, _EPSILON * largest)
    return replace(task, settings=settings.model_copy(update={"tau": tau})), float(np.sqrt(power))


class LowTextureCount:
    """Count of the pixels whose texture is distinguishable from noise, but lies below the threshold τ.

    At such a pixel, the third eigenvalue is below τ, but ten times the fourth: three dimensions of its structure tensor
    contain texture, two contain noise. With a lower τ, its depth and motion would be valid. In low-contrast images,
    most pixels are such. Without texture, or with texture in one direction, the third eigenvalue is also noise.
    """

    def __init__(self, task: EstimationInputs) -> None:
        self._tau = float(task.settings.tau)
        # Value that `with_threshold` sets for images without noise.
        self._least = _TAU_OVER_NOISE * _LEAST_NOISE**2 * task.noise.gradient
        self._tried = self._clear = 0

    def add(self, maps: EstimateMaps) -> None:
        """Add the pixels of a group of frames."""
        for frame in range(maps.kind.shape[0]):
            first, third, fourth = (maps.eigenvalues[rank, frame] for rank in (0, 2, 3))
            clear = (third > _CLEAR * fourth) & (third > np.maximum(self._least, _LEAST_SHARE * first))
            self._clear += int(((third <= self._tau) & clear & (maps.kind[frame] < STATUS_VALID)).sum())
            self._tried += int(np.isfinite(third).sum())

    def warn_if_many(self) -> None:
        """Warn if the fraction of such pixels is above the limit."""
        if self._clear > _MANY * self._tried:
            message = (
                f"tau: {self._tau:g} is too high for {100 * self._clear / self._tried:.0f} % of the pixels: their "
                "texture is distinguishable from noise, but below this threshold, so these pixels are invalid; "
                "tau='auto' sets the threshold from the image noise"
            )
            warnings.warn(message, EstimateWarning, stacklevel=_CALLER)


def _sample(task: EstimationInputs, registrations: Sequence[Registration]) -> tuple[float, float]:
    """Return the power of the image noise, from the model residuals at a grid of pixels, and the largest eigenvalue."""
    plain = replace(task, settings=task.settings.model_copy(update={"tau": 0.0}), outputs=task.outputs[:1])
    model, (height, width) = task.noise, task.images.shape[-2:]
    rows, columns = (np.linspace(0, size - 1, _SAMPLES + 2).astype(np.int64)[1:-1] for size in (height, width))
    lines = [(int(y), BestRegistration.empty(1, 1, width)) for y in rows]
    for number, item in enumerate(registrations):
        top, bottom, left, right = common_area(task, item)
        images = shift_by_subpixels(task, item.disparity)
        inside = columns[(columns >= left) & (columns < right)]
        for y, line in lines:
            if top <= y < bottom:
                tiles = np.array([(y, y + 1, x, x + 1) for x in inside], dtype=np.int64).reshape(-1, 4)
                run_kernel(plain, item, CandidateRegistration(number, images, 0.0), tiles, line, y)
    powers, largest = [], 0.0
    for _, line in lines:
        at = (0, 0, np.flatnonzero(line.choice[0, 0] >= 0))
        largest = max(largest, float(line.eigenvalues[0, 0, 0, at[-1]].max(initial=0.0)))
        if task.rig.sees_depth:
            of_unit = model.residual_s[0] + model.residual_s[1] * line.v_x[at] ** 2
            powers.append(line.residual_s[at] / of_unit)
        if task.rig.sees_motion:
            of_unit = model.residual_t[0] + model.residual_t[1] * (line.flow_x[at] ** 2 + line.flow_y[at] ** 2)
            powers.append(line.residual_t[at] / of_unit)
    values = np.concatenate(powers)
    values = values[np.isfinite(values)]
    return (float(max(np.median(values), 0.0)) if values.size else 0.0), largest


def choose_registrations(task: EstimationInputs) -> list[Registration]:
    """Return the registrations: as specified, from the images, or from an estimate at half the resolution."""
    settings, rig, images = task.settings, task.rig, task.images
    frame = int(task.outputs[len(task.outputs) // 2])
    camera = int(np.argmin(np.abs(rig.positions)))
    largest = largest_disparity(task)
    disparity, flow = settings.working_point_px, settings.flow_working_point_px
    if not rig.sees_depth:
        disparity = 0
    if not rig.sees_motion:
        flow = (0, 0)
    coarse: list[Registration] = []
    if settings.pyramid_levels > 0 and (disparity == "per_pixel" or flow == "auto"):
        coarse = [
            Registration(
                disparity if isinstance(disparity, int) else item.disparity,
                flow if flow != "auto" else item.flow,
                item.cells,
                item.fits,
            )
            for item in _coarse_registrations(task, frame, largest)
        ]
    flows: list[tuple[int, int]]
    if flow == "auto":
        frames = images[:, camera, frame - rig.before : frame - rig.before + rig.frames]
        most = find_working_point_of_flow(frames)
        flows = [(0, 0)] if most == (0, 0) else [(0, 0), most]
    else:
        flows = [flow]
    if disparity == "per_pixel":
        along = registrations_along_surfaces(images[:, :, frame], rig.positions, largest)
        # Fine texture is lost in a coarse estimate; the registrations from the full images are included.
        return _merge([*(replace(one, flow=item) for item in flows for one in along), *coarse])
    if disparity == "auto":
        disparity = find_working_point(np.concatenate(images[:, :, frame], axis=1), rig.positions)
    return _merge([*(Registration(int(disparity), item) for item in flows), *coarse])


def _merge(registrations: Iterable[Registration]) -> list[Registration]:
    """Merge the cells of equal registrations."""
    merged: dict[tuple[int, tuple[int, int]], Registration] = {}
    for item in registrations:
        key = (item.disparity, item.flow)
        known = merged.get(key, item)
        merged[key] = replace(item, cells=_either(known.cells, item.cells), fits=_either(known.fits, item.fits))
    return list(merged.values())


def _either(one: NDArray[np.bool_] | None, other: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    return other if one is None or other is None else one | other


def _coarse_registrations(task: EstimationInputs, frame: int, largest: int) -> list[Registration]:
    """Return the registrations from an estimate of one frame at half the resolution."""
    smaller = _halve(task.images[:, :, frame - task.rig.before : frame - task.rig.before + task.rig.frames])
    settings = task.settings.model_copy(
        update={
            "pyramid_levels": task.settings.pyramid_levels - 1,
            "working_point_px": "per_pixel",
            "flow_working_point_px": "auto",
            "tau": 0.0,
        }
    )
    fine = task.intrinsics
    (c_x, c_y), height, width = fine.principal_point_px, *smaller.shape[-2:]
    if axis_problems(settings, 2, 2, width, height):
        return []
    coarse = replace(
        task,
        images=smaller,
        settings=settings,
        intrinsics=replace(fine, focal_length_px=fine.focal_length_px / 2, principal_point_px=(c_x / 2, c_y / 2)),
        outputs=task.rig.outputs(smaller.shape[2]),
    )
    maps = run(coarse, choose_registrations(coarse), None)
    known = maps.kind[0] > 0
    disparity = np.nan_to_num(maps.disparity[0])
    flow = np.nan_to_num(maps.flow[:, 0])
    return registrations_from_coarse(disparity, flow, known, task.images.shape[-2:], largest)


def _halve(images: NDArray[Any]) -> NDArray[np.float32]:
    """Return images smoothed and subsampled by two."""
    weights = np.array([1, 4, 6, 4, 1], dtype=np.float32) / 16
    rows = correlate1d(images.astype(np.float32), weights, axis=-2, mode="nearest")[..., ::2, :]
    return np.ascontiguousarray(correlate1d(rows, weights, axis=-1, mode="nearest")[..., ::2])


# Maps of the estimate: their dimensions in addition to frame and pixels, and their type.
_MAPS: Mapping[str, tuple[tuple[int, ...], DTypeLike]] = {
    "depth": ((), np.float32),
    "velocity": ((3,), np.float32),
    "disparity": ((), np.float32),
    "flow": ((2,), np.float32),
    "divergence": ((), np.float32),
    "status": ((), np.uint8),
    "status_disparity": ((), np.uint8),
    "status_motion": ((), np.uint8),
    "valid": ((), np.bool_),
    "invalid_reason": ((), np.uint8),
    "depth_std": ((), np.float32),
    "velocity_std": ((3,), np.float32),
    "disparity_std": ((), np.float32),
    "coherence": ((), np.float32),
    "registration_disparity": ((), np.float32),
    "eigenvalues": ((5,), np.float32),
}
_IN_PIXELS = ("disparity", "flow", "disparity_std", "registration_disparity")
# Variables whose fields in `EstimateMaps` have other names, which the kernels use.
_FIELDS = {
    "status_disparity": "kind_disparity",
    "status_motion": "kind_motion",
    "coherence": "confidence",
    "registration_disparity": "working_point",
}


def blank_estimate(recording: xr.Dataset, settings: StructureTensorSettings) -> xr.Dataset:
    """Return the estimate of a recording with blank maps."""
    rig = _acquisition_axes(recording, settings)
    outputs = rig.outputs(recording.sizes["t"])
    shape = (len(outputs), recording.sizes["y"], recording.sizes["x"])
    return label(
        "estimate",
        {name: blank_map(dtype, (*components, *shape)) for name, (components, dtype) in _MAPS.items()},
        read_intrinsics(recording),
        t=recording["t"].values[outputs],
        x=recording["x"].values if "x" in recording.coords else None,
        y=recording["y"].values if "y" in recording.coords else None,
        attrs={
            **{key: recording.attrs[key] for key in ("scene", "scene_hash") if key in recording.attrs},
            "method": "structure_tensor",
            "settings": settings.model_dump_json(),
            "filters_s": rig.over_s.name,
            "filters_t": rig.over_t.name,
            "filters_xy": PAPER.name,
            "window_taps_frames": len(rig.window_t),
        },
    )


def fill_estimate(
    recording: xr.Dataset, settings: StructureTensorSettings, put: Put, progress: Progress | None = None
) -> dict[str, Any]:
    """Estimate all maps with the 4D structure tensor (paper, sections 2 to 4) in groups of frames, to limit memory."""
    rig = _acquisition_axes(recording, settings)
    images = FrameReader(recording)
    empty = images.empty_images()
    if empty:
        raise EstimateError(empty)
    # The filters operate on columns and rows of the recording, not on camera pixels.
    grid, intrinsics = compute_pixel_grid(recording), read_intrinsics(recording)
    outputs, groups = rig.outputs(images.shape[2]), _groups(rig, images)
    middle = int(outputs[len(outputs) // 2]) - rig.before
    task = make_inputs(
        images.frames(middle, middle + rig.frames),
        rig,
        _in_columns(settings, grid),
        grid.in_columns(intrinsics),
        float(recording.attrs["full_scale"]),
        read_demosaicing(recording),
    )
    registrations = choose_registrations(task)
    check_common_view(task, registrations)
    task = with_channel_weights(_at(task, images, groups[0]), registrations)
    task, sigma = with_threshold(task, registrations)
    dim, usual = LowTextureCount(task), Counter[int]()
    steps = [step_count(len(group), images.shape[-2:]) * len(registrations) for group in groups]
    for number, group in enumerate(groups):
        entries = None if progress is None else _later(progress, sum(steps[:number]), sum(steps))
        maps = run(_at(task, images, group), registrations, entries)
        if settings.tau != "auto":
            dim.add(maps)
        values, counts = np.unique(maps.working_point[np.isfinite(maps.working_point)], return_counts=True)
        usual.update(dict(zip(values.astype(np.int64).tolist(), counts.tolist(), strict=True)))
        _put(maps, int(group[0]) - rig.before, np.float32(grid.step_px), put, float(task.settings.tau))
        del maps
    if settings.tau != "auto":
        dim.warn_if_many()
    return {
        "working_point_px": _in_pixels(_median(usual, registrations[0].disparity), grid),
        "working_points_px": sorted(
            [_in_pixels(value, grid) for value in (item.disparity, *item.flow)] for item in registrations
        ),
        "tau": float(task.settings.tau),
        **({"noise_std": sigma} if np.isfinite(sigma) else {}),
    }


def _acquisition_axes(recording: xr.Dataset, settings: StructureTensorSettings) -> AcquisitionAxes:
    """Return the axes of a recording; raise if it does not meet the requirements."""
    sizes = recording["image"].sizes
    count_s, count_t = sizes["s"], sizes["t"]
    problems = axis_problems(settings, count_s, count_t, sizes["x"], sizes["y"])
    baseline_mm = read_intrinsics(recording).baseline_mm if count_s > 1 else 1.0
    stage_x_mm = recording["stage_x_mm"].values
    positions = stage_x_mm / baseline_mm
    if np.any(np.diff(positions) <= 1e-6):
        message = "must increase strictly with s in the direction of baseline_mm"
        problems.append(Problem("stage_x_mm", message, stage_x_mm.tolist()))
    elif abs(positions[recording["s"].values == 0][0]) > 1e-6:
        problems.append(Problem("stage_x_mm", "must be 0 at s = 0", stage_x_mm.tolist()))
    if problems:
        raise EstimateError(problems)
    return choose_acquisition_axes(positions, count_t, settings)


def _groups(rig: AcquisitionAxes, images: FrameReader) -> list[NDArray[np.int64]]:
    """Return the frames to estimate, as indices along t, in groups of bounded memory."""
    outputs = rig.outputs(images.shape[2])
    count = frames_at_a_time(images.shape[-2:])
    return [outputs[first : first + count] for first in range(0, len(outputs), count)]


def _at(task: EstimationInputs, images: FrameReader, outputs: NDArray[np.int64]) -> EstimationInputs:
    """Return the inputs for a group of frames, with the images that their filters and windows require."""
    first = int(outputs[0]) - task.rig.before
    window = images.frames(first, first + task.rig.frames + len(outputs) - 1)
    return replace(task, images=window, outputs=outputs - first)


def _later(progress: Progress, before: int, steps: int) -> Progress:
    """Return a progress function that reports the progress of one group as part of all groups."""
    return lambda what, done, _: progress(what, before + done, steps)


def _put(maps: EstimateMaps, first: int, step: np.float32, put: Put, tau: float) -> None:
    """Write the maps of a group of frames from an index along t onwards, in camera pixels."""
    validity = compute_validity({"status": maps.kind, "invalid_reason": _stated_reasons(maps, tau)})
    for name, (components, dtype) in _MAPS.items():
        values = validity[name] if name in validity else getattr(maps, _FIELDS.get(name, name))
        if name in _IN_PIXELS and step != 1:
            values *= step
        for index in range(values.shape[len(components)]):
            put(
                name,
                {"t": first + index},
                values[(*(slice(None) for _ in components), index)].astype(dtype, copy=False),
            )


def _stated_reasons(maps: EstimateMaps, tau: float) -> NDArray[np.uint8]:
    """Return the reasons for invalidity that follow from the structure tensor; 0 where none follows.

    Without eigenvalues, the filters and the window of the pixel do not lie inside the registered images. If the largest
    eigenvalue is below the threshold, there is no texture. A valid normal component alone indicates texture in one
    direction. An eigenvalue in excess of those of the texture contradicts a single surface with a single motion.
    """
    largest = maps.eigenvalues[0]
    # After resampling, a pixel may also be invalid because its neighbour is.
    border = REASONS.index("border" if maps.shift.size == 0 else "not_determined")
    reason = np.where(np.isfinite(largest), 0, border).astype(np.uint8)
    reason[largest <= tau] = REASONS.index("low_texture")
    reason[maps.kind_motion == STATUS_NORMAL] = REASONS.index("ambiguous_match")
    reason[maps.model_violation > 0] = REASONS.index("model_violation")
    return reason


def _median(counts: Mapping[int, int], otherwise: int) -> int:
    """Return the median of integers, rounded towards zero, from their counts."""
    if not counts:
        return otherwise
    values = np.array(sorted(counts))
    upto = np.cumsum([counts[value] for value in values.tolist()])
    middle = [values[np.searchsorted(upto, place, side="right")] for place in ((upto[-1] - 1) // 2, upto[-1] // 2)]
    return int(sum(middle) / 2)


def _in_columns(settings: StructureTensorSettings, grid: PixelGrid) -> StructureTensorSettings:
    """Return settings with the registration shifts in columns of the recording, rounded."""
    disparity, flow = settings.working_point_px, settings.flow_working_point_px
    return settings.model_copy(
        update={
            "working_point_px": disparity if isinstance(disparity, str) else round(disparity / grid.step_px),
            "flow_working_point_px": flow if isinstance(flow, str) else tuple(round(u / grid.step_px) for u in flow),
        }
    )


def _in_pixels(columns: int, grid: PixelGrid) -> int | float:
    """Return a number of columns in camera pixels, as an integer if possible."""
    pixels = columns * grid.step_px
    return round(pixels) if pixels == round(pixels) else pixels
