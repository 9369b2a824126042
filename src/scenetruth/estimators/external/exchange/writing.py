"""A recording as a folder that a program of any language can read."""

from __future__ import annotations

import json
import os
from pathlib import Path

import xarray as xr

from scenetruth.errors import EstimateError, OutputExistsError
from scenetruth.estimators.external.exchange.camera_file import CAMERA_FILE, camera_of
from scenetruth.estimators.external.exchange.frames import single_row
from scenetruth.estimators.external.exchange.image_files import ImageForm, image_problems, image_scale, write_images
from scenetruth.plain import argument_problems
from scenetruth.progress import Progress
from scenetruth.schema import check_dataset

__all__ = ["write_recording"]


def write_recording(
    recording: xr.Dataset,
    folder: str | os.PathLike[str],
    images: ImageForm = "png",
    *,
    progress: Progress | None = None,
) -> None:
    """Write a recording as images and camera.json; nothing else of it, and nothing of its scene, is written.

    Parameters
    ----------
    recording
        The recording, in memory or opened from a store; it is read frame by frame.
    folder
        Where files go; made if it is not there. It must be empty.
    images
        ``"png"``: ``s+0_t+0.png`` of 16 bits, (colours of 8 if there are no more); ``"tiff"``: the same names, as
        recorded or float32; ``"npy"``: ``images.npy``, float32, shape (s, t, y, x[, channel]).
    progress
        Called with ("images", frames done, frames in all).

    Raises
    ------
    RecordingError
        If the recording does not have the agreed form.
    EstimateError
        If its cameras stand in several rows, or its images cannot be written in this form.
    OutputExistsError
        If the folder holds something.

    See Also
    --------
    read_results : What a program made of it.

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
        raise OutputExistsError(place, "is not empty; name a folder that is, or is not there yet")
    scale = image_scale(recording, images)
    masks = write_images(recording, place, images, scale, progress)
    told = json.dumps(camera_of(recording, images, scale, masks), indent=2, ensure_ascii=False)
    (place / CAMERA_FILE).write_text(told + "\n", encoding="utf-8")
