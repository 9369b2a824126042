"""Construction of recordings from image arrays."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenetruth.errors import Problem, RecordingError, SceneWarning
from scenetruth.indexing import centred_indices
from scenetruth.lazy_exports import lazy_module
from scenetruth.schema.acquisition import LENS_TOLERANCES, TOLERANCE_NAMES, tolerance_attributes
from scenetruth.schema.attributes import Intrinsics
from scenetruth.schema.input_arrays import (
    attributes_from,
    copy_array,
    exclusion_mask_from,
    images_from,
    number_from,
    numbers_from,
    pair_from,
    real_array,
    without_repeats,
)
from scenetruth.schema.plausible_units import describe_positions, describe_rig
from scenetruth.schema.validation import check_dataset
from scenetruth.schema.variables import label

if TYPE_CHECKING:
    import xarray as xr
else:
    xr = lazy_module("xarray")

__all__ = ["image_to_grey", "make_recording"]


def make_recording(
    images: ArrayLike,
    focal_length_px: float,
    baseline_mm: float,
    *,
    principal_point_px: tuple[float, float] | None = None,
    frame_interval_s: float = 1.0,
    stage_x_mm: ArrayLike | None = None,
    stage_y_mm: ArrayLike | None = None,
    planned_time_s: ArrayLike | None = None,
    line_time_s: float = 0.0,
    distortion: Sequence[float] | None = None,
    stage_tolerances: Mapping[str, float] | None = None,
    lens_tolerances: Mapping[str, Any] | None = None,
    full_scale: float | None = None,
    exclusion_mask: ArrayLike | xr.DataArray | None = None,
    attrs: Mapping[str, Any] | None = None,
    copy: bool = True,
) -> xr.Dataset:
    """Create a recording from image arrays.

    Parameters
    ----------
    images
        Grey values, shape (s, t, y, x), or colours, shape (s, t, y, x, channel); integers are digital numbers, floats
        linear radiance. With ``stage_y_mm``, the cameras form a grid, and ``s_y`` precedes ``s``. A DataArray is put
        into this order by the names of its dimensions; the mask of a masked array joins ``exclusion_mask``.
    focal_length_px
        f, in pixels.
    baseline_mm
        V_X, the camera displacement in mm per step of s; positive if larger s is further to the right.
    principal_point_px
        (c_x, c_y), in pixel indices; default: the image centre ((W-1)/2, (H-1)/2).
    frame_interval_s
        Time between consecutive frames.
    stage_x_mm
        Camera position for every s, 0 at the reference; default: ``baseline_mm * s``.
    stage_y_mm
        Position of every row of a camera grid, 0 at the reference (middle) row; default: a single row.
    planned_time_s
        Planned time of every image in s, shape ([s_y, ]s, t): mid-exposure of its middle row. Default: all images of a
        frame at the same time. Times increase along t and refer to the same clock for all positions.
    line_time_s
        Time between the exposures of consecutive rows (rolling shutter): the readout time divided by the number of
        rows less 1; 0 for a global shutter.
    distortion
        Coefficients of the lens in the order of OpenCV, (k1, k2, p1, p2[, k3[, k4, k5, k6]]); default: a pinhole
        camera.
    stage_tolerances
        Standard deviations of the errors of the stage, from its data sheet or calibration: ``pitch_urad``,
        ``yaw_urad``, ``roll_urad``, ``straightness_um``, ``accuracy_um``, ``repeatability_um``, ``backlash_um``,
        ``scale_ppm``; what is omitted is taken as exact. They become attributes ``stage_tolerance_*``.
    lens_tolerances
        Standard deviations of the calibration of the lens: ``focal_length_std_px``, ``principal_point_std_px`` (one
        number or two), ``distortion_std`` (as many as there are coefficients); they become attributes of these names.
    full_scale
        Largest value of an image; default: 1 for floats, which must then lie in [-1, 1], and the largest value of the
        data type for integers of 8 or 16 bits; required for others. Grey values in [-1, 1] (paper) are
        ``2 image / full_scale - 1``.
    exclusion_mask
        Boolean array, True where a pixel must not be used, as in NumPy's masked arrays. Shape (y, x) for all images,
        (s, y, x) for each camera, or (s, t, y, x), where s and t may be 1; in a grid, ``s_y`` precedes ``s``. A
        DataArray may have any of these dimensions.
    attrs
        Additional attributes of the recording.
    copy
        Copy ``images``. With False the recording shares memory with ``images``.

    Returns
    -------
    xarray.Dataset
        ``image`` ([s_y, ]s, t, y, x[, channel]) with coordinates, units and intrinsics; ``exclusion_mask`` if given.

    Raises
    ------
    RecordingError
        If the images or parameters are invalid; lists every problem.

    Warns
    -----
    SceneWarning
        If a focal length, a baseline or positions are likely to be in another unit than px and mm, or images of 16 bits
        to have fewer.

    See Also
    --------
    simulate : Simulate a scene: recording and ground truth.
    estimate : Estimate depth and motion from a recording.

    Examples
    --------
    >>> recording = make_recording(np.zeros((5, 9, 32, 64)), focal_length_px=500, baseline_mm=5)
    >>> recording.s.values.tolist()
    [-2, -1, 0, 1, 2]
    >>> recording.attrs["principal_point_px"]
    [31.5, 15.5]
    """
    problems: list[Problem] = []
    grid = stage_y_mm is not None
    values, hidden = images_from(images, grid=grid, problems=problems)
    focal = number_from("focal_length_px", focal_length_px, problems, positive=True)
    baseline = number_from("baseline_mm", baseline_mm, problems)
    interval = number_from("frame_interval_s", frame_interval_s, problems, positive=True)
    point = None if principal_point_px is None else pair_from("principal_point_px", principal_point_px, problems)
    scale = None if full_scale is None else number_from("full_scale", full_scale, problems, positive=True)
    more = attributes_from(attrs, _RESERVED, problems)
    more |= _acquisition_attributes(line_time_s, distortion, stage_tolerances, lens_tolerances, problems)
    if baseline == 0 and values is not None and values.ndim > grid and values.shape[int(grid)] > 1:
        problems.append(Problem("baseline_mm", "must not be zero; depth needs a baseline", baseline))
    if values is None or problems:
        raise RecordingError(problems, source="images of a recording")
    count_s, count_t, height, width = values.shape[int(grid) :][:4]
    if scale is None and values.dtype.kind == "f" and (largest := _largest(values)) > 1:
        message = f"floats reach {largest:.6g}, outside [-1, 1]: specify full_scale="
        problems.append(Problem("images", message))
    if scale is None and values.dtype.kind in "iu" and values.dtype.itemsize > _ASKED_BYTES:
        message = (
            f"are integers of {8 * values.dtype.itemsize} bits, whose largest value is not that of a camera: specify "
            f"full_scale= (255 for 8 bits, 4095 for 12, 65535 for 16), or convert them; they reach {values.max():,}"
        )
        problems.append(Problem("images", message))
    positions = None if stage_x_mm is None else numbers_from("stage_x_mm", stage_x_mm, count_s, "cameras", problems)
    rows = None if stage_y_mm is None else numbers_from("stage_y_mm", stage_y_mm, len(values), "rows", problems)
    times = None
    if planned_time_s is not None:
        times = _times_from(planned_time_s, values.shape[: 2 + grid], problems)
    dims = ("s_y", "s", "t", "y", "x")[not grid :]
    masked = (
        None
        if exclusion_mask is None
        else exclusion_mask_from(exclusion_mask, dict(zip(dims, values.shape, strict=False)), problems)
    )
    if hidden is not None:
        every = exclusion_mask_from(hidden, dict(zip(dims, values.shape, strict=False)), problems)
        masked = every if masked is None or every is None else _either(masked, every)
    if problems:
        raise RecordingError(problems, source="images of a recording")
    for message in (*describe_rig(focal, baseline, width, height), *describe_positions(positions, baseline)):
        warnings.warn(message, SceneWarning, stacklevel=2)
    if scale is None and copy and values.dtype.kind == "u" and values.dtype.itemsize == _ASKED_BYTES:
        _warn_of_fewer_bits(int(values.max()))
    if scale is None:
        scale = float(np.iinfo(values.dtype).max) if np.issubdtype(values.dtype, np.integer) else 1.0
    dataset = label(
        "recording",
        {"image": copy_array(values) if copy else values},
        Intrinsics(focal, point or ((width - 1) / 2, (height - 1) / 2), baseline, interval),
        t=centred_indices(count_t),
        s=centred_indices(count_s),
        stage_x_mm=positions,
        stage_y_mm=rows,
        planned_time_s=times,
        attrs={"full_scale": scale, **more},
    )
    if masked is not None:
        dataset["exclusion_mask"] = masked
    check_dataset(dataset, "recording")
    return dataset


_ASKED_BYTES = 2  # integers with more bytes have no full scale that could be meant


def _warn_of_fewer_bits(largest: int) -> None:
    """Warn of 16-bit images whose largest value is that of a sensor with fewer bits."""
    for bits in (10, 12, 14):
        if largest == 2**bits - 1:
            message = (
                f"images: are of 16 bits and reach {largest:,}, the largest value of {bits} bits; if the sensor has "
                f"{bits} bits, specify full_scale={largest}, by which saturated pixels are recognised"
            )
            warnings.warn(message, SceneWarning, stacklevel=3)


def _either(one: xr.Variable, other: xr.Variable) -> xr.Variable:
    """Return where any of two masks is True."""
    both = one | other
    return xr.Variable(other.dims, both.transpose(*other.dims).values, other.attrs)


_RESERVED = frozenset(
    {
        *("scenetruth", "format", "full_scale"),
        *("focal_length_px", "principal_point_px", "baseline_mm", "frame_interval_s"),
    }
)


def _acquisition_attributes(
    line_time_s: Any, distortion: Any, stage: Any, lens: Any, problems: list[Problem]
) -> dict[str, Any]:
    """Return the attributes that describe stage, lens and shutter; `check_dataset` validates their values."""
    found: dict[str, Any] = {}
    if line_time_s != 0:
        found["line_time_s"] = number_from("line_time_s", line_time_s, problems)
    if distortion is not None:
        found["distortion"] = distortion.tolist() if isinstance(distortion, np.ndarray) else distortion
    for name, given, allowed in (
        ("stage_tolerances", stage, TOLERANCE_NAMES),
        ("lens_tolerances", lens, LENS_TOLERANCES),
    ):
        if given is None:
            continue
        if not isinstance(given, Mapping):
            problems.append(Problem(name, "must be a mapping from names to standard deviations", given))
            continue
        problems += [
            Problem(f"{name}.{each}", f"is no tolerance; these are {', '.join(allowed)}")
            for each in given
            if each not in allowed
        ]
        plain = {each: value.tolist() if isinstance(value, np.ndarray) else value for each, value in given.items()}
        found |= tolerance_attributes(plain) if allowed is TOLERANCE_NAMES else plain
    return found


def _times_from(times: Any, shape: tuple[int, ...], problems: list[Problem]) -> NDArray[Any] | None:
    """Return the planned time of every image, or None after appending a problem."""
    found = real_array("planned_time_s", times, problems)
    if found is not None and found.shape != shape:
        message = f"must hold one time for each image, shape {shape}"
        problems.append(Problem("planned_time_s", message, found.shape))
        return None
    return found


def _largest(values: NDArray[Any]) -> float:
    """Return the largest magnitude of finite values."""
    # Broadcast views are reduced to their distinct values.
    values = without_repeats(values)
    finite = values[np.isfinite(values)]
    # Rendered values may exceed full scale by rounding.
    return float(np.abs(finite).max(initial=0.0)) / (1 + 1e-6)


def image_to_grey(recording: xr.Dataset) -> NDArray[np.float32]:
    """Return the images as grey values (paper), float32: [0, full scale] maps to [-1, 1]."""
    scale = np.float32(2.0 / float(recording.attrs["full_scale"]))
    grey: NDArray[np.float32] = recording["image"].values.astype(np.float32)
    grey *= scale
    grey -= np.float32(1.0)
    return grey
