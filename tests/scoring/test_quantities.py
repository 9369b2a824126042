"""Where the scored quantities are read from, and where an estimate claims to know them."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from scenetruth.schema import STATUS_VALID
from scenetruth.scoring.error_pairs import find_valid_pixels, read_quantity, read_std
from scenetruth.scoring.quantities import QUANTITIES
from tests.helpers.synthetic_case import Case


def test_components_are_read_by_name(full_case: Case) -> None:
    estimate = full_case.estimate
    np.testing.assert_array_equal(read_quantity(estimate, "depth"), estimate["depth"])
    np.testing.assert_array_equal(read_quantity(estimate, "velocity_y"), estimate["velocity"].sel(component="Y"))
    np.testing.assert_array_equal(read_quantity(estimate, "flow_x"), estimate["flow"].sel(image_component="x"))
    assert read_quantity(estimate.astype(np.float32), "depth").dtype == np.float64


def test_standard_deviations_belong_to_their_quantity(full_case: Case) -> None:
    estimate = full_case.estimate
    expected = {
        "depth": estimate["depth_std"],
        "disparity": estimate["disparity_std"],
        **{f"velocity_{name.lower()}": estimate["velocity_std"].sel(component=name) for name in "XYZ"},
    }
    for name in QUANTITIES:
        std = read_std(estimate, name)
        if name in expected:
            np.testing.assert_array_equal(std, expected[name])
        else:
            assert std is None
        assert read_std(full_case.truth, name) is None


def test_foreign_variables_are_no_standard_deviation(full_case: Case) -> None:
    assert read_std(full_case.estimate.assign(flow_std=("x", np.ones(160))), "flow_x") is None


@pytest.mark.parametrize(
    ("missing", "disparity", "motion"),
    [
        ((), "status_disparity", "status_motion"),
        (("status",), "status_disparity", "status_motion"),
        (("status_disparity",), "status", "status_motion"),
        (("status_motion",), "status_disparity", "status"),
        (("status_disparity", "status_motion"), "status", "status"),
        (("status", "status_motion"), "status_disparity", None),
        (("status", "status_disparity", "status_motion"), None, None),
    ],
)
def test_kind_stands_in_for_those_that_are_missing(
    full_case: Case, missing: tuple[str, ...], disparity: str | None, motion: str | None
) -> None:
    estimate = full_case.estimate.drop_vars(missing)
    by_disparity, by_motion = (_full(estimate, name) for name in (disparity, motion))
    expected = {
        "depth": by_disparity,
        "disparity": by_disparity,
        "flow": by_motion,
        "velocity": by_disparity & by_motion,
    }
    for variable, mask in expected.items():
        np.testing.assert_array_equal(find_valid_pixels(estimate, variable), mask)


def _full(estimate: xr.Dataset, name: str | None) -> xr.DataArray:
    return xr.ones_like(estimate["depth"], dtype=bool) if name is None else estimate[name] == STATUS_VALID
