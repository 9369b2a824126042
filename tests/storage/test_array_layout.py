"""Small variables and chunks are read as zarr itself reads them; metadata of other stores is rejected."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import zarr

import scenetruth as st
from scenetruth.storage.array_layout import ArrayLayout, ShardReader
from scenetruth.storage.zarr_layout import ShardFile, with_checksum, without_warnings


@pytest.mark.parametrize("kind", ["recording", "truth", "estimate"])
def test_all_variables_are_those_that_zarr_reads(data: dict[str, xr.Dataset], kind: str, tmp_path: Path) -> None:
    found = st.load_store(st.save_store(data[kind], tmp_path / "x.zarr"))
    with without_warnings():
        group = zarr.open_group(tmp_path / "x.zarr", mode="r")
        expected = {name: (np.asarray(array[...]), dict(array.attrs)) for name, array in group.arrays()}
    assert set(found.variables) == set(expected)
    for name, (values, attrs) in expected.items():
        one = found.variables[name]
        assert (one.dtype, one.attrs) == (values.dtype, attrs)
        assert one.values.tobytes() == values.tobytes()
        assert one.values.flags.writeable or name in found.indexes


@pytest.fixture(scope="module")
def metadata(data: dict[str, xr.Dataset], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    store = st.save_store(data["truth"], tmp_path_factory.mktemp("layout") / "x.zarr")
    arrays: dict[str, Any] = json.loads((store / "zarr.json").read_text())["consolidated_metadata"]["metadata"]
    return arrays


@pytest.mark.parametrize(
    ("name", "path", "value"),
    [
        ("depth", "codecs/0/configuration/index_location", "start"),
        ("depth", "codecs/0/configuration/chunk_shape/1", 2),
        ("depth", "chunk_grid/configuration/chunk_shape/0", 1),
        ("t", "codecs/0/configuration/endian", "big"),
        ("t", "data_type", "object"),
        ("t", "data_type", "f8"),
        ("component", "data_type/name", "raw_bytes"),
    ],
)
def test_other_layouts_are_rejected(metadata: dict[str, Any], name: str, path: str, value: Any) -> None:
    changed = copy.deepcopy(metadata[name])
    ArrayLayout.from_metadata(name, changed)
    *parents, last = [int(part) if part.isdigit() else part for part in path.split("/")]
    entry = changed
    for part in parents:
        entry = entry[part]
    entry[last] = value
    with pytest.raises(ValueError, match="not"):
        ArrayLayout.from_metadata(name, changed)


def test_unknown_codecs_are_rejected(metadata: dict[str, Any]) -> None:
    changed = copy.deepcopy(metadata["t"])
    changed["codecs"].insert(1, {"name": "transpose"})
    with pytest.raises(ValueError, match="unknown codecs bytes, transpose"):
        ArrayLayout.from_metadata("t", changed).decode(with_checksum(b"chunk"))


def test_missing_chunks_and_wrong_checksums_are_found(tmp_path: Path) -> None:
    file = ShardFile(tmp_path / "c", (2, 3))
    file.put((0, 1), with_checksum(b"chunk"))
    file.close()
    size = (tmp_path / "c").stat().st_size
    reader = ShardReader(tmp_path / "c", 0, size, (2, 3))
    with reader.open() as opened:
        assert reader.read(opened, (0, 1)) == with_checksum(b"chunk")
        with pytest.raises(ValueError, match=r"chunk \(1, 2\) is missing"):
            reader.read(opened, (1, 2))
    with pytest.raises(ValueError, match="a checksum is wrong"):
        ShardReader(tmp_path / "c", 0, size - 1, (2, 3))
