"""Selections of opened stores equal those in memory, whatever is selected, and follow a store that is replaced."""

from __future__ import annotations

import pickle
import tracemalloc
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as some

import scenetruth as st

SIZES = {"s": 3, "t": 4, "y": 8, "x": 9}


def recording(seed: int, **sizes: int) -> xr.Dataset:
    shape = [{**SIZES, **sizes}[dim] for dim in SIZES]
    images = np.random.default_rng(seed).integers(0, 255, (*shape, 3), dtype=np.uint8)
    return st.make_recording(images, focal_length_px=500, baseline_mm=5)


@cache
def opened(folder: Path, suffix: str) -> xr.Dataset:
    return st.open_store(st.save_store(recording(0), folder / f"whole{suffix}"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("stored")


def indices(size: int) -> some.SearchStrategy[Any]:
    number = some.integers(-size, size - 1)
    # xarray itself fails for empty slices with a negative step.
    slices = some.slices(size).filter(lambda one: len(range(*one.indices(size))) > 0)
    return some.one_of(number, slices, some.lists(number, min_size=1, max_size=size + 2))


SELECTIONS = some.fixed_dictionaries(
    {}, optional={name: indices(size) for name, size in {**SIZES, "channel": 3}.items()}
)


@pytest.mark.parametrize("suffix", [".zarr", ".zarr.zip"])
@given(selection=SELECTIONS)
def test_selections_equal_those_in_memory(folder: Path, suffix: str, selection: dict[str, Any]) -> None:
    found = opened(folder, suffix)["image"].isel(selection)
    xr.testing.assert_identical(found.load(), recording(0)["image"].isel(selection))


@pytest.mark.parametrize("suffix", [".zarr", ".zarr.zip"])
def test_a_replaced_store_is_read_anew(tmp_path: Path, suffix: str) -> None:
    path = st.save_store(recording(1), tmp_path / f"x{suffix}")
    lazy = st.open_store(path)
    assert lazy["image"][0, 0].equals(recording(1)["image"][0, 0])
    st.save_store(recording(2), path, overwrite=True)
    assert lazy["image"].equals(recording(2)["image"])
    # Of another size, it is not what was opened.
    st.save_store(recording(2, t=5), path, overwrite=True)
    with pytest.raises(st.StoreError, match="'image' cannot be read"):
        lazy["image"].load()


@pytest.mark.parametrize("suffix", [".zarr", ".zarr.zip"])
def test_opened_stores_travel_to_other_processes(folder: Path, suffix: str) -> None:
    lazy = opened(folder, suffix)
    xr.testing.assert_identical(pickle.loads(pickle.dumps(lazy)).load(), recording(0))


def test_a_selection_needs_its_own_memory_and_that_of_a_chunk(tmp_path: Path) -> None:
    images = recording(3, t=40, y=64, x=64)
    lazy = st.open_store(st.save_store(images, tmp_path / "x.zarr"))
    lazy["image"][0, 0].load()
    tracemalloc.start()
    lazy["image"][:, :, :2].load()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # The selection is a 32nd of the images. A chunk is held packed, without checksum and decoded; xarray needs 64 KiB.
    assert peak < images["image"].nbytes / 32 + 3 * 64 * 64 * 3 + 65536
