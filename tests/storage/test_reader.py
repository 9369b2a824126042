"""Damage of stores is found: by whoever reads the damaged part, and by whoever verifies."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr

import scenetruth as st
from scenetruth.storage import verify_store
from tests.helpers.nightly import nightly


@pytest.fixture(scope="module")
def stores(data: dict[str, xr.Dataset], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stores")
    for kind, dataset in data.items():
        for suffix in (".zarr", ".zarr.zip"):
            st.save_store(dataset, folder / f"{kind}{suffix}")
    return folder


def files_of(store: Path) -> list[Path]:
    return sorted(file for file in store.rglob("*") if file.is_file())


def test_whole_stores_are_whole(stores: Path) -> None:
    for kind in ("recording", "truth", "estimate"):
        for suffix in (".zarr", ".zarr.zip"):
            assert verify_store(stores / f"{kind}{suffix}") == kind


@pytest.mark.parametrize("kind", ["recording", "truth", "estimate"])
def test_every_flipped_bit_is_found(stores: Path, kind: str, tmp_path: Path) -> None:
    check_flips(stores / f"{kind}.zarr", tmp_path / "x.zarr", count=8, seed=0)


@nightly
def test_three_hundred_flipped_bits_are_found(stores: Path, tmp_path: Path) -> None:
    for number, kind in enumerate(("recording", "truth", "estimate")):
        check_flips(stores / f"{kind}.zarr", tmp_path / f"{kind}.zarr", count=100, seed=number + 1)


def check_flips(store: Path, copy: Path, count: int, seed: int) -> None:
    """Flip single bits, half of them in metadata, and ask for an error of ours each time."""
    shutil.copytree(store, copy)
    generator = np.random.default_rng(seed)
    files = files_of(copy)
    kinds = [[file for file in files if file.name == "zarr.json"], [file for file in files if file.name != "zarr.json"]]
    for number in range(count):
        chosen = kinds[number % 2]
        # Every byte is as likely as any other, but that small files count as one of 4 kB.
        sizes = np.array([max(4096, file.stat().st_size) for file in chosen])
        file = chosen[generator.choice(len(chosen), p=sizes / sizes.sum())]
        content = bytearray(file.read_bytes())
        bit = int(generator.integers(8 * len(content)))
        content[bit // 8] ^= 1 << bit % 8
        original = file.read_bytes()
        file.write_bytes(content)
        with pytest.raises(st.StoreError):
            verify_store(copy)
        file.write_bytes(original)
    verify_store(copy)


def test_every_flipped_bit_of_a_zip_file_is_found(stores: Path, tmp_path: Path) -> None:
    whole = (stores / "estimate.zarr.zip").read_bytes()
    generator = np.random.default_rng(1)
    # Its directory is at the end.
    places = [*generator.integers(0, len(whole), 8), *generator.integers(len(whole) - 2000, len(whole), 8)]
    bits = [(place, int(generator.integers(8))) for place in places]
    # That says an entry is encrypted, in its own header and in the directory.
    bits += [(6, 0), (whole.index(b"PK\x01\x02") + 8, 0)]
    for place, bit in bits:
        content = bytearray(whole)
        content[place] ^= 1 << bit
        (tmp_path / "x.zarr.zip").write_bytes(content)
        with pytest.raises(st.StoreError):
            verify_store(tmp_path / "x.zarr.zip")


def test_damaged_chunks_are_found_where_they_are_read(stores: Path, tmp_path: Path) -> None:
    shutil.copytree(stores / "truth.zarr", tmp_path / "x.zarr")
    file = next((tmp_path / "x.zarr" / "depth" / "c").rglob("0"), None)
    file = max(files_of(tmp_path / "x.zarr" / "depth"), key=lambda path: path.stat().st_size)
    content = bytearray(file.read_bytes())
    content[10] ^= 1
    file.write_bytes(content)
    opened = st.open_store(tmp_path / "x.zarr")
    # The reference image is computed first, and lies first; others, and other variables, are whole.
    assert np.isfinite(opened["depth"].sel(t=2).values).any()
    with pytest.raises(st.StoreError, match=r"x\.zarr: is damaged: 'depth' cannot be read"):
        opened["depth"].sel(t=opened["t"]).load()
    with pytest.raises(st.StoreError, match="'depth' cannot be read"):
        st.load_store(tmp_path / "x.zarr")


def test_changed_metadata_is_found(stores: Path, tmp_path: Path) -> None:
    shutil.copytree(stores / "recording.zarr", tmp_path / "x.zarr")
    attrs = zarr.open_group(tmp_path / "x.zarr", mode="r+").attrs
    attrs["focal_length_px"] = 2 * attrs["focal_length_px"]
    with pytest.raises(st.StoreError, match="its metadata, or the names or sizes of its files, have changed"):
        st.load_store(tmp_path / "x.zarr")


@pytest.mark.parametrize("damage", ["lost", "cut", "metadata", "empty"])
def test_a_store_that_is_cut_short(stores: Path, tmp_path: Path, damage: str) -> None:
    store = tmp_path / "x.zarr"
    shutil.copytree(stores / "recording.zarr", store)
    chunk = max(files_of(store), key=lambda path: path.stat().st_size)
    if damage == "lost":
        chunk.unlink()
    elif damage == "cut":
        chunk.write_bytes(chunk.read_bytes()[:-9])
    elif damage == "empty":
        (store / "zarr.json").write_text("")
    else:
        (store / "zarr.json").write_text((store / "zarr.json").read_text()[:-40])
    with pytest.raises(st.StoreError, match="damaged"):
        st.load_store(store)


def test_other_versions_of_the_format(stores: Path, tmp_path: Path) -> None:
    shutil.copytree(stores / "recording.zarr", tmp_path / "x.zarr")
    attrs = zarr.open_group(tmp_path / "x.zarr", mode="r+").attrs
    attrs["format"] = 99
    with pytest.raises(st.StoreError, match=r"format 99; .* update scenetruth"):
        st.load_store(tmp_path / "x.zarr")
    attrs["format"] = 1
    with pytest.raises(st.StoreError, match=r"format 1 with obsolete variable names; .* create the store again"):
        st.load_store(tmp_path / "x.zarr")
    del attrs["format"]
    with pytest.raises(st.StoreError, match=r"format 1 with obsolete variable names; .* create the store again"):
        st.load_store(tmp_path / "x.zarr")


def test_what_is_no_store_of_ours(stores: Path, tmp_path: Path) -> None:
    with pytest.raises(st.StoreError, match="no such store"):
        st.load_store(tmp_path / "nothing.zarr")
    with pytest.raises(st.StoreError, match="holds a truth, but a recording is needed"):
        st.load_store(stores / "truth.zarr", kind="recording")
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("hello")
    zarr.open_group(tmp_path / "other.zarr", mode="w", zarr_format=3)
    for name in ("folder", "file", "other.zarr"):
        with pytest.raises(st.StoreError, match="was not written by scenetruth"):
            st.load_store(tmp_path / name)
