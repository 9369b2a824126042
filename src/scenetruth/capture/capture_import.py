"""The import of a capture as a recording: corrected, and with a calibration rectified or with its lens."""

from __future__ import annotations

import warnings
from pathlib import Path

import xarray as xr

from scenetruth.capture.calibration import RigCalibration
from scenetruth.capture.capture_file import CaptureLike
from scenetruth.capture.corrections import undistort_images
from scenetruth.capture.folder_reading import open_capture
from scenetruth.capture.measurement_check import contradictions
from scenetruth.capture.rectification import Geometry, load_calibration
from scenetruth.errors import CaptureError, CaptureWarning, Problem
from scenetruth.output import check_output, write_atomically
from scenetruth.progress import Progress
from scenetruth.storage import RECORDING, StoreWriter, claim_store, open_store, save_store, store_name

__all__ = ["import_capture"]


def import_capture(
    capture: CaptureLike,
    *,
    output: str | Path | None = None,
    overwrite: bool = False,
    correct: bool = True,
    undistort: bool = False,
    calibration: RigCalibration | str | Path | None = None,
    geometry: Geometry = "rectified",
    progress: Progress | None = None,
) -> xr.Dataset:
    """Read the images of a capture as a recording.

    Parameters
    ----------
    capture
        Folder with a ``capture.yaml``, the path of such a file, or a capture.
    output
        Run directory, in which ``recording.zarr`` is written image by image; default: the recording is in memory.
    overwrite
        Replace an existing recording.
    correct
        Correct the images with the dark frames and flat fields of the capture.
    undistort
        Remove the distortion of the lens, see `scenetruth.undistort_images`; method ``refined`` needs no such step.
    calibration
        Calibration of the rig, or its file; default: the lens that the capture states.
    geometry
        With a calibration, ``rectified``: the images are resampled to an ideal rig, a pinhole camera of the estimated
        focal length that moves along its X axis, with Z nearest that of the reference camera. Errors of stage and lens
        that the calibration has estimated are removed; of the tolerances of the stage, the repeatability of new visits
        remains. `scenetruth.capture.add_calibration_errors` adds the uncertainty of the calibration to an estimate.
        ``recorded``: the images are as recorded, with the lens, its tolerances and the step length of the calibration;
        methods that correct poses estimate those of the stage anew within its tolerances.
    progress
        Called with the number of images read.

    Returns
    -------
    xarray.Dataset
        The recording; with ``output`` it is read lazily from the store. Missing images are NaN, and listed in the
        attribute ``missing_images``. Rectified recordings have the variable ``noise_share``: the variance of the image
        noise after the resampling relative to that before, which method ``refined`` takes into account.

    Raises
    ------
    CaptureError
        If the files do not fit the capture, or the calibration is that of another camera or of other positions; lists
        every problem.
    OutputExistsError, StoreError
        If the recording exists already, or cannot be written.

    Warns
    -----
    CaptureWarning
        If images are missing, the bit depth is unlikely, the stated distance is likely to be in another unit, or the
        images contradict the calibration: by their direction of motion, their vertical parallax or their distance.

    See Also
    --------
    scenetruth.read_images : Reads images without a capture file.
    scenetruth.capture.check_capture : Checks the images in advance.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> import imageio.v3 as imageio
    >>> import numpy as np
    >>> from scenetruth.capture import Capture
    >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 100}, "frames": {"count": 1}}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "files": {"images": "s{s:+d}.png", "dark": "dark.png"}}
    >>> with TemporaryDirectory() as folder:
    ...     for s in (-1, 0, 1):
    ...         imageio.imwrite(f"{folder}/s{s:+d}.png", np.full((30, 40), 100 + s, dtype=np.uint8))
    ...     imageio.imwrite(f"{folder}/dark.png", np.full((30, 40), 8, dtype=np.uint8))
    ...     recording = import_capture(Capture.from_dict(plain, folder=Path(folder)))
    >>> recording.image[:, 0, 0, 0].values.tolist()
    [91.0, 92.0, 93.0]
    """
    store = None if output is None else Path(output) / store_name(RECORDING, zipped=False)
    if undistort and calibration is not None:
        message = "must not be combined with a calibration, whose rectification removes the distortion"
        raise CaptureError([Problem("undistort", message, undistort)])
    if geometry not in ("rectified", "recorded"):
        raise CaptureError([Problem("geometry", "must be 'rectified' or 'recorded'", geometry)])
    rig = None if calibration is None else load_calibration(calibration)
    folder = open_capture(capture)
    if store is not None:
        check_output(store, overwrite=overwrite, claim=claim_store)
    plan = folder.plan(correct=correct, calibration=rig, geometry=geometry)
    if undistort and "distortion" not in plan.geometry:
        message = "is missing: there is no distortion to remove"
        raise CaptureError([Problem("camera.distortion", message)], source=folder.capture.folder)
    if store is None or undistort:
        recording = plan.load(progress)
        recording = undistort_images(recording) if undistort else recording
        if store is not None:
            save_store(recording, store, overwrite=overwrite)
            recording = open_store(store, kind="recording")
    else:
        blank = plan.blank()
        with (
            write_atomically(store, overwrite=overwrite, claim=claim_store) as partial,
            StoreWriter(partial, blank) as writer,
        ):
            plan.fill(writer.put, progress)
            if "exclusion_mask" in blank:
                writer.put("exclusion_mask", {}, blank["exclusion_mask"].values)
        recording = open_store(store, kind="recording")
    plan.warn()
    for message in () if rig is None else contradictions(folder, rig):
        warnings.warn(message, CaptureWarning, stacklevel=2)
    if folder.capture.distance_mm is not None:
        for message in folder.describe_units():
            if message.startswith("distance_mm"):
                warnings.warn(message, CaptureWarning, stacklevel=2)
    return recording
