"""Maps of estimates held against each other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr

from scenetruth.schema import make_estimate
from scenetruth.testing.conformance import Plane
from scenetruth.testing.conformance.comparing import (
    agree,
    changed_sign,
    flipped,
    near_in_the_middle,
    near_to_rounding,
    reach_of,
    same_bytes,
    scalar_maps,
)
from scenetruth.testing.conformance.deviation import Deviation, NotApplicable

PLANE = Plane(size=(12, 16))
TOLD: dict[str, Any] = {"done": "d", "expectation": "e", "remedy": "r"}


@pytest.fixture(scope="module")
def estimate() -> xr.Dataset:
    truth = {name: item.values for name, item in PLANE.truth().items()}
    velocity = np.stack([truth[f"velocity_{axis}"] for axis in "xyz"])
    depth = np.where(np.arange(16) < 3, np.nan, truth["depth"])
    return make_estimate(like=PLANE.recording(), depth=depth, velocity=velocity)


def test_only_what_is_fully_known_counts(estimate: xr.Dataset) -> None:
    maps = scalar_maps(estimate)
    assert set(maps) == set(PLANE.truth())
    assert all(np.isnan(maps[name].values[..., :3]).all() for name in ("depth", "velocity_x", "flow_y"))
    normal = estimate.assign(kind_motion=xr.full_like(estimate["kind_motion"], 1))
    fewer = scalar_maps(normal)
    assert not np.isfinite(fewer["flow_x"]).any()
    assert not np.isfinite(fewer["velocity_z"]).any()
    xr.testing.assert_identical(fewer["depth"], maps["depth"])
    near_to_rounding(
        {name: item.isel(x=slice(3, None)) for name, item in maps.items()},
        {name: item.isel(x=slice(3, None)) for name, item in PLANE.truth().items()},
        **TOLD,
    )


def test_maps_agree_within_tolerances_where_both_are_known(estimate: xr.Dataset) -> None:
    maps = scalar_maps(estimate)
    other = {name: item.isel(t=[1], y=slice(2, None)) + 0.5 for name, item in maps.items()}
    agree(other, maps, {"depth": 0.6, "flow_x": 0.6}, **TOLD)
    with pytest.raises(Deviation, match=r"flow_x is off by 0\.5 px/frame rms \(0\.4 px/frame are allowed\)"):
        agree(other, maps, {"depth": 0.6, "flow_x": 0.4}, **TOLD)
    with pytest.raises(Deviation, match="known in 0% of the pixels"):
        agree({"depth": maps["depth"] * np.nan}, maps, {"depth": 1.0}, **TOLD)
    with pytest.raises(Deviation, match="no flow_x any more"):
        agree({}, maps, {"flow_x": 1.0}, **TOLD)
    later = {name: item.assign_coords(t=item["t"] + 10) for name, item in maps.items()}
    with pytest.raises(NotApplicable, match="no frame in common"):
        agree(later, maps, {"depth": 1.0}, **TOLD)


def test_rounding_is_told_from_differences(estimate: xr.Dataset) -> None:
    maps = scalar_maps(estimate)
    near_to_rounding({name: item * (1 + 1e-5) for name, item in maps.items()}, maps, **TOLD)
    with pytest.raises(Deviation, match="depth differs in 81% of the pixels"):
        near_to_rounding({"depth": maps["depth"] * 1.001}, {"depth": maps["depth"]}, **TOLD)
    with pytest.raises(Deviation, match="depth differs in 19% of the pixels"):
        near_to_rounding({"depth": maps["depth"].fillna(1.0)}, {"depth": maps["depth"]}, **TOLD)


@pytest.mark.parametrize("name", PLANE.truth())
def test_a_wrong_sign_is_far_off_and_some_noise_is_not(name: str) -> None:
    truth = PLANE.truth()
    noise = np.random.default_rng(0).normal(0, 0.1, truth[name].shape) * np.median(np.abs(truth[name]))
    near_in_the_middle({name: truth[name] + noise}, truth, [name], done="d", remedy="r")
    with pytest.raises(Deviation, match=f"{name} is .* in the median, the truth"):
        near_in_the_middle({name: -truth[name] + noise}, truth, [name], done="d", remedy="r")


def test_velocity_that_is_uncertain_must_scatter_around_the_truth() -> None:
    truth = PLANE.truth()
    rounded = xr.zeros_like(truth["velocity_z"])
    rounded.values[..., ::4] = 3 * truth["velocity_z"].values[..., ::4]
    near_in_the_middle({"velocity_z": rounded}, truth, ["velocity_z"], done="d", remedy="r")
    with pytest.raises(Deviation, match="velocity_z"):
        near_in_the_middle({"velocity_z": -rounded}, truth, ["velocity_z"], done="d", remedy="r")


def test_mirrors_are_their_own_inverse(estimate: xr.Dataset) -> None:
    maps = scalar_maps(estimate)
    there = changed_sign(flipped(maps, "x"), ["flow_x"])
    back = changed_sign(flipped(there, "x"), ["flow_x"])
    for name, item in maps.items():
        xr.testing.assert_identical(back[name], item)
    np.testing.assert_array_equal(there["flow_x"].values, -maps["flow_x"].values[..., ::-1])
    assert there["depth"]["x"].values.tolist() == list(range(16))


def test_how_large_a_vector_is() -> None:
    # (1.5, -1.25, -9) mm per frame everywhere.
    assert reach_of(PLANE.truth(), "velocity_y") == pytest.approx(np.sqrt(1.5**2 + 1.25**2 + 9.0**2))


def test_bytes_are_compared_with_nan_and_type(estimate: xr.Dataset) -> None:
    assert same_bytes(estimate, estimate.copy(deep=True)) == []
    assert same_bytes(estimate, estimate.assign(depth=estimate["depth"].astype(np.float64))) == ["depth"]
    assert same_bytes(estimate, estimate.drop_vars("flow")) == ["flow"]
