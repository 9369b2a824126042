"""Whether the results in a folder are as they were written, and belong together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from scenetruth.errors import MismatchError, ScenetruthError, StoreError
from scenetruth.pipeline.folder import RunFolder
from scenetruth.progress import Progress
from scenetruth.scene import load_scene
from scenetruth.schema import check_same_run
from scenetruth.storage import is_store, open_store, verify_store

__all__ = ["Verdict", "verify_folder"]


@dataclass(frozen=True)
class Verdict:
    """What became of checking one result.

    Parameters
    ----------
    path
        The file or store.
    problem
        What is wrong with it; empty if nothing is.
    """

    path: Path
    problem: str = ""


def verify_folder(folder: str | Path, progress: Progress | None = None) -> list[Verdict]:
    """Check every result in the folder of a run, or a single store, down to the last byte of its data.

    Parameters
    ----------
    folder
        The folder, or the store.
    progress
        Called with (what, done, total).

    Returns
    -------
    list of Verdict
        One for every scene, store and score in the folder; of parts that do not belong together, one more.

    Raises
    ------
    StoreError
        If there is nothing of ours.

    See Also
    --------
    load : It checks what it reads.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 1, 8, 8)), focal_length_px=500, baseline_mm=5)
    >>> with TemporaryDirectory() as folder:
    ...     st.save(recording, f"{folder}/recording.zarr")
    ...     [(found.path.name, found.problem) for found in verify_folder(folder)]
    [('recording.zarr', '')]
    """
    path = Path(folder)
    if is_store(path):
        parts = [path]
    elif path.is_dir():
        parts = list(_parts(RunFolder(path)))
    else:
        raise StoreError(path, "no such folder")
    if not parts:
        raise StoreError(path, "holds no results of scenetruth")
    verdicts = []
    for done, part in enumerate(parts):
        if progress is not None:
            progress("verify", done, len(parts))
        verdicts.append(Verdict(part, _problem(part)))
    if progress is not None:
        progress("verify", len(parts), len(parts))
    whole = [verdict.path for verdict in verdicts if not verdict.problem and _is_named_store(verdict.path)]
    try:
        check_same_run({str(store): open_store(store).attrs for store in whole})
    except MismatchError as error:
        verdicts += [Verdict(Path(problem.path), problem.message) for problem in error.problems]
    return verdicts


def _parts(run: RunFolder) -> Iterator[Path]:
    yield from (file for file in (run.scene, run.recording, run.truth) if file.exists())
    yield from sorted(run.stores("estimate*"))
    yield from sorted(run.path.glob("score*.json"))


def _is_named_store(path: Path) -> bool:
    return path.name.endswith((".zarr", ".zarr.zip"))


def _problem(part: Path) -> str:
    from scenetruth.scoring import Score

    try:
        if _is_named_store(part):
            verify_store(part)
        elif part.suffix == ".json":
            Score.read(part)
        else:
            load_scene(part)
    except StoreError as error:
        return error.message
    except ScenetruthError as error:
        return str(error)
    except (OSError, UnicodeDecodeError) as error:
        return f"cannot be read: {error}"
    return ""
