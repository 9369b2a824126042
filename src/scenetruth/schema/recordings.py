"""Recordings from images of any origin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from scenetruth.errors import Problem, RecordingError
from scenetruth.indexing import centred_indices
from scenetruth.schema.attributes import Intrinsics
from scenetruth.schema.input_arrays import (
    attributes_from,
    copy_array,
    exclusion_mask_from,
    number_from,
    numbers_from,
    pair_from,
    real_array,
    without_repeats,
)
from scenetruth.schema.validation import check_dataset
from scenetruth.schema.variables import label

__all__ = ["image_to_grey", "make_recording"]


def make_recording(
    images: ArrayLike,
    focal_length_px: float,
    baseline_mm: float,
    principal_point_px: tuple[float, float] | None = None,
    frame_interval_s: float = 1.0,
    *,
    stage_x_mm: ArrayLike | None = None,
    stage_y_mm: ArrayLike | None = None,
    full_scale: float | None = None,
    exclusion_mask: ArrayLike | xr.DataArray | None = None,
    attrs: Mapping[str, Any] | None = None,
    copy: bool = True,
) -> xr.Dataset:
    """Make a recording from images of any origin.

    Parameters
    ----------
    images
        Grey values, shape (s, t, y, x), or colours, (s, t, y, x, channel); integers are digital numbers, floats linear
        radiance. With ``stage_y_mm``, the cameras stand in a grid, and ``s_y`` comes before ``s``.
    focal_length_px
        f, in pixels.
    baseline_mm
        V_X, the camera's displacement in mm per step of s; positive when larger s stands further to the right.
    principal_point_px
        (c_x, c_y), in pixel indices; the image's centre ((W-1)/2, (H-1)/2) if not given.
    frame_interval_s
        Time between two frames.
    stage_x_mm
        The camera's position for every s, 0 at the reference; ``baseline_mm * s`` if not given.
    stage_y_mm
        The position of every row of a grid of cameras, 0 at the reference, the middle row; one row if not given.
    full_scale
        The largest value that an image can hold; if not given, 1 for floats, which must then lie in [-1, 1], and the
        type's largest for integers.
        The grey values of the paper, in [-1, 1], are ``2 image / full_scale - 1``.
    exclusion_mask
        Pixels that must not be used, as booleans: True where an image must not be trusted, as in NumPy's masked arrays.
        Of shape (y, x) for all images, (s, y, x) for each camera, or (s, t, y, x), where s and t may be 1; in a grid,
        ``s_y`` comes before ``s``. A DataArray says by its own names which of these dimensions it has.
    attrs
        More attributes to keep with the recording.
    copy
        Whether the recording has an array of its own, so that what is changed later in ``images`` does not change the
        recording, nor the other way round. False saves the memory where nobody else has the array.

    Returns
    -------
    xarray.Dataset
        ``image`` ([s_y, ]s, t, y, x[, channel]) with coordinates, units and intrinsics; ``exclusion_mask`` if given.

    Raises
    ------
    RecordingError
        If the images or the numbers do not have the agreed form; lists all that is wrong.

    See Also
    --------
    simulate : A recording of a scene, with its truth.
    estimate : Depth and motion from a recording.

    Examples
    --------
    >>> recording = make_recording(np.zeros((5, 9, 32, 64)), focal_length_px=500, baseline_mm=5)
    >>> recording.s.values.tolist()
    [-2, -1, 0, 1, 2]
    >>> recording.attrs["principal_point_px"]
    [31.5, 15.5]
    """
    problems: list[Problem] = []
    values, grid = real_array("images", images, problems), stage_y_mm is not None
    if values is not None and (values.ndim - grid not in (4, 5) or 0 in values.shape):
        names = "s_y, s, t, y, x" if grid else "s, t, y, x"
        message = f"must be a non-empty array with the dimensions ({names}), or ({names}, channel)"
        problems.append(Problem("images", message, values.shape))
    focal = number_from("focal_length_px", focal_length_px, problems, positive=True)
    baseline = number_from("baseline_mm", baseline_mm, problems)
    interval = number_from("frame_interval_s", frame_interval_s, problems, positive=True)
    point = None if principal_point_px is None else pair_from("principal_point_px", principal_point_px, problems)
    scale = None if full_scale is None else number_from("full_scale", full_scale, problems, positive=True)
    more = attributes_from(attrs, _RESERVED, problems)
    if baseline == 0 and values is not None and values.ndim > grid and values.shape[int(grid)] > 1:
        problems.append(Problem("baseline_mm", "must not be zero: depth cannot be seen without a baseline", baseline))
    if values is None or problems:
        raise RecordingError(problems, source="images of a recording")
    count_s, count_t, height, width = values.shape[int(grid) :][:4]
    if scale is None and values.dtype.kind == "f" and (largest := _largest(values)) > 1:
        message = f"floats reach {largest:.6g}, beyond [-1, 1]: say by full_scale= which value is full scale"
        problems.append(Problem("images", message))
    positions = None if stage_x_mm is None else numbers_from("stage_x_mm", stage_x_mm, count_s, "cameras", problems)
    rows = None if stage_y_mm is None else numbers_from("stage_y_mm", stage_y_mm, len(values), "rows", problems)
    dims = ("s_y", "s", "t", "y", "x")[not grid :]
    masked = (
        None
        if exclusion_mask is None
        else exclusion_mask_from(exclusion_mask, dict(zip(dims, values.shape, strict=False)), problems)
    )
    if problems:
        raise RecordingError(problems, source="images of a recording")
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
        attrs={"full_scale": scale, **more},
    )
    if masked is not None:
        dataset["exclusion_mask"] = masked
    check_dataset(dataset, "recording")
    return dataset


_RESERVED = frozenset(
    {
        *("scenetruth", "format", "full_scale"),
        *("focal_length_px", "principal_point_px", "baseline_mm", "frame_interval_s"),
    }
)


def _largest(values: NDArray[Any]) -> float:
    """Return the largest magnitude of finite values."""
    # A view of one value that stands for all need not be gone through.
    values = without_repeats(values)
    finite = values[np.isfinite(values)]
    # A render may exceed full scale by rounding.
    return float(np.abs(finite).max(initial=0.0)) / (1 + 1e-6)


def image_to_grey(recording: xr.Dataset) -> NDArray[np.float32]:
    """Return the images as the paper's grey values: [0, full scale] becomes [-1, 1].

    Returns: float32, shape (s, t, y, x[, channel]).
    """
    scale = np.float32(2.0 / float(recording.attrs["full_scale"]))
    grey: NDArray[np.float32] = recording["image"].values.astype(np.float32)
    grey *= scale
    grey -= np.float32(1.0)
    return grey
