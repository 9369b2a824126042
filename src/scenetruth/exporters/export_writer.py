"""Writing of exports, and replacement of earlier exports."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import xarray as xr
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from scenetruth.errors import ExportError, Problem, RecordingError
from scenetruth.exporters.export_source import ExportSource
from scenetruth.exporters.format_base import ExportFormat, load_formats
from scenetruth.output import OwnershipResult, check_output, describe_foreign_files, write_atomically
from scenetruth.schema import check_dataset, check_same_run, read_lineage
from scenetruth.validated_model import field_docstrings
from scenetruth.validation_problems import list_problems, suggest_word

__all__ = ["ExportResult", "checked_source", "choose_format", "export_data", "export_formats", "write_export"]


EXPORT_RECORD = "export.json"
"""File in every export with its description and list of files."""
MAKER = "scenetruth"


def claim_export(path: Path) -> OwnershipResult:
    """Claim the directory of an earlier export; foreign files are kept, but not inside its subdirectories."""
    if not path.is_dir():
        return OwnershipResult("is a file, and not the directory of an export")
    try:
        values = json.loads((path / EXPORT_RECORD).read_text(encoding="utf-8"))
        own = {EXPORT_RECORD, *map(str, values["files"])} if values["made_by"] == MAKER else None
    except (OSError, ValueError, KeyError, TypeError):
        own = None
    if own is None:
        return OwnershipResult(f"is a directory without the {EXPORT_RECORD} of an export")
    folders = {name.split("/")[0] for name in own if "/" in name}
    foreign, inside = [], []
    for entry in path.iterdir():
        if entry.name in folders and entry.is_dir() and not entry.is_symlink():
            inside += [name for name in _files_below(entry, path) if name not in own]
        elif entry.name not in own or entry.is_symlink():
            foreign.append(entry.name)
    return (
        OwnershipResult(describe_foreign_files(inside)) if inside else OwnershipResult(foreign=tuple(sorted(foreign)))
    )


def _files_below(folder: Path, top: Path) -> list[str]:
    """Return everything except directories below a directory, relative to the top; links are not followed."""
    found = []
    for place, folders, files in os.walk(folder):
        links = [name for name in folders if (Path(place) / name).is_symlink()]
        found += [(Path(place) / name).relative_to(top).as_posix() for name in (*files, *links)]
    return found


@dataclass(frozen=True)
class ExportResult:
    """Result of an export: file names without ``export.json``, and ``failures`` of a data set by sample number.

    ``notes``: Resolution of the format, pixels outside its range, flow that is not a displacement.
    """

    folder: Path
    files: tuple[str, ...]
    notes: tuple[str, ...]
    failures: Mapping[int, str] = field(default_factory=dict)


def export_formats(*names: str) -> dict[str, str]:
    """Return a mapping from format name to a one-line description.

    Parameters
    ----------
    *names
        Formats; default: all.

    Returns
    -------
    dict
        One line per format.

    Raises
    ------
    ExportError
        If a format is unknown.

    See Also
    --------
    export : Write data in a format.

    Examples
    --------
    >>> import scenetruth as st
    >>> st.export_formats("flo")
    {'flo': 'optical flow as .flo (Middlebury), with the images'}
    """
    found = {str(name).lower(): _find_format(name) for name in names} if names else load_formats()
    return {kind: model.summary for kind, model in found.items()}


def choose_format(name: str, options: Mapping[str, Any]) -> ExportFormat:
    """Return a format with validated options."""
    model = _find_format(name)
    try:
        return model.model_validate({"kind": str(name).lower(), **options})
    except ValidationError as error:
        raise ExportError(_option_problems(model, options, error), source=f"options of {str(name).lower()}") from None


def export_data(
    recording: xr.Dataset,
    maps: xr.Dataset,
    folder: str | Path,
    format: str,
    *,
    overwrite: bool = False,
    **options: Any,
) -> ExportResult:
    """Write a recording and its truth, or an estimate, in another format.

    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 2, 8, 8)), focal_length_px=500, baseline_mm=5)
    >>> estimate = st.make_estimate(flow=np.ones((2, 2, 8, 8)), recording=recording)
    >>> with TemporaryDirectory() as folder:
    ...     done = st.export((recording, estimate), "flo", output=f"{folder}/flow", flow="instantaneous")
    >>> done.files
    ('flow/s+0_t+0.flo', 'images/s+0_t+0.png', 'images/s+0_t+1.png')
    """
    chosen = choose_format(format, options)
    source = checked_source(recording, maps, chosen)
    check_output(folder, overwrite=overwrite, claim=claim_export)
    with write_atomically(folder, overwrite=overwrite, claim=claim_export) as partial:
        written = write_export(source, chosen, partial)
    return replace(written, folder=Path(folder))


def write_export(source: ExportSource, chosen: ExportFormat, folder: Path) -> ExportResult:
    """Write validated data into a new directory; the caller renames it on completion."""
    folder.mkdir()
    notes = chosen.write(source, folder)
    files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    values = _meta(source, chosen, notes, files)
    (folder / EXPORT_RECORD).write_text(json.dumps(values, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    return ExportResult(folder, tuple(files), tuple(notes))


def _find_format(name: str) -> type[ExportFormat]:
    known = load_formats()
    model = known.get(str(name).lower())
    if model is None:
        message = f"must be one of {', '.join(known)}{suggest_word(str(name), known)}"
        raise ExportError([Problem("format", message, name)])
    return model


def checked_source(recording: xr.Dataset, maps: xr.Dataset, chosen: ExportFormat) -> ExportSource:
    """Return the validated input of an export."""
    is_truth = isinstance(maps, xr.Dataset) and "mixed" in maps
    problems = []
    for dataset, kind in ((recording, "recording"), (maps, "truth" if is_truth else "estimate")):
        try:
            check_dataset(dataset, kind)
        except RecordingError as error:
            problems += [Problem(f"{kind}.{each.path}", each.message, each.value) for each in error.problems]
    problems += list(chosen.missing_packages())
    if not any(problem.path.startswith(("recording.", "truth.", "estimate.")) for problem in problems):
        check_same_run({"recording": recording.attrs, "truth" if is_truth else "estimate": maps.attrs})
        source = ExportSource(recording, maps, is_truth)
        fitting = list(_fit_problems(source))
        problems += fitting or list(chosen.problems(source))
    if problems:
        raise ExportError(problems)
    return source


def _fit_problems(source: ExportSource) -> Iterator[Problem]:
    recording, maps = source.recording, source.maps
    if "s_y" in recording["image"].dims or any("s_y" in item.dims for item in maps.data_vars.values()):
        rows = recording["s_y"].values.tolist()
        yield Problem(
            "s_y", "must be one row of cameras; select it: --row N, recording.sel(s_y=N), truth.sel(s_y=N)", rows
        )
    elif source.is_truth and source.views == [0] and int(recording.coords.get("s_y", 0)) != 0:
        remedy = "compute the truth of all cameras (`--truth-views all`)"
        yield Problem("s_y", f"is not the row of the truth, which is 0; {remedy}", int(recording["s_y"]))
    for name in ("y", "x"):
        if name not in maps.dims:
            continue
        one, other = (dataset[name].values if name in dataset.coords else None for dataset in (recording, maps))
        same = recording.sizes[name] == maps.sizes[name] and (one is None or other is None or (one == other).all())
        if not same:
            message = f"has {maps.sizes[name]} pixels, which differ from the {recording.sizes[name]} of the recording"
            yield Problem(name, f"{message}; select the same pixels of both, recording.sel({name}=maps.{name})")
    if not source.frames:
        yield Problem("t", "of the maps must be frames of the recording", maps["t"].values.tolist())


def _option_problems(model: type[ExportFormat], options: Mapping[str, Any], error: ValidationError) -> list[Problem]:
    names = [name for name in model.model_fields if name != "kind"]

    def words(entry: ErrorDetails, path: str) -> str | None:
        if entry["type"] == "extra_forbidden":
            offered = f"options are {', '.join(names)}" if names else "it has no options"
            return f"is not an option of this format; {offered}" + suggest_word(path, names)
        text = " ".join(field_docstrings(model).get(path, "").split())
        return f"{entry['msg']}; {text}" if text and path in names else None

    return list_problems(error, options, words=words)


def _meta(source: ExportSource, chosen: ExportFormat, notes: list[str], files: list[str]) -> dict[str, Any]:
    options = chosen.model_dump(mode="json")
    return {
        "made_by": MAKER,
        "format": options.pop("kind"),
        "options": options,
        "from": "truth" if source.is_truth else f"estimate by {source.maps.attrs.get('method', 'another program')}",
        **read_lineage(source.recording),
        **read_lineage(source.maps),
        "notes": notes,
        "meaning": chosen.meaning().splitlines(),
        "files": files,
    }
