"""Results folder: reader with metadata results.json, and its use as a method."""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import create_model

from scenetruth.errors import EstimateError, Problem, RecordingError
from scenetruth.estimators.external.recording_writer import recording_key
from scenetruth.estimators.external.result_files import METADATA_FILE, QUANTITIES, ResultFile, find_results, read_map
from scenetruth.estimators.protocol import Method, MethodSettings, Needs
from scenetruth.estimators.registry import name_problems
from scenetruth.plain_data import parse_json
from scenetruth.progress import Progress
from scenetruth.schema import STATUS_INVALID, assemble_estimate, check_dataset, compute_pixel_grid, read_intrinsics

__all__ = ["ResultsFolder", "ResultsFolderSettings", "ResultsMetadata", "read_results"]


_LENGTHS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3}
_KEYS = ("t", "method", "units")


@dataclass(frozen=True)
class ResultsMetadata:
    """Content of results.json.

    ``t``: Frames of the arrays whose file names do not specify them; None if missing.
    ``factors``: Conversion factors of the quantities to the units of this package.
    """

    t: list[int] | None = None
    method: str = ""
    factors: Mapping[str, float] = field(default_factory=dict)


def read_metadata(folder: Path, frame_interval_s: float, problems: list[Problem]) -> ResultsMetadata:
    """Return the content of results.json; defaults if the file is missing."""
    file = folder / METADATA_FILE
    if not file.is_file():
        return ResultsMetadata()
    try:
        entries = parse_json(file.read_bytes())
    except (ValueError, OSError) as error:
        problems.append(Problem(METADATA_FILE, f"cannot be read: {error}"))
        return ResultsMetadata()
    if not isinstance(entries, dict):
        problems.append(Problem(METADATA_FILE, f"must be a mapping with any of {', '.join(_KEYS)}"))
        return ResultsMetadata()
    problems += [_unknown(key, key, _KEYS) for key in entries if key not in _KEYS]
    t, method = entries.get("t"), entries.get("method", "")
    frames = None
    if t is not None:
        frames = t if isinstance(t, list) else [t]
        if not frames or not all(isinstance(n, int) and not isinstance(n, bool) for n in frames):
            problems.append(Problem(f"{METADATA_FILE}: t", "must be a frame number or a list of frame numbers", t))
            frames = None
        elif len(set(frames)) < len(frames):
            problems.append(Problem(f"{METADATA_FILE}: t", "contains a frame twice", t))
            frames = None
    if not isinstance(method, str) or not method.isprintable():
        problems.append(Problem(f"{METADATA_FILE}: method", "must be a name", method))
        method = ""
    return ResultsMetadata(frames, method, _factors(entries.get("units", {}), frame_interval_s, problems))


def _factors(units: Any, frame_interval_s: float, problems: list[Problem]) -> dict[str, float]:
    if not isinstance(units, dict):
        problems.append(Problem(f"{METADATA_FILE}: units", "must be a mapping from quantities to units", units))
        return {}
    found = {}
    for name, unit in units.items():
        if name not in QUANTITIES:
            problems.append(_unknown(f"units.{name}", name, tuple(QUANTITIES)))
            continue
        known = _get_allowed_units(name, frame_interval_s)
        if not isinstance(unit, str) or unit not in known:
            problems.append(Problem(f"{METADATA_FILE}: units.{name}", f"must be one of {', '.join(known)}", unit))
            continue
        found[name] = known[unit]
    return found


def _get_allowed_units(name: str, frame_interval_s: float) -> dict[str, float]:
    """Return the units allowed for a quantity, the default first, with their conversion factors."""
    what = name.removesuffix("_std")
    if what == "depth":
        return _LENGTHS
    if what in ("velocity", "depth_rate"):
        each = {f"{length}/frame": factor for length, factor in _LENGTHS.items()}
        return each | {f"{length}/s": factor * frame_interval_s for length, factor in _LENGTHS.items()}
    if what == "flow":
        return {"px/frame": 1.0, "px/s": frame_interval_s}
    return {"px/step": 1.0} if what == "disparity" else {"1": 1.0}


