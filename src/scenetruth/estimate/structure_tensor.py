"""The paper's estimator: one 4D structure tensor gives disparity and 3D motion of every pixel."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimate.filters import DERIVATIVE, DERIVATIVE_MOMENT, SMOOTHING, gaussian_window
from scenetruth.estimate.working_point import find_working_point
from scenetruth.recording import (
    KIND_FULL,
    KIND_NONE,
    KIND_NORMAL,
    Intrinsics,
    intrinsics_of,
    label,
)
from scenetruth.settings import EstimateSettings

__all__ = ["estimate_structure_tensor", "requirements"]

Progress = Callable[[str, int, int], None]
Array = NDArray[np.float64]
Maps = dict[str, NDArray[np.generic]]

_REACH = len(DERIVATIVE) // 2
# A tile with its border needs about 15 MB of scratch.
_TILE_ROWS, _TILE_COLUMNS = 128, 512


def requirements(settings: EstimateSettings, cameras: int, frames: int, width: int, height: int) -> list[Problem]:
    """Return what keeps the filters and the window from fitting into a recording of this size."""
    border = 2 * _REACH + settings.window_taps_px
    needed_frames = 2 * _REACH + settings.window_taps_frames
    problems = []
    if cameras < len(DERIVATIVE):
        problems.append(
            Problem("stage.positions", f"too few cameras: the filters need {len(DERIVATIVE)} positions", cameras)
        )
    if frames < needed_frames:
        message = f"too few frames: filters and window need {needed_frames} for one estimate in time"
        problems.append(Problem("frames.count", message, frames))
    for name, size in (("camera.width", width), ("camera.height", height)):
        if size < border:
            problems.append(Problem(name, f"too small: filters and window need {border} px", size))
    return problems


def estimate_structure_tensor(
    recording: xr.Dataset, settings: EstimateSettings, progress: Progress | None = None
) -> xr.Dataset:
    """Estimate depth, disparity, flow and velocity with the 4D structure tensor (paper, sections 2 to 4).

    Parameters
    ----------
    recording
        A checked recording.
    settings
        Window, threshold and working point.
    progress
        Called with (what, done, total).

    Returns
    -------
    xarray.Dataset
        An estimate for every frame whose window lies inside the recording. Pixels whose filters and window do not lie
        inside the registered images are NaN with ``kind`` none.

    Raises
    ------
    EstimateError
        If the recording is too small for the filters, or the working point leaves no common view.
    """
    count_s, count_t, height, width = recording["image"].shape
    problems = requirements(settings, count_s, count_t, width, height)
    positions = recording["stage_x_mm"].values
    s = recording["s"].values
    if not problems:
        problems = _stage_problems(s, positions, recording.attrs["baseline_mm"])
    images = _plain_images(recording)
    missing = sum(int((~np.isfinite(camera)).sum()) for camera in images) if images.dtype.kind == "f" else 0
    if missing:
        problems.append(
            Problem("image", f"holds {missing} values that are not finite in float32; the filters would spread them")
        )
    if problems:
        raise EstimateError(problems)
    middle = int(np.flatnonzero(s == 0)[0])
    shift = settings.working_point_px
    if shift == "auto":
        reference = int(np.flatnonzero(recording["t"].values == 0)[0])
        shift = find_working_point(images[:, reference])
    first, last = _REACH * abs(shift), width - _REACH * abs(shift)
    reach = _REACH + settings.window_taps_px // 2
    if last - first < 2 * reach + 1:
        message = f"images registered by {shift} px per step share only {max(last - first, 0)} columns"
        raise EstimateError(
            [Problem("estimate.working_point_px", f"{message}; filters and window need {2 * reach + 1}")]
        )
    frames = _output_frames(count_t, settings)
    maps = _empty_maps(len(frames), height, width)
    if progress is not None:
        progress("estimate", 0, len(frames))
    _run_kernel(images, middle - _REACH, shift, (first, last), recording.attrs["full_scale"], settings, maps)
    intrinsics = intrinsics_of(recording)
    for index in range(len(frames)):
        _finish({name: array[..., index, :, :] for name, array in maps.items()}, intrinsics)
        if progress is not None:
            progress("estimate", index + 1, len(frames))
    return label(
        "estimate",
        maps,
        intrinsics,
        t=recording["t"].values[frames],
        attrs={
            **{key: recording.attrs[key] for key in ("scene", "scene_hash") if key in recording.attrs},
            "method": "structure_tensor",
            "settings": settings.model_dump_json(),
            "working_point_px": int(shift),
        },
    )


def _plain_images(recording: xr.Dataset) -> NDArray[Any]:
    """Return the images in a form that the kernels know: uint8 or uint16 as recorded, all else in float32."""
    images = recording["image"].values
    native = images.dtype.newbyteorder("=")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(images, dtype=native if native in (np.uint8, np.uint16) else np.float32)


def _stage_problems(s: NDArray[np.int64], positions: Array, baseline: float) -> list[Problem]:
    if 0 not in s[_REACH : len(s) - _REACH]:
        return [Problem("s", f"needs {_REACH} cameras on each side of the reference 0", s.tolist())]
    if not np.allclose(positions, baseline * s, rtol=0, atol=1e-6 * abs(baseline)):
        message = "must be equidistant, baseline_mm apart, for the derivative filter in s"
        return [Problem("stage_x_mm", message, positions.tolist())]
    return []


def _output_frames(count: int, settings: EstimateSettings) -> NDArray[np.int64]:
    margin = _REACH + settings.window_taps_frames // 2
    return np.arange(margin, count - margin)


def _empty_maps(count: int, height: int, width: int) -> Maps:
    shape = (count, height, width)
    return {
        "depth": np.full(shape, np.nan),
        "velocity": np.full((3, *shape), np.nan),
        "disparity": np.full(shape, np.nan),
        "flow": np.full((2, *shape), np.nan),
        "kind": np.zeros(shape, dtype=np.uint8),
        "confidence": np.zeros(shape, dtype=np.float32),
        "eigenvalues": np.full((5, *shape), np.nan, dtype=np.float32),
    }


def _run_kernel(
    images: NDArray[Any],
    camera: int,
    shift: int,
    columns: tuple[int, int],
    full_scale: float,
    settings: EstimateSettings,
    maps: Maps,
) -> None:
    """Fill disparity, flow and eigenvalues; leave u_z in the Z component of velocity, the rank in kind."""
    import numba

    from scenetruth.estimate.tensor_kernels import estimate_tiles

    # The paper's kernels are convolutions: they run against the samples.
    filters = np.array([SMOOTHING[::-1], DERIVATIVE[::-1], DERIVATIVE_MOMENT[::-1]], dtype=np.float32)
    # Grey values in [-1, 1] are 2 image / full scale - 1; the filters take no notice of the constant.
    # The divergence term counts x from each camera's own principal point: in registered images that is x - shift s.
    tilt = -shift * np.arange(-_REACH, _REACH + 1) * SMOOTHING
    over_s = (np.array([SMOOTHING[::-1], DERIVATIVE[::-1], tilt]) * (2 / full_scale)).astype(np.float32)
    window = gaussian_window(settings.window_sigma_px, settings.window_taps_px)
    local = np.arange(len(window)) - len(window) // 2
    reach = _REACH + len(window) // 2
    estimate_tiles(
        images,
        camera,
        shift,
        columns[0],
        _tiles(images.shape[2] - 2 * reach, columns[1] - columns[0] - 2 * reach, numba.get_num_threads()),
        filters,
        over_s,
        gaussian_window(settings.window_sigma_frames, settings.window_taps_frames).astype(np.float32),
        np.array([window, window * local, window * local**2], dtype=np.float32),
        settings.divergence == "consistent",
        settings.tau,
        maps["disparity"],
        maps["flow"],
        maps["velocity"][2],
        maps["eigenvalues"],
        maps["kind"],
    )


def _tiles(rows: int, columns: int, threads: int) -> NDArray[np.int64]:
    """Cut the output into tiles: several for each thread, and small enough for the processor's caches."""
    row_edges = _edges(rows, max(2 * threads, -(-rows // _TILE_ROWS)))
    column_edges = _edges(columns, -(-columns // _TILE_COLUMNS))
    return np.array(
        [(*across, *along) for across in pairwise(row_edges) for along in pairwise(column_edges)], dtype=np.int64
    )


def _edges(size: int, count: int) -> list[int]:
    return [int(edge) for edge in np.linspace(0, size, min(count, size) + 1)]


def _finish(maps: dict[str, Any], intrinsics: Intrinsics) -> None:
    """Turn what the kernel left into world coordinates (paper, end of section 3), kind and confidence, in place."""
    focal, (c_x, c_y) = intrinsics.focal_length_px, intrinsics.principal_point_px
    height, width = maps["depth"].shape
    x0, y0 = np.arange(width) - c_x, (np.arange(height) - c_y)[:, None]
    depth, velocity, flow, above = maps["depth"], maps["velocity"], maps["flow"], maps["kind"]
    values = maps["eigenvalues"]
    with np.errstate(divide="ignore", invalid="ignore"):
        np.divide(focal * intrinsics.baseline_mm, maps["disparity"], out=depth)
        u_z = velocity[2].copy()
        velocity[0] = (flow[0] - x0 * u_z) * depth / focal
        velocity[1] = (flow[1] - y0 * u_z) * depth / focal
        velocity[2] = -u_z * depth
        gap = (values[2] - values[3]) / (values[2] + values[3])
    known = (above > 0) & np.isfinite(depth) & (depth > 0) & np.isfinite(velocity).all(axis=0)
    maps["confidence"][known] = np.nan_to_num(gap[known].clip(0, 1)) ** 2
    above[:] = np.select([~known, above >= 3], [KIND_NONE, KIND_FULL], KIND_NORMAL)
    for name in ("depth", "disparity", "velocity", "flow"):
        maps[name][..., ~known] = np.nan
