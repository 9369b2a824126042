"""What a program is told of a recording beside its images: camera.json."""

from __future__ import annotations

from typing import Any

import xarray as xr

from scenetruth.estimators.external.exchange.grey_scale import GreyScale
from scenetruth.estimators.external.exchange.image_files import ImageForm
from scenetruth.schema import intrinsics_of, pixel_grid_of

__all__ = ["CAMERA_FILE", "EXCHANGE_VERSION", "camera_of"]

CAMERA_FILE = "camera.json"
"""Name of the file; it is written last, when all images are there."""

EXCHANGE_VERSION = 1
"""Version of the folders that programs are given, and of those that are read."""

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
    "unknown": "NaN; in .pfm +inf, in .flo 1e10",
    "image": "value = image_offset + image_scale * number in the file; full_scale is the largest possible value",
    "masks": "not 0 where a pixel must not be used; images without a mask are good everywhere",
}


def camera_of(recording: xr.Dataset, form: ImageForm, scale: GreyScale, masks: list[str]) -> dict[str, Any]:
    """Return what camera.json says: intrinsics, positions, frames, and how images are to be read; never a scene.

    Everything counts in columns and rows of the images as they are written. Where a recording is cropped or thinned
    out, these are not the camera's pixels: focal length and principal point are converted.

    Parameters
    ----------
    recording
        A checked recording of one row of cameras.
    form
        The form of its images.
    scale
        How numbers in files stand for values.
    masks
        Names of the files of masks.
    """
    grid, image = pixel_grid_of(recording), recording["image"]
    intrinsics = grid.in_columns(intrinsics_of(recording))
    frames = [int(t) for t in recording["t"].values]
    return {
        "format_version": EXCHANGE_VERSION,
        "width_px": int(image.sizes["x"]),
        "height_px": int(image.sizes["y"]),
        "channels": int(image.sizes.get("channel", 1)),
        **intrinsics.to_attrs(),
        # As OpenCV orders them; they belong to x / focal_length_px, whatever the columns.
        "distortion_k1_k2_p1_p2_k3_k4_k5_k6": _distortion(recording),
        "s": [int(s) for s in recording["s"].values],
        "stage_x_mm": [float(x) for x in recording["stage_x_mm"].values],
        "t": frames,
        "reference_s": 0,
        "reference_t": 0,
        "estimate_t": frames,
        "image_format": form,
        "image_files": _FILES[form],
        "image_scale": scale.scale,
        "image_offset": scale.offset,
        "image_lossless": scale.lossless,
        "full_scale": float(recording.attrs["full_scale"]),
        "masks": masks,
        "part": {"first_column_px": grid.first_x, "first_row_px": grid.first_y, "pixel_step_px": grid.step_px},
        "conventions": _CONVENTIONS,
    }


def _distortion(recording: xr.Dataset) -> list[float]:
    return [float(value) for value in recording.attrs.get("distortion", ())]