def _unknown(path: str, word: str, known: tuple[str, ...]) -> Problem:
    near = difflib.get_close_matches(word, known, n=1)
    hint = f"did you mean '{near[0]}'?" if near else f"valid: {', '.join(known)}"
    return Problem(f"{METADATA_FILE}: {path}", f"is unknown; {hint}")


def type_problem(values: NDArray[Any], name: str) -> str:
    """Return the problem of the type of an array; empty if there is none.

    >>> type_problem(np.zeros(3, dtype=np.uint16), "depth")
    'contains integers (uint16); write float32 in the units of the quantity, NaN where invalid'
    """
    kind = values.dtype.kind
    if kind == "c":
        return f"contains complex numbers ({values.dtype}); write float32"
    if kind not in "fiub":
        return f"does not contain numbers ({values.dtype}); write float32"
    if name == "status":
        if kind == "b" or not np.isin(values, (0, 1, 2, 3)).all():
            return "must contain 0 (invalid), 1 (normal component only), 2 (valid) or 3 (fallback), as uint8"
    elif kind != "f":
        what = "booleans" if kind == "b" else "integers"
        return f"contains {what} ({values.dtype}); write float32 in the units of the quantity, NaN where invalid"
    return ""


def arranged(values: NDArray[Any], components: int, size: tuple[int, int]) -> NDArray[np.float64]:
    """Return an array (t, y, x), (y, x), (c, t, y, x) or (c, y, x), or with c last, in the order (component, t, y, x).

    >>> arranged(np.zeros((30, 40, 2)), 2, (30, 40)).shape
    (2, 1, 30, 40)
    >>> arranged(np.zeros((40, 30)), 1, (30, 40))
    Traceback (most recent call last):
    ValueError: has the shape (40, 30), not (30, 40) or (t, 30, 40): transposed to (x, y)?
    """
    shape = values.shape
    if values.size == 0:
        msg = f"is empty: its shape is {shape}"
        raise ValueError(msg)
    if components == 1:
        if values.ndim in (2, 3) and shape[-2:] == size:
            return np.array(values, dtype=np.float64).reshape(1, -1, *size)
    elif values.ndim in (3, 4):
        if shape[0] == components and shape[-2:] == size:
            return np.array(values, dtype=np.float64).reshape(components, -1, *size)
        if shape[-1] == components and shape[-3:-1] == size:
            return np.array(np.moveaxis(values, -1, 0), dtype=np.float64).reshape(components, -1, *size)
    height, width = size
    lead = "" if components == 1 else f"{components}, "
    hint = _hint(shape, components, size)
    msg = f"has the shape {shape}, not ({lead}{height}, {width}) or ({lead}t, {height}, {width})"
    raise ValueError(msg + (f": {hint}" if hint else ""))


