"""Bands of rows, groups of frames and threads leave no trace in the results."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as some
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

import scenetruth as st
from scenetruth import threads
from scenetruth.estimators.structure_tensor import execution
from scenetruth.estimators.structure_tensor.registration import CELL, Rectangle, Registration
from tests.estimators.structure_tensor.analytic import Plane


def same(one: xr.Dataset, two: xr.Dataset) -> None:
    for name in one.data_vars:
        np.testing.assert_array_equal(one[name], two[name], err_msg=str(name))


@pytest.mark.parametrize("scratch_bytes", [1, 300_000, 1_000_000])
@pytest.mark.parametrize("settings", [{"working_point_px": 2}, {}], ids=str)
def test_bands_and_groups(monkeypatch: pytest.MonkeyPatch, scratch_bytes: int, settings: dict[str, int]) -> None:
    recording = Plane(velocity=(0.1, -0.05, 0.3), slope=0.3, size=(90, 80)).recording(np.arange(5) - 2, 11, noise=0.01)
    whole = st.estimate(recording, progress=None, **settings)  # type: ignore[arg-type]
    monkeypatch.setattr(execution, "_SCRATCH_BYTES", scratch_bytes)
    monkeypatch.setattr(execution, "_BAND_ROWS", 32)
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
        for module in (execution, threads):
            monkeypatch.setattr(module, "thread_count", lambda count=count: count)
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
    execution._forget_second_best(after, registrations, areas, first_row)
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
