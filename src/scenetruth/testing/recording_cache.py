"""Recordings for tests, simulated once and cached."""

from __future__ import annotations

import copy
import json
import re
import shutil
import time
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import xarray as xr

import scenetruth
from scenetruth.cache import entry_key, source_hash
from scenetruth.errors import OutputExistsError, Problem, SceneError, SceneWarning, StoreError
from scenetruth.estimators.estimation import read_only
from scenetruth.output import OwnershipResult, lock_output, remove_leftovers, write_atomically
from scenetruth.provenance import scene_hash
from scenetruth.scene import Scene, load_scene
from scenetruth.scene.scene_loader import apply_overrides
from scenetruth.settings import StorageSettings
from scenetruth.storage import RECORDING, TRUTH, load_store, store_name
from scenetruth.validation_problems import suggest_word

__all__ = ["RecordingCache", "SimulatedRecording", "remove_entries"]

_WARNINGS = "warnings.json"
_ENTRY = re.compile(r"recording-[0-9a-f]{40}")
_WAIT_S = 0.1
_IN_MEMORY = 8
"""Number of recordings in memory, so that tests that share a recording read it once."""
_Entry = tuple[xr.Dataset, xr.Dataset, tuple[str, ...]]
"""Recording, truth, and warnings of an entry."""


@dataclass(frozen=True, eq=False)
class SimulatedRecording:
    """A scene with its recording and truth, in memory, with read-only arrays."""

    recording: xr.Dataset
    truth: xr.Dataset
    scene: Scene


class RecordingCache:
    """Simulates recordings of scenes, or reads them from a cache directory.

    The key of an entry is a hash of the scene, its input files, the source of scenetruth and all other dependencies of
    the images. Entries are written atomically, a damaged entry is replaced, and only one process simulates an entry
    while the others wait. ``root`` is the base of relative scene paths, after the current directory.
    """

    def __init__(self, folder: Path, root: Path) -> None:
        self.folder, self._root = folder, root
        self._load = lru_cache(maxsize=_IN_MEMORY)(_load)

    def __call__(
        self,
        scene: str | Path | Mapping[str, Any] | Scene,
        *overrides: str,
        save_radiance: bool = False,
        truth_content: Literal["standard", "complete"] = "standard",
    ) -> SimulatedRecording:
        """Return the recording of a scene and its truth."""
        chosen = self._scene(scene, overrides)
        key = entry_key("recording", scene_hash(chosen), bool(save_radiance), truth_content, _source())
        recording, truth, messages = self._found(self.folder / key, chosen, save_radiance, truth_content)
        for message in messages:
            warnings.warn(message, SceneWarning, stacklevel=2)
        return SimulatedRecording(read_only(recording), read_only(truth), chosen)

    def _found(
        self, entry: Path, scene: Scene, save_radiance: bool, truth_content: Literal["standard", "complete"]
    ) -> _Entry:
        while True:
            # Missing or damaged.
            with suppress(StoreError):
                return self._load(entry)
            try:
                with lock_output(entry, _claim):
                    # Another process may have written it in the meantime.
                    with suppress(StoreError):
                        return self._load(entry)
                    _make(entry, scene, save_radiance, truth_content)
                    return self._load(entry)
            except OutputExistsError:
                # Another process is simulating it; if it dies, its lock is released, and the next process takes over.
                time.sleep(_WAIT_S)

    def _scene(self, scene: object, overrides: tuple[str, ...]) -> Scene:
        if isinstance(scene, str | Path):
            chosen = load_scene(self._file(scene), overrides=overrides)
        elif isinstance(scene, Scene | Mapping):
            plain = scene.to_dict() if isinstance(scene, Scene) else copy.deepcopy(dict(scene))
            apply_overrides(plain, overrides)
            chosen = Scene.from_dict(plain, folder=self._root)
        else:
            message = "must be a scene, its file, its name, or plain values as in a scene file"
            raise SceneError([Problem("scene", message, type(scene).__name__)])
        backend = "raycast" if chosen.render.backend == "auto" else chosen.render.backend
        render = chosen.render.model_copy(update={"backend": backend})
        return chosen.model_copy(update={"render": render, "storage": StorageSettings()})

    def _file(self, name: str | Path) -> Path:
        """Return the file of a scene, which may be missing if it was specified as a path."""
        path = Path(name)
        if isinstance(name, Path) or path.suffix in (".yaml", ".yml") or len(path.parts) != 1:
            beside = self._root / path
            return beside if not path.exists() and beside.exists() else path
        folders = [self._root / "scenes", *_checkout()]
        files = {file.stem: file for folder in reversed(folders) for file in sorted(folder.glob("*.yaml"))}
        if str(name) in files:
            return files[str(name)]
        message = f"no scene of this name in {' or '.join(map(str, folders))}"
        message += suggest_word(str(name), files) or "; specify the path of a scene file"
        if len(folders) == 1:
            message += " (the bundled scenes are available by name in a checkout only, not once installed)"
        raise SceneError([Problem("scene", message, str(name))])


def remove_entries(folder: Path) -> int:
    """Remove the entries of a directory, and nothing else in it; return their number."""
    removed = 0
    for entry in sorted(folder.iterdir()) if folder.is_dir() else ():
        if _ENTRY.fullmatch(entry.name):
            with suppress(OutputExistsError), lock_output(entry, _claim):
                shutil.rmtree(entry)
                removed += 1
    if folder.is_dir():
        remove_leftovers(folder, _claim)
    return removed


def _make(entry: Path, scene: Scene, save_radiance: bool, truth_content: Literal["standard", "complete"]) -> None:
    from scenetruth.simulation import simulate_into
    from scenetruth.truth import TruthOptions

    with write_atomically(entry, overwrite=True, claim=_claim) as partial:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            partial.mkdir()
            choice = TruthOptions("reference", "actual", truth_content)
            simulate_into(partial, scene, choice, save_radiance=save_radiance)
        values = [str(item.message) for item in caught if issubclass(item.category, SceneWarning)]
        (partial / _WARNINGS).write_text(json.dumps(values), encoding="utf-8")
    for item in caught:
        if not issubclass(item.category, SceneWarning):
            warnings.warn_explicit(item.message, item.category, item.filename, item.lineno)


def _load(entry: Path) -> _Entry:
    """Read an entry and verify its checksums."""
    recording = load_store(entry / store_name(RECORDING, zipped=False), kind="recording")
    truth = load_store(entry / store_name(TRUTH, zipped=False), kind="truth")
    try:
        messages = json.loads((entry / _WARNINGS).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise StoreError(entry, f"is damaged: {error}") from error
    return recording, truth, tuple(map(str, messages))


def _claim(path: Path) -> OwnershipResult:
    """Claim a path with the name of an entry: in this directory, no other file is named by a hash."""
    return OwnershipResult()


def _source() -> str:
    # The version does not change while scenetruth itself is edited.
    return source_hash(Path(scenetruth.__file__).parent)


def _checkout() -> list[Path]:
    """Return the directory of the bundled scenes, which is not part of an installation."""
    package = Path(scenetruth.__file__).resolve().parent
    library = package.parents[1] / "scenes"
    return [library] if package.parent.name == "src" and library.is_dir() else []
