"""Construction of estimates from arrays."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenetruth.errors import EstimateWarning, Problem, RecordingError
from scenetruth.lazy_exports import lazy_module
from scenetruth.number_format import format_two_digits
from scenetruth.schema.attributes import Intrinsics, estimate_hash, read_intrinsics
from scenetruth.schema.input_arrays import order_problems, real_array
from scenetruth.schema.pixel_grid import compute_pixel_grid
from scenetruth.schema.plausible_units import describe_estimated_depth
from scenetruth.schema.scene_flow import depth_from_disparity, depth_rate_along, flow_from_velocity, velocity_from_flow
from scenetruth.schema.validation import check_dataset
from scenetruth.schema.validity import STATUS_SOURCES, compute_validity, excluded_pixels, status_of_quantity
from scenetruth.schema.variables import STATUS_FALLBACK, STATUS_INVALID, STATUS_VALID, label

if TYPE_CHECKING:
    import xarray as xr
else:
    xr = lazy_module("xarray")

__all__ = ["assemble_estimate", "make_estimate"]

Map = NDArray[np.float64]

_COMPONENTS = {"flow": 2, "velocity": 3, "velocity_std": 3}
_STANDARD_DEVIATIONS = ("depth_std", "disparity_std", "velocity_std")
_QUANTITIES = ("depth", "disparity", "flow", "velocity", *_STANDARD_DEVIATIONS)
_ATTRIBUTES = ("scene", "scene_hash", "recording_hash")


def make_estimate(
    *,
    recording: xr.Dataset,
    depth: ArrayLike | None = None,
    disparity: ArrayLike | None = None,
    flow: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    depth_rate: ArrayLike | None = None,
    depth_std: ArrayLike | None = None,
    disparity_std: ArrayLike | None = None,
    velocity_std: ArrayLike | None = None,
    status: ArrayLike | None = None,
    t: ArrayLike | None = None,
    method: str = "external",
) -> xr.Dataset:
    """Create an estimate from arrays and derive dependent quantities.

    Arrays have the shape (t, y, x), or (y, x) for a single frame; the components of flow (dx, dy) and velocity (X, Y,
    Z) form the first dimension. Invalid pixels are NaN. At least one of ``depth``, ``disparity``, ``flow`` and
    ``velocity`` is required.

    - Depth and disparity are converted into each other: d = f V_X / Z.
    - With depth, velocity is computed from flow and the rate of depth: U_X = (Z u + x U_Z) / f and likewise U_Y, with x
      relative to the principal point. If ``depth_rate`` is not given, it is estimated from the depth of neighbouring
      frames along the flow where available.
    - With depth, flow is computed from velocity.

    Parameters
    ----------
    recording
        The recording that the arrays were computed from. It defines frames, pixels and intrinsics. For a cropped or
        subsampled recording, disparity and flow remain in pixels of the full-resolution camera.
    depth
        Z along the optical axis in mm; positive.
    disparity
        In px per step of s, x_s = x_0 - disparity s: positive if ``baseline_mm`` is.
    flow
        (dx/dt, dy/dt) in px per frame; x to the right, y down.
    velocity
        (U_X, U_Y, U_Z) in mm per frame; U_Z < 0 is towards the camera.
    depth_rate
        U_Z alone, the rate of depth of the surface point in mm per frame.
    depth_std, disparity_std, velocity_std
        Standard deviations, in the same units; not negative.
    status
        Status of each pixel: 0 invalid, 1 normal component only (aperture problem), 2 valid, 3 fallback. By default,
        all finite values are valid.
    t
        Frame indices of the arrays. Default: all frames of the recording, or the reference frame for a single map.
    method
        Name of the method that computed the arrays.

    Returns
    -------
    xarray.Dataset
        An estimate with coordinates, units and intrinsics, float32; the input arrays are copied.

    Raises
    ------
    RecordingError
        If an array has an invalid shape, type, sign, frame or infinite values; lists every problem.

    Warns
    -----
    EstimateWarning
        If the median depth indicates another unit, as for `estimate`.

    See Also
    --------
    estimate : Run an installed method.

    Examples
    --------
    >>> from scenetruth.schema import make_recording
    >>> recording = make_recording(np.zeros((2, 2, 3, 4)), focal_length_px=500, baseline_mm=5)
    >>> depth, flow = np.full((3, 4), 1000.0), np.ones((2, 3, 4))
    >>> found = make_estimate(recording=recording, depth=depth, flow=flow, depth_rate=0.0)
    >>> float(found.disparity[0, 0, 0]), found.velocity[:, 0, 0, 0].values.tolist(), found.t.values.tolist()
    (2.5, [2.0, 2.0, 0.0], [0])
    """
    made = assemble_estimate(
        recording=recording,
        depth=depth,
        disparity=disparity,
        flow=flow,
        velocity=velocity,
        depth_rate=depth_rate,
        depth_std=depth_std,
        disparity_std=disparity_std,
        velocity_std=velocity_std,
        status=status,
        t=t,
        method=method,
    )
    if "depth" in made:
        finite = made["depth"].values[np.isfinite(made["depth"].values)]
        if finite.size:
            for message in describe_estimated_depth(float(np.median(finite)), recording):
                warnings.warn(message, EstimateWarning, stacklevel=2)
    return made


def assemble_estimate(
    *,
    recording: xr.Dataset,
    depth_rate: ArrayLike | None = None,
    status: ArrayLike | None = None,
    t: ArrayLike | None = None,
    method: str = "external",
    **quantities: ArrayLike | None,
) -> xr.Dataset:
    """Create an estimate as `make_estimate` does, without a judgement of its values."""
    check_dataset(recording, "recording")
    if not isinstance(method, str) or not method.isprintable():
        raise RecordingError([Problem("method", "must be printable text", method)], source="arrays of an estimate")
    given = {name: quantities.pop(name, None) for name in _QUANTITIES}
    if quantities:
        message = f"assemble_estimate() got an unexpected keyword argument '{next(iter(quantities))}'"
        raise TypeError(message)
    size = (recording.sizes["y"], recording.sizes["x"])
    problems: list[Problem] = []
    arrays = {
        name: found
        for name, values in given.items()
        if values is not None and (found := _array(name, values, size, problems)) is not None
    }
    if all(given[name] is None for name in ("depth", "disparity", "flow", "velocity")):
        problems.append(Problem("", "at least one of depth, disparity, flow, velocity is required"))
    frames = _frames(recording, arrays, t, problems)
    if problems:
        raise RecordingError(problems, source="arrays of an estimate")
    intrinsics = read_intrinsics(recording)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        _drop_impossible(arrays, intrinsics)
        problems = _sign_problems(arrays, intrinsics)
    shape = (len(frames), *size)
    rate = None if depth_rate is None else _rate(depth_rate, shape, problems)
    given_status = None if status is None else _status(status, shape, problems)
    if problems:
        raise RecordingError(problems, source="arrays of an estimate")
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        _derive(arrays, intrinsics, frames, rate, recording)
        for name, values in arrays.items():
            # Values derived from near-zero inputs may overflow float32 and are then invalid.
            arrays[name] = np.where(np.abs(values) <= np.finfo(np.float32).max, values, np.nan)
    maps: dict[str, NDArray[Any]] = {name: values.astype(np.float32) for name, values in arrays.items()}
    x, y = (recording[name].values if name in recording.coords else None for name in ("x", "y"))
    statuses = _statuses(arrays, given_status, shape)
    validity = compute_validity(statuses, excluded_pixels(recording, frames))
    made = label("estimate", maps | statuses | validity, intrinsics, t=frames, x=x, y=y)
    made.attrs |= {key: recording.attrs[key] for key in _ATTRIBUTES if key in recording.attrs} | {"method": method}
    made.attrs["estimate_hash"] = estimate_hash(made)
    check_dataset(made, "estimate")
    return made


def _array(name: str, values: ArrayLike, size: tuple[int, int], problems: list[Problem]) -> Map | None:
    """Return an array as float64 with a frame dimension, or None after appending a problem."""
    if isinstance(values, xr.DataArray):
        disordered = order_problems(name, values)
        if disordered:
            problems += disordered
            return None
        # Dimensions of these names are in any order; an array with other names is read in the order of its dimensions.
        usual = ("component", "image_component", "t", "y", "x")
        if {"y", "x"} <= set(values.dims) <= set(usual):
            values = values.transpose(*(dim for dim in usual if dim in values.dims))
    raw = real_array(name, values, problems, masked_is_nan=True)
    if raw is None:
        return None
    shape = raw.shape
    count = _COMPONENTS.get(name)
    lead = () if count is None else (count,)
    names = f"({'' if count is None else f'{count}, '}t, y, x)"
    if raw.ndim == len(lead) + 2:
        raw = raw.reshape(*raw.shape[: len(lead)], 1, *raw.shape[len(lead) :])
    if raw.ndim != len(lead) + 3 or raw.shape[: len(lead)] != lead or raw.shape[-2:] != size:
        message = f"must have the shape {names}, or that without t, with the recording's (y, x) = {size}"
        if count is not None and shape[-1:] == (count,) and shape[-3:-1] == size:
            message += "; components are in the last dimension: move them to the front with np.moveaxis(array, -1, 0)"
        elif raw.shape[-2:] == size[::-1] != size:
            message += "; rows and columns appear to be swapped"
        problems.append(Problem(name, message, shape))
        return None
    if raw.size == 0:
        problems.append(Problem(name, "is empty", shape))
        return None
    # Estimates are float32.
    infinite = int((np.abs(raw) > np.finfo(np.float32).max).sum())
    if infinite:
        problems.append(
            Problem(name, f"holds {infinite} values that are infinite or exceed float32; mark invalid pixels as NaN")
        )
        return None
    return raw.astype(np.float64)


def _frames(
    recording: xr.Dataset, arrays: dict[str, Map], t: ArrayLike | None, problems: list[Problem]
) -> NDArray[np.int64]:
    counts = {name: values.shape[-3] for name, values in arrays.items()}
    recorded = recording["t"].values
    if len(set(counts.values())) > 1:
        problems.append(Problem("", "arrays have different numbers of frames", counts))
        return recorded[:0].astype(np.int64)
    count = next(iter(counts.values()), 0)
    if t is not None:
        given = real_array("t", t, problems)
        if given is None or given.dtype.kind == "f" or given.ndim > 1 or given.size == 0:
            if given is not None:
                problems.append(Problem("t", "must be a frame index or a list of frame indices", t))
            return recorded[:0].astype(np.int64)
        frames = np.array(np.atleast_1d(given), dtype=np.int64)
        if len(set(frames.tolist())) < len(frames):
            problems.append(Problem("t", "contains duplicate frames", frames.tolist()))
        missing = sorted(set(frames.tolist()) - set(recorded.tolist()))
        if missing:
            problems.append(Problem("t", f"not in the recording, whose frames are {recorded.tolist()}", missing))
        if counts and len(frames) != count:
            problems.append(Problem("t", f"has {len(frames)} frames, but the arrays have {count}", frames.tolist()))
        return frames
    if count == 1:
        return np.zeros(1, dtype=np.int64)
    if counts and count != len(recorded):
        message = f"arrays have {count} frames, the recording {len(recorded)}: specify the frames with t="
        problems.append(Problem("t", message))
    return np.asarray(recorded, dtype=np.int64)


def _drop_impossible(arrays: dict[str, Map], intrinsics: Intrinsics) -> None:
    """Make pixels without a positive depth invalid, with a warning, if they are fewer than half; more are an error."""
    signs = {"depth": 1.0, "disparity": float(np.sign(intrinsics.baseline_mm))}
    for name, sign in signs.items():
        if name not in arrays or sign == 0:
            continue
        wrong = arrays[name] * sign <= 0
        count, known = int(wrong.sum()), int(np.isfinite(arrays[name]).sum())
        if 0 < count <= _MOST_IMPOSSIBLE * known:
            arrays[name] = np.where(wrong, np.nan, arrays[name])
            what = "positive" if sign > 0 else "negative"
            message = (
                f"{name}: {count} of {known} finite pixels "
                f"({format_two_digits(100 * count / known)} %) are not {what}: invalid"
            )
            warnings.warn(message, EstimateWarning, stacklevel=3)


_MOST_IMPOSSIBLE = 0.5  # share of pixels without a positive depth that are invalid; more have another sign convention


def _sign_problems(arrays: dict[str, Map], intrinsics: Intrinsics) -> list[Problem]:
    problems = []
    if "depth" in arrays and (arrays["depth"] <= 0).any():
        count = int((arrays["depth"] <= 0).sum())
        problems.append(Problem("depth", f"must be positive: {count} pixels are not; mark invalid pixels as NaN"))
    if "disparity" in arrays and intrinsics.baseline_mm != 0:
        wrong = arrays["disparity"] * np.sign(intrinsics.baseline_mm) <= 0
        count = int(wrong.sum())
        if count:
            sign = "positive" if intrinsics.baseline_mm > 0 else "negative"
            known = int(np.isfinite(arrays["disparity"]).sum())
            message = f"must be {sign} (x_s = x_0 - disparity s): {count} of {known} finite pixels are not"
            message += "; change the sign" if count == known else "; mark invalid pixels as NaN"
            problems.append(Problem("disparity", message))
    problems += [
        Problem(name, f"must not be negative: {int((arrays[name] < 0).sum())} pixels are")
        for name in _STANDARD_DEVIATIONS
        if name in arrays and (arrays[name] < 0).any()
    ]
    if "depth" in arrays and "disparity" in arrays:
        follows = depth_from_disparity(arrays["disparity"], intrinsics)
        both = np.isfinite(follows) & np.isfinite(arrays["depth"])
        if both.any() and np.median(np.abs(follows[both] / arrays["depth"][both] - 1)) > 0.1:
            ratio = float(np.median(arrays["depth"][both] / follows[both]))
            message = (
                f"contradicts disparity: it is {ratio:.4g} times f V_X / disparity; specify only one or check the units"
            )
            problems.append(Problem("depth", message))
    return problems


def _rate(values: ArrayLike, shape: tuple[int, ...], problems: list[Problem]) -> Map | None:
    given = real_array("depth_rate", values, problems, masked_is_nan=True)
    if given is None:
        return None
    raw = given.astype(np.float64)
    if np.isinf(raw).any():
        problems.append(Problem("depth_rate", "holds infinite values; mark invalid pixels as NaN"))
        return None
    if raw.ndim and not _is_of_frames(raw, shape):
        problems.append(Problem("depth_rate", f"must be a number or have the shape {shape}", raw.shape))
        return None
    return np.broadcast_to(raw, shape)


def _is_of_frames(values: NDArray[Any], shape: tuple[int, ...]) -> bool:
    """Return whether an array has the shape (t, y, x), or (y, x) for a single frame."""
    return values.shape == shape or (shape[0] == 1 and values.shape == shape[1:])


def _status(values: ArrayLike, shape: tuple[int, ...], problems: list[Problem]) -> NDArray[np.uint8] | None:
    raw = real_array("status", values, problems)
    if raw is None:
        return None
    if not _is_of_frames(raw, shape) or not np.isin(raw, range(STATUS_FALLBACK + 1)).all():
        message = (
            f"must have the shape {shape} and hold 0 (invalid), 1 (normal component only), 2 (valid) or 3 (fallback)"
        )
        problems.append(Problem("status", message, raw.shape))
        return None
    return raw.reshape(shape).astype(np.uint8)


def _derive(
    arrays: dict[str, Map], intrinsics: Intrinsics, frames: NDArray[np.int64], rate: Map | None, recording: xr.Dataset
) -> None:
    """Add the dependent quantities to the arrays, in place."""
    product = intrinsics.focal_length_px * intrinsics.baseline_mm
    if product != 0:
        # The conversion is its own inverse.
        for one, other in (("depth", "disparity"), ("disparity", "depth")):
            if one in arrays and other not in arrays:
                arrays[other] = depth_from_disparity(arrays[one], intrinsics)
                std = f"{one}_std"
                if std in arrays and f"{other}_std" not in arrays:
                    arrays[f"{other}_std"] = np.abs(product) / arrays[one] ** 2 * arrays[std]
    if "depth" not in arrays:
        return
    grid = compute_pixel_grid(recording).positions(recording.sizes["y"], recording.sizes["x"])
    if "velocity" in arrays:
        if "flow" not in arrays:
            arrays["flow"] = flow_from_velocity(arrays["velocity"], arrays["depth"], grid, intrinsics)
    elif "flow" in arrays:
        if rate is None and len(frames) > 1:
            rate = depth_rate_along(arrays["depth"], arrays["flow"], frames, grid)
        if rate is not None:
            arrays["velocity"] = velocity_from_flow(arrays["flow"], arrays["depth"], rate, grid, intrinsics)
    if "velocity" in arrays:
        arrays["divergence"] = -arrays["velocity"][2] / arrays["depth"]


def _statuses(
    arrays: dict[str, Map], given: NDArray[np.uint8] | None, shape: tuple[int, ...]
) -> dict[str, NDArray[np.uint8]]:
    """Return ``status_disparity`` and ``status_motion``: as given, or invalid where the quantity is not finite."""
    wanted = np.full(shape, STATUS_VALID, dtype=np.uint8) if given is None else given
    found = {}
    for name, quantities in STATUS_SOURCES.items():
        quantity = next((quantity for quantity in quantities if quantity in arrays), None)
        if quantity is not None:
            finite = status_of_quantity(arrays[quantity].reshape(-1, *shape), components=True)
            found[name] = np.where(finite == STATUS_VALID, wanted, STATUS_INVALID).astype(np.uint8)
    return found
