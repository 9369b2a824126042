"""Export of a recording to a folder for external programs, with camera.json, and hash of its content."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.errors import EstimateError, OutputExistsError
from scenetruth.estimators.external.image_writer import (
    ImageForm,
    IntensityScaling,
    each_frame,
    image_problems,
    image_scale,
    single_row,
    write_images,
)
from scenetruth.plain_data import argument_problems
from scenetruth.progress import Progress
from scenetruth.schema import check_dataset, compute_pixel_grid, read_acquisition, read_intrinsics
from scenetruth.schema.acquisition import TOLERANCE_ATTRIBUTES

__all__ = ["recording_key", "write_recording"]


def recording_key(recording: xr.Dataset) -> str:
    """Return a key of the images, mask and intrinsics: the first 16 hexadecimal digits of a SHA-256 hash.

    Attributes are excluded, so that a recording has the same key whether it is simulated, read from a store, or created
    from images and intrinsics. Images of another type have another key.

    Parameters
    ----------
    recording
        The recording, in memory or opened from a store; it is read frame by frame.

    Raises
    ------
    RecordingError
        If the recording is malformed.
    EstimateError
        If the recording is a grid of several camera rows.

    See Also
    --------
    scenetruth.estimators.external.ResultsFolder : Find results by this key.

    Examples
    --------
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 3, 30, 40)), focal_length_px=500, baseline_mm=5)
    >>> again = st.make_recording(np.zeros((2, 3, 30, 40)), focal_length_px=500, baseline_mm=5, attrs={"note": "mine"})
    >>> recording_key(recording) == recording_key(again), len(recording_key(recording))
    (True, 16)
    """
    check_dataset(recording, "recording")
    recording = single_row(recording)
    image, grid = recording["image"], compute_pixel_grid(recording)
    entries = {
        **read_intrinsics(recording).to_attrs(),
        "full_scale": float(recording.attrs["full_scale"]),
        "distortion": [float(value) for value in recording.attrs.get("distortion", ())],
        "dims": [str(dim) for dim in image.dims],
        "shape": list(image.shape),
        # Without the byte order, which depends on the machine.
        "type": image.dtype.str[1:],
        "s": recording["s"].values.tolist(),
        "t": recording["t"].values.tolist(),
        "stage_x_mm": [float(value) for value in recording["stage_x_mm"].values],
        "pixels": [grid.first_x, grid.first_y, grid.step_px],
        # Without entries that a recording does not state, so that its key does not depend on them.
        **_stated(recording),
    }
    found = hashlib.sha256(json.dumps(entries, sort_keys=True).encode())
    for values, bad in each_frame(recording):
        found.update(np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).data)
        found.update(np.packbits(bad).data)
    return found.hexdigest()[:16]


CAMERA_FILE = "camera.json"
"""Name of the camera file; it is written last, after all images."""

EXCHANGE_VERSION = 2
"""Version of the exchange format of recordings and results."""

_FILES = {
    "png": "s{s:+d}_t{t:+d}.png",
    "tiff": "s{s:+d}_t{t:+d}.tiff",
    "npy": "images.npy, float32, (s, t, y, x[, channel])",
}
_CONVENTIONS = {
    "frame": "X right, Y down, Z forward, in mm; the reference camera (s = 0) stands at the origin and looks along Z",
    "pixels": "centres are integers, the first one (0, 0); x counts columns to the right, y rows down, of these images",
    "projection": "x = focal_length_px (X - stage_x_mm) / Z + c_x, y = focal_length_px Y / Z + c_y",
    "depth": "Z along the optical axis in mm, at the pixels of the reference camera, positive",
    "disparity": "d = focal_length_px baseline_mm / Z in px per step of s: x_s = x_0 - d stage_x_mm / baseline_mm",
    "flow": "(dx/dt, dy/dt) in px per frame; dx > 0 to the right, dy > 0 down",
    "velocity": "(U_X, U_Y, U_Z) in mm per frame; U_Z < 0 comes nearer",
    "depth_rate": "U_Z alone, in mm per frame, of the surface point",
    "time": "planned_time_s in s, by camera and frame: mid-exposure of the middle row; rows are line_time_s apart",
    "tolerances": "standard deviations of the errors of stage and lens; what is missing is not stated",
    "unknown": "NaN; in .pfm +inf, in .flo 1e10",
    "image": "value = image_offset + image_scale * number in the file; full_scale is the largest possible value",
    "exclusion_masks": "not 0 where a pixel must not be used; images without a mask are good everywhere",
}


def describe_camera(
    recording: xr.Dataset, form: ImageForm, scale: IntensityScaling, masks: list[str]
) -> dict[str, Any]:
    """Return the content of camera.json: intrinsics, positions, frames and image format, without the scene.

    All values are in columns and rows of the written images. For a cropped or subsampled recording, these differ from
    the camera pixels, and focal length and principal point are converted.
    """
    grid, image = compute_pixel_grid(recording), recording["image"]
    intrinsics = grid.in_columns(read_intrinsics(recording))
    acquisition = read_acquisition(recording)
    frames = [int(t) for t in recording["t"].values]
    return {
        "format_version": EXCHANGE_VERSION,
        "width_px": int(image.sizes["x"]),
        "height_px": int(image.sizes["y"]),
        "channels": int(image.sizes.get("channel", 1)),
        **intrinsics.to_attrs(),
        # In the order of OpenCV; they refer to x / focal_length_px, which is independent of the pixel grid.
        "distortion_k1_k2_p1_p2_k3_k4_k5_k6": _distortion(recording),
        "s": [int(s) for s in recording["s"].values],
        "stage_x_mm": [float(x) for x in recording["stage_x_mm"].values],
        "t": frames,
        "planned_time_s": _times(recording),
        "line_time_s": acquisition.line_time_s * grid.step_px,
        "tolerances": _tolerances(recording, grid.step_px),
        "reference_s": 0,
        "reference_t": 0,
        "estimate_t": frames,
        "image_format": form,
        "image_files": _FILES[form],
        "image_scale": scale.scale,
        "image_offset": scale.offset,
        "image_lossless": scale.lossless,
        "full_scale": float(recording.attrs["full_scale"]),
        "exclusion_masks": masks,
        "part": {"first_column_px": grid.first_x, "first_row_px": grid.first_y, "pixel_step_px": grid.step_px},
        "conventions": _CONVENTIONS,
    }


def _times(recording: xr.Dataset) -> list[list[float]]:
    """Return the planned time of every image in s, by camera and frame."""
    return [[float(time) for time in times] for times in read_acquisition(recording).time_s[0]]


def _tolerances(recording: xr.Dataset, step_px: float) -> dict[str, Any]:
    """Return the stated standard deviations of stage and lens; lengths in the image are in columns."""
    stated = {name: recording.attrs[name] for name in TOLERANCE_ATTRIBUTES if name in recording.attrs}
    plain = {name: np.asarray(value, dtype=np.float64) for name, value in stated.items()}
    return {name: (value / step_px if name.endswith("_px") else value).tolist() for name, value in plain.items()}


def _stated(recording: xr.Dataset) -> dict[str, Any]:
    """Return the times and tolerances that a recording states."""
    found = {name: recording.attrs[name] for name in ("line_time_s", "stage_speed_mm_per_s") if name in recording.attrs}
    frames = recording["t"].values * read_intrinsics(recording).frame_interval_s
    times = read_acquisition(recording).time_s[0]
    if not np.array_equal(times, np.broadcast_to(frames, times.shape)):
        found["planned_time_s"] = times.tolist()
    tolerances = _tolerances(recording, 1.0)
    return found | ({"tolerances": tolerances} if tolerances else {})


def _distortion(recording: xr.Dataset) -> list[float]:
    return [float(value) for value in recording.attrs.get("distortion", ())]


def write_recording(
    recording: xr.Dataset,
    folder: str | os.PathLike[str],
    images: ImageForm = "png",
    *,
    progress: Progress | None = None,
) -> None:
    """Write a recording as images and camera.json, without any other data of the recording or its scene.

    Parameters
    ----------
    recording
        The recording, in memory or opened from a store; it is read frame by frame.
    folder
        Output folder; created if missing. It must be empty.
    images
        ``"png"``: ``s+0_t+0.png`` of 16 bits (8-bit colours stay 8-bit); ``"tiff"``: the same names, as recorded or
        float32; ``"npy"``: ``images.npy``, float32, shape (s, t, y, x[, channel]).
    progress
        Called with ("images", completed frames, total frames).

    Raises
    ------
    RecordingError
        If the recording is malformed.
    EstimateError
        If the recording is a grid of several camera rows, or its images cannot be written in this format.
    OutputExistsError
        If the folder is not empty.

    See Also
    --------
    read_results : Read the results of a program.

    Examples
    --------
    >>> import json
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((3, 1, 30, 40)), focal_length_px=500, baseline_mm=5)
    >>> with TemporaryDirectory() as folder:
    ...     write_recording(recording, folder)
    ...     print(*sorted(path.name for path in Path(folder).iterdir()))
    ...     camera = json.loads(Path(folder, "camera.json").read_text(encoding="utf-8"))
    camera.json s+0_t+0.png s+1_t+0.png s-1_t+0.png
    >>> camera["focal_length_px"], camera["stage_x_mm"], camera["reference_s"]
    (500.0, [-5.0, 0.0, 5.0], 0)
    """
    problems = argument_problems(progress, images=(images, ImageForm))
    if problems:
        raise EstimateError(problems, source="call of write_recording")
    check_dataset(recording, "recording")
    recording = single_row(recording)
    problems = image_problems(recording, images)
    if problems:
        raise EstimateError(problems, source="recording to write")
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    if any(place.iterdir()):
        raise OutputExistsError(place, "is not empty; specify an empty or a new folder")
    scale = image_scale(recording, images)
    masks = write_images(recording, place, images, scale, progress)
    entries = json.dumps(describe_camera(recording, images, scale, masks), indent=2, ensure_ascii=False)
    (place / CAMERA_FILE).write_text(entries + "\n", encoding="utf-8")
