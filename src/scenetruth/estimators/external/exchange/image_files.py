"""The images of a recording as files that every language reads: PNG, TIFF or NumPy's own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.estimators.external.exchange.array_file import ArrayFile
from scenetruth.estimators.external.exchange.frames import each_frame
from scenetruth.estimators.external.exchange.grey_scale import GreyScale, grey_scale_of
from scenetruth.estimators.external.exchange.png import write_mask_png, write_png
from scenetruth.progress import Progress

__all__ = ["ImageForm", "image_problems", "image_scale", "write_images"]

ImageForm = Literal["png", "tiff", "npy"]
"""``png``: numbers of 16 bits; ``tiff``: as recorded, or float32; ``npy``: all images in one float32 array."""

# Beyond it, float32 does not hold every integer.
_EXACT = 2**24


def image_problems(recording: xr.Dataset, form: ImageForm) -> list[Problem]:
    """Return what keeps images from being written in a form."""
    channels = recording.sizes.get("channel", 1)
    if form == "png" and channels not in (1, 3):
        message = "PNG files are written of 1 or 3 channels; take images='tiff' or 'npy'"
        return [Problem("channel", message, channels)]
    return []


def image_scale(recording: xr.Dataset, form: ImageForm) -> GreyScale:
    """Return how numbers in files stand for values."""
    if form == "png":
        return grey_scale_of(recording)
    dtype = recording["image"].dtype
    if dtype.kind == "f":
        return GreyScale(lossless=dtype.itemsize <= 4)
    # Larger integers than these are rounded where there are such.
    return GreyScale(lossless=np.iinfo(dtype).max <= _EXACT)


def write_images(
    recording: xr.Dataset, folder: Path, form: ImageForm, scale: GreyScale, progress: Progress | None = None
) -> list[str]:
    """Write all images, frame by frame.

    Parameters
    ----------
    recording
        A checked recording of one row of cameras, without `image_problems`.
    folder
        Where files go; it exists.
    form
        Their form.
    scale
        From `image_scale`.
    progress
        Called with ("images", frames done, frames in all).

    Returns
    -------
    list
        Names of the files of masks; none if all pixels may be used.
    """
    write = _write_arrays if form == "npy" else _write_files
    masks = []
    for done, mask in enumerate(write(recording, folder, form, scale), start=1):
        masks += mask
        if progress is not None:
            progress("images", done, recording.sizes["t"])
    return sorted(set(masks))


def _write_files(recording: xr.Dataset, folder: Path, form: ImageForm, scale: GreyScale) -> Iterator[list[str]]:
    """Write one file for each image, and one for each mask with anything in it; yield the masks of every frame."""
    cameras, frames = (recording[name].values.tolist() for name in ("s", "t"))
    write = _png_writer(recording, scale) if form == "png" else _write_tiff
    for t, (images, bad) in zip(frames, each_frame(recording), strict=True):
        masks = []
        for s, image, wrong in zip(cameras, images, bad, strict=True):
            name = f"s{s:+d}_t{t:+d}"
            write(folder / f"{name}.{form}", image[..., 0] if image.ndim == 3 and image.shape[-1] == 1 else image)
            if wrong.any():
                masks.append(f"mask_{name}.png")
                write_mask_png(folder / masks[-1], wrong)
        yield masks


def _png_writer(recording: xr.Dataset, scale: GreyScale) -> Callable[[Path, NDArray[Any]], None]:
    # Most readers make 8 bits of colours: what has no more is written with 8.
    eight = recording["image"].dtype == np.uint8 and recording.sizes.get("channel", 1) == 3
    return lambda file, image: write_png(file, image if eight else scale.numbers(image))


def _write_tiff(file: Path, image: NDArray[Any]) -> None:
    import tifffile

    values = image if image.dtype.kind == "u" and image.dtype.itemsize <= 2 else image.astype(np.float32)
    colours = image.ndim == 3 and image.shape[-1] == 3
    tifffile.imwrite(
        file,
        values,
        photometric="rgb" if colours else "minisblack",
        planarconfig="contig" if image.ndim == 3 else None,
        metadata=None,
    )


def _write_arrays(recording: xr.Dataset, folder: Path, form: ImageForm, scale: GreyScale) -> Iterator[list[str]]:
    """Write images.npy and, if anything is masked, mask.npy."""
    shape = recording["image"].shape
    with ExitStack() as open_:
        images = open_.enter_context(ArrayFile(folder / "images.npy", np.float32, shape))
        mask: ArrayFile | None = None
        for place, (values, bad) in enumerate(each_frame(recording)):
            with np.errstate(over="ignore"):
                images.put(place, values)
            if bad.any():
                if mask is None:
                    mask = open_.enter_context(ArrayFile(folder / "mask.npy", np.uint8, shape[:4]))
                mask.put(place, bad)
            yield [] if mask is None else ["mask.npy"]
