"""Any recording and any settings give an estimate of the agreed form, or one of our errors."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as some

import scenetruth as st
from scenetruth.schema import STATUS_INVALID, check_dataset

# Thresholds are too high on purpose, among others.
pytestmark = pytest.mark.filterwarnings("ignore:tau:scenetruth.EstimateWarning")

dtypes = some.sampled_from([np.uint8, np.uint16, np.int16, np.int32, np.float32, np.float64, ">u2", ">f4", bool])
shapes = some.tuples(some.integers(1, 7), some.integers(1, 11), some.integers(1, 45), some.integers(1, 80))
channels = some.sampled_from([(), (), (1,), (3,)])
fills = some.sampled_from(["noise", "constant", "huge", "nan", "inf", "one spike"])
settings_of_all_kinds = some.fixed_dictionaries(
    {},
    optional={
        "window_sigma_px": some.sampled_from([1e-9, 1.0, 6.0, 1e9, -1.0, float("nan"), "wide"]),
        "window_taps_px": some.sampled_from([3, 5, 25, 4, -1, 2.5]),
        "window_taps_frames": some.sampled_from([1, 3, 5, 0]),
        "tau": some.sampled_from([0.0, 0.0012, 1e30, float("inf"), "auto"]),
        "noise_std": some.sampled_from(["auto", 0.01, 1e30, -1.0]),
        "working_point_px": some.sampled_from(["auto", "per_pixel", 0, 3, -2, 1000, 10**12, "x", 1.5]),
        "flow_working_point_px": some.sampled_from(["auto", (0, 0), (1, -2), (1000, 0), (0, 10**12), "x", (1,)]),
        "pyramid_levels": some.sampled_from([0, 1, 3, -1]),
        "divergence": some.sampled_from(["paper", "consistent", "other"]),
        "unknown": some.just(1),
    },
)


def fill(shape: tuple[int, ...], dtype: Any, kind: str, seed: int) -> Any:
    generator = np.random.default_rng(seed)
    values = generator.uniform(0, 100, shape)
    if kind == "constant":
        values[:] = 7
    with np.errstate(all="ignore"):
        images = values.astype(dtype)
    if images.dtype.kind == "f" and kind in ("nan", "inf", "huge"):
        images.flat[0] = {"nan": np.nan, "inf": np.inf, "huge": np.finfo(images.dtype).max}[kind]
    elif kind == "one spike":
        images.flat[0] = 1
    return images


# An even number of cameras and frames, and flows that are known beside unknown ones.
@example(shape=(2, 2, 20, 22), channels=(), dtype=np.uint8, kind="noise", seed=2, chosen={"window_taps_px": 3})
@settings(max_examples=150, deadline=None)
@given(
    shape=shapes, channels=channels, dtype=dtypes, kind=fills, seed=some.integers(0, 99), chosen=settings_of_all_kinds
)
def test_an_estimate_or_an_error_of_ours(
    shape: tuple[int, ...], channels: tuple[int, ...], dtype: Any, kind: str, seed: int, chosen: dict[str, Any]
) -> None:
    with contextlib.suppress(st.EstimateError, st.RecordingError):
        recording = st.make_recording(fill(shape + channels, dtype, kind, seed), 500.0, 5.0)
        estimate = st.estimate(recording, **chosen)
        check_dataset(estimate, "estimate")
        known = estimate["status_disparity"].values != STATUS_INVALID
        moving = estimate["status_motion"].values != STATUS_INVALID
        for name in ("depth", "disparity"):
            assert (np.isfinite(estimate[name].values) == known).all()
        assert (np.isfinite(estimate["divergence"].values) == moving).all()
        assert (np.isfinite(estimate["flow"].values) == moving).all()
        assert (np.isfinite(estimate["velocity"].values) == (known & moving)).all()
        assert (estimate["depth"].values[known] > 0).all()
        for name in ("depth_std", "velocity_std", "disparity_std"):
            std = estimate[name].values
            assert (np.isnan(std) | (std >= 0)).all()
            assert np.isnan(std[..., ~known]).all()
        assert ((estimate["coherence"].values >= 0) & (estimate["coherence"].values <= 1)).all()


@settings(max_examples=20, deadline=None)
@given(
    shape=some.tuples(some.just(5), some.just(9), some.integers(29, 40), some.integers(29, 60)),
    seed=some.integers(0, 99),
)
def test_constant_images_of_any_size_give_nothing(shape: tuple[int, int, int, int], seed: int) -> None:
    level = np.random.default_rng(seed).random()
    estimate = st.estimate(st.make_recording(np.full(shape, level), 500.0, 5.0))
    assert (estimate["status"] == STATUS_INVALID).all()
