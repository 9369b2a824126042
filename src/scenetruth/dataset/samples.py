"""Samples: simulated, described by statistics of their truth, partitioned between machines, and stored."""

from __future__ import annotations

import json
import math
import platform
import traceback
import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.dataset.checksums import dump_record, file_sha256, load_record
from scenetruth.dataset.fingerprint import DatasetFingerprint, open_sampler, read_fingerprint, refuse_changed_files
from scenetruth.dataset.layout import (
    RECORDING,
    SAMPLE,
    SCENE,
    TRUTH,
    DatasetFolder,
    claim_sample,
    compute_shard_number,
    list_shard_samples,
    pack_shard,
    read_shard_records,
)
from scenetruth.dataset.sampler import Draw, Sampler
from scenetruth.errors import (
    BackendUnavailableError,
    MachineError,
    Problem,
    RecipeError,
    ScenetruthError,
    SceneWarning,
    StoreError,
)
from scenetruth.jobs.results import TaskResult, describe_error, perform_task
from scenetruth.jobs.worker_setup import refuse_other_versions
from scenetruth.output import write_atomically
from scenetruth.scene import Scene
from scenetruth.storage import open_store

__all__ = [
    "STATISTICS",
    "Partition",
    "SampleStore",
    "build_sample_scene",
    "compute_truth_statistics",
    "make_sample",
    "try_sample",
]


STATISTICS = {
    "depth_min_mm": "smallest depth visible to the reference camera at the reference frame",
    "depth_max_mm": "largest depth",
    "disparity_min_px": "smallest disparity, px per step",
    "disparity_max_px": "largest disparity, px per step",
    "flow_rms_px_per_frame": "RMS optical flow of the visible surfaces, px per frame",
    "flow_max_px_per_frame": "largest flow, px per frame",
    "velocity_z_median_mm_per_frame": "median of U_Z over the moving objects, mm per frame; 0 if none moves",
    "growth_median_per_hour": "relative growth rate of area, 1/h: median over the pixels that show growing objects; "
    "0 if none grows",
    "seen_share": "fraction of the image that shows a surface",
    "occluded_share": "fraction of the visible surface that is occluded, or outside the image, in another camera",
    "mixed_share": "fraction of mixed pixels in the image",
}
"""Descriptions of the columns; all values refer to the reference camera at the reference frame."""
_HOUR_S = 3600.0
_STILL = 1e-9
"""Upper limit of rounding errors of growth per frame and of displacement in mm."""


def compute_truth_statistics(truth: xr.Dataset) -> dict[str, Any]:
    """Return statistics of a truth."""
    at = {dim: truth.indexes[dim].get_loc(0) for dim in ("t", "s", "s_y") if dim in truth["depth"].dims}
    names = ("depth", "disparity", "flow", "velocity", "growth_rate", "object_id", "occluded_across_cameras", "mixed")
    # Selecting by label, xarray would import Dask, see `with_indexes`.
    given = {name: truth.variables[name] for name in names if name in truth}
    maps = {name: item.isel(at, missing_dims="ignore").values for name, item in given.items()}
    seen = maps["object_id"] >= 0
    depth, disparity = maps["depth"][seen], maps["disparity"][seen]
    speed = np.hypot(*maps["flow"])[seen]
    per_hour = _HOUR_S / float(truth.attrs["frame_interval_s"])
    moving = _mask_objects_with(np.linalg.norm(maps["velocity"], axis=0), maps["object_id"])
    growing = _mask_objects_with(np.abs(maps["growth_rate"]), maps["object_id"])
    found: dict[str, Any] = {
        "depth_min_mm": _least(depth),
        "depth_max_mm": _largest(depth),
        "disparity_min_px": _least(disparity),
        "disparity_max_px": _largest(disparity),
        "flow_rms_px_per_frame": float(np.sqrt(np.mean(speed**2))) if speed.size else float("nan"),
        "flow_max_px_per_frame": _largest(speed),
        "velocity_z_median_mm_per_frame": _masked_median(maps["velocity"][2], moving, seen),
        "growth_median_per_hour": _masked_median(maps["growth_rate"], growing, seen) * per_hour,
        "seen_share": float(seen.mean()),
        "occluded_share": float(maps["occluded_across_cameras"][seen].mean()) if seen.any() else 0.0,
        "mixed_share": float(maps["mixed"].mean()),
    }
    found["objects"] = [
        {
            "name": name,
            "image_share": float(own.mean()),
            "seen_by_all": float(1 - maps["occluded_across_cameras"][own].mean()) if own.any() else 0.0,
            "depth_min_mm": _least(maps["depth"][own]),
            "depth_max_mm": _largest(maps["depth"][own]),
            "growth_median_per_hour": _median(maps["growth_rate"][own]) * per_hour,
        }
        for number, name in enumerate(json.loads(truth.attrs["object_names"]))
        for own in [maps["object_id"] == number]
    ]
    return found


