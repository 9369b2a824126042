"""Maps of estimates held against each other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr

from scenetruth.schema import make_estimate
from scenetruth.testing.conformance import (
    CheckFailure,
    NotApplicable,
    SyntheticPlane,
    change_sign,
    compute_magnitude,
    flip_maps,
    list_differing_variables,
    require_agreement,
    require_equal_to_rounding,
    require_median_near,
    scalar_maps,
)

PLANE = SyntheticPlane(size=(12, 16))
TOLD: dict[str, Any] = {"done": "d", "expectation": "e", "remedy": "r"}


@pytest.fixture(scope="module")
def estimate() -> xr.Dataset:
    truth = {name: item.values for name, item in PLANE.truth().items()}
    velocity = np.stack([truth[f"velocity_{axis}"] for axis in "xyz"])
    depth = np.where(np.arange(16) < 3, np.nan, truth["depth"])
    return make_estimate(recording=PLANE.recording(), depth=depth, velocity=velocity)


def test_only_what_is_fully_known_counts(estimate: xr.Dataset) -> None:
    maps = scalar_maps(estimate)
    assert set(maps) == set(PLANE.truth())
    assert all(np.isnan(maps[name].values[..., :3]).all() for name in ("depth", "velocity_x", "flow_y"))
    normal = estimate.assign(status_motion=xr.full_like(estimate["status_motion"], 1))
    fewer = scalar_maps(normal)
    assert not np.isfinite(fewer["flow_x"]).any()
    assert not np.isfinite(fewer["velocity_z"]).any()
    xr.testing.assert_identical(fewer["depth"], maps["depth"])
    require_equal_to_rounding(
        {name: item.isel(x=slice(3, None)) for name, item in maps.items()},
        {name: item.isel(x=slice(3, None)) for name, item in PLANE.truth().items()},
        **TOLD,
    )


def test_maps_agree_within_tolerances_where_both_are_known(estimate: xr.Dataset) -> None:
    maps = scalar_maps(estimate)
    other = {name: item.isel(t=[1], y=slice(2, None)) + 0.5 for name, item in maps.items()}
    require_agreement(other, maps, {"depth": 0.6, "flow_x": 0.6}, **TOLD)
    with pytest.raises(CheckFailure, match=r"flow_x differs by 0\.5 px/frame rms \(limit 0\.4 px/frame\)"):
        require_agreement(other, maps, {"depth": 0.6, "flow_x": 0.4}, **TOLD)
    with pytest.raises(CheckFailure, match="valid in 0% of the previously valid pixels"):
        require_agreement({"depth": maps["depth"] * np.nan}, maps, {"depth": 1.0}, **TOLD)
    with pytest.raises(CheckFailure, match="no flow_x is estimated"):
        require_agreement({}, maps, {"flow_x": 1.0}, **TOLD)
    later = {name: item.assign_coords(t=item["t"] + 10) for name, item in maps.items()}
    with pytest.raises(NotApplicable, match="no common frame"):
        require_agreement(later, maps, {"depth": 1.0}, **TOLD)


def test_rounding_is_told_from_differences(estimate: xr.Dataset) -> None:
    maps = scalar_maps(estimate)
    require_equal_to_rounding({name: item * (1 + 1e-5) for name, item in maps.items()}, maps, **TOLD)
    with pytest.raises(CheckFailure, match="depth differs in 81% of the pixels"):
        require_equal_to_rounding({"depth": maps["depth"] * 1.001}, {"depth": maps["depth"]}, **TOLD)
    with pytest.raises(CheckFailure, match="depth differs in 19% of the pixels"):
        require_equal_to_rounding({"depth": maps["depth"].fillna(1.0)}, {"depth": maps["depth"]}, **TOLD)


@pytest.mark.parametrize("name", PLANE.truth())
def test_a_wrong_sign_is_far_off_and_some_noise_is_not(name: str) -> None:
    truth = PLANE.truth()
    noise = np.random.default_rng(0).normal(0, 0.1, truth[name].shape) * np.median(np.abs(truth[name]))
    require_median_near({name: truth[name] + noise}, truth, [name], done="d", remedy="r")
    with pytest.raises(CheckFailure, match=f"{name} is .* in the median, the truth"):
        require_median_near({name: -truth[name] + noise}, truth, [name], done="d", remedy="r")


def test_velocity_that_is_uncertain_must_scatter_around_the_truth() -> None:
    truth = PLANE.truth()
    rounded = xr.zeros_like(truth["velocity_z"])
    rounded.values[..., ::4] = 3 * truth["velocity_z"].values[..., ::4]
    require_median_near({"velocity_z": rounded}, truth, ["velocity_z"], done="d", remedy="r")
    with pytest.raises(CheckFailure, match="velocity_z"):
        require_median_near({"velocity_z": -rounded}, truth, ["velocity_z"], done="d", remedy="r")


def test_mirrors_are_their_own_inverse(estimate: xr.Dataset) -> None:
    maps = scalar_maps(estimate)
    there = change_sign(flip_maps(maps, "x"), ["flow_x"])
    back = change_sign(flip_maps(there, "x"), ["flow_x"])
    for name, item in maps.items():
        xr.testing.assert_identical(back[name], item)
    np.testing.assert_array_equal(there["flow_x"].values, -maps["flow_x"].values[..., ::-1])
    assert there["depth"]["x"].values.tolist() == list(range(16))


def test_how_large_a_vector_is() -> None:
    # (1.5, -1.25, -9) mm per frame everywhere.
    assert compute_magnitude(PLANE.truth(), "velocity_y") == pytest.approx(np.sqrt(1.5**2 + 1.25**2 + 9.0**2))


def test_bytes_are_compared_with_nan_and_type(estimate: xr.Dataset) -> None:
    assert list_differing_variables(estimate, estimate.copy(deep=True)) == []
    assert list_differing_variables(estimate, estimate.assign(depth=estimate["depth"].astype(np.float64))) == ["depth"]
    assert list_differing_variables(estimate, estimate.drop_vars("flow")) == ["flow"]