def _hint(shape: tuple[int, ...], components: int, size: tuple[int, int]) -> str:
    """Return the probable cause of a wrong shape."""
    if len(shape) < 2:
        return ""
    last = components > 1 and shape[0] != components and shape[-1] == components and len(shape) > 2
    found = shape[-3:-1] if last else shape[-2:]
    if found == size:
        if components > 1 and len(shape) == 4 and shape[1] == components:
            return "components must precede frames"
        return f"it requires {components} components" if components > 1 else "one value per pixel is required"
    if found == size[::-1]:
        return "transposed to (x, y)?"
    gaps = {had - has for had, has in zip(found, size, strict=True)}
    if gaps <= {0, 1} or gaps <= {0, -1}:
        much = "large" if 1 in gaps else "small"
        return f"one pixel too {much}: a half-pixel grid? One value per pixel centre is required"
    for times in (2, 4, 8):
        if found == tuple(-(-length // times) for length in size) or found == tuple(n // times for n in size):
            return f"it seems to contain every {times}{'nd' if times == 2 else 'th'} pixel only"
    return ""


Map = NDArray[np.float64]
Frames = dict[int, Map]

_REQUIRED_QUANTITIES = ("depth", "disparity", "flow", "velocity")
_IN_PIXELS = ("disparity", "disparity_std", "flow")


def read_results(folder: str | os.PathLike[str], recording: xr.Dataset) -> xr.Dataset:
    """Return the results of an external program as an estimate.

    One file for each quantity: ``depth``, ``disparity``, ``flow``, ``velocity``, ``depth_rate``, ``depth_std``,
    ``disparity_std``, ``velocity_std``, ``status``, as ``NAME.npy``, ``NAME.npz``, ``NAME.pfm``, ``NAME.zarr``, or
    ``flow.flo``; for a single frame ``NAME_t+0.npy``. Arrays are (t, y, x) or (y, x); with components (c, t, y, x),
    (c, y, x), or with c last. ``results.json`` may define ``t``, ``method`` and ``units``. Pixels are those of the
    images written by `write_recording`; units and signs are those of camera.json.

    Parameters
    ----------
    folder
        Results folder.
    recording
        Recording of the results.

    Returns
    -------
    xarray.Dataset
        As from `scenetruth.make_estimate`, which derives further quantities. Quantities are NaN in frames in which only
        others exist.

    Raises
    ------
    RecordingError
        If the recording is malformed.
    EstimateError
        If files are invalid; lists all problems by file name: missing or unknown names, wrong shapes, types, signs,
        infinite values, no valid pixel.

    See Also
    --------
    write_recording : Write the input of a program.

    Examples
    --------
    A disparity map in px per step, which determines the depth in mm:

    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 1, 30, 40)), focal_length_px=500, baseline_mm=5)
    >>> with TemporaryDirectory() as folder:
    ...     np.save(Path(folder, "disparity.npy"), np.full((30, 40), 2.5))
    ...     found = read_results(folder, recording=recording)
    >>> found.depth.sel(t=0)[15, 20].item(), found.attrs["method"]
    (1000.0, 'external')

    All problems are reported by file name:

    >>> with TemporaryDirectory() as folder:
    ...     np.save(Path(folder, "disparity.npy"), np.full((40, 30), 2.5))
    ...     np.save(Path(folder, "fow.npy"), np.zeros((2, 30, 40)))
    ...     try:
    ...         read_results(folder, recording=recording)
    ...     except st.EstimateError as error:
    ...         for problem in error.problems:
    ...             print(problem)
    fow.npy: is not the name of a quantity; did you mean 'flow'? Put other files in a sub-folder
    disparity.npy: has the shape (40, 30), not (30, 40) or (t, 30, 40): transposed to (x, y)?
    """
    check_dataset(recording, "recording")
    place, problems = Path(folder), list[Problem]()
    files = find_results(place, problems)
    note = read_metadata(place, read_intrinsics(recording).frame_interval_s, problems)
    if note.t is not None and (strange := sorted(set(note.t) - set(recording["t"].values.tolist()))):
        message = f"the recording has no such frames; it has {recording['t'].values.tolist()}"
        problems.append(Problem(f"{METADATA_FILE}: t", message, strange))
        note = replace(note, t=None)
    found: dict[str, Frames] = {}
    for name, items in files.items():
        frames: Frames = {}
        bad = len(problems)
        for item in items:
            frames |= _read_frames(item, recording, note, problems)
        if len(problems) == bad:
            found[name] = _in_our_units(name, frames, note, recording, items, problems)
    arrays, times = _together(found, recording)
    # This also detects signs and contradictions if other files are missing or wrong.
    if not problems or any(name in found for name in _REQUIRED_QUANTITIES):
        try:
            made = assemble_estimate(recording=recording, t=times, method=note.method or "external", **arrays)
        except RecordingError as error:
            problems += [_by_file(problem, files, place) for problem in error.problems]
    if problems:
        raise EstimateError(problems, source=f"the results in {place}")
    return made


def _read_frames(item: ResultFile, recording: xr.Dataset, note: ResultsMetadata, problems: list[Problem]) -> Frames:
    """Return the maps of a file by frame, shape (c, y, x); empty, with problems appended, if the file is invalid."""
    path, size = item.path.name, (recording.sizes["y"], recording.sizes["x"])
    try:
        values = read_map(item.path, item.name)
        wrong = type_problem(values, item.name)
        if wrong:
            problems.append(Problem(path, wrong))
            # Further problems can be detected only in numeric arrays.
            values = values.astype(np.float64) if values.dtype.kind in "iub" else values
        maps = arranged(values if values.dtype.kind in "fiub" else np.zeros(values.shape), QUANTITIES[item.name], size)
    except ValueError as error:
        problems.append(Problem(path, str(error)))
        return {}
    # Estimates are float32.
    with np.errstate(invalid="ignore"):
        infinite = int((np.abs(maps) > np.finfo(np.float32).max).sum())
    if infinite:
        problems.append(Problem(path, f"contains {infinite} infinite or too large values; write NaN where invalid"))
    times = _find_frame_numbers(item, maps.shape[1], recording, note, problems)
    return {t: maps[:, place] for place, t in enumerate(times)}


def _find_frame_numbers(
    item: ResultFile, count: int, recording: xr.Dataset, note: ResultsMetadata, problems: list[Problem]
) -> list[int]:
    """Return the frames of a file; empty, with a problem appended, if they are undetermined."""
    path, recorded = item.path.name, [int(t) for t in recording["t"].values]
    if item.t is not None:
        if item.t not in recorded:
            problems.append(Problem(path, f"the recording has no such frame; it has {recorded}", item.t))
            return []
        if count != 1:
            problems.append(Problem(path, f"must contain only the frame of its name; got {count}"))
            return []
        return [item.t]
    if note.t is not None:
        if len(note.t) != count:
            problems.append(Problem(path, f"contains {count} frames, but {METADATA_FILE} lists {len(note.t)}", note.t))
            return []
        return note.t
    if count == len(recorded):
        return recorded
    if count == 1:
        return [0]
    message = f"contains {count} frames, the recording {len(recorded)}; list them in {METADATA_FILE}, "
    problems.append(Problem(path, message + f'{{"t": {recorded[:count]}}}, or write a file for each, {item.name}_t+0'))
    return []


def _in_our_units(
    name: str,
    frames: Frames,
    note: ResultsMetadata,
    recording: xr.Dataset,
    items: list[ResultFile],
    problems: list[Problem],
) -> Frames:
    if frames and all(np.isnan(values).all() for values in frames.values()):
        names = ", ".join(item.path.name for item in items)
        problems.append(Problem(names, "contains only NaN: no valid pixel"))
    factor = note.factors.get(name, 1.0)
    if name in _IN_PIXELS:
        # Adjacent columns of a subsampled image are several camera pixels apart.
        factor *= compute_pixel_grid(recording).step_px
    return frames if factor == 1 else {t: values * factor for t, values in frames.items()}


def _together(found: Mapping[str, Frames], recording: xr.Dataset) -> tuple[dict[str, Any], list[int]]:
    """Return arrays over the frames of all quantities, in the form of `make_estimate`, and these frames."""
    times = sorted({t for frames in found.values() for t in frames})
    size = (len(times), recording.sizes["y"], recording.sizes["x"])
    arrays: dict[str, Any] = {}
    for name, frames in found.items():
        values = np.full((QUANTITIES[name], *size), STATUS_INVALID if name == "status" else np.nan)
        for place, t in enumerate(times):
            if t in frames:
                values[:, place] = frames[t]
        arrays[name] = values if QUANTITIES[name] > 1 else values[0]
    if "status" in arrays:
        arrays["status"] = arrays["status"].astype(np.uint8)
    return arrays, times


def _by_file(problem: Problem, files: Mapping[str, list[ResultFile]], folder: Path) -> Problem:
    items = files.get(problem.path, [])
    path = ", ".join(item.path.name for item in items) or problem.path or str(folder)
    return Problem(path, problem.message, problem.value)


class ResultsFolderSettings(MethodSettings):
    """Location of the results."""

    folder: str
    """Folder with a sub-folder for each recording, named after its key."""


class ResultsFolder(Method):
    """A results folder as a method, which reads existing results instead of computing them.

    ``folder/KEY`` contains the results of one recording in the files that `read_results` reads; KEY is the
    `recording_key` of the recording. Results from another computer or from manual measurement can thus be evaluated
    like those of any method.

    Parameters
    ----------
    folder
        Results folder.
    name
        Name of the method.

    Raises
    ------
    EstimateError
        If the name is invalid.

    See Also
    --------
    scenetruth.estimators.external.recording_key : Name of the sub-folder of a recording.
    scenetruth.estimators.external.read_results : Files allowed in a sub-folder.
    scenetruth.estimators.external.CommandMethod : Run an external program.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> import scenetruth as st
    >>> from scenetruth.estimators.external import ResultsFolder, recording_key
    >>> recording = st.make_recording(np.zeros((2, 1, 30, 40)), focal_length_px=500, baseline_mm=5)
    >>> with TemporaryDirectory() as folder:
    ...     place = Path(folder, recording_key(recording))
    ...     place.mkdir()
    ...     np.save(place / "depth.npy", np.full((30, 40), 1000.0))
    ...     found = st.estimate(recording, ResultsFolder(folder, "by_hand"))
    >>> found.attrs["method"], found.disparity.sel(t=0)[15, 20].item()
    ('by_hand', 2.5)
    """

    needs = Needs(exclusion_mask=True, distortion=True, schedule=True)
    reads_frames = True

    def __init__(self, folder: str | os.PathLike[str], name: str) -> None:
        if problems := name_problems(name):
            raise EstimateError(problems, source="folder of results")
        self.name = name
        self._where = str(Path(folder).absolute())
        fields: dict[str, Any] = {"folder": (str, self._where)}
        self.settings = create_model("ResultsFolderSettings", __base__=ResultsFolderSettings, **fields)

    def __reduce__(self) -> tuple[Any, ...]:
        # Models created at run time cannot be unpickled; worker processes create their own.
        return ResultsFolder, (self._where, self.name)

    def as_option(self, label: str) -> tuple[str, str]:
        """Return the option and value of the command line that specify the method."""
        return "--results", f"{label}={self._where}"

    def listing(self) -> str:
        """Return names, sizes and modification times of the files, which detect changes of the results."""
        lines = []
        for file in sorted(Path(self._where).rglob("*")):
            if file.is_file():
                entries = file.stat()
                lines.append(f"{file.relative_to(self._where)} {entries.st_size} {entries.st_mtime_ns}")
        return "\n".join(lines)

    def requirements(self, recording: xr.Dataset, settings: ResultsFolderSettings) -> list[Problem]:
        """Return a problem if the folder is missing; its contents are checked by `estimate`."""
        if Path(settings.folder).is_dir():
            return []
        return [Problem("folder", "no such results folder", settings.folder)]

    def estimate(self, recording: xr.Dataset, settings: ResultsFolderSettings, progress: Progress | None) -> xr.Dataset:
        """Read the results of a recording."""
        place = Path(settings.folder) / recording_key(recording)
        if not place.is_dir():
            message = (
                "no results for this recording; write it with "
                "scenetruth.estimators.external.write_recording(recording, FOLDER), and put the results of the "
                "program into this folder"
            )
            raise EstimateError([Problem(str(place), message)])
        return read_results(place, recording)