def _least(values: NDArray[Any]) -> float:
    return float(values.min()) if values.size else float("nan")


def _largest(values: NDArray[Any]) -> float:
    return float(values.max()) if values.size else float("nan")


def _median(values: NDArray[Any]) -> float:
    return float(np.median(values)) if values.size else float("nan")


def _mask_objects_with(amount: NDArray[Any], object_id: NDArray[Any]) -> NDArray[np.bool_]:
    """Return the mask of the objects with a nonzero amount, because static background may cover most of the image."""
    return np.isin(object_id, np.unique(object_id[(object_id >= 0) & (amount > _STILL)]))


def _masked_median(values: NDArray[Any], these: NDArray[np.bool_], seen: NDArray[np.bool_]) -> float:
    return 0.0 if seen.any() and not these.any() else _median(values[these])


def build_sample_scene(sampler: Sampler, identity: DatasetFingerprint, draw: Draw) -> Scene:
    """Return the scene of a sample as rendered, with the backend of the data set and zip stores."""
    plain = dict(draw.plain)
    plain["render"] = {**plain["render"], "backend": identity.backend, "platform": identity.platform}
    plain["storage"] = {**plain["storage"], "form": "zip"}
    return Draw(**{**draw.__dict__, "plain": plain}).scene()


def make_sample(sampler: Sampler, identity: DatasetFingerprint, number: int, target: Path) -> dict[str, Any]:
    """Generate a sample in a new directory, written atomically."""
    from scenetruth.simulation import simulate_into
    from scenetruth.truth import TruthOptions

    draw = sampler.draw(number)
    scene = build_sample_scene(sampler, identity, draw)
    refuse_changed_files(identity, scene)
    recipe = sampler.recipe
    choice = TruthOptions(recipe.truth.views, recipe.truth.poses, recipe.truth.content)
    with write_atomically(target, claim=claim_sample) as partial_:
        partial_.mkdir()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            simulate_into(partial_, scene, choice, save_radiance=recipe.save_radiance)
        refuse_changed_files(identity, scene)
        entries = [str(one.message) for one in caught if issubclass(one.category, SceneWarning)]
        row = _row(draw, scene, entries, partial_)
        (partial_ / SAMPLE).write_text(dump_record(row), encoding="utf-8")
    return row


def _row(draw: Draw, scene: Scene, messages: list[str], folder: Path) -> dict[str, Any]:
    recording = open_store(folder / RECORDING, kind="recording")
    truth = open_store(folder / TRUTH, kind="truth")
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
        "statistics": compute_truth_statistics(truth),
        "warnings": messages,
        "files": {name: _file(folder / name) for name in (SCENE, RECORDING, TRUTH)},
    }
    return dict(_finite(row))


def _file(path: Path) -> dict[str, Any]:
    return {"sha256": file_sha256(path), "bytes": path.stat().st_size}


