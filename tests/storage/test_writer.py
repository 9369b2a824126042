"""What is saved is read again, as it was, and by other programs too."""

from __future__ import annotations

import json
import os
import warnings
import zipfile
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import xarray as xr
import zarr

import scenetruth as st
from scenetruth.schema import blank_map, label
from scenetruth.schema.attributes import Intrinsics
from scenetruth.storage import open_store
from scenetruth.storage.array_layout import ArrayLayout
from scenetruth.storage.writer import StoreWriter

KINDS: tuple[Literal["recording", "truth", "estimate"], ...] = ("recording", "truth", "estimate")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("read", [st.load_store, st.open_store])
@pytest.mark.parametrize("file", ["x.zarr", "x.zarr.zip"])
def test_round_trip(data: dict[str, xr.Dataset], kind: str, read: Any, file: str, tmp_path: Path) -> None:
    dataset = data[kind]
    st.save_store(dataset, tmp_path / file)
    again = read(tmp_path / file)
    xr.testing.assert_identical(again, dataset)
    for name in dataset.variables:
        assert again[name].dtype == dataset[name].dtype
        assert again[name].values.tobytes() == dataset[name].values.tobytes()
    assert [path.name for path in tmp_path.iterdir()] == [file]
    assert (tmp_path / file).is_file() == file.endswith(".zip")


def test_colours_and_rows_of_cameras_come_back(tmp_path: Path) -> None:
    images = np.random.default_rng(0).integers(0, 255, (3, 2, 2, 7, 9, 3), dtype=np.uint8)
    recording = st.make_recording(images, 500.0, 5.0, stage_y_mm=[-5.0, 0.0, 5.0])
    st.save_store(recording, tmp_path / "x.zarr")
    xr.testing.assert_identical(st.load_store(tmp_path / "x.zarr"), recording)
    assert zarr.open_group(tmp_path / "x.zarr", mode="r")["image"].chunks == (1, 1, 1, 7, 9, 3)


def test_a_chunk_is_an_image_and_a_variable_a_file(data: dict[str, xr.Dataset], tmp_path: Path) -> None:
    st.save_store(data["recording"], tmp_path / "x.zarr")
    image = zarr.open_group(tmp_path / "x.zarr", mode="r")["image"]
    assert (image.chunks, image.shards) == ((1, 1, 40, 48), (5, 9, 40, 48))
    assert len([file for file in (tmp_path / "x.zarr" / "image").rglob("*") if file.is_file()]) == 2


