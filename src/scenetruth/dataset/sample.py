"""One sample: drawn, rendered, measured and put into its place, whole or not at all."""

from __future__ import annotations

import hashlib
import json
import math
import time
import traceback
import warnings
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from scenetruth.dataset.catalogue.statistics import statistics_of
from scenetruth.dataset.folder import RECORDING, SAMPLE, SCENE, TRUTH, DatasetFolder, claim_sample
from scenetruth.dataset.identity import Identity, open_sampler, read_identity
from scenetruth.dataset.sampler import Draw, Sampler
from scenetruth.dataset.unfit import refuse_other_versions, unfit_to_render
from scenetruth.errors import BackendUnavailableError, MachineError, ScenetruthError, SceneWarning, StoreError
from scenetruth.placing import is_full_disk, write_aside
from scenetruth.plain import parse_json
from scenetruth.scene import Scene
from scenetruth.storage import open_store

__all__ = ["Made", "make_sample", "read_sample", "scene_of", "try_sample"]


@dataclass(frozen=True)
class Made:
    """What became of a sample.

    Parameters
    ----------
    number
        Its number.
    row
        What the catalogue tells of it; empty if it failed.
    failure
        What went wrong, as plain values; empty if nothing did.
    seconds
        Time spent on it.
    disk_full
        Whether it failed because the disk was full: no fault of its own.
    """

    number: int
    row: dict[str, Any] = field(default_factory=dict)
    failure: dict[str, Any] = field(default_factory=dict)
    seconds: float = math.nan
    disk_full: bool = False


def scene_of(sampler: Sampler, identity: Identity, draw: Draw) -> Scene:
    """Return the scene of a sample as it is rendered: by the data set's backend, into zip files.

    Raises
    ------
    SceneError
        If the values make no scene.
    """
    plain = dict(draw.plain)
    plain["render"] = {**plain["render"], "backend": identity.backend, "platform": identity.platform}
    plain["storage"] = {**plain["storage"], "form": "zip"}
    return Draw(**{**draw.__dict__, "plain": plain}).scene()


def make_sample(sampler: Sampler, identity: Identity, number: int, target: Path) -> dict[str, Any]:
    """Make a sample in a folder that does not exist yet; it appears whole, or not at all.

    Parameters
    ----------
    sampler, identity
        The recipe, and the data set that it belongs to.
    number
        Number of the sample.
    target
        The folder to make.

    Returns
    -------
    dict
        What ``sample.json`` says: what was drawn, hashes, and what the truth tells. The same each time.

    Raises
    ------
    ScenetruthError
        If the sample cannot be made.
    """
    from scenetruth.simulation import simulate_into
    from scenetruth.truth import TruthChoice

    draw = sampler.draw(number)
    scene = scene_of(sampler, identity, draw)
    recipe = sampler.recipe
    choice = TruthChoice(recipe.truth.views, recipe.truth.poses, recipe.truth.content)
    with write_aside(target, claim=claim_sample) as aside:
        aside.mkdir()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            simulate_into(aside, scene, choice, ideal=recipe.ideal)
        told = [str(one.message) for one in caught if issubclass(one.category, SceneWarning)]
        row = _row(draw, scene, told, aside)
        (aside / SAMPLE).write_text(_json(row), encoding="utf-8")
    return row


def _row(draw: Draw, scene: Scene, told: list[str], folder: Path) -> dict[str, Any]:
    recording = open_store(folder / RECORDING, "recording")
    truth = open_store(folder / TRUTH, "truth")
    row = {
        "sample": draw.number,
        "draw": draw.draw,
        "step": draw.step,
        "factor": draw.factor,
        "split": draw.split,
        "base": draw.base,
        "attempts": draw.attempts,
        "rejected": list(draw.rejected),
        "scene_seed": scene.seed,
        "scene_hash": recording.attrs["scene_hash"],
        "recording_hash": recording.attrs["recording_hash"],
        "backend": recording.attrs["render_backend"],
        "values": dict(draw.values),
        "statistics": statistics_of(truth),
        "warnings": told,
        "files": {name: _file(folder / name) for name in (SCENE, RECORDING, TRUTH)},
    }
    return dict(_finite(row))


def _file(path: Path) -> dict[str, Any]:
    with path.open("rb") as stream:
        found = hashlib.file_digest(stream, "sha256").hexdigest()
    return {"sha256": found, "bytes": path.stat().st_size}


def _json(row: dict[str, Any]) -> str:
    return json.dumps(row, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    """Return plain values with nothing in place of what is no number: JSON has no word for it."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def read_sample(folder: Path) -> dict[str, Any]:
    """Return what ``sample.json`` says.

    Raises
    ------
    StoreError
        If it is missing or damaged.
    """
    try:
        found = parse_json((folder / SAMPLE).read_bytes())
        return dict(found)
    except (OSError, ValueError, TypeError) as error:
        raise StoreError(folder / SAMPLE, f"is missing or damaged: {error}") from error


def try_sample(folder: str, number: int) -> Made:
    """Make a sample of the data set in a folder, for whoever works through many: what goes wrong is returned.

    Parameters
    ----------
    folder
        The folder of the data set.
    number
        Number of the sample. One that is there already stays as it is.

    Raises
    ------
    MachineError
        If this machine cannot make samples of this data set: another one may.
    """
    start = time.perf_counter()
    places = DatasetFolder(folder)
    target = places.sample(number)
    if target.exists():
        return Made(number, read_sample(target))
    try:
        sampler, identity = _opened(folder, places.identity.stat().st_mtime_ns)
        row = make_sample(sampler, identity, number, target)
    except BackendUnavailableError as error:
        raise unfit_to_render(error) from error
    except MachineError:
        raise
    except Exception as error:  # whatever it is, the run goes on, and tells
        seconds = time.perf_counter() - start
        return Made(number, failure=_failure(folder, number, error), seconds=seconds, disk_full=is_full_disk(error))
    return Made(number, row, seconds=time.perf_counter() - start)


@lru_cache(maxsize=4)
def _opened(folder: str, version: int) -> tuple[Sampler, Identity]:
    """Return recipe and identity of a data set; read again when its files have changed."""
    places = DatasetFolder(folder)
    identity = read_identity(places)
    refuse_other_versions(identity.versions)
    return open_sampler(places), identity


def _failure(folder: str, number: int, error: Exception) -> dict[str, Any]:
    values: dict[str, Any] = {}
    try:
        places = DatasetFolder(folder)
        values = dict(_opened(folder, places.identity.stat().st_mtime_ns)[0].draw(number).values)
    except Exception:  # what it was made from may be what is wrong
        values = {}
    return {
        "sample": number,
        "error": type(error).__name__,
        "message": str(error),
        "values": values,
        "again": f"scenetruth dataset sample {DatasetFolder(folder).recipe} {number} -o sample_{number:08d}",
        # Of errors that are ours, the message tells all.
        "traceback": "" if isinstance(error, ScenetruthError) else traceback.format_exc(),
    }
