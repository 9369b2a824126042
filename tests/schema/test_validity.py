"""Status, validity and reasons for invalidity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as some
from hypothesis.extra import numpy as hnp

import scenetruth as st
from scenetruth.estimators import StreamingMethod, prepare
from scenetruth.estimators.protocol import Needs
from scenetruth.schema import REASONS, IncrementalDataset, Put, blank_map, label, make_recording, read_intrinsics
from scenetruth.schema.validity import VALIDITY_MAPS, complete_validity, compute_validity, lower_status

MASKED, UNKNOWN, LOW = (REASONS.index(name) for name in ("masked", "not_determined", "low_texture"))
SHAPE = (3, 6, 8)


@pytest.fixture
def recording() -> xr.Dataset:
    mask = np.zeros(SHAPE[1:], dtype=bool)
    mask[:2] = True
    return make_recording(np.zeros((2, *SHAPE), np.float32), 100.0, 5.0, exclusion_mask=mask)


@given(
    status=hnp.arrays(np.uint8, (4, 5), elements=some.integers(0, 3)),
    reason=hnp.arrays(np.uint8, (4, 5), elements=some.integers(0, len(REASONS) - 1)),
    excluded=hnp.arrays(bool, (4, 5)),
)
def test_reasons_are_none_exactly_where_valid(status: Any, reason: Any, excluded: Any) -> None:
    found = compute_validity({"status": status, "invalid_reason": reason}, excluded)
    assert (found["valid"] == (status == 2)).all()
    assert ((found["invalid_reason"] == 0) == found["valid"]).all()
    assert (found["invalid_reason"][excluded & (status != 2)] == MASKED).all()
    stated = ~excluded & (status != 2) & (reason > 0)
    assert (found["invalid_reason"][stated] == reason[stated]).all()


def test_the_lower_status_is_that_of_both() -> None:
    order = [0, 3, 1, 2]
    for n, low in enumerate(order):
        for high in order[n:]:
            assert lower_status(np.array([low]), np.array([high])).tolist() == [low]


def test_excluded_pixels_are_masked(recording: xr.Dataset) -> None:
    depth = np.full(SHAPE, 100.0)
    depth[:, ::2] = np.nan
    found = st.make_estimate(recording=recording, depth=depth)
    assert (found["invalid_reason"].values[:, 0] == MASKED).all()
    assert (found["invalid_reason"].values[:, 2::2] == UNKNOWN).all()
    assert found["valid"].dtype == bool
    assert found["invalid_reason"].attrs["flag_meanings"].split() == list(REASONS)


def bare(recording: xr.Dataset, **more: Any) -> xr.Dataset:
    """Return an estimate without status, of which the first column is invalid."""
    depth = np.full(SHAPE, 100.0, np.float32)
    depth[..., 0] = np.nan
    return label("estimate", {"depth": depth, **more}, read_intrinsics(recording), t=recording["t"].values)


def test_a_status_that_a_method_does_not_give_follows_from_nan(recording: xr.Dataset) -> None:
    def mine(recording: xr.Dataset) -> xr.Dataset:
        return bare(recording, invalid_reason=np.full(SHAPE, LOW, np.uint8))

    mine.needs = Needs(exclusion_mask=True)  # type: ignore[attr-defined]
    found = st.estimate(recording, mine)
    assert set(VALIDITY_MAPS) <= set(found.data_vars)
    assert (found["valid"].values == np.isfinite(found["depth"].values)).all()
    assert (found["invalid_reason"].values[:, :2, 0] == MASKED).all()
    assert (found["invalid_reason"].values[:, 2:, 0] == LOW).all()


class Plain(StreamingMethod):
    """Puts depth and flow, in parts or as a whole, and no status."""

    name = "plain"
    gives = frozenset({"depth", "flow"})
    needs = Needs(exclusion_mask=True)

    def __init__(self, *, whole: bool) -> None:
        self.whole = whole

    def blank(self, recording: xr.Dataset, settings: Any) -> xr.Dataset:
        maps = {"depth": blank_map(np.float32, SHAPE), "flow": blank_map(np.float32, (2, *SHAPE))}
        return label("estimate", maps, read_intrinsics(recording), t=recording["t"].values)

    def fill(self, recording: xr.Dataset, settings: Any, put: Put, progress: Any) -> Mapping[str, Any]:
        depth = bare(recording)["depth"].values
        flow = np.ones((2, *SHAPE), np.float32)
        flow[1, ..., -1] = np.nan
        if self.whole:
            put("depth", {}, depth)
            put("flow", {}, flow)
            return {}
        for t in range(SHAPE[0]):
            for component in (0, 1):
                put("flow", {"t": t, "image_component": component}, flow[component, t])
            put("depth", {"t": t}, depth[t])
        return {}


@pytest.mark.parametrize("whole", [True, False])
def test_streams_are_completed_as_estimates_in_memory_are(recording: xr.Dataset, whole: bool) -> None:
    method = Plain(whole=whole)
    kept = st.estimate(recording, method)
    estimation = prepare(recording, method)
    blank = estimation.blank()
    assert blank is not None
    filling = IncrementalDataset(blank)
    estimation.fill(filling.put)
    streamed = filling.dataset()
    for name in VALIDITY_MAPS:
        xr.testing.assert_identical(streamed[name], kept[name])
    assert (kept["valid"].values[..., 1:-1]).all()
    assert not kept["valid"].values[..., [0, -1]].any()
    xr.testing.assert_identical(complete_validity(kept, recording), kept)
