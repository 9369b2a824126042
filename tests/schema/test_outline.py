"""Outlines describe data sets as xarray does."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from scenetruth.errors import RecordingError
from scenetruth.schema import DatasetOutline, Intrinsics, blank_map, check_dataset, make_outline


def outlined() -> DatasetOutline:
    arrays = {"image": blank_map(np.uint8, (2, 3, 3, 5, 6))}
    attrs = {"full_scale": 255.0}
    return make_outline(
        "recording", arrays, Intrinsics(500, (3, 2), 5), t=[-1, 0, 1], stage_y_mm=[0.0, 4.0], attrs=attrs
    )


def test_an_outline_has_the_parts_of_its_data_set() -> None:
    found = outlined()
    dataset = found.dataset()
    assert (found.sizes, found.dims) == (dict(dataset.sizes), dict(dataset.sizes))
    assert (list(found.data_vars), set(found.coords)) == (list(dataset.data_vars), set(dataset.coords))
    assert found.attrs == dataset.attrs
    assert "image" in found
    assert "t" in found
    assert "depth" not in found
    for name, own in found.variables.items():
        other = dataset.variables[name]
        assert (own.dims, own.shape, own.ndim, own.sizes) == (other.dims, other.shape, other.ndim, dict(other.sizes))
        assert (own.dtype, own.attrs) == (other.dtype, other.attrs)
        np.testing.assert_array_equal(found[name].values, other.values)


def test_outlines_are_changed_as_data_sets_are() -> None:
    narrow = {"image": (("s_y", "s", "t", "y", "x"), np.ones((2, 3, 3, 5, 6), np.float32), {"units": "1"})}
    found = outlined()
    changed = found.assign(narrow).assign_attrs({"seed": 3})
    xr.testing.assert_identical(changed.dataset(), found.dataset().assign(narrow).assign_attrs({"seed": 3}))
    assert found["image"].dtype == np.uint8


def test_outlines_are_checked_as_data_sets_are() -> None:
    wrong = outlined().assign_attrs({"full_scale": -1, "focal_length_px": "long", "seed": -4})
    messages = []
    for each in (wrong, wrong.dataset()):
        with pytest.raises(RecordingError) as caught:
            check_dataset(each, "recording")
        messages.append(str(caught.value))
    assert messages[0] == messages[1]
    assert messages[0].count("attrs.") == 3
