"""Windows of frames hold what the recording holds, in whatever order they are read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.protocol import FrameReader, Needs

FRAMES = 7
windows = some.lists(
    some.tuples(some.integers(0, FRAMES - 1), some.integers(1, FRAMES)).map(
        lambda pair: (pair[0], min(pair[0] + pair[1], FRAMES))
    ),
    min_size=1,
    max_size=6,
)


def images(dtype: Any, channels: int = 0) -> NDArray[Any]:
    shape = (3, FRAMES, 8, 9, *((channels,) if channels else ()))
    return np.random.default_rng(1).integers(0, 200, shape).astype(dtype)


@given(windows, some.sampled_from([np.uint8, np.uint16, np.float64, ">u2"]), some.sampled_from([0, 3]))
def test_windows_are_the_recordings(asked: list[tuple[int, int]], dtype: Any, channels: int) -> None:
    values = images(dtype, channels)
    reader = FrameReader(st.make_recording(values, focal_length_px=500, baseline_mm=5, full_scale=200))
    expected = np.moveaxis(values, -1, 0) if channels else values[None]
    assert reader.shape == expected.shape
    for first, last in asked:
        found = reader.frames(first, last)
        np.testing.assert_array_equal(found, expected[:, :, first:last])
        assert found.dtype == reader.dtype
        assert found.dtype in (np.uint8, np.uint16, np.float32)
        assert found.flags.c_contiguous
        np.testing.assert_array_equal(reader.part(last - 1, last), expected[:, :, last - 1 : last])
        assert reader.frames(first, last) is found


def test_stored_frames_are_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from scenetruth.storage import stored_array as reading

    st.save_store(
        st.make_recording(images(np.uint8), focal_length_px=500, baseline_mm=5, full_scale=200),
        tmp_path / "recording.zarr",
    )
    read: list[int] = []
    plain = reading.StoredArray.read

    def counting(self: Any, key: tuple[Any, ...]) -> NDArray[Any]:
        found = plain(self, key)
        read.append(found.shape[1] if found.ndim > 1 else 0)
        return found

    monkeypatch.setattr(reading.StoredArray, "read", counting)
    reader = FrameReader(st.open_store(tmp_path / "recording.zarr"))
    read.clear()
    for first in range(3):
        reader.frames(first, first + 5)
    assert read == [5, 1, 1]
    assert reader.missing() == 0


@pytest.mark.parametrize(("value", "count"), [(np.nan, 2), (np.inf, 2), (1e39, 2), (1e30, 0)])
def test_what_is_not_finite_in_float32_is_counted(value: float, count: int) -> None:
    values = images(np.float64)
    values[1, 3, 2, 2] = values[2, 5, 0, 0] = value
    assert FrameReader(st.make_recording(values, focal_length_px=500, baseline_mm=5, full_scale=200)).missing() == count


def test_remedy_for_colours_is_a_recording_of_grey_images() -> None:
    colours = st.make_recording(images(np.uint8, 3), focal_length_px=500, baseline_mm=5, full_scale=200)
    (problem,) = Needs(channels=1).problems(colours, "mine")
    remedy = "recording.mean('channel', keep_attrs=True)"
    assert remedy in problem.message
    grey = colours.mean("channel", keep_attrs=True)
    assert not Needs(channels=1).problems(grey, "mine")
    np.testing.assert_allclose(FrameReader(grey).frames(0, 2)[0], images(np.uint8, 3).mean(axis=-1)[:, :2], rtol=1e-6)
