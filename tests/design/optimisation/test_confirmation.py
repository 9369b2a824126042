"""Simulations of rigs: what is simulated and kept, intervals of figures, and the order of rigs."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import scenetruth as st
from scenetruth.design.optimisation import (
    STATISTICS,
    ConfirmationSpec,
    ConfirmationTask,
    DesignSpec,
    Objective,
    PredictionInterval,
    RigDesign,
    check_pair_rank,
    check_rank_consistency,
    compare_with_prediction,
    compose_summary,
    compute_prediction_interval,
    compute_rig_interval,
    describe_rank_consistency,
    evaluate_rig,
    find_indistinct,
    get_simulated_statistic,
    prepare_problem,
    reduce_scene,
    rig_from_evaluation,
    simulate_candidate,
    simulate_candidates,
    simulate_objectives,
)
from scenetruth.scene import Scene
from tests.helpers.small_specification import objective, scene, spec

DEPTH = Objective("depth", "interior", "mm", "Depth")
OF_WALL = Objective("depth", "object_wall", "mm", "Depth of wall")
NOTHING = Objective("growth_rate", "interior", "%/h", "Growth")


def test_figures_are_those_of_a_score() -> None:
    made = Scene.from_dict({**scene(), "estimate": {"method": "structure_tensor"}})
    found = simulate_objectives(made, (DEPTH, OF_WALL, NOTHING))
    recording, truth = st.simulate(made)
    told = st.score(st.estimate(recording), truth, settings={"interior_margin_px": 0.0}).regions["interior"]["depth"]
    assert found["Depth"]["rmse"] == told["rmse"]
    # The only object is all that there is; what nothing is told of is left out.
    assert found["Depth of wall"] == found["Depth"]
    assert "Growth" not in found


def test_growth_of_lengths_is_measured_though_the_standard_truth_does_not_tell_it() -> None:
    method = {"method": "refined", "motion": "affine", "surface": "plane"}
    made = Scene.from_dict({**scene(), "estimate": method})
    found = simulate_objectives(made, (Objective("growth_principal_1", "interior", "%/h", "Growth"),))
    assert found["Growth"]["rmse"] > 0
    assert 0 < found["Growth"]["density"] <= 1


def test_a_rig_of_which_little_is_told_says_so() -> None:
    prepared = prepare_problem(DesignSpec.from_dict(spec()))
    values = {"stage.baseline_mm": 4.0, "stage.positions": 3, "optics.psf": None}
    rig = rig_from_evaluation(7, evaluate_rig(prepared.task, values), prepared)
    assert math.isnan(rig.density("Depth"))
    every = dict.fromkeys(STATISTICS, (0.1, 0.2))
    for densities, told in (((0.5, 0.7), True), ((0.9, 0.95), False), ((0.6, math.nan), True)):
        simulated_rig = replace(
            rig,
            figures={"Depth": {**every, "density": densities}},
            simulated={"Depth": compute_prediction_interval((0.1, 0.2))},
        )
        words = " ".join(compose_summary(prepared.task.objectives, simulated_rig, (), (), ()))
        assert ("only 60 % of the pixels are valid" in words) == told


def test_seeds_make_intervals_and_are_simulated_once(tmp_path: Path) -> None:
    prepared = prepare_problem(DesignSpec.from_dict(spec()))
    values = {"stage.baseline_mm": 4.0, "stage.positions": 3, "optics.psf": None}
    rig = rig_from_evaluation(7, evaluate_rig(prepared.task, values), prepared)
    first = simulate_candidates([rig], prepared, ConfirmationSpec(rigs=1, seeds=2, max_size_px=None), tmp_path)
    told = first.rigs[7].simulated["Depth"]
    assert told.seeds == 2
    assert 0 < told.pi_low < told.value < told.pi_high
    assert first.discrepancies[0].predicted == pytest.approx(rig.predicted["Depth"])
    assert first.changes == ()
    # What is there is not made again; one seed more is.
    before = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.json")}
    again = simulate_candidates([rig], prepared, ConfirmationSpec(rigs=1, seeds=3, max_size_px=None), tmp_path)
    after = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.json")}
    assert (len(before), len(after)) == (2, 3)
    assert before.items() <= after.items()
    assert again.rigs[7].simulated["Depth"].seeds == 3
    figures = again.rigs[7].figures["Depth"]
    # A median is no larger than √2 of the rms; what 95 % lie below, no larger than √20 of it.
    for typical, rms, percentile in zip(*(figures[name] for name in STATISTICS), strict=True):
        assert 0 < typical <= 1.4826 * 2**0.5 * rms
        assert typical / 1.4826 <= percentile <= 20**0.5 * rms
    assert again.rigs[7].simulated["Depth"] == compute_prediction_interval(figures["scaled_median_abs_error"])
    assert simulate_candidates([], prepared, ConfirmationSpec(), tmp_path).rigs == {}


def test_figures_that_lack_a_statistic_are_made_again(tmp_path: Path) -> None:
    plain = {**scene(), "estimate": {"method": "structure_tensor"}}
    job = ConfirmationTask(str(tmp_path), (plain,), (1,), (DEPTH,), ())
    told = {"Depth": {"rmse": 0.2, "median_abs_error": 0.1, "bias": 0.0, "density": 1.0}}
    (tmp_path / f"{job.key(0)}.json").write_text(json.dumps({"key": job.key(0), "figures": told}))
    assert job.figures(0) == told
    assert get_simulated_statistic(told, "Depth", "scaled_median_abs_error") == pytest.approx(0.14826)
    assert replace(job, objectives=(replace(DEPTH, statistic="p95_abs_error"),)).figures(0) is None


def test_what_fails_is_told(tmp_path: Path) -> None:
    broken = {**scene(), "estimate": {"method": "structure_tensor"}, "objects": []}
    job = ConfirmationTask(str(tmp_path), (broken,), (1,), (DEPTH,), ())
    made = simulate_candidate(job, 0)
    assert "simulated rig 1, seed 1: SceneError" in made.failure["message"]


@pytest.mark.parametrize("seeds", [2, 4, 10])
def test_one_more_figure_lies_inside_with_95_percent(seeds: int) -> None:
    draws = 2000
    figures = np.exp(0.2 * np.random.default_rng(seeds).standard_normal((draws, seeds + 1)))
    inside = 0
    for *known, another in figures:
        found = compute_prediction_interval(known)
        inside += found.pi_low <= another <= found.pi_high
    # Of 2000 draws, the share is known to √(0.95 0.05 / 2000) = 0.5 %; three of them are allowed.
    assert inside / draws == pytest.approx(0.95, abs=0.015)


def test_few_figures() -> None:
    assert compute_prediction_interval([]).seeds == 0
    one = compute_prediction_interval([2.0])
    assert (one.value, one.seeds) == (2.0, 1)
    assert math.isnan(one.pi_low)
    assert math.isnan(compute_prediction_interval([0.0, 1.0]).pi_high)
    figures = {"depth": {"scaled_median_abs_error": (1.0, math.nan, 4.0), "rmse": (2.0, 2.0, 2.0)}}
    rig = RigDesign(1, {}, {}, {}, {}, (), None, "", figures)
    # What was not told of a seed is left out.
    assert compute_rig_interval(rig, "depth", "scaled_median_abs_error") == compute_prediction_interval([1.0, 4.0])
    assert compute_rig_interval(rig, "depth", "rmse").value == 2.0
    assert compute_rig_interval(rig, "growth", "rmse").seeds == 0


@pytest.mark.parametrize(
    ("simulated", "notable", "words"),
    [
        (PredictionInterval(1.1, 1.0, 1.2, 4), False, "within the scatter of 4 seeds (factor 1.10)"),
        # The scatter does not explain the difference, which is small.
        (PredictionInterval(1.24, 1.13, 1.37, 5), False, "a factor of 1.24, not notable"),
        (PredictionInterval(2.0, 1.8, 2.2, 4), True, "2.0 times the prediction"),
        (PredictionInterval(0.5, 0.4, 0.6, 4), True, "0.50 times the prediction"),
        # Seeds differ too much to tell.
        (PredictionInterval(2.0, 0.5, 8.0, 2), False, "within the scatter of 2 seeds"),
        (PredictionInterval(math.nan, math.nan, math.nan, 0), True, "no valid estimate"),
    ],
)
def test_discrepancies_are_told(simulated: PredictionInterval, notable: bool, words: str) -> None:
    found = compare_with_prediction(3, objective(), 1.0, simulated)
    assert (found.rig, found.notable) == (3, notable)
    assert words in found.says


def wide(**changes: object) -> Scene:
    plain = scene()
    plain["camera"] = {"width": 160, "height": 120, "focal_length_px": 500}
    plain["frames"] = {"count": 1}
    plain["sensor"] = "ideal"
    plain["objects"][0]["pose"]["position_mm"] = [10, -6, 500]
    return Scene.from_dict({**plain, **changes})


def test_a_part_is_what_the_whole_shows_there() -> None:
    whole = wide()
    part = reduce_scene(whole, "object_wall", 48)
    # 48 px, and a disparity of 4 px at each side of the reference's; ten standard deviations of the window are no less
    # than the 36 rows that 48 px would have.
    assert part.changes == ("images cropped from 160 x 120 to 56 x 36 px",)
    narrow = wide(estimate={"method": "structure_tensor", "window_sigma_px": 3.0, "window_taps_px": 13})
    assert reduce_scene(narrow, "object_wall", 48).changes == ("images cropped from 160 x 120 to 56 x 32 px",)
    left, top = np.subtract(whole.camera.principal_point, part.plain["camera"]["principal_point_px"])
    images, _ = st.simulate(whole)
    some, _ = st.simulate(Scene.from_dict(dict(part.plain)))
    rows, columns = (slice(int(a), int(a) + n) for a, n in zip((top, left), some["image"].shape[-2:], strict=True))
    # The same rays through the same places, to the rounding of the principal point.
    np.testing.assert_allclose(some["image"].values, images["image"].values[..., rows, columns], atol=2e-6)


def test_small_images_stay_whole() -> None:
    assert reduce_scene(wide(), "all", 160) == reduce_scene(wide(), "all", None)
    assert reduce_scene(wide(), "all", None).plain["camera"] == wide().to_dict()["camera"]


def test_what_does_nothing_is_left_out_and_told() -> None:
    focused = {"defocus": {"aperture_mm": 4.0, "focus_distance_mm": 500.0}}
    found = reduce_scene(wide(optics=focused, shutter={"exposure_time_s": 0.1}), "all", None)
    assert found.plain["optics"]["defocus"] is None
    assert found.plain["shutter"]["exposure_time_s"] == 0.0
    assert len(found.changes) == 2
    # 500 px 10 mm (1/500 - 1/550) = 0.91 px, and a quarter of that as standard deviation.
    psf = {"kind": "gaussian", "sigma_px": 0.6}
    near = {"psf": psf, "defocus": {"aperture_mm": 10.0, "focus_distance_mm": 550.0}}
    found = reduce_scene(wide(optics=near), "all", None)
    assert found.plain["optics"]["defocus"] is None
    disc = 500 * 10 * (1 / 500 - 1 / 550)
    assert found.plain["optics"]["psf"]["sigma_px"] == pytest.approx(np.hypot(0.6, disc / 4), rel=1e-3)
    # Four times that is no small disc; 0.1 mm per frame over two frames is 0.2 px.
    blurred = {"defocus": {"aperture_mm": 40.0, "focus_distance_mm": 550.0}}
    found = reduce_scene(wide(optics=blurred, shutter={"exposure_time_s": 2.0}), "all", None)
    assert found.plain["optics"]["defocus"]["samples"] == 12
    assert found.plain["shutter"]["exposure_time_s"] == 2.0
    assert found.changes == (f"12 aperture samples instead of {wide(optics=blurred).optics.defocus.samples}",)  # type: ignore[union-attr]


def rig(number: int, predicted: float, *figures: float) -> RigDesign:
    simulated = {"depth": PredictionInterval(1.0, 0.9, 1.1, len(figures))} if figures else {}
    return RigDesign(
        number, {}, {}, {"depth": predicted}, simulated, (), None, "", {"depth": {"scaled_median_abs_error": figures}}
    )


def test_what_seeds_have_in_common_does_not_hide_an_order() -> None:
    # Seeds differ by a factor of ten, rigs by a fifth in every seed.
    common = np.array([0.1, 1.0, 0.4, 0.2])
    better, worse = rig(1, 1.0, *common), rig(2, 1.5, *(common * [1.19, 1.21, 1.2, 1.2]))
    found = check_pair_rank(worse, better, objective())
    assert (found.better, found.worse, found.predicted, found.verdict) == (1, 2, 1.5, "kept")
    assert found.simulated == pytest.approx(1.2, rel=1e-3)
    assert 1.15 < found.ci_low < found.simulated < found.ci_high < 1.25
    swapped = check_pair_rank(replace(better, predicted={"depth": 2.0}), worse, objective())
    assert (swapped.better, swapped.worse, swapped.verdict) == (2, 1, "swapped")
    assert swapped.simulated == pytest.approx(1 / found.simulated)
    # The median statistic was told, the other was not.
    unknown = check_pair_rank(better, worse, replace(objective(), statistic="rmse"))
    assert (unknown.seeds, unknown.verdict) == (0, "undecided")


def test_what_seeds_do_not_tell_is_told_so() -> None:
    near = check_pair_rank(rig(1, 1.0, 1.0, 1.1, 0.9), rig(2, 1.02, 1.1, 0.9, 1.0), objective())
    assert near.verdict == "undecided"
    assert near.ci_low < 1 < near.ci_high
    # Seeds that tell one rig alone tell nothing.
    lost = check_pair_rank(rig(1, 1.0, 1.0, math.nan, 1.0), rig(2, 1.2, math.nan, 2.0, 2.0), objective())
    assert (lost.seeds, lost.verdict) == (1, "undecided")
    assert math.isnan(lost.simulated)


def test_rigs_that_seeds_do_not_distinguish_are_found() -> None:
    best, near, far = rig(1, 1.0, 1.0, 1.1, 0.9), rig(2, 1.02, 1.1, 0.9, 1.0), rig(3, 2.0, 2.0, 2.2, 1.8)
    assert find_indistinct(best, [far, near, best], [objective()]) == [near, best]
    # One seed decides nothing, and distinguishes nothing: the order of the values stays.
    assert find_indistinct(best, [best, rig(4, 1.0, 1.0)], [objective()]) == [best]


def test_one_pair_of_twenty_like_rigs_is_told_apart_by_chance() -> None:
    generator = np.random.default_rng(7)
    draws = 4000
    told = 0
    for figures in np.exp(0.2 * generator.standard_normal((draws, 2, 5))):
        one = check_pair_rank(rig(1, 1.0, *figures[0]), rig(2, 1.01, *figures[1]), objective())
        told += one.verdict != "undecided"
    # Known to √(0.05 0.95 / 4000) = 0.34 %; three of them are allowed.
    assert told / draws == pytest.approx(0.05, abs=0.0105)


def test_all_pairs_that_were_simulated_are_judged_and_counted() -> None:
    rigs = [rig(1, 1.0, 1.0, 1.1), rig(2, 2.0, 2.0, 2.2), rig(3, 3.0), rig(4, 1.0, 0.5, 0.55), rig(5, 9.0, 2.1, 2.1)]
    found = check_rank_consistency(rigs, (objective(),))
    # None with rig 3, which was not simulated; none of 1 and 4, which are predicted to be alike.
    assert [(one.better, one.worse) for one in found] == [(1, 2), (1, 5), (2, 4)[::-1], (2, 5), (4, 5)]
    (line,) = describe_rank_consistency((objective(),), found)
    verdicts = [one.verdict for one in found]
    assert verdicts.count("kept") == 4
    assert line.startswith("depth: predicted order of 5 pairs of rigs in the simulations: 4 confirmed, 1 ")
    assert list(describe_rank_consistency((objective("growth"),), found)) == []