def test_opened_stores_read_what_is_selected(
    data: dict[str, xr.Dataset], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    st.save_store(data["recording"], tmp_path / "x.zarr")
    opened = st.open_store(tmp_path / "x.zarr")
    read: list[int] = []
    original = ArrayLayout.decode

    def decode(layout: ArrayLayout, packed: bytes) -> Any:
        chunk = original(layout, packed)
        read.append(chunk.size)
        return chunk

    monkeypatch.setattr(ArrayLayout, "decode", decode)
    one = opened["image"].sel(s=1, t=-2)
    assert read == []
    np.testing.assert_array_equal(one.values, data["recording"]["image"].sel(s=1, t=-2).values)
    assert read == [one.size]


def test_the_scene_travels_with_the_data(data: dict[str, xr.Dataset]) -> None:
    for dataset in data.values():
        assert st.Scene.from_dict(json.loads(dataset.attrs["scene"])).camera.width == 48


@pytest.mark.parametrize("kind", KINDS)
def test_xarray_alone_opens_a_store(data: dict[str, xr.Dataset], kind: str, tmp_path: Path) -> None:
    st.save_store(data[kind], tmp_path / "x.zarr")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # It tells that not every program reads pcodec; nothing else.
        warnings.filterwarnings("ignore", message="Numcodecs codecs are not in the Zarr version 3")
        opened = xr.open_zarr(tmp_path / "x.zarr", chunks=None).load()
    del opened.attrs["content"]
    xr.testing.assert_identical(opened, data[kind])


@pytest.mark.parametrize("kind", KINDS)
def test_what_lost_its_stamp_is_stamped_again(
    data: dict[str, xr.Dataset], kind: Literal["recording", "truth", "estimate"], tmp_path: Path
) -> None:
    bare = data[kind].copy()
    del bare.attrs["scenetruth"], bare.attrs["format"]
    st.save_store(bare, tmp_path / "x.zarr")
    assert st.load_store(tmp_path / "x.zarr", kind=kind).attrs["scenetruth"] == kind


def test_what_could_not_be_loaded_is_not_saved(data: dict[str, xr.Dataset], tmp_path: Path) -> None:
    without = data["estimate"].copy()
    without.attrs = {}
    with pytest.raises(st.RecordingError, match=r"attrs\.focal_length_px: must be a finite number"):
        st.save_store(without, tmp_path / "x.zarr")
    with pytest.raises(st.RecordingError, match=r"attrs\.scenetruth: must be one of"):
        st.save_store(data["recording"].assign_attrs(scenetruth="picture"), tmp_path / "x.zarr")
    with pytest.raises(st.RecordingError, match="image: is missing"):
        st.save_store(data["truth"].assign_attrs(scenetruth="recording"), tmp_path / "x.zarr")
    odd = data["recording"].assign_attrs(note=object(), gain=float("nan"))
    odd["names"] = ("t", np.array([None] * 9, dtype=object))
    with pytest.raises(st.RecordingError) as caught:
        st.save_store(odd, tmp_path / "x.zarr")
    assert [problem.path for problem in caught.value.problems] == ["attrs.note", "attrs.gain", "names"]
    assert list(tmp_path.iterdir()) == []


def test_numbers_of_numpy_among_attributes_come_back_plain(data: dict[str, xr.Dataset], tmp_path: Path) -> None:
    noted = data["recording"].assign_attrs(gain=np.float64(0.5), taps=np.array([1, 2]), pair=(3, "four"), nothing=None)
    st.save_store(noted, tmp_path / "x.zarr")
    attrs = st.load_store(tmp_path / "x.zarr").attrs
    assert [attrs[name] for name in ("gain", "taps", "pair", "nothing")] == [0.5, [1, 2], [3, "four"], None]


def test_existing_stores_are_refused_or_replaced(data: dict[str, xr.Dataset], tmp_path: Path) -> None:
    st.save_store(data["recording"], tmp_path / "x.zarr")
    with pytest.raises(st.OutputExistsError, match="exists already"):
        st.save_store(data["truth"], tmp_path / "x.zarr")
    st.save_store(data["truth"], tmp_path / "x.zarr", overwrite=True)
    assert st.load_store(tmp_path / "x.zarr").attrs["scenetruth"] == "truth"
    assert [path.name for path in tmp_path.iterdir()] == ["x.zarr"]


def test_only_stores_of_ours_are_replaced(data: dict[str, xr.Dataset], tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.txt").write_text("all my work")
    (tmp_path / "notes.txt").write_text("mine")
    zarr.open_group(tmp_path / "other.zarr", mode="w", zarr_format=3)
    with zipfile.ZipFile(tmp_path / "work.zip", "w") as archive:
        archive.writestr("chapter.txt", "all my work")
    for name in ("thesis", "notes.txt", "other.zarr", "work.zip"):
        with pytest.raises(st.OutputExistsError, match="scenetruth"):
            st.save_store(data["recording"], tmp_path / name, overwrite=True)
    st.save_store(data["recording"], tmp_path / "x.zarr")
    (tmp_path / "x.zarr" / "image" / "notes.txt").write_text("mine")
    with pytest.raises(st.OutputExistsError, match=r"not written by scenetruth \(image/notes\.txt\)"):
        st.save_store(data["truth"], tmp_path / "x.zarr", overwrite=True)
    assert (tmp_path / "x.zarr" / "image" / "notes.txt").read_text() == "mine"
    assert (tmp_path / "thesis" / "chapter.txt").read_text() == "all my work"
    # A foreign file is no damage.
    assert st.load_store(tmp_path / "x.zarr").identical(data["recording"])


def test_what_has_no_pixels_is_written_part_by_part(tmp_path: Path) -> None:
    blank = label(
        "estimate",
        {"depth": blank_map(np.float32, (2, 4, 5)), "image_roll": blank_map(np.float64, (3, 2))},
        Intrinsics(500.0, (2.0, 1.5), 5.0, 1.0),
        t=[0, 1],
    )
    with StoreWriter(tmp_path / "estimate.zarr", blank) as writer:
        for t in (0, 1):
            writer.put("depth", {"t": t}, np.full((4, 5), t, dtype=np.float32))
            writer.put("image_roll", {"t": t}, np.array([1e-6, 0.0, 2e-6 * t]))
    found = open_store(tmp_path / "estimate.zarr")
    np.testing.assert_array_equal(found["image_roll"].values, [[1e-6, 1e-6], [0.0, 0.0], [0.0, 2e-6]])


def test_a_zip_file_holds_the_files_of_the_directory(data: dict[str, xr.Dataset], tmp_path: Path) -> None:
    folder = st.save_store(data["truth"], tmp_path / "truth.zarr")
    zipped = st.save_store(data["truth"], tmp_path / "truth.zarr.zip")
    with zipfile.ZipFile(zipped) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    assert content == {
        file.relative_to(folder).as_posix(): file.read_bytes() for file in folder.rglob("*") if file.is_file()
    }
    assert list(content) == sorted(content)
    assert sorted(tmp_path.iterdir()) == [folder, zipped]  # without temporary files


def test_a_zip_file_is_made_of_few_directories(
    data: dict[str, xr.Dataset], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Each waits for the journal of the file system: 2.4 ms to remove one on ext4.
    made: list[Any] = []
    make = os.mkdir

    def counted(path: Any, mode: int = 0o777) -> None:
        make(path, mode)
        made.append(path)

    monkeypatch.setattr(os, "mkdir", counted)
    st.save_store(data["truth"], tmp_path / "truth.zarr.zip")
    assert len(made) == 1
