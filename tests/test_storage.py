"""Stores: what is written is read again, and nothing half-written or damaged passes for whole."""

from __future__ import annotations

import contextlib
import errno
import json
import threading
import time
import warnings
from pathlib import Path
from typing import Any, Literal

import imageio.v3 as imageio
import numpy as np
import pytest
import xarray as xr
import zarr

import scenetruth as st
from scenetruth import storage
from tests.scenes import cube

SMALL = {"camera": {"width": 48, "height": 40, "focal_length_px": 700}}


@pytest.fixture(scope="module")
def data() -> tuple[xr.Dataset, xr.Dataset, xr.Dataset]:
    sensor = {"bit_depth": 10, "noise_std": 0.01}
    recording, truth = st.simulate(cube(**SMALL, sensor=sensor))
    return recording, truth, st.estimate(recording, working_point_px=0)


def left_behind(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("index", [0, 1, 2], ids=["recording", "truth", "estimate"])
def test_round_trip(data: tuple[xr.Dataset, ...], index: int, tmp_path: Path) -> None:
    dataset = data[index]
    st.save(dataset, tmp_path / "x.zarr")
    again = st.load(tmp_path / "x.zarr")
    xr.testing.assert_identical(again, dataset)
    for name in dataset.variables:
        assert again[name].dtype.kind == dataset[name].dtype.kind
        assert again[name].dtype.itemsize == dataset[name].dtype.itemsize or dataset[name].dtype.kind == "U"
    assert left_behind(tmp_path) == ["x.zarr"]


def test_a_chunk_is_an_image(data: tuple[xr.Dataset, ...], tmp_path: Path) -> None:
    st.save(data[0], tmp_path / "x.zarr")
    assert zarr.open_group(tmp_path / "x.zarr", mode="r")["image"].chunks == (1, 1, 40, 48)


def test_the_scene_travels_with_the_data(data: tuple[xr.Dataset, ...], tmp_path: Path) -> None:
    for dataset in data:
        scene = st.scene_from_plain(json.loads(dataset.attrs["scene"]))
        assert scene.camera.width == 48


def test_existing_stores_are_refused_or_replaced(data: tuple[xr.Dataset, ...], tmp_path: Path) -> None:
    st.save(data[0], tmp_path / "x.zarr")
    with pytest.raises(st.OutputExistsError, match="exists already"):
        st.save(data[1], tmp_path / "x.zarr")
    st.save(data[1], tmp_path / "x.zarr", overwrite=True)
    assert st.load(tmp_path / "x.zarr").attrs["scenetruth"] == "truth"
    assert left_behind(tmp_path) == ["x.zarr"]


def test_a_store_of_another_kind(data: tuple[xr.Dataset, ...], tmp_path: Path) -> None:
    st.save(data[1], tmp_path / "x.zarr")
    with pytest.raises(st.StoreError, match="holds a truth, but a recording is needed"):
        st.load(tmp_path / "x.zarr", "recording")


def test_no_store(tmp_path: Path) -> None:
    with pytest.raises(st.StoreError, match="no such store"):
        st.load(tmp_path / "nothing.zarr")


def test_a_store_that_is_not_ours(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("hello")
    zarr.open_group(tmp_path / "other.zarr", mode="w", zarr_format=3)
    for name in ("folder", "file", "other.zarr"):
        with pytest.raises(st.StoreError, match="is not a store of scenetruth"):
            st.load(tmp_path / name)


def test_a_store_of_a_later_format(data: tuple[xr.Dataset, ...], tmp_path: Path) -> None:
    st.save(data[0], tmp_path / "x.zarr")
    zarr.open_group(tmp_path / "x.zarr", mode="r+").attrs["format_version"] = 99
    with pytest.raises(st.StoreError, match=r"format version 99; .* update it"):
        st.load(tmp_path / "x.zarr")


def chunk_files(store: Path) -> list[Path]:
    return sorted(path for path in store.rglob("c/**/*") if path.is_file())


@pytest.mark.parametrize("damage", ["lost", "cut", "metadata"])
def test_a_store_that_is_cut_short(data: tuple[xr.Dataset, ...], tmp_path: Path, damage: str) -> None:
    store = tmp_path / "x.zarr"
    st.save(data[0], store)
    chunk = chunk_files(store)[7]
    if damage == "lost":
        chunk.unlink()
    elif damage == "cut":
        chunk.write_bytes(chunk.read_bytes()[:-9])
    else:
        (store / "zarr.json").write_text((store / "zarr.json").read_text()[:-40])
    with pytest.raises(st.StoreError, match="damaged"):
        st.load(store)


class Refusal:
    """Stands in for a write that the operating system refuses after a while."""

    def __init__(self, error: BaseException) -> None:
        self.error = error

    def __call__(self, *_: Any, **__: Any) -> None:
        raise self.error


def test_a_full_disk_leaves_nothing_behind(
    data: tuple[xr.Dataset, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    st.save(data[0], tmp_path / "x.zarr")
    monkeypatch.setattr(storage, "_content", Refusal(OSError(errno.ENOSPC, "No space left on device")))
    with pytest.raises(st.StoreError, match="the disk is full; nothing was kept"):
        st.save(data[1], tmp_path / "x.zarr", overwrite=True)
    monkeypatch.undo()
    assert left_behind(tmp_path) == ["x.zarr"]
    xr.testing.assert_identical(st.load(tmp_path / "x.zarr"), data[0])


def test_an_interrupt_leaves_nothing_behind(
    data: tuple[xr.Dataset, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(storage, "_content", Refusal(KeyboardInterrupt()))
    with pytest.raises(KeyboardInterrupt):
        st.save(data[0], tmp_path / "x.zarr")
    assert left_behind(tmp_path) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_for_real(tmp_path: Path) -> None:

    def fill(target: Path) -> None:
        with storage.write_aside(target) as aside:
            aside.symlink_to("/dev/full")
            with aside.open("w") as file:
                file.write("x" * 100_000)

    with pytest.raises(st.StoreError, match="the disk is full"):
        fill(tmp_path / "score.json")
    assert left_behind(tmp_path) == []


def test_writers_that_finish_late_leave_nothing_behind(tmp_path: Path) -> None:
    writers = []

    def write_late(aside: Path) -> None:
        deadline = time.monotonic() + 0.3
        while time.monotonic() < deadline:
            # The folder may be cleared away between the two, which is what this is about.
            with contextlib.suppress(FileNotFoundError, FileExistsError):
                aside.mkdir(exist_ok=True)
                (aside / "chunk").write_bytes(b"0")

    def fail() -> None:
        with storage.write_aside(tmp_path / "x.zarr") as aside:
            writers.append(threading.Thread(target=write_late, args=(aside,)))
            writers[0].start()
            raise RuntimeError

    with contextlib.suppress(RuntimeError):
        fail()
    writers[0].join()
    assert left_behind(tmp_path) == []


@pytest.mark.parametrize("form", ["png", "tiff"])
def test_image_files_hold_the_images(data: tuple[xr.Dataset, ...], tmp_path: Path, form: Any) -> None:
    recording = data[0]
    storage.write_images(recording, tmp_path / "images", form)
    files = left_behind(tmp_path / "images")
    assert len(files) == 45
    assert f"s+0_t-4.{form}" in files
    image = imageio.imread(tmp_path / "images" / f"s-2_t+3.{form}")
    expected = recording["image"].sel(s=-2, t=3).values
    if form == "png":
        assert image.dtype == np.uint16
        assert (np.rint(image / 65535 * 1023) == expected).all()
    else:
        assert image.dtype == np.float32
        np.testing.assert_allclose(image * 1023, expected, atol=1e-4)


@pytest.mark.parametrize("index", [0, 1, 2], ids=["recording", "truth", "estimate"])
def test_xarray_alone_opens_a_store_without_a_warning(data: tuple[xr.Dataset, ...], index: int, tmp_path: Path) -> None:
    st.save(data[index], tmp_path / "x.zarr")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        opened = xr.open_zarr(tmp_path / "x.zarr", chunks=None)
        assert opened["y"].values.tolist() == data[index]["y"].values.tolist()


@pytest.mark.parametrize("index", [0, 1, 2], ids=["recording", "truth", "estimate"])
def test_what_lost_its_stamp_is_stamped_again(data: tuple[xr.Dataset, ...], index: int, tmp_path: Path) -> None:
    kinds: tuple[Literal["recording", "truth", "estimate"], ...] = ("recording", "truth", "estimate")
    kind = kinds[index]
    bare = data[index].copy()
    del bare.attrs["scenetruth"], bare.attrs["format_version"]
    st.save(bare, tmp_path / "x.zarr")
    assert st.load(tmp_path / "x.zarr", kind).attrs["scenetruth"] == kind


def test_what_could_not_be_loaded_is_not_saved(data: tuple[xr.Dataset, ...], tmp_path: Path) -> None:
    without = data[2].copy()
    without.attrs = {}
    with pytest.raises(st.RecordingError, match=r"attrs\.focal_length_px: must be a finite number"):
        st.save(without, tmp_path / "x.zarr")
    with pytest.raises(st.RecordingError, match=r"attrs\.scenetruth: must be one of"):
        st.save(data[0].assign_attrs(scenetruth="picture"), tmp_path / "x.zarr")
    with pytest.raises(st.RecordingError, match="image: is missing"):
        st.save(data[1].assign_attrs(scenetruth="recording"), tmp_path / "x.zarr")
    assert left_behind(tmp_path) == []
