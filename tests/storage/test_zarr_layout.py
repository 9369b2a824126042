"""Warnings of zarr that users need not hear, and files of chunks as zarr itself writes them."""

from __future__ import annotations

import threading
import warnings
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import zarr
import zarr.errors
from hypothesis import given
from hypothesis import strategies as some

from scenetruth.storage.zarr_layout import (
    ShardFile,
    chunk_shape,
    select_codecs,
    select_encoder,
    with_checksum,
    without_warnings,
)


def _warn() -> None:
    warnings.warn("not in the specification", zarr.errors.ZarrUserWarning, stacklevel=2)


@pytest.mark.filterwarnings("error")
def test_a_thread_that_leaves_does_not_make_another_hear_them() -> None:
    before = list(warnings.filters)
    entered, left = threading.Event(), threading.Event()
    raised: list[Warning] = []

    def second() -> None:
        with without_warnings():
            entered.set()
            left.wait(10)
            try:
                _warn()
            except Warning as warning:
                raised.append(warning)

    thread = threading.Thread(target=second)
    with without_warnings():
        thread.start()
        entered.wait(10)
        _warn()
    left.set()
    thread.join(10)
    assert raised == []
    assert list(warnings.filters) == before
    with pytest.raises(zarr.errors.ZarrUserWarning):
        _warn()


DTYPES = ["uint8", "uint16", "int16", "int32", "float32", "float64", "bool"]


@given(
    some.sampled_from(DTYPES),
    some.tuples(*(some.integers(1, 3) for _ in range(2)), *(some.integers(1, 9) for _ in range(2))),
    some.integers(0, 2**32),
    some.randoms(),
)
def test_zarr_reads_what_is_put_in_any_order(
    tmp_path_factory: pytest.TempPathFactory, dtype: str, shape: tuple[int, ...], seed: int, order: object
) -> None:
    folder = tmp_path_factory.mktemp("shard")
    values = (np.random.default_rng(seed).normal(size=shape) * 100).astype(dtype)
    chunks = chunk_shape(("s", "t", "y", "x"), shape)
    with without_warnings():
        array = zarr.create_array(
            folder, shape=shape, dtype=dtype, chunks=chunks, shards=shape, **select_codecs("depth", np.dtype(dtype))
        )
    places = list(product(range(shape[0]), range(shape[1])))
    order.shuffle(places)  # type: ignore[attr-defined]
    file = ShardFile(folder.joinpath("c", *("0" * len(shape))), shape[:2] + (1, 1))
    encoder = select_encoder("depth", np.dtype(dtype))
    for s, t in places:
        file.put((s, t, 0, 0), with_checksum(bytes(encoder.encode(np.ascontiguousarray(values[s, t])))))
    assert file.missing == 0
    file.close()
    with without_warnings():
        found = np.asarray(array[...])
    assert found.tobytes() == values.tobytes()


def test_missing_chunks_are_counted(tmp_path: Path) -> None:
    file = ShardFile(tmp_path / "c", (2, 3))
    file.put((0, 1), b"abcd")
    assert file.missing == 5
    file.give_up()
