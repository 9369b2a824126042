"""Bands of rows, groups of frames, threads and freshly compiled code leave no trace in the results."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as some
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

import scenetruth as st
from scenetruth import compilation
from scenetruth.compilation import thread_count
from scenetruth.estimators.structure_tensor import (
    CELL,
    MEMORY_LIMITS,
    Rectangle,
    Registration,
    carry_to_reference,
    forget_second_best,
)
from tests.helpers.analytic_plane import Plane
from tests.helpers.nightly import by_night, nightly


def same(one: xr.Dataset, two: xr.Dataset) -> None:
    for name in one.data_vars:
        np.testing.assert_array_equal(one[name], two[name], err_msg=str(name))


@pytest.mark.parametrize(
    ("scratch_bytes", "settings"),
    [
        *((1, {}), (1_000_000, {"working_point_px": 2})),
        *by_night((300_000, {}), (1_000_000, {}), (1, {"working_point_px": 2}), (300_000, {"working_point_px": 2})),
    ],
    ids=str,
)
def test_bands_and_groups(monkeypatch: pytest.MonkeyPatch, scratch_bytes: int, settings: dict[str, int]) -> None:
    recording = Plane(velocity=(0.1, -0.05, 0.3), slope=0.3, size=(90, 80)).recording(np.arange(5) - 2, 11, noise=0.01)
    whole = st.estimate(recording, progress=None, **settings)  # type: ignore[arg-type]
    monkeypatch.setattr(MEMORY_LIMITS, "scratch_bytes", scratch_bytes)
    monkeypatch.setattr(MEMORY_LIMITS, "band_rows", 32)
    parts = st.estimate(recording, progress=None, **settings)  # type: ignore[arg-type]
    # The window over the texture's spectrum ends with a band's border: error bars to the last digits, all else exactly.
    bars = [str(name) for name in whole.data_vars if str(name).endswith("_std")]
    same(whole.drop_vars(bars), parts.drop_vars(bars))
    for name in bars:
        np.testing.assert_allclose(parts[name], whole[name], rtol=1e-5)


def test_one_thread_and_several(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = Plane(velocity=(0.1, -0.05, 0.3), size=(70, 80)).recording(np.arange(5) - 2, 9)
    found = []
    for count in (1, 2, 5):
        monkeypatch.setattr(compilation, "thread_count", lambda count=count: count)
        found.append(st.estimate(recording))
    same(found[0], found[1])
    same(found[0], found[2])


@settings(max_examples=60, deadline=None)
@given(
    items=some.lists(
        some.tuples(
            some.integers(0, 2),
            arrays.arrays(bool, (3, 4)),
            some.tuples(some.integers(0, 30), some.integers(0, 50), some.integers(0, 30), some.integers(0, 60)),
        ),
        min_size=1,
        max_size=4,
    ),
    first_row=some.sampled_from([0, 8, 19]),
    seed=some.integers(0, 99),
)
def test_what_could_not_be_tried_everywhere_is_not_chosen(
    items: list[tuple[int, NDArray[np.bool_], tuple[int, int, int, int]]], first_row: int, seed: int
) -> None:
    registrations = [Registration(n, (flow, 0), None, fits) for n, (flow, fits, _) in enumerate(items)]
    areas = [Rectangle(*area) for *_, area in items]
    before = np.random.default_rng(seed).integers(-1, len(items), (2, 21, 55)).astype(np.int16)
    after = before.copy()
    forget_second_best(after, registrations, areas, first_row)
    for t, y, x in np.ndindex(before.shape):
        chosen = before[t, y, x]
        lacks = any(
            item.fits is not None
            and item.flow == registrations[chosen].flow
            and item.fits[(first_row + y) // CELL, x // CELL]
            and not (top <= first_row + y < bottom and left <= x < right)
            for item, (top, bottom, left, right) in zip(registrations, areas, strict=True)
        )
        assert after[t, y, x] == (-1 if lacks else chosen)


@pytest.mark.parametrize(("right", "down"), [(0.0, 0.0), (0.4, -0.3), (-1.2, 0.7)])
def test_linear_maps_are_carried_exactly(right: float, down: float) -> None:
    y, x = np.mgrid[:20, :30].astype(np.float64)
    moved = np.stack([right + 0.01 * x, down - 0.02 * y])
    # The value of a point is linear where it is seen by the reference.
    value = 2.0 * (x + moved[0]) - 3.0 * (y + moved[1])
    carried, _ = carry_to_reference(moved, value[None], np.ones((1, 20, 30), dtype=np.uint8))
    inner = np.s_[3:-3, 3:-3]
    np.testing.assert_allclose(carried[0][inner], (2 * x - 3 * y)[inner], atol=1e-5)


def test_pixels_next_to_unknown_ones_are_unknown() -> None:
    moved = np.full((2, 9, 9), 0.5)
    moved[:, 4, 4] = np.nan
    flags = np.full((1, 9, 9), 2, dtype=np.uint8)
    carried, kinds = carry_to_reference(moved, np.ones((1, 9, 9)), flags)
    assert np.isnan(carried[0, 4:6, 4:6]).all()
    assert (kinds[0, 4:6, 4:6] == 0).all()
    assert np.isfinite(carried[0, 1:4, 1:4]).all()
    assert (kinds[0, 1:4, 1:4] == 2).all()


def test_what_comes_from_outside_is_unknown() -> None:
    moved = np.full((2, 8, 8), 3.0)
    carried, _ = carry_to_reference(moved, np.ones((1, 8, 8)), np.ones((1, 8, 8), dtype=np.uint8))
    assert np.isnan(carried[0, :3]).all()
    assert np.isnan(carried[0, :, :3]).all()
    assert np.isfinite(carried[0, 3:, 3:]).all()


CODE = """
import hashlib, numpy as np, scenetruth as st
images = np.random.default_rng(0).integers(0, 255, (5, 9, 64, 96), dtype=np.uint8)
maps = st.estimate(st.make_recording(images, 500.0, 5.0), working_point_px=1, tau=0.0)
print(hashlib.sha256(b"".join(maps[name].values.tobytes() for name in sorted(maps.data_vars))).hexdigest())
"""


def hashes_of(*threads: str, **environment: str) -> set[str]:
    found = set()
    for count in threads:
        own = {**os.environ, "NUMBA_NUM_THREADS": count, **environment}
        done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True, env=own)
        found.add(done.stdout)
    return found


def hash_here() -> str:
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(CODE, {})
    return printed.getvalue()


@nightly
def test_estimates_do_not_depend_on_threads() -> None:
    many = {hash_here()} if thread_count() > 1 else hashes_of("2")
    assert len(many | hashes_of("1")) == 1


@nightly
def test_estimates_do_not_depend_on_compilation(tmp_path: Path) -> None:
    # The first one compiles everything.
    assert len(hashes_of("2", "2", "1", NUMBA_CACHE_DIR=str(tmp_path)) | hashes_of("2")) == 1
