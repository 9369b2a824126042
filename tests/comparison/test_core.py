"""The built-in methods over the suite's core, within bounds that follow from theory and not from earlier figures."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator

import numpy as np
import pytest

import scenetruth as st
from scenetruth.benchmark import BenchmarkResult, compare
from scenetruth.benchmark.cases.case import BOUND, all_cases
from scenetruth.benchmark.design_point import ignore_scene_warnings
from scenetruth.bound import cramer_rao_bound
from scenetruth.estimators import list_methods
from scenetruth.scene import Scene
from scenetruth.scoring.regions import visible_throughout
from tests.nightly import whole_core

METHODS = [entry.name for entry in list_methods() if entry.origin == "scenetruth"]
REFINED, TENSOR, SWEEP = "refined", "structure_tensor", "plane_sweep"
BOTH = (REFINED, TENSOR)
QUANTITIES = ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z", "flow_x")
SIGMA_PX = 6.0
# Cut off at two standard deviations, a Gaussian has a variance of 0.774 sigma squared.
VARIANCE_PX2 = 0.774 * SIGMA_PX**2
# The rms over a region of some 40 windows is known to 12 %: within twice that of 1.
KNOWN = 1.3
# Splines and derivative filters leave errors of some 1e-4 of a pixel, without any noise.
FILTERS_PX = 1e-3
# Planes whose texture has no waves below 3 px, which images show as other waves.
PLANES = [
    (case, value)
    for case in ("noise", "contrast", "blur", "disparity", "motion", "brightness", "slope", "wavelength")
    for value in all_cases()[case].core
    if (case, value) not in (("slope", 60.0), ("wavelength", 3.0))
]
# The share that is left of a wave, and the period that has 90 % left, under a Gaussian window; both by its variance.
SHARE_LEFT = {period: math.exp(-VARIANCE_PX2 * (2 * math.pi / period) ** 2 / 2) for period in (32.0, 48.0, 96.0)}
PERIOD_LEFT_PX = 2 * math.pi * math.sqrt(VARIANCE_PX2 / (2 * math.log(1 / 0.9)))

pytestmark = whole_core
Of = Callable[[str, float], dict[str, float]]


@pytest.fixture(scope="module")
def core() -> Iterator[BenchmarkResult]:
    with ignore_scene_warnings():
        yield compare(METHODS, suite="core", workers=min(2, os.cpu_count() or 1))


@pytest.fixture(scope="module")
def bounds() -> Of:
    """The rms of the Cramér-Rao bound over the region of a case, gains of the images unknown, by quantity."""
    found: dict[tuple[str, float], dict[str, float]] = {}

    def of(kind: str, value: float) -> dict[str, float]:
        if (kind, value) not in found:
            found[kind, value] = _bounds(kind, value)
        return found[kind, value]

    return of


def _bounds(kind: str, value: float) -> dict[str, float]:
    case = all_cases()[kind]
    with ignore_scene_warnings():
        recording, truth = st.simulate(Scene.from_dict(case.scene(value)))
        bound = cramer_rao_bound(
            truth,
            recording,
            noise_std=case.noise_std(value),
            window_sigma_px=SIGMA_PX,
            motion="growing",
            brightness="per_image",
        ).sel(t=0)
    region = case.region_at(truth.sel(t=0).assign(seen_throughout=(("y", "x"), visible_throughout(truth))), value)
    found = {}
    for quantity in QUANTITIES:
        name, _, axis = quantity.partition("_")
        maps = bound[f"{name}_std"].values
        std = (maps["xyz".index(axis)] if axis else maps)[region]
        found[quantity] = float(np.sqrt(np.nanmean(np.square(std))))
    return found


def test_every_method_gives_something_everywhere(core: BenchmarkResult) -> None:
    assert not core.failures
    assert {row.method for row in core.rows} == {*METHODS, BOUND}


@pytest.mark.parametrize(("case", "value"), PLANES)
def test_refined_is_at_the_bound_on_planes(core: BenchmarkResult, bounds: Of, case: str, value: float) -> None:
    told = all_cases()[case].bounded
    others = {} if told else bounds(case, value)
    for quantity in QUANTITIES:
        bound = (
            core.value(quantity, "noise_std", case=case, method=BOUND, level=value).value if told else others[quantity]
        )
        assert core.value(quantity, "rmse", case=case, method=REFINED, level=value).value < KNOWN * bound, quantity


def test_nothing_is_below_the_bound(core: BenchmarkResult) -> None:
    for row in core.rows:
        if row.case == "noise" and row.statistic == "noise_std" and row.method != BOUND:
            bound = core.value(row.quantity, "noise_std", case="noise", method=BOUND, level=row.level).value
            assert row.value > bound / KNOWN, row


@pytest.mark.parametrize("method", BOTH)
def test_errors_are_as_large_as_the_noise(core: BenchmarkResult, method: str) -> None:
    for quantity in QUANTITIES:
        low, high = (
            core.value(quantity, "noise_std", case="noise", method=method, level=value).value for value in (0.005, 0.02)
        )
        # The same noise, four times as large: all is linear as long as errors are far below a pixel.
        assert high / low == pytest.approx(4, rel=0.1)


@pytest.mark.parametrize("method", BOTH)
def test_error_bars_are_honest(core: BenchmarkResult, method: str) -> None:
    for quantity in ("depth", "velocity_x", "velocity_z"):
        for value in (0.005, 0.02):
            assert 1 / KNOWN < core.value(quantity, "rms_z", case="noise", method=method, level=value).value < KNOWN


def test_nothing_locks_to_whole_pixels(core: BenchmarkResult) -> None:
    for case, quantity, methods in (
        ("phase_of_disparity", "disparity", (*BOTH, SWEEP)),
        ("phase_of_flow", "flow_x", BOTH),
    ):
        for method in methods:
            for value in all_cases()[case].core:
                assert abs(core.value(quantity, "bias", case=case, method=method, level=value).value) < FILTERS_PX, (
                    method,
                    value,
                )


@pytest.mark.parametrize(("case", "quantity"), [("waves_of_motion", "flow_y"), ("waves_of_depth", "depth")])
def test_a_gaussian_window_leaves_what_it_must(core: BenchmarkResult, case: str, quantity: str) -> None:
    for period, expected in SHARE_LEFT.items():
        # Texture weighs the pixels of a window unevenly, here by chance.
        assert core.value(quantity, "amplitude_ratio", case=case, method=TENSOR, level=period).value == pytest.approx(
            expected, abs=0.06
        )
        # A plane in the window leaves all that is linear, so that more is left than of its mean.
        assert core.value(quantity, "amplitude_ratio", case=case, method=REFINED, level=period).value > expected - 0.06
    if case == "waves_of_motion":
        crossing = core.value(quantity, "cutoff_period_first", case=case, method=TENSOR).value
        assert crossing == pytest.approx(PERIOD_LEFT_PX, rel=0.1)


@pytest.mark.parametrize("method", BOTH)
def test_an_unsteady_stage_costs_what_it_must(core: BenchmarkResult, method: str) -> None:
    # Every image is off by 0.1 px; a line through five cameras, in each of five frames, has this slope.
    expected = 0.1 / math.sqrt(5 * sum(s * s for s in range(-2, 3)))
    assert core.value("disparity", "rmse", case="stage_error", method=method, level=0.1).value < 3 * expected


@pytest.mark.parametrize("case", ["edge_of_depth", "step_of_motion"])
def test_refined_keeps_to_its_side_of_an_edge(core: BenchmarkResult, case: str) -> None:
    quantity, step_px = {"edge_of_depth": ("disparity", 1.47), "step_of_motion": ("flow_y", 0.8)}[case]
    for value in all_cases()[case].core:
        # A window of both sides would be wrong by 40 % of the step, one pixel from it.
        assert core.value(quantity, "rmse", case=case, method=REFINED, level=value).value < 0.02 * step_px


def test_growth_is_as_certain_as_the_bound(core: BenchmarkResult) -> None:
    case = all_cases()["growth"]
    for minutes in case.core:
        with ignore_scene_warnings():
            recording, truth = st.simulate(Scene.from_dict(case.scene(minutes)))
            bound = cramer_rao_bound(truth, recording, noise_std=case.noise_std(minutes), motion="growing").sel(t=0)
        std = float(bound["growth_rate_std"].median()) * 60 / minutes * 100
        # Growth over 20 px is a mean over more than the window that the bound has.
        assert (
            core.value("growth_rate_windowed", "rmse", case="growth", method=REFINED, level=minutes).value < KNOWN * std
        )
