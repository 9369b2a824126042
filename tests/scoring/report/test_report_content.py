"""The page begins with the answer: the score's own figures, in sentences."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scenetruth.number_format import format_number, format_percent_value, format_share
from scenetruth.schema import REASONS
from scenetruth.scoring import score
from scenetruth.scoring.report import (
    Viewer,
    build_score_content,
    build_viewer,
    describe_invalidity,
    describe_maps,
    describe_noise,
    state_result,
    summarise_estimate,
    summarise_score,
)
from scenetruth.scoring.score_result import Score
from tests.helpers.synthetic_case import Case, make_growing_case, with_regions


@pytest.fixture(scope="module")
def scored(full_case: Case) -> tuple[Score, Viewer]:
    case = with_regions(full_case)
    result = score(case.estimate, case.truth, case.recording)
    return result, build_viewer(case.recording, case.estimate, case.truth, result)


def test_depth_and_motion_are_told_with_their_signal_and_where_they_are_worst(scored: tuple[Score, Viewer]) -> None:
    result, viewer = scored
    depth, motion = summarise_score(result, viewer)
    inner = result.regions["interior"]
    assert (depth.title, depth.figure, depth.units) == ("Depth", format_number(inner["depth"]["rmse"]), "mm")
    share = inner["depth"]["relative_rmse"]
    assert share is not None
    assert share < 2
    assert f"{format_percent_value(share)} % of the true value" in depth.rest
    spread = viewer.spread["depth"]
    assert inner["depth"]["rmse"] is not None
    varies = f"{format_percent_value(inner['depth']['rmse'] / spread)} % of the standard deviation of the true depth"
    assert varies in depth.rest
    assert motion.figure == format_number(inner["velocity_epe"]["rmse"])
    assert motion.layer == "velocity_epe:error"
    assert motion.place == viewer.worst["velocity_epe"]
    further = {name: values for name, values in result.regions.items() if name not in ("all", "interior")}
    worst = max(values["depth"]["rmse"] or 0.0 for values in further.values() if (values["depth"]["count"] or 0) >= 100)
    assert f", {format_number(worst)} mm." in depth.rest
    # The picture shows the pixel with the largest error in its middle, and says what its colours are.
    assert depth.picture is not None
    assert f"{format_number(depth.picture.limit, 2)} mm and more" in depth.legend
    assert depth.whole == format_number(result.regions["all"]["depth"]["rmse"])
    assert f"Over all valid pixels: {depth.whole} mm" in depth.rest
    assert state_result([depth, motion], "mine").startswith(f"The method mine measures depth to {depth.figure} mm and ")


def test_errors_of_surfaces_without_relief_are_no_share_of_it(scored: tuple[Score, Viewer]) -> None:
    result, viewer = scored
    rmse = result.regions["interior"]["depth"]["rmse"]
    assert rmse is not None
    for spread, said in ((rmse / 9.9, True), (rmse / 10.1, False), (0.0, False)):
        depth, _ = summarise_score(result, dataclasses.replace(viewer, spread={"depth": spread}))
        assert ("of the standard deviation of the true depth" in depth.rest) == said


def test_errors_above_the_quantity_are_no_measurement(scored: tuple[Score, Viewer]) -> None:
    depth, motion = summarise_score(*scored)
    worse = dataclasses.replace(motion, relative=10.4)
    growth = dataclasses.replace(motion, title="Growth", units="%/h", relative=46.9)
    text = state_result([depth, worse, growth], "mine", 0.4)
    assert f"measures depth to {depth.figure} mm (RMSE in the interior, 40.0 % of the surface; over all" in text
    assert text.endswith("Motion and growth are not measurable here: the errors are 10 and 47 times the true values.")
    assert "measures" not in state_result([worse], "mine")
    # Just below and above the quantity.
    assert dataclasses.replace(motion, relative=0.999).is_measured
    assert not dataclasses.replace(motion, relative=1.0).is_measured


def test_quantities_without_a_scored_pixel_are_named(scored: tuple[Score, Viewer]) -> None:
    """Of a single frame, no motion is estimated; a dash with a unit would be no statement."""
    result, viewer = scored
    empty = dict.fromkeys(result.regions["interior"]["depth"]) | {"count": 0, "density": 0.0}
    regions = {
        region: {name: empty if "velocity" in name else entries for name, entries in values.items()}
        for region, values in result.regions.items()
    }
    depth, motion = sentences = summarise_score(Score(regions, result.metadata), viewer)
    assert (depth.has_figure, motion.has_figure) == (True, False)
    assert state_result(sentences, "mine").endswith("Motion is not scored: no pixel of the interior has a valid value.")
    # Where pixels near edges are valid, their error is stated.
    near = {**regions, "all": result.regions["all"]}
    rest = summarise_score(Score(near, result.metadata), viewer)[-1].rest
    whole = format_number(result.regions["all"]["velocity_epe"]["rmse"])
    assert rest.startswith(f"no pixel of the interior has a valid value; over all valid pixels: {whole} mm/frame RMSE.")
    # The page has a sentence for an estimate without any number.
    assert state_result([motion], "mine") == ""
    cards = {card["title"] for card in build_score_content(Score(regions, result.metadata))["headlines"]}
    assert {"Depth, RMSE", "Density of depth"} < cards
    assert not any("Velocity" in card for card in cards)


def test_the_whole_surface_has_one_number(scored: tuple[Score, Viewer]) -> None:
    depth, _ = summarise_score(*scored)
    whole = dataclasses.replace(depth, whole=depth.figure)
    stated = f"The method mine measures depth to {depth.figure} mm (RMSE over all valid pixels), relative to the exact"
    assert state_result([whole], "mine", 1.0).startswith(stated)
    assert "in the interior, 40.0 % of the surface; over all" in state_result([whole], "mine", 0.4)
    assert f"of the surface; over all valid pixels: {depth.whole} mm" in state_result([depth], "mine", 1.0)


def test_nearly_empty_regions_are_not_the_worst(scored: tuple[Score, Viewer]) -> None:
    result, viewer = scored
    (depth, _), (before, _) = summarise_score(_with_empty(result, 0.09), viewer), summarise_score(result, viewer)
    assert "77.0 mm" not in depth.rest
    assert depth.rest == before.rest
    assert "Region with the largest RMSE: on the object “ghost”, 77.0 mm." in (
        summarise_score(_with_empty(result, 0.11), viewer)[0].rest
    )


def _with_empty(result: Score, density: float) -> Score:
    """Return a score with a further region of large errors and this density."""
    values = {name: {**one, "density": density} for name, one in result.regions["all"].items()}
    values["depth"] |= {"rmse": 77.0, "count": 500}
    return dataclasses.replace(result, regions={**result.regions, "object_ghost": values})


def test_reasons_of_invalid_pixels_are_fractions_of_the_surface(full_case: Case) -> None:
    estimate, truth = full_case.estimate, full_case.truth.copy(deep=True)
    reasons = np.zeros(estimate["depth"].shape, dtype=np.int8)
    half = reasons.shape[1] // 2
    reasons[:, half : half + 3] = REASONS.index("border")
    stated = estimate.assign(invalid_reason=(("t", "y", "x"), reasons))
    # Where the truth has no surface, no pixel could be valid.
    for rows in (0, 1):
        truth["depth"].values[..., half : half + rows, :] = np.nan
        surface = np.isfinite(truth.sel(t=estimate["t"].values)["depth"].values)
        share = 100 * surface[:, half : half + 3].sum() / surface.sum()
        assert share > 0
        assert describe_invalidity(stated, truth) == f"border of the image {share:.1f} %"
    assert describe_invalidity(estimate.drop_vars("invalid_reason", errors="ignore"), truth) == ""


def test_medians_below_the_noise_of_a_pixel_are_named(full_case: Case) -> None:
    found = describe_maps(full_case.estimate)
    quiet = dataclasses.replace(found["velocity_z"], median=0.25, median_std=0.1)
    noise = describe_noise(found | {"velocity_z": quiet})
    assert "velocity in Z (0.25 ± 0.10) mm/frame" in noise["medians"]
    assert noise["hidden"] == ""
    loud = dataclasses.replace(quiet, median=-0.008, median_std=0.05)
    noise = describe_noise(found | {"velocity_z": loud})
    assert "velocity in Z (−0.008 ± 0.050) mm/frame" in noise["medians"]
    assert noise["hidden"] == "The median of velocity in Z is smaller than the standard deviation of a pixel."
    still = dataclasses.replace(loud, title="Growth rate", units="%/h", median_common=None)
    both = describe_noise(found | {"velocity_z": loud, "growth_rate": still})
    assert both["hidden"].startswith("The medians of velocity in Z and growth rate are smaller")


def test_flow_is_the_motion_where_there_is_no_velocity(full_case: Case) -> None:
    estimate = full_case.estimate[["flow"]]
    result = score(estimate, full_case.truth)
    (motion,) = summarise_score(result, build_viewer(full_case.recording, estimate, full_case.truth, result))
    inner = result.regions["interior"]
    rms_x, rms_y = (inner[name]["rmse"] for name in ("flow_x", "flow_y"))
    assert rms_x is not None
    assert rms_y is not None
    assert (motion.title, motion.units) == ("Optical flow", "px/frame")
    assert motion.figure == format_number((rms_x**2 + rms_y**2) ** 0.5)


def test_growth_is_told_where_something_grows() -> None:
    case = make_growing_case(48, 36, 380.0, velocity_noise=1e-4)
    result = score(case.estimate, case.truth, case.recording, settings={"growth_window_px": 6, "interior_margin_px": 3})
    viewer = build_viewer(case.recording, case.estimate, case.truth, result)
    growth = summarise_score(result, viewer)[-1]
    assert (growth.title, growth.units) == ("Growth", "%/h")
    assert growth.figure == format_number(result.regions["interior"]["growth_rate"]["rmse"])
    # The map that tells the place is one that the viewer has.
    name, what = growth.layer.split(":")
    maps = next(one for one in viewer.plain["groups"] if one["name"] == name)["maps"]["0"]
    assert what in maps


def test_growth_is_that_of_the_objects_that_grow() -> None:
    """The zero growth of a wall behind two leaves makes the RMSE over all pixels smaller, and says nothing of them."""
    case = make_growing_case(48, 36, 380.0, velocity_noise=1e-4)
    result = score(case.estimate, case.truth, case.recording, settings={"growth_window_px": 6, "interior_margin_px": 3})
    viewer = build_viewer(case.recording, case.estimate, case.truth, result)
    rng = np.random.default_rng(4)
    errors = {"object_one": (rng.normal(0, 2, 300), 3.0), "object_two": (rng.normal(0, 5, 500), 4.0)}

    def with_objects(names: list[str]) -> Score:
        regions = {name: values for name, values in result.regions.items() if not name.startswith("object_")}
        base = regions["interior"]
        for name in names:
            error, growth = errors.get(name, (np.full(4000, 0.1), 0.0))
            rms = float(np.sqrt(np.mean(error**2)))
            values = {"rmse": rms, "relative_rmse": rms / growth if growth else None, "count": error.size}
            regions[name] = dict(base) | {"growth_rate": {**base["growth_rate"], **values}}
        return Score(regions, result.metadata)

    pooled = np.concatenate([error for error, _ in errors.values()])
    growth = np.concatenate([np.full(error.size, rate) for error, rate in errors.values()])
    two = summarise_score(with_objects([*errors, "object_wall"]), viewer)[-1]
    assert (two.title, two.units) == ("Growth of 2 objects", "%/h")
    assert two.figure == format_number(float(np.sqrt(np.mean(pooled**2))))
    share = float(np.sqrt(np.mean(pooled**2) / np.mean(growth**2)))
    assert f"{format_share(share)} of the true value of {format_number(float(np.sqrt(np.mean(growth**2))))}" in two.rest
    interior = format_number(result.regions["interior"]["growth_rate"]["rmse"])
    assert f"; {interior} %/h with the objects that do not grow." in two.rest
    one = summarise_score(with_objects(["object_two", "object_wall"]), viewer)[-1]
    assert one.title == "Growth of “two”"
    assert state_result([one], "mine").startswith(f"The method mine measures growth of “two” to {one.figure} %/h")
    # The interior holds the wall alone: its error is not that of the leaves.
    inner = result.regions["interior"]
    none = {name: {**inner[name], "relative_rmse": None} for name in ("growth_rate", "growth_rate_windowed")}
    still = Score({**result.regions, "interior": {**inner, **none}}, result.metadata)
    hidden = summarise_score(still, viewer)[-1]
    assert (hidden.title, hidden.has_figure) == ("Growth", False)
    assert hidden.rest == "no surface that grows is scored in the interior."
    # Where all objects grow, or one alone is seen, the interior is theirs.
    for names in (list(errors), ["object_two"]):
        assert summarise_score(with_objects(names), viewer)[-1].figure == interior


def test_without_truth_medians_are_told(full_case: Case) -> None:
    found = describe_maps(full_case.estimate)
    depth, motion = summarise_estimate(found)
    # A median has the digits that its standard deviation leaves, as in the first sentence of the page.
    assert describe_noise(found)["medians"].startswith(f"depth ({depth.figure} ± ")
    assert f"The density is {format_percent_value(found['depth'].density)} %" in depth.rest
    assert motion.title == "Velocity in Z"
    assert depth.where == ""


def test_growth_is_a_headline_with_its_standard_deviation_only(full_case: Case) -> None:
    """Growth in windows, which the report computes itself, has none; a still surface would seem to grow."""
    found = describe_maps(full_case.estimate)
    growing = dataclasses.replace(
        found["velocity_z"], title="Growth rate", units="%/h", median=1.13, median_std=None, median_common=None
    )
    assert [one.title for one in summarise_estimate(found | {"growth_rate": growing})] == ["Depth", "Velocity in Z"]
    stated = dataclasses.replace(growing, median_std=0.25)
    growth = summarise_estimate(found | {"growth_rate": stated})[-1]
    assert (growth.title, growth.figure) == ("Growth rate", "1.13")
    assert "with a median stated standard deviation of 0.25 %/h" in growth.rest


def test_the_common_part_of_standard_deviations_is_stated(full_case: Case) -> None:
    estimate = full_case.estimate
    common = estimate["depth_std"] / 4
    before, _ = summarise_estimate(describe_maps(estimate))
    assert "common to all pixels" not in before.rest
    found = describe_maps(estimate.assign(depth_std_common=common))
    depth, _ = summarise_estimate(found)
    assert found["depth"].median_common is not None
    assert found["depth"].median_std is not None
    # Of a different set: values of zero count as well.
    assert found["depth"].median_common <= found["depth"].median_std / 4 * (1 + 1e-6)
    assert f"(common to all pixels: {format_number(found['depth'].median_common, 2)} mm)" in depth.rest
