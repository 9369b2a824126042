"""A name for a recording that follows from what its images show, and from nothing else."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import xarray as xr

from scenetruth.estimators.external.exchange.frames import each_frame, single_row
from scenetruth.schema import check_dataset, intrinsics_of, pixel_grid_of

__all__ = ["recording_key"]


def recording_key(recording: xr.Dataset) -> str:
    """Return a key of a recording's images, mask and intrinsics: the first 16 hexadecimal digits of a SHA-256.

    Attributes do not count, so that a recording has the same key wherever it comes from: from a simulation, from a
    store, or from images and intrinsics alone. Images that are given in another type have another key.

    Parameters
    ----------
    recording
        The recording, in memory or opened from a store; it is read frame by frame.

    Raises
    ------
    RecordingError
        If the recording does not have the agreed form.
    EstimateError
        If its cameras stand in several rows.

    See Also
    --------
    scenetruth.estimators.external.ResultsFolder : Looks results up by this key.

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
    image, grid = recording["image"], pixel_grid_of(recording)
    told = {
        **intrinsics_of(recording).to_attrs(),
        "full_scale": float(recording.attrs["full_scale"]),
        "distortion": [float(value) for value in recording.attrs.get("distortion", ())],
        "dims": [str(dim) for dim in image.dims],
        "shape": list(image.shape),
        # Without the order of its bytes, which is the machine's business.
        "type": image.dtype.str[1:],
        "s": recording["s"].values.tolist(),
        "t": recording["t"].values.tolist(),
        "stage_x_mm": [float(value) for value in recording["stage_x_mm"].values],
        "pixels": [grid.first_x, grid.first_y, grid.step_px],
    }
    found = hashlib.sha256(json.dumps(told, sort_keys=True).encode())
    for values, bad in each_frame(recording):
        found.update(np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).data)
        found.update(np.packbits(bad).data)
    return found.hexdigest()[:16]
