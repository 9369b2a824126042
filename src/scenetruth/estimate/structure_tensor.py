"""The paper's estimator: one 4D structure tensor gives disparity and 3D motion of every pixel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimate.filters import DERIVATIVE, SMOOTHING, gaussian_window
from scenetruth.estimate.working_point import find_working_point, register
from scenetruth.recording import (
    KIND_FULL,
    KIND_NONE,
    KIND_NORMAL,
    Intrinsics,
    image_to_grey,
    intrinsics_of,
    label,
)
from scenetruth.settings import EstimateSettings

__all__ = ["estimate_structure_tensor", "null_space_solutions", "requirements", "structure_tensor"]

Progress = Callable[[str, int, int], None]
Array = NDArray[np.float64]

_REACH = len(DERIVATIVE) // 2


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
    grey = image_to_grey(recording)
    if not np.isfinite(grey).all():
        count = int((~np.isfinite(grey)).sum())
        problems.append(Problem("image", f"holds {count} values that are not finite; the filters would spread them"))
    if problems:
        raise EstimateError(problems)
    middle = int(np.flatnonzero(s == 0)[0])
    reference = int(np.flatnonzero(recording["t"].values == 0)[0])
    shift = settings.working_point_px
    if shift == "auto":
        shift = find_working_point(grey[:, reference])
    first, last = _REACH * abs(shift), width - _REACH * abs(shift)
    reach = _REACH + settings.window_taps_px // 2
    if last - first < 2 * reach + 1:
        message = f"images registered by {shift} px per step share only {max(last - first, 0)} columns"
        raise EstimateError(
            [Problem("estimate.working_point_px", f"{message}; filters and window need {2 * reach + 1}")]
        )
    cameras = slice(middle - _REACH, middle + _REACH + 1)
    frames = _output_frames(recording["t"].values, settings)
    intrinsics = intrinsics_of(recording)
    maps = _empty_maps(len(frames), height, width)
    inner = (slice(reach, height - reach), slice(first + reach, last - reach))
    derivatives = _FrameDerivatives(grey[cameras], shift, first, last)
    for index, frame in enumerate(frames):
        if progress is not None:
            progress("estimate", index, len(frames))
        gradients = derivatives.around(frame, settings.window_taps_frames)
        tensor = structure_tensor(gradients, settings)[reach : height - reach, reach : last - first - reach]
        _solve(
            tensor,
            settings.tau,
            intrinsics,
            shift,
            inner,
            {name: array[..., index, :, :] for name, array in maps.items()},
        )
        derivatives.forget(frame)
    if progress is not None:
        progress("estimate", len(frames), len(frames))
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


def _stage_problems(s: NDArray[np.int64], positions: Array, baseline: float) -> list[Problem]:
    if 0 not in s[_REACH : len(s) - _REACH]:
        return [Problem("s", f"needs {_REACH} cameras on each side of the reference 0", s.tolist())]
    if not np.allclose(positions, baseline * s, rtol=0, atol=1e-6 * abs(baseline)):
        message = "must be equidistant, baseline_mm apart, for the derivative filter in s"
        return [Problem("stage_x_mm", message, positions.tolist())]
    return []


def _output_frames(t: NDArray[np.int64], settings: EstimateSettings) -> NDArray[np.int64]:
    margin = _REACH + settings.window_taps_frames // 2
    return np.arange(margin, len(t) - margin)


def _empty_maps(count: int, height: int, width: int) -> dict[str, NDArray[np.generic]]:
    shape = (count, height, width)
    return {
        "depth": np.full(shape, np.nan),
        "velocity": np.full((3, *shape), np.nan),
        "disparity": np.full(shape, np.nan),
        "flow": np.full((2, *shape), np.nan),
        "kind": np.full(shape, KIND_NONE, dtype=np.uint8),
        "confidence": np.zeros(shape, dtype=np.float32),
        "eigenvalues": np.full((5, *shape), np.nan, dtype=np.float32),
    }


class _FrameDerivatives:
    """Derivatives of registered images, frame by frame; frames that several estimates share are made once."""

    def __init__(self, grey: NDArray[np.float32], shift: int, first: int, last: int) -> None:
        self._grey, self._shift, self._columns = grey, shift, (first, last)
        self._reduced: dict[int, tuple[Array, Array]] = {}
        self._made: dict[int, tuple[Array, Array, Array, Array]] = {}

    def around(self, frame: int, taps: int) -> list[tuple[Array, Array, Array, Array]]:
        """Return (g_x, g_y, g_s, g_t) of the frames inside the window around a frame, shape (y, x) each."""
        half = taps // 2
        return [self._derive(other) for other in range(frame - half, frame + half + 1)]

    def forget(self, frame: int) -> None:
        """Drop what estimates after this frame do not need."""
        for store in (self._reduced, self._made):
            for old in [other for other in store if other < frame - 2 * _REACH]:
                del store[old]

    def _over_s(self, frame: int) -> tuple[Array, Array]:
        """Return the images of a frame smoothed, and derived, along s at the middle camera."""
        if frame not in self._reduced:
            stack = np.stack(
                [
                    register(self._grey[_REACH + s, frame], s * self._shift, *self._columns)
                    for s in range(-_REACH, _REACH + 1)
                ]
            ).astype(np.float64)
            # Convolution: the kernel runs against the samples.
            self._reduced[frame] = (
                np.tensordot(SMOOTHING[::-1], stack, 1),
                np.tensordot(DERIVATIVE[::-1], stack, 1),
            )
        return self._reduced[frame]

    def _derive(self, frame: int) -> tuple[Array, Array, Array, Array]:
        if frame not in self._made:
            near = [self._over_s(frame + offset) for offset in range(-_REACH, _REACH + 1)]
            smooth = sum(weight * one for weight, (one, _) in zip(SMOOTHING[::-1], near, strict=True))
            over_s = sum(weight * two for weight, (_, two) in zip(SMOOTHING[::-1], near, strict=True))
            over_t = sum(weight * one for weight, (one, _) in zip(DERIVATIVE[::-1], near, strict=True))
            self._made[frame] = (
                _along(_along(smooth, DERIVATIVE, 1), SMOOTHING, 0),
                _along(_along(smooth, SMOOTHING, 1), DERIVATIVE, 0),
                _along(_along(over_s, SMOOTHING, 1), SMOOTHING, 0),
                _along(_along(over_t, SMOOTHING, 1), SMOOTHING, 0),
            )
        return self._made[frame]


def _along(image: Array, kernel: Array, axis: int) -> Array:
    """Convolve an image with a kernel along one axis."""
    filtered: Array = correlate1d(image, kernel[::-1], axis=axis, mode="nearest")
    return filtered


def structure_tensor(gradients: list[tuple[Array, Array, Array, Array]], settings: EstimateSettings) -> Array:
    """Sum up the structure tensor J = Σ w d dᵀ over the window (paper eq. 12).

    Parameters
    ----------
    gradients
        (g_x, g_y, g_s, g_t) of every frame inside the window, shape (y, x) each.
    settings
        The window.

    Returns
    -------
    numpy.ndarray
        J of d = (g_x, g_y, g_x ξ + g_y η, g_s, g_t), shape (y, x, 5, 5). The local coordinates ξ, η count from each
        window's own centre, so that the sums with them are filters with the kernels w, w ξ and w ξ².
    """
    over_t = gaussian_window(settings.window_sigma_frames, settings.window_taps_frames)
    window = gaussian_window(settings.window_sigma_px, settings.window_taps_px)
    local = np.arange(len(window)) - len(window) // 2
    kernels = (window, window * local, window * local**2)

    def product(a: int, b: int) -> Array:
        return np.asarray(sum(weight * frame[a] * frame[b] for weight, frame in zip(over_t, gradients, strict=True)))

    def weigh(image: Array, order_x: int, order_y: int) -> Array:
        rows: Array = correlate1d(image, kernels[order_x], axis=1, mode="constant")
        both: Array = correlate1d(rows, kernels[order_y], axis=0, mode="constant")
        return both

    x, y, s, t = range(4)
    tensor = np.empty((*gradients[0][0].shape, 5, 5))

    def put(i: int, j: int, values: Array) -> None:
        tensor[..., i, j] = tensor[..., j, i] = values

    xx, xy, yy = product(x, x), product(x, y), product(y, y)
    put(0, 0, weigh(xx, 0, 0))
    put(0, 1, weigh(xy, 0, 0))
    put(1, 1, weigh(yy, 0, 0))
    put(0, 2, weigh(xx, 1, 0) + weigh(xy, 0, 1))
    put(1, 2, weigh(xy, 1, 0) + weigh(yy, 0, 1))
    put(2, 2, weigh(xx, 2, 0) + 2 * weigh(xy, 1, 1) + weigh(yy, 0, 2))
    for index, other in ((3, s), (4, t)):
        xo, yo = product(x, other), product(y, other)
        put(0, index, weigh(xo, 0, 0))
        put(1, index, weigh(yo, 0, 0))
        put(2, index, weigh(xo, 1, 0) + weigh(yo, 0, 1))
    put(3, 3, weigh(product(s, s), 0, 0))
    put(3, 4, weigh(product(s, t), 0, 0))
    put(4, 4, weigh(product(t, t), 0, 0))
    return tensor


def null_space_solutions(vectors: Array, rank: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the parameter vectors p_s (dt = 0, ds = 1) and p_t (ds = 0, dt = 1) of least norm in the null space.

    For a null space of two dimensions, spanned by a and b, these are the paper's combinations a b5 - b a5 and
    a b4 - b a4, scaled; of a larger null space (aperture problem) it is the one of least norm. With P the projector on
    the null space and A the block of its rows and columns 4 and 5, both are the columns of P[:, 4:5] A⁻¹.

    Parameters
    ----------
    vectors
        Eigenvectors in columns, by falling eigenvalue, shape (n, 5, 5).
    rank
        Dimension of the data space (0 to 3), shape (n,).

    Returns
    -------
    tuple
        p_s and p_t, shape (n, 5) each; NaN where the null space does not reach ds or dt.
    """
    data = vectors * (np.arange(5) < rank[:, None])[:, None, :]
    projector = np.eye(5) - data @ np.swapaxes(data, 1, 2)
    a, b, c = projector[:, 3, 3], projector[:, 3, 4], projector[:, 4, 4]
    determinant = a * c - b * b
    safe = np.where(determinant > 1e-12, determinant, np.nan)[:, None]
    column_s, column_t = projector[:, :, 3], projector[:, :, 4]
    p_s = (column_s * c[:, None] - column_t * b[:, None]) / safe
    p_t = (column_t * a[:, None] - column_s * b[:, None]) / safe
    return p_s, p_t


