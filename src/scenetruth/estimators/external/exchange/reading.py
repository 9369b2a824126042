"""A folder of results, from a program of any language, as an estimate."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import EstimateError, Problem, RecordingError
from scenetruth.estimators.external.exchange.file_formats import read_map
from scenetruth.estimators.external.exchange.note import Note, read_note
from scenetruth.estimators.external.exchange.result_files import NOTE_FILE, QUANTITIES, ResultFile, find_results
from scenetruth.estimators.external.exchange.shapes import arranged, type_problem
from scenetruth.schema import KIND_NONE, check_dataset, intrinsics_of, make_estimate, pixel_grid_of

__all__ = ["read_results"]

Map = NDArray[np.float64]
Frames = dict[int, Map]

_ONE_OF = ("depth", "disparity", "flow", "velocity")
_IN_PIXELS = ("disparity", "disparity_std", "flow")


def read_results(folder: str | os.PathLike[str], like: xr.Dataset) -> xr.Dataset:
    """Return what a program has written as an estimate.

    A file for each quantity, ``depth``, ``disparity``, ``flow``, ``velocity``, ``depth_rate``, ``depth_std``,
    ``disparity_std``, ``velocity_std``, ``kind``: ``NAME.npy``, ``NAME.npz``, ``NAME.pfm``, ``NAME.zarr``, or
    ``flow.flo``; of one frame ``NAME_t+0.npy``. Arrays are (t, y, x) or (y, x); of components (c, t, y, x),
    (c, y, x), or with c last. ``results.json`` may tell ``t``, ``method`` and ``units``. Pixels are those of the
    images that `write_recording` wrote; units and signs are those of camera.json.

    Parameters
    ----------
    folder
        The folder.
    like
        The recording that the results belong to.

    Returns
    -------
    xarray.Dataset
        As of `scenetruth.make_estimate`, which derives what follows. Frames that only some quantities have are NaN in
        the others.

    Raises
    ------
    RecordingError
        If the recording does not have the agreed form.
    EstimateError
        With everything that is wrong, by the names of the files: missing or unknown names, wrong shapes, types, signs,
        infinite values, nothing but NaN.

    See Also
    --------
    write_recording : What a program reads.

    Examples
    --------
    A map of disparity in px per step, from which depth in mm follows:

    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 1, 30, 40)), focal_length_px=500, baseline_mm=5)
    >>> with TemporaryDirectory() as folder:
    ...     np.save(Path(folder, "disparity.npy"), np.full((30, 40), 2.5))
    ...     found = read_results(folder, like=recording)
    >>> found.depth.sel(t=0)[15, 20].item(), found.attrs["method"]
    (1000.0, 'external')

    Whatever is wrong is told by the names of the files:

    >>> with TemporaryDirectory() as folder:
    ...     np.save(Path(folder, "disparity.npy"), np.full((40, 30), 2.5))
    ...     np.save(Path(folder, "fow.npy"), np.zeros((2, 30, 40)))
    ...     try:
    ...         read_results(folder, like=recording)
    ...     except st.EstimateError as error:
    ...         for problem in error.problems:
    ...             print(problem)
    fow.npy: has a name that means nothing; did you mean 'flow'? Put other files in a sub-folder
    disparity.npy: has the shape (40, 30), not (30, 40) or (t, 30, 40): it looks transposed: (x, y)
    """
    check_dataset(like, "recording")
    place, problems = Path(folder), list[Problem]()
    files = find_results(place, problems)
    note = read_note(place, intrinsics_of(like).frame_interval_s, problems)
    if note.t is not None and (strange := sorted(set(note.t) - set(like["t"].values.tolist()))):
        message = f"the recording has no such frames; it has {like['t'].values.tolist()}"
        problems.append(Problem(f"{NOTE_FILE}: t", message, strange))
        note = replace(note, t=None)
    found: dict[str, Frames] = {}
    for name, items in files.items():
        frames: Frames = {}
        bad = len(problems)
        for item in items:
            frames |= _frames_of(item, like, note, problems)
        if len(problems) == bad:
            found[name] = _in_our_units(name, frames, note, like, items, problems)
    arrays, times = _together(found, like)
    # Signs and contradictions are found there, also where files are missing or wrong.
    if not problems or any(name in found for name in _ONE_OF):
        try:
            made = make_estimate(like=like, t=times, method=note.method or "external", **arrays)
        except RecordingError as error:
            problems += [_by_file(problem, files, place) for problem in error.problems]
    if problems:
        raise EstimateError(problems, source=f"the results in {place}")
    return made


def _frames_of(item: ResultFile, like: xr.Dataset, note: Note, problems: list[Problem]) -> Frames:
    """Return the maps of a file by their frames, shape (c, y, x); none, with problems noted, if it holds no such."""
    path, size = item.path.name, (like.sizes["y"], like.sizes["x"])
    try:
        values = read_map(item.path, item.name)
        wrong = type_problem(values, item.name)
        if wrong:
            problems.append(Problem(path, wrong))
            # More can be told only of what counts as numbers.
            values = values.astype(np.float64) if values.dtype.kind in "iub" else values
        maps = arranged(values if values.dtype.kind in "fiub" else np.zeros(values.shape), QUANTITIES[item.name], size)
    except ValueError as error:
        problems.append(Problem(path, str(error)))
        return {}
    # Estimates are float32.
    with np.errstate(invalid="ignore"):
        infinite = int((np.abs(maps) > np.finfo(np.float32).max).sum())
    if infinite:
        problems.append(Problem(path, f"holds {infinite} infinite values, or too large ones; unknown is NaN"))
    times = _times_of(item, maps.shape[1], like, note, problems)
    return {t: maps[:, place] for place, t in enumerate(times)}


def _times_of(item: ResultFile, count: int, like: xr.Dataset, note: Note, problems: list[Problem]) -> list[int]:
    """Return the frames that a file holds; none, with a problem noted, if that is open."""
    path, recorded = item.path.name, [int(t) for t in like["t"].values]
    if item.t is not None:
        if item.t not in recorded:
            problems.append(Problem(path, f"the recording has no such frame; it has {recorded}", item.t))
            return []
        if count != 1:
            problems.append(Problem(path, f"must hold one frame, by its name; it holds {count}"))
            return []
        return [item.t]
    if note.t is not None:
        if len(note.t) != count:
            problems.append(Problem(path, f"holds {count} frames, but {NOTE_FILE} names {len(note.t)}", note.t))
            return []
        return note.t
    if count == len(recorded):
        return recorded
    if count == 1:
        return [0]
    message = f"holds {count} frames, the recording {len(recorded)}: say which in {NOTE_FILE}, "
    problems.append(Problem(path, message + f'{{"t": {recorded[:count]}}}, or write a file for each, {item.name}_t+0'))
    return []


def _in_our_units(
    name: str, frames: Frames, note: Note, like: xr.Dataset, items: list[ResultFile], problems: list[Problem]
) -> Frames:
    if frames and all(np.isnan(values).all() for values in frames.values()):
        names = ", ".join(item.path.name for item in items)
        problems.append(Problem(names, "holds nothing but NaN: nothing was estimated"))
    factor = note.factors.get(name, 1.0)
    if name in _IN_PIXELS:
        # Neighbours in an image that was thinned out are several pixels of the camera apart.
        factor *= pixel_grid_of(like).step_px
    return frames if factor == 1 else {t: values * factor for t, values in frames.items()}


def _together(found: Mapping[str, Frames], like: xr.Dataset) -> tuple[dict[str, Any], list[int]]:
    """Return arrays of the frames that any quantity has, as `make_estimate` takes them, and these frames."""
    times = sorted({t for frames in found.values() for t in frames})
    size = (len(times), like.sizes["y"], like.sizes["x"])
    arrays: dict[str, Any] = {}
    for name, frames in found.items():
        values = np.full((QUANTITIES[name], *size), KIND_NONE if name == "kind" else np.nan)
        for place, t in enumerate(times):
            if t in frames:
                values[:, place] = frames[t]
        arrays[name] = values if QUANTITIES[name] > 1 else values[0]
    if "kind" in arrays:
        arrays["kind"] = arrays["kind"].astype(np.uint8)
    return arrays, times


def _by_file(problem: Problem, files: Mapping[str, list[ResultFile]], folder: Path) -> Problem:
    items = files.get(problem.path, [])
    path = ", ".join(item.path.name for item in items) or problem.path or str(folder)
    return Problem(path, problem.message, problem.value)
