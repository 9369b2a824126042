"""Stores on disk: data sets in zarr and images as files, written beside their target and then renamed."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np
import xarray as xr

from scenetruth.errors import OutputExistsError, Problem, RecordingError, StoreError
from scenetruth.schema import FORMAT_VERSION, check_dataset

__all__ = ["load", "save", "write_aside", "write_images"]

_KINDS = ("recording", "truth", "estimate")
_SEAL = "content"
_QUIET_S, _PATIENCE_S = 0.25, 10.0


@contextmanager
def write_aside(target: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Give a path beside the target to write to; it becomes the target when all went well, and vanishes otherwise.

    Parameters
    ----------
    target
        The file or folder to make.
    overwrite
        Whether an existing target may be replaced; it stays until the new one is whole.

    Yields
    ------
    pathlib.Path
        Where to write. Nothing is there yet, but its parent folder exists.

    Raises
    ------
    OutputExistsError
        If the target exists and may not be replaced.
    StoreError
        If the file system refuses (disk full, no permission).
    """
    target = Path(target)
    if target.exists() and not overwrite:
        raise OutputExistsError(target)
    aside = target.with_name(f".{target.name}.partial-{os.getpid()}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        _remove(aside)
        yield aside
        _replace(target, aside)
    except OSError as error:
        _clear_up(aside)
        raise StoreError(target, _explain(error)) from error
    except BaseException:
        _clear_up(aside)
        raise


def _replace(target: Path, new: Path) -> None:
    old = target.with_name(f".{target.name}.replaced-{os.getpid()}")
    _remove(old)
    if target.exists():
        target.rename(old)
    try:
        new.rename(target)
    except BaseException:
        if old.exists():
            old.rename(target)
        raise
    _remove(old)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(IsADirectoryError):
            path.unlink(missing_ok=True)


def _clear_up(path: Path) -> None:
    """Remove what a failed or interrupted writer left.

    zarr writes in threads of its own, which may finish a chunk after the error has reached us: the path must stay away
    for a while before it counts as removed.
    """
    quiet_since = time.monotonic()
    deadline = quiet_since + _PATIENCE_S
    while time.monotonic() < min(quiet_since + _QUIET_S, deadline):
        if path.exists() or path.is_symlink():
            _remove(path)
            quiet_since = time.monotonic()
        time.sleep(0.01)


def _explain(error: OSError) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "the disk is full; nothing was kept. Free some space or choose another output"
    return f"cannot be written: {error.strerror or error}; nothing was kept"


def save(dataset: xr.Dataset, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a recording, a truth or an estimate as a zarr store, one chunk for each image or map.

    Parameters
    ----------
    dataset
        The data set.
    path
        The store to make.
    overwrite
        Whether an existing store may be replaced.

    Raises
    ------
    OutputExistsError
        If the store exists and may not be replaced.
    RecordingError
        If it is not a recording, truth or estimate that `load` could read again; lists what is wrong.
    StoreError
        If it cannot be written; nothing is left behind then.

    See Also
    --------
    load : Read it again.

    Examples
    --------
    >>> import tempfile
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 1, 8, 8)), focal_length_px=500, baseline_mm=5)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save(recording, f"{folder}/recording.zarr")
    ...     load(f"{folder}/recording.zarr", "recording").equals(recording)
    True
    """
    import zarr

    dataset = _stamped(dataset)
    encoding = {
        str(name): {
            "chunks": tuple(
                size if dim in ("y", "x") or "x" not in variable.dims else 1 for dim, size in variable.sizes.items()
            )
        }
        for name, variable in dataset.data_vars.items()
    }
    with write_aside(path, overwrite=overwrite) as aside, _without_warnings():
        dataset.to_zarr(aside, mode="w", zarr_format=3, consolidated=False, encoding=encoding)
        zarr.open_group(aside, mode="r+").attrs[_SEAL] = _content(aside)
        # Without consolidated metadata, xarray alone would warn when it opens the store.
        zarr.consolidate_metadata(aside, zarr_format=3)


def _stamped(dataset: xr.Dataset) -> xr.Dataset:
    """Return a data set with its kind and format version; arithmetic with xarray may have dropped its attributes.

    Raises
    ------
    RecordingError
        If `load` could not read it.
    """
    kind = dataset.attrs.get("scenetruth")
    if kind is None:
        kind = "recording" if "image" in dataset else "truth" if "mixed" in dataset else "estimate"
    if kind not in _KINDS:
        message = f"must be one of {', '.join(_KINDS)}"
        raise RecordingError([Problem("attrs.scenetruth", message, kind)], source="data set to save")
    stamped = dataset.assign_attrs(scenetruth=kind, format_version=FORMAT_VERSION)
    stamped.attrs.pop(_SEAL, None)
    check_dataset(stamped, kind)
    return stamped


def load(path: str | Path, kind: Literal["recording", "truth", "estimate"] | None = None) -> xr.Dataset:
    """Read a store that `save` has written.

    Parameters
    ----------
    path
        The store.
    kind
        Kind that the store must hold; any kind if not given.

    Returns
    -------
    xarray.Dataset
        The data set, in memory.

    Raises
    ------
    StoreError
        If there is no such store, it is not ours or of another kind, or it is damaged.

    See Also
    --------
    save : Write a store.

    Examples
    --------
    >>> import tempfile
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 1, 8, 8)), focal_length_px=500, baseline_mm=5)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save(recording, f"{folder}/recording.zarr")
    ...     again = load(f"{folder}/recording.zarr")
    ...     try:
    ...         load(f"{folder}/recording.zarr", "truth")
    ...     except StoreError as error:
    ...         print(error.message)
    holds a recording, but a truth is needed
    >>> again.image.dims, again.attrs["baseline_mm"]
    (('s', 't', 'y', 'x'), 5.0)
    """
    import zarr

    path = Path(path)
    if not path.exists():
        raise StoreError(path, "no such store")
    foreign = "is not a store of scenetruth"
    try:
        attrs = dict(zarr.open_group(path, mode="r").attrs)
    except Exception as error:  # zarr reports a damaged store with errors of many kinds
        raise StoreError(path, f"{foreign}, or its metadata is damaged ({error})") from error
    found, format_version, seal = attrs.get("scenetruth"), attrs.get("format_version"), attrs.get(_SEAL)
    if found not in _KINDS:
        raise StoreError(path, foreign)
    if kind is not None and found != kind:
        raise StoreError(path, f"holds a {found}, but a {kind} is needed")
    if not isinstance(format_version, int) or format_version > FORMAT_VERSION:
        message = f"has the format version {format_version}; this scenetruth reads up to {FORMAT_VERSION}: update it"
        raise StoreError(path, message)
    content = _content(path)
    if seal != content:
        raise StoreError(path, f"is damaged or cut short: sealed with {seal}, but it holds {content}; make it again")
    try:
        with _without_warnings():
            dataset: xr.Dataset = xr.open_zarr(path, consolidated=False, chunks=None).load()
    except Exception as error:
        raise StoreError(path, f"is damaged ({error}); make it again") from error
    del dataset.attrs[_SEAL]
    try:
        check_dataset(dataset, str(found))
    except RecordingError as error:
        raise StoreError(path, f"does not have the agreed form: {error}") from error
    return dataset


def _content(path: Path) -> dict[str, int]:
    """Count the files of a store, and the bytes of its chunks; a store that lost a chunk would read as empty there."""
    files = [file for file in path.rglob("*") if file.is_file() and file != path / "zarr.json"]
    return {"files": len(files), "bytes": sum(file.stat().st_size for file in files)}


def _unstable_specification() -> tuple[type[Warning], ...]:
    import zarr.errors

    names = ("UnstableSpecificationWarning", "ZarrUserWarning")
    return tuple(getattr(zarr.errors, name, FutureWarning) for name in names)


@contextmanager
def _without_warnings() -> Iterator[None]:
    """Silence what zarr warns of: short strings and consolidated metadata are not yet in its specification."""
    with warnings.catch_warnings():
        for category in _unstable_specification():
            warnings.filterwarnings("ignore", category=category)
        yield


def write_images(recording: xr.Dataset, folder: str | Path, form: Literal["png", "tiff"]) -> None:
    """Write every image of a recording as a file ``s+0_t+0.png``, or ``r+0_s+0_t+0.png`` in row ``s_y`` = 0 of a grid.

    Parameters
    ----------
    recording
        The recording.
    folder
        Folder for the files; it must not exist yet.
    form
        ``"png"``: 16 bit, full scale is 65535 (digital numbers of up to 16 bits follow from it exactly).
        ``"tiff"``: float32, full scale is 1.
    """
    import imageio.v3 as imageio

    folder = Path(folder)
    folder.mkdir(parents=True)
    full_scale = float(recording.attrs["full_scale"])
    images = recording["image"]
    leading = [dim for dim in ("s_y", "s", "t") if dim in images.dims]
    for index in product(*(recording[dim].values for dim in leading)):
        at = dict(zip(leading, index, strict=True))
        image = images.sel(at).values.astype(np.float64) / full_scale
        values = np.rint(np.clip(image, 0, 1) * 65535).astype(np.uint16) if form == "png" else image.astype(np.float32)
        name = "_".join(f"{'r' if dim == 's_y' else dim}{number:+d}" for dim, number in at.items())
        imageio.imwrite(folder / f"{name}.{form}", values)