def _solve(
    tensor: Array,
    tau: float,
    intrinsics: Intrinsics,
    shift: int,
    inner: tuple[slice, slice],
    maps: dict[str, NDArray[np.generic]],
) -> None:
    """Fill the maps of one frame from the tensors of the pixels that the window reaches."""
    shape = tensor.shape[:2]
    values, vectors = np.linalg.eigh(tensor.reshape(-1, 5, 5))
    values, vectors = values[:, ::-1], vectors[:, :, ::-1]
    above = (values > tau).sum(axis=1)
    p_s, p_t = null_space_solutions(vectors, np.minimum(above, 3))
    y, x = (axis.ravel() for axis in np.mgrid[inner])
    focal, (c_x, c_y) = intrinsics.focal_length_px, intrinsics.principal_point_px
    x0, y0 = x - c_x, y - c_y
    with np.errstate(divide="ignore", invalid="ignore"):
        # Registered by d, an image point moves by v_x + d per step of s.
        disparity = shift - p_s[:, 0] / p_s[:, 3]
        flow = p_t[:, :2] / p_t[:, 4:]
        u_z = p_t[:, 2] / p_t[:, 4]
        depth = focal * intrinsics.baseline_mm / disparity
        u_x, u_y = flow[:, 0] - x0 * u_z, flow[:, 1] - y0 * u_z
        velocity = np.stack([u_x * depth / focal, u_y * depth / focal, -u_z * depth])
        gap = (values[:, 2] - values[:, 3]) / (values[:, 2] + values[:, 3])
    kind = np.select([above >= 3, above > 0], [KIND_FULL, KIND_NORMAL], KIND_NONE)
    known = (kind != KIND_NONE) & np.isfinite(depth) & (depth > 0) & np.isfinite(velocity).all(axis=0)
    kind[~known] = KIND_NONE
    results = {"depth": depth, "disparity": disparity, "velocity": velocity, "flow": flow.T}
    for name, result in results.items():
        maps[name][..., *inner] = np.where(known, result, np.nan).reshape(*result.shape[:-1], *shape)
    maps["kind"][inner] = kind.reshape(shape)
    maps["confidence"][inner] = np.where(known, np.nan_to_num(gap.clip(0, 1)) ** 2, 0).reshape(shape)
    maps["eigenvalues"][..., *inner] = values.T.reshape(5, *shape)
