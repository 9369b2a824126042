"""Samples as learning code reads them: arrays and tensors, pairs of images with their flow or disparity, WebDataset."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, SupportsIndex, get_args

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.dataset.checksums import check_listed, list_path, write_with_checksums
from scenetruth.errors import ArgumentError, MachineError, Problem
from scenetruth.exporters.export_source import ExportSource, FlowKind
from scenetruth.jobs.job_folder import JobFolder
from scenetruth.progress import Progress

if TYPE_CHECKING:
    import pandas as pd

    from scenetruth.dataset.fingerprint import DatasetFingerprint

__all__ = [
    "MAPS",
    "FlowPairs",
    "ImagePair",
    "StereoPairs",
    "TensorsOf",
    "check_maps",
    "import_torch",
    "list_maps",
    "read_arrays",
    "write_webdataset",
]


class SampleData(Protocol):
    """The parts of a sample that are read: see `scenetruth.dataset.reading.Sample`."""

    @property
    def number(self) -> int:
        """Number of the sample."""

    @property
    def row(self) -> Mapping[str, Any]:
        """Row of the catalogue."""

    @property
    def values(self) -> Mapping[str, Any]:
        """Drawn values."""

    @property
    def recording(self) -> xr.Dataset:
        """The recording."""

    @property
    def truth(self) -> xr.Dataset:
        """The truth."""


class SampleSequence(Protocol):
    """The parts of a data set that are read: see `scenetruth.dataset.SceneDataset`."""

    @property
    def catalogue(self) -> pd.DataFrame:
        """The catalogue, one row per sample."""

    @property
    def identity(self) -> DatasetFingerprint:
        """Fingerprint of the data set."""

    def __len__(self) -> int: ...

    def sample(self, index: SupportsIndex) -> SampleData:
        """Return a sample by index."""


MAPS = ("depth", "velocity")
"""Maps of the truth that are returned with the images by default."""
_CHANNEL = "channel"


def read_arrays(sample: SampleData, maps: str | Sequence[str] = MAPS) -> dict[str, NDArray[Any]]:
    """Return the images and maps of a sample as arrays in the order that learning code expects.

    ``image``: float32 with full scale 1, shape (..., channel, y, x), with one channel if grey; a map of floating-point
    numbers: float32, NaN where there is no value; other maps: as they are. The leading dimensions are those of the
    recording and of the truth: camera positions s, frames t, components of vectors.
    """
    names = check_maps(sample, maps)
    found = {"image": _image(sample.recording)}
    for name in names:
        values = sample.truth[name].values
        found[name] = values.astype(np.float32) if np.issubdtype(values.dtype, np.floating) else values
    return found


def list_maps(maps: str | Sequence[str]) -> tuple[str, ...]:
    """Return the names of maps, also of a single one."""
    return (maps,) if isinstance(maps, str) else tuple(maps)


def check_maps(sample: SampleData, maps: str | Sequence[str]) -> tuple[str, ...]:
    """Return the names of maps; raise if the truth of a sample does not contain them."""
    names = list_maps(maps)
    if missing := [name for name in names if name not in sample.truth]:
        there = ", ".join(sorted(map(str, sample.truth.data_vars)))
        problems = [Problem("maps", f"is not in the truth, which contains {there}", name) for name in missing]
        raise ArgumentError(problems, source=f"sample {sample.number}")
    return names


def _image(recording: xr.Dataset) -> NDArray[np.float32]:
    image = recording["image"]
    image = image if _CHANNEL in image.dims else image.expand_dims(_CHANNEL)
    values = image.transpose(..., _CHANNEL, "y", "x").values
    return np.asarray(values / float(recording.attrs.get("full_scale", 1.0)), dtype=np.float32)


@dataclass(frozen=True)
class TensorsOf:
    """Transform of a sample to a mapping of PyTorch tensors; see `SceneDataset.to_torch`."""

    maps: tuple[str, ...] = MAPS

    def __call__(self, sample: SampleData) -> dict[str, Any]:
        """Return the tensors of `read_arrays`, and the number of the sample."""
        torch = import_torch()
        arrays = read_arrays(sample, self.maps)
        tensors = {name: torch.from_numpy(np.ascontiguousarray(values)) for name, values in arrays.items()}
        return {**tensors, "sample": sample.number}


def import_torch() -> Any:
    """Return PyTorch; raise `MachineError` if it cannot be imported."""
    try:
        import torch
    except ImportError as error:
        message = f"tensors need PyTorch, which cannot be imported ({error}): pip install torch"
        raise MachineError([Problem("torch", message)]) from error
    return torch


class ImagePair(NamedTuple):
    """Two images with the exact map between them, as loaders of KITTI, Sintel and Spring return it."""

    first: NDArray[np.float32]
    """Left image, or image of the earlier frame; full scale 1, shape (channel, y, x)."""
    second: NDArray[np.float32]
    """Right image, or image of the later frame."""
    map: NDArray[np.float32]
    """Flow in px, u to the right, v downwards, shape (2, y, x); or disparity x_left - x_right in px, shape (1, y, x);
    0 where invalid."""
    valid: NDArray[np.bool_]
    """Pixels with a value, shape (y, x); points that the other image does not show are included."""


class _Pairs(Sequence[ImagePair]):
    """Pairs of images of the samples of a data set; picklable, as PyTorch's ``DataLoader`` requires.

    Of several rows of cameras, that of the reference camera is used.
    """

    def __init__(self, dataset: SampleSequence) -> None:
        self._dataset = dataset

    def __len__(self) -> int:
        return len(self._dataset)

    def __getitem__(self, index: Any) -> Any:
        """Return the pair of a sample."""
        if isinstance(index, slice):
            return [self[place] for place in range(len(self))[index]]
        return self._pair(self._source(index))

    def __iter__(self) -> Iterator[ImagePair]:
        return (self[index] for index in range(len(self)))

    def _pair(self, source: ExportSource) -> ImagePair:
        raise NotImplementedError

    def _source(self, index: SupportsIndex) -> ExportSource:
        sample = self._dataset.sample(index)
        recording, truth = (
            each.sel(s_y=0) if "s_y" in each.dims else each for each in (sample.recording, sample.truth)
        )
        return ExportSource(recording, truth)


class FlowPairs(_Pairs):
    """Images of two successive frames of a camera, with the flow from the first to the second.

    ``frame``: First frame t. ``camera``: Position s. ``motion``: ``finite``, the displacement to the next frame, which
    only a complete truth contains; or ``instantaneous``, dx/dt per frame.
    """

    def __init__(self, dataset: SampleSequence, frame: int = 0, camera: int = 0, motion: FlowKind = "finite") -> None:
        super().__init__(dataset)
        if motion not in get_args(FlowKind):
            raise ArgumentError([Problem("motion", f"must be one of {', '.join(get_args(FlowKind))}", motion)])
        self._frame, self._camera, self._motion = frame, camera, motion

    def _pair(self, source: ExportSource) -> ImagePair:
        t, s = self._frame, self._camera
        problems = []
        if t not in source.pairs_of_frames:
            found = source.pairs_of_frames
            message = f"must be a frame with a successor, one of {found}" if found else "has no successor"
            problems.append(Problem("frame", message, t))
        if s not in source.views:
            problems.append(Problem("camera", f"must be a position with maps, one of {source.views}", s))
        name = "flow_next" if self._motion == "finite" else "flow"
        if name not in source.maps:
            message = (
                f"the truth has no '{name}'; generate it with `truth.content: complete`, or use motion='instantaneous'"
            )
            problems.append(Problem("motion", message, self._motion))
        if problems:
            raise ArgumentError(problems, source="pairs of frames")
        flow = source.flow(s, t, self._motion)
        return _as_pair(source, (s, t), (s, t + 1), flow)


class StereoPairs(_Pairs):
    """Images of a camera and its right neighbour in one frame, with the disparity of the left image.

    ``left``: Position s of the left camera. ``frame``: Frame t.
    """

    def __init__(self, dataset: SampleSequence, left: int = 0, frame: int = 0) -> None:
        super().__init__(dataset)
        self._left, self._frame = left, frame

    def _pair(self, source: ExportSource) -> ImagePair:
        pair = source.pair(self._left)
        problems = [pair] if isinstance(pair, Problem) else []
        if self._frame not in source.frames:
            problems.append(Problem("frame", f"must be a frame with maps, one of {source.frames}", self._frame))
        if isinstance(pair, Problem) or problems:
            raise ArgumentError(problems, source="pairs of cameras")
        disparity = source.disparity(source.depth(pair.left, self._frame), pair)
        return _as_pair(source, (pair.left, self._frame), (pair.right, self._frame), disparity[None])


def _as_pair(
    source: ExportSource, first: tuple[int, int], second: tuple[int, int], values: NDArray[np.float64]
) -> ImagePair:
    images = []
    for place in (first, second):
        image = source.image(*place).astype(np.float32)
        images.append(np.moveaxis(image, -1, 0) if image.ndim == 3 else image[None])
    valid = np.isfinite(values).all(axis=0)
    return ImagePair(images[0], images[1], np.where(valid, values, 0.0).astype(np.float32), np.asarray(valid))


_SHARDS = JobFolder("webdataset.json", "WebDataset shards", "shards")


def write_webdataset(
    dataset: SampleSequence,
    output: str | Path,
    *,
    maps: str | Sequence[str] = MAPS,
    samples_per_shard: int = 100,
    progress: Progress | None = None,
) -> list[Path]:
    """Write samples as WebDataset: tar files that learning code streams.

    A sample has the files ``00000417.image.npy``, one ``00000417.MAP.npy`` for each map, as `read_arrays` returns them,
    and ``00000417.json`` with its drawn values, its split, and the camera. The files of a split are
    ``shards/SPLIT-000000.tar`` and so on (``samples-000000.tar`` without splits), each with its checksum in
    ``SPLIT-000000.sha256``. Tar files are the same bytes in every run, and written atomically: an interrupted run
    resumes when it is repeated, and writes damaged tar files again.

    Parameters
    ----------
    dataset
        Samples of `open_dataset`; its transform is not applied.
    output
        Output directory: new, or that of an interrupted run with the same samples and settings.
    maps
        Variables of the truth.
    samples_per_shard
        Number of samples in a tar file.
    progress
        Called with (what, done, total).

    Returns
    -------
    list of pathlib.Path
        The tar files, in order.

    Raises
    ------
    ArgumentError
        If the truth has no such map, or the number of samples is not positive.
    OutputExistsError
        If the directory contains other files, or shards of other samples or settings.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import scenetruth as st
    >>> from scenetruth.dataset import write_webdataset
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 100]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> plain = {"camera": {"width": 30, "height": 25, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 2, "baseline_mm": 5}, "frames": {"count": 1}, "render": {"backend": "raycast"}}
    >>> with TemporaryDirectory() as folder:
    ...     _ = st.run_dataset({"name": "walls", "base": plain, "samples": 3}, output=f"{folder}/walls")
    ...     shards = write_webdataset(st.open_dataset(f"{folder}/walls"), f"{folder}/tars", samples_per_shard=2)
    ...     [path.name for path in shards]
    ['samples-000000.tar', 'samples-000001.tar']
    """
    if samples_per_shard < 1:
        raise ArgumentError([Problem("samples_per_shard", "must be at least 1", samples_per_shard)])
    maps = check_maps(dataset.sample(0), maps) if len(dataset) else list_maps(maps)
    plan = _plan_shards(dataset, samples_per_shard)
    identity = {
        "data_set": [dataset.identity.recipe_hash, dataset.identity.backend],
        "maps": list(maps),
        "shards": {name: [int(dataset.catalogue["sample"].iloc[place]) for place in places] for name, places in plan},
    }
    written, done = [], 0

    def write(partial: Path) -> None:
        with tarfile.open(partial, "w", format=tarfile.USTAR_FORMAT) as tar:
            for number, place in enumerate(places):
                if progress is not None:
                    progress("samples", done + number, len(dataset))
                _add_sample(tar, dataset.sample(place), maps)

    with _SHARDS.open(output, identity, other=lambda there: _describe_other(identity, there)) as folder:
        for name, places in plan:
            target = folder / "shards" / name
            written.append(target)
            # A tar file that was damaged since is written again.
            if not target.exists() or check_listed(list_path(target), [target], ""):
                write_with_checksums({target: write})
            done += len(places)
    if progress is not None:
        progress("samples", done, len(dataset))
    return written


def _describe_other(now: Mapping[str, Any], there: Any) -> str:
    """Return the parts in which the shards of a directory differ."""
    there = there if isinstance(there, dict) else {}
    if there.get("data_set") != now["data_set"]:
        return "contains shards of another data set; choose another output"
    if there.get("maps") != now["maps"]:
        return f"contains shards with the maps {', '.join(there.get('maps', ()))}; choose another output"
    before, after = (sum(map(len, each["shards"].values())) for each in (there, now))
    if before != after:
        return f"contains shards of {before:,} samples instead of {after:,}; choose another output"
    return "contains shards of other samples, or with another number of samples; choose another output"


def _plan_shards(dataset: SampleSequence, samples_per_shard: int) -> list[tuple[str, list[int]]]:
    """Return the names of the tar files with the indices of their samples, split by split."""
    by_split: dict[str, list[int]] = {}
    for place, split in enumerate(dataset.catalogue["split"].tolist()):
        by_split.setdefault(split if isinstance(split, str) and split else "samples", []).append(place)
    return [
        (f"{split}-{first // samples_per_shard:06d}.tar", places[first : first + samples_per_shard])
        for split, places in by_split.items()
        for first in range(0, len(places), samples_per_shard)
    ]


def _add_sample(tar: tarfile.TarFile, sample: SampleData, maps: Sequence[str]) -> None:
    key = f"{sample.number:08d}"
    for name, values in read_arrays(sample, maps).items():
        with io.BytesIO() as file:
            np.save(file, values)
            _add(tar, f"{key}.{name}.npy", file.getvalue())
    _add(tar, f"{key}.json", json.dumps(_describe(sample), ensure_ascii=False).encode("utf-8"))


def _describe(sample: SampleData) -> Mapping[str, Any]:
    attributes = sample.recording.attrs
    camera = ("focal_length_px", "principal_point_px", "baseline_mm", "frame_interval_s")
    return {
        "sample": sample.number,
        "split": sample.row.get("split") if isinstance(sample.row.get("split"), str) else None,
        "values": sample.values,
        **{name: np.asarray(attributes[name]).tolist() for name in camera},
        "image_dims": [*(dim for dim in map(str, sample.recording["image"].dims) if dim not in _LAST), *_LAST],
    }


_LAST = (_CHANNEL, "y", "x")


def _add(tar: tarfile.TarFile, name: str, content: bytes) -> None:
    # Neither time nor owner: the same bytes in every run.
    entry = tarfile.TarInfo(name)
    entry.size = len(content)
    tar.addfile(entry, io.BytesIO(content))
