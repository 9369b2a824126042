"""Scores of what an estimate tells of the surface element: slopes, normal, curvature, rotation, and its own growth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from scenetruth.schema import STATUS_NORMAL, VARIABLES, label, read_intrinsics
from scenetruth.scoring import QUANTITIES, Score, plot_one, score
from scenetruth.scoring.figures import collect_figure_arrays, draw_estimated_growth, draw_growth
from scenetruth.scoring.report import describe_maps
from scenetruth.scoring.statistics import angle_deg
from tests.helpers.nightly import by_night
from tests.helpers.synthetic_case import Case, make_growing_case

Map = NDArray[np.float64]

PERCENT_PER_HOUR = 100 * 3600 / 60
"""Of frames a minute apart."""
STD = {"slope": 0.01, "mean_curvature": 1e-4, "gaussian_curvature": 1e-5, "rotation_rate": 2e-4}
STD |= {"growth_rate": 3e-5, "principal_growth_rates": 2e-5}
TILT = 0.002
"""By which estimated normals are turned, in radians."""
TURN = 0.03


def make_full_case() -> Case:
    """Return the growing leaf with all that a complete truth has, and an estimate with normal errors of known size."""
    case = make_growing_case()
    truth, known = case.truth, np.isfinite(case.truth["depth"].values)
    rng = np.random.default_rng(7)
    e_1, normal = np.array([np.cos(np.pi / 6), 0.0, 0.5]), np.array([0.5, 0.0, -np.cos(np.pi / 6)])

    def everywhere(*values: float) -> Map:
        return np.where(known, np.reshape(values, (-1, 1, 1, 1)), np.nan)

    rate = truth["growth_rate"].values
    exact = {
        "normal": everywhere(*normal),
        "curvature": everywhere(0.02, -0.005),
        "rotation_rate": everywhere(1e-3, -2e-3, 3e-3),
        "principal_growth_rates": np.stack([rate, 0 * rate]),
        "principal_growth_direction": everywhere(*e_1),
        "growth_rate": rate,
    }
    names = ("depth", "velocity", "disparity", "flow", "mixed")
    whole = label("truth", {name: truth[name].values for name in names} | exact, read_intrinsics(truth), t=[0])
    right = {
        "slope": everywhere(np.tan(np.pi / 6), 0.0),
        "mean_curvature": everywhere(0.0075)[0],
        "gaussian_curvature": everywhere(-1e-4)[0],
    } | {name: exact[name] for name in ("rotation_rate", "growth_rate", "principal_growth_rates")}
    found: dict[str, NDArray[np.generic]] = {}
    for name, values in right.items():
        found[name] = values + STD[name] * rng.standard_normal(values.shape)
        found[f"{name}_std"] = np.full(values.shape, STD[name])
    found["normal"] = everywhere(*(np.cos(TILT) * normal + np.sin(TILT) * np.array([0.0, 1.0, 0.0])))
    angle = TURN * rng.standard_normal(known.shape)
    # Either sign of a direction is the same.
    signs = rng.choice([-1.0, 1.0], known.shape)
    across = np.cross(normal, e_1)
    found["principal_growth_direction"] = signs * (
        np.cos(angle) * e_1.reshape(3, 1, 1, 1) + np.sin(angle) * across.reshape(3, 1, 1, 1)
    )
    found["principal_growth_direction_std"] = np.full(known.shape, TURN)
    kept = {name: case.estimate[name].values for name in ("depth", "velocity", "status")}
    return Case(case.recording, label("estimate", kept | found, read_intrinsics(truth), t=[0]), whole)


@pytest.fixture(scope="module")
def full() -> Case:
    return make_full_case()


@pytest.fixture(scope="module")
def scored(full: Case) -> Score:
    return score(full.estimate, full.truth)


def test_every_quantity_is_scored_with_its_errors(scored: Score) -> None:
    values = scored.regions["all"]
    assert set(values) == set(QUANTITIES) - {"disparity", "flow_x", "flow_y"}
    sizes = {"slope_x": STD["slope"], "mean_curvature": STD["mean_curvature"]}
    sizes |= {"gaussian_curvature": STD["gaussian_curvature"], "rotation_rate_y": STD["rotation_rate"]}
    sizes |= {"growth_rate": PERCENT_PER_HOUR * STD["growth_rate"], "growth_direction": np.degrees(TURN)}
    sizes |= {"growth_principal_2": PERCENT_PER_HOUR * STD["principal_growth_rates"]}
    for name, size in sizes.items():
        # 10,000 independent errors: 0.7 %, of five standard deviations 3.5 %.
        assert values[name]["rmse"] == pytest.approx(size, rel=0.035), name
        assert values[name]["rms_z"] == pytest.approx(1, rel=0.035), name
        assert values[name]["coverage_2_std"] == pytest.approx(0.9545, abs=0.011), name
        assert values[name]["density"] == 1.0
    for name in ("normal", "velocity_epe"):
        assert values[name]["rms_z"] is None
    assert values["normal"]["rmse"] == pytest.approx(np.degrees(TILT), rel=1e-6)
    # Angles are no part of anything.
    assert values["normal"]["relative_rmse"] is None
    assert values["growth_rate"]["median_abs_error"] == pytest.approx(
        0.6745 * PERCENT_PER_HOUR * STD["growth_rate"], rel=0.05
    )


def test_growth_in_windows_follows_from_depth_and_velocity(full: Case, scored: Score) -> None:
    without = full.estimate.drop_vars(["growth_rate", "growth_rate_std"])
    plain = score(without, full.truth).regions["all"]
    assert plain["growth_rate_windowed"] == scored.regions["all"]["growth_rate_windowed"]
    assert plain["growth_rate"]["rms_z"] is None
    assert plain["growth_rate"] != scored.regions["all"]["growth_rate"]


def test_scores_are_read_again(scored: Score) -> None:
    assert Score.from_json(scored.to_json()) == scored
    frame = scored.to_dataframe()
    assert frame.loc[("interior", "normal"), "units"] == "°"
    assert frame.loc[("interior", "growth_principal_1"), "units"] == "%/h"
    assert "rotation_rate_z,rad/frame" in scored.to_csv()


def test_what_the_truth_does_not_tell_is_not_scored(full: Case) -> None:
    few = full.truth.drop_vars(
        ["curvature", "rotation_rate", "principal_growth_rates", "principal_growth_direction", "normal"]
    )
    told = {QUANTITIES[name].variable for name in score(full.estimate, few).regions["all"]}
    # Windows have no variable.
    assert told == {"depth", "velocity", "growth_rate", ""}
    views = collect_figure_arrays(full.recording, full.estimate, few)
    assert "slope_x" in views.estimate
    assert "slope_x" not in views.truth


def test_a_truths_own_slopes_come_first(full: Case) -> None:
    own = full.truth.assign(slope=full.estimate["slope"] - 1.0)
    assert score(full.estimate, own).regions["all"]["slope_y"]["bias"] == pytest.approx(1.0)


def test_only_full_pixels_count(full: Case) -> None:
    kind = full.estimate["status"].copy(deep=True)
    kind[:, :60] = STATUS_NORMAL
    values = score(full.estimate.assign(status=kind), full.truth).regions["all"]
    for name in ("slope_x", "normal", "growth_rate", "growth_direction", "rotation_rate_x"):
        assert values[name]["density"] == pytest.approx(0.5, abs=0.01)


@given(st.floats(1e-9, np.pi), st.integers(0, 1000))
def test_angles_are_those_of_turned_vectors(angle: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = np.linalg.qr(rng.standard_normal((3, 2)))[0].T
    turned = np.cos(angle) * one + np.sin(angle) * other
    # Rounding of unit vectors.
    assert angle_deg(3.0 * one, 2.0 * turned) == pytest.approx(np.degrees(angle), abs=1e-13)
    assert angle_deg(one, -turned, lines=True) == pytest.approx(np.degrees(min(angle, np.pi - angle)), abs=1e-13)


def test_estimates_alone_are_described_with_their_own_growth(full: Case) -> None:
    found = describe_maps(full.estimate)
    assert found["growth_rate"].median == pytest.approx(2, abs=0.2)
    assert found["growth_rate"].median_std == pytest.approx(PERCENT_PER_HOUR * STD["growth_rate"])
    assert found["mean_curvature"].median == pytest.approx(0.0075, rel=0.01)
    assert "normal" not in found


@pytest.mark.usefixtures("undrawn_figures")
@pytest.mark.parametrize("stated", [True, *by_night(False)])
def test_the_figure_shows_the_estimates_own_growth(full: Case, stated: bool, tmp_path: Path) -> None:
    estimate = full.estimate if stated else full.estimate.drop_vars("growth_rate_std")
    result = score(estimate, full.truth)
    figure = plot_one("growth_rate", full.recording, estimate, full.truth, result, tmp_path)
    assert figure is not None
    assert "estimated by the method at every pixel" in figure.caption
    views = collect_figure_arrays(full.recording, estimate, full.truth)
    assert draw_growth(views, estimate, full.truth, result, tmp_path) == figure
    alone = draw_estimated_growth(views, estimate, tmp_path)
    assert alone is not None
    assert "as estimated by the method at every pixel" in alone.caption


def test_variables_of_an_estimate_are_those_of_the_truth() -> None:
    """Where both have a variable, it is the same; and every standard deviation has the dimensions of its variable."""
    both = set(VARIABLES["truth"]) & set(VARIABLES["estimate"])
    assert {"slope", "principal_growth_rates", "principal_growth_direction", "rotation_rate"} <= both
    for name in both:
        assert VARIABLES["truth"][name] == VARIABLES["estimate"][name]
    for name, entry in VARIABLES["estimate"].items():
        if name.endswith("_std"):
            variable = VARIABLES["estimate"][name.removesuffix("_std")]
            if name != "principal_growth_direction_std":
                assert (entry.dims, entry.units) == (variable.dims, variable.units)


def test_every_quantity_belongs_to_a_variable(full: Case) -> None:
    for name, entry in QUANTITIES.items():
        if name != "growth_rate_windowed":
            dims = VARIABLES["estimate"][entry.variable].dims
            whole = entry.error != "difference"
            assert (entry.component is None) == (whole or len(dims) == 3), name


def test_nothing_is_scored_of_an_empty_truth(full: Case) -> None:
    empty = full.truth.assign({name: xr.full_like(full.truth[name], np.nan) for name in ("normal", "growth_rate")})
    values = score(full.estimate, empty).regions["all"]
    assert values["normal"]["density"] is None
    assert values["growth_rate"]["count"] == 0