def _finite(value: Any) -> Any:
    """Return plain values with None for non-finite numbers, which JSON does not support."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def read_sample(folder: Path) -> dict[str, Any]:
    """Return the contents of ``sample.json``, verified by its checksum."""
    try:
        return load_record((folder / SAMPLE).read_bytes())
    except (OSError, ValueError, TypeError) as error:
        remedy = f"remove {folder}, and run the data set again"
        raise StoreError(folder / SAMPLE, f"is missing or damaged: {error}; {remedy}") from error


def try_sample(folder: str, known: Mapping[int, tuple[str, ...]], number: int) -> TaskResult:
    """Generate a sample in a worker; exceptions are returned. ``known``: Draws already accepted, see `Sampler`."""
    places = DatasetFolder(folder)
    target = places.sample(number)
    if target.exists():
        return TaskResult(number, read_sample(target))

    def work() -> dict[str, Any]:
        try:
            sampler, identity = _opened(folder, places.identity.stat().st_mtime_ns)
            sampler.known.update(known)
            return make_sample(sampler, identity, number, target)
        except BackendUnavailableError as error:
            raise _explain_missing_backend(error) from error

    return perform_task(number, work, describe=partial(_failure, folder, number), raised=(MachineError,))


def _explain_missing_backend(error: BackendUnavailableError) -> MachineError:
    """Return the error of a machine that lacks the backend of the data set; the sample itself is valid."""
    message = (
        f"{platform.node()} cannot render this data set with the backend selected at its start: {error}; "
        "repair or remove this machine, and repeat the command to resume"
    )
    return MachineError([Problem("workers", message)])


@lru_cache(maxsize=4)
def _opened(folder: str, version: int) -> tuple[Sampler, DatasetFingerprint]:
    """Return recipe and fingerprint of a data set; they are read again after a change of the files."""
    places = DatasetFolder(folder)
    identity = read_fingerprint(places)
    refuse_other_versions(identity.versions)
    return open_sampler(places), identity


def _failure(folder: str, number: int, error: Exception) -> dict[str, Any]:
    values: dict[str, Any] = {}
    try:
        places = DatasetFolder(folder)
        values = dict(_opened(folder, places.identity.stat().st_mtime_ns)[0].draw(number).values)
    except Exception:  # the recipe itself may be the cause
        values = {}
    return {
        "sample": number,
        **describe_error(error),
        "values": values,
        "again": f"scenetruth dataset sample {DatasetFolder(folder).recipe} {number} -o sample_{number:08d}",
        # For errors of this package the message suffices.
        "traceback": "" if isinstance(error, ScenetruthError) else traceback.format_exc(),
    }


@dataclass(frozen=True)
class Partition:
    """Partition ``number``, from 1, of ``count`` partitions of a data set, which a run generates.

    >>> [number for number in range(10) if number in Partition(2, 3).numbers(10)]
    [3, 4, 5]
    >>> Partition.read("2/3")
    Partition(number=2, count=3)
    """

    number: int = 1
    count: int = 1

    @staticmethod
    def read(text: str) -> Partition:
        """Parse a partition such as ``3/10``."""
        first, separator, second = text.partition("/")
        if separator and first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second) <= 1_000_000:
            return Partition(int(first), int(second))
        raise RecipeError([Problem("--partition", "must have the form NUMBER/COUNT, such as 3/10", text)])

    def numbers(self, count: int, together: int = 1) -> range:
        """Return the sample numbers of this partition of ``count`` samples, in groups of ``together``."""
        groups = -(-count // together)
        first, last = groups * (self.number - 1) // self.count, groups * self.number // self.count
        return range(min(first * together, count), min(last * together, count))

    @property
    def label(self) -> str:
        """Label in file names."""
        return f"{self.number}of{self.count}"


@dataclass(frozen=True)
class SampleStore:
    """The samples of a data set in shards of ``per_shard`` samples; 0 for one directory per sample."""

    folder: DatasetFolder
    count: int
    per_shard: int

    @staticmethod
    def of(folder: DatasetFolder, sampler: Sampler, identity: DatasetFingerprint) -> SampleStore:
        """Return the sample store of a data set."""
        per_shard = sampler.recipe.samples_per_shard if sampler.recipe.layout == "shards" else 0
        return SampleStore(folder, identity.count, per_shard)

    def numbers(self, part: Partition) -> range:
        """Return the sample numbers of a partition; shards are not divided."""
        return part.numbers(self.count, max(self.per_shard, 1))

    def present(self, among: range) -> set[int]:
        """Return the numbers of the existing samples."""
        found = {number for number in self.folder.done() if number in among}
        if self.per_shard:
            for shard in self.folder.done_shards():
                found.update(number for number in self._in_shard(shard) if number in among)
        return found

    def refuse_empty(self, present: Collection[int]) -> None:
        """Raise if no sample exists, for operations on existing samples."""
        if not present:
            remedy = f"generate its samples: scenetruth dataset run {self.folder.recipe} -o {self.folder.path}"
            raise StoreError(self.folder.path, f"is empty: it has a recipe, and no samples yet; {remedy}")

    def rows(self, numbers: Iterable[int]) -> Iterator[dict[str, Any]]:
        """Yield the contents of ``sample.json`` of samples, in order."""
        wanted = sorted(numbers)
        packed: dict[int, dict[str, Any]] = {}
        for number in wanted:
            path = self.folder.shard(compute_shard_number(number, self.per_shard)) if self.per_shard else None
            if path is None or not path.exists():
                yield read_sample(self.folder.sample(number))
                continue
            if number not in packed:
                packed = {row["sample"]: row for row in read_shard_records(path)}
            yield packed[number]

    def pack(self, among: range) -> None:
        """Pack complete groups of samples into shards, and finish interrupted packing."""
        if not self.per_shard:
            return
        lying = {number for number in self.folder.done() if number in among}
        for shard in sorted({compute_shard_number(number, self.per_shard) for number in lying}):
            numbers = self._in_shard(shard)
            if self.folder.shard(shard).exists() or lying.issuperset(numbers):
                pack_shard(self.folder, shard, numbers)

    def added(self, number: int) -> None:
        """Pack the shard of a new sample once its last sample exists."""
        if self.per_shard:
            shard = compute_shard_number(number, self.per_shard)
            if all(self.folder.sample(one).is_dir() for one in self._in_shard(shard)):
                pack_shard(self.folder, shard, self._in_shard(shard))

    def _in_shard(self, shard: int) -> range:
        return list_shard_samples(shard, self.per_shard, self.count)
