"""The page of a design: every figure of it comes from the design, and no word in it acts."""

from __future__ import annotations

import html
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from scenetruth.design.optimisation import (
    AxisSpec,
    DesignResult,
    Objective,
    PredictionInterval,
    build_axis,
    build_constraint_table,
    build_discrepancy_table,
    build_front_charts,
    build_front_table,
    build_parameter_table,
    build_preview_file,
    build_rank_consistency_table,
    build_scene_file,
    build_sensitivity_charts,
    build_sensitivity_table,
    compute_prediction_interval,
    derive_blur_limit,
    describe_sensitivities,
    list_warnings,
    summarise_objectives,
    write_design_files,
    write_design_page,
)
from scenetruth.number_format import format_duration
from scenetruth.scene import Scene, load_scene
from tests.helpers.command_line import scenetruth
from tests.helpers.page_words import without_definitions
from tests.helpers.sample_design import DEPTH, GROWTH, NUMBERS, design

REFERENCE_WORK_S = 2.2e-3
"""Time of the small benchmark of `scenetruth.resources` at reference speed."""

HOSTILE = "</script><script>alert(1)</script>"


@pytest.fixture(scope="module")
def sample() -> DesignResult:
    return design()


def text_of(found: DesignResult, folder: Path) -> str:
    return without_definitions(write_design_page(found, folder).read_text(encoding="utf-8"))


def said_in(text: str) -> str:
    """Return the words of a page, without scripts, styles and tags."""
    bare = re.sub(r"<(script|style)>.*?</\1>", "", text, flags=re.DOTALL)
    return html.unescape(re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", bare)))


def charts_in(text: str) -> dict[str, Any]:
    found = re.search(r"^const charts = (.*);$", text, re.MULTILINE)
    assert found is not None
    charts: dict[str, Any] = json.loads(found[1])
    return charts


def test_the_page_is_one_file_that_tells_all(sample: DesignResult, tmp_path: Path) -> None:
    text = text_of(sample, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["index.html"]
    # Nothing is fetched.
    outside = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(r'(src|href)="(?!#|data:)', outside)
    for name in charts_in(text):
        assert f'id="chart-{name}"' in text
    said = said_in(text)
    for number in NUMBERS:
        assert f" {number} " in said
    told = [
        *sample.assumptions,
        sample.recommended.limits,
        *(each for one in sample.rules for each in (one.here, one.source)),
    ]
    told += [one.title for one in sample.recommended.constraints] + [one.says for one in sample.discrepancies]
    for words in told:
        assert words in said
    # The first sentence states each result with its interval, and no name of a field stands for a word.
    first = re.search(r"The recommended rig measures the .*?\.\s", said.replace("\N{NO-BREAK SPACE}", " "))
    assert first is not None
    for reached in summarise_objectives(sample):
        assert f"{reached.figure} {reached.unit} (" in first[0]
        assert reached.between in first[0]
        assert re.fullmatch(rf"\S+ to \S+ {reached.unit}", reached.between)
    assert "scenetruth run recommended.yaml -o outputs/recommended" in said
    assert "target: 0.3" in said
    identities = re.findall(r' id="([^"]*)"', outside)
    assert len(identities) == len(set(identities))
    for place in re.findall(r'href="#([^"]*)"', outside):
        assert place in identities


def test_no_word_acts(sample: DesignResult, tmp_path: Path) -> None:
    plain = json.loads(json.dumps(sample.recommended.scene))
    plain["objects"][1]["name"] = plain["description"] = HOSTILE
    best = replace(
        sample.recommended,
        scene=plain,
        limits=HOSTILE,
        parameters={**sample.recommended.parameters, "lens": HOSTILE},
        constraints=tuple(replace(one, title=HOSTILE) for one in sample.recommended.constraints),
    )
    front = tuple(best if one.number == best.number else one for one in sample.front)
    rules = tuple(replace(one, here=HOSTILE, source=HOSTILE) for one in sample.rules)
    found = replace(sample, title=HOSTILE, recommended=best, front=front, rules=rules, assumptions=(HOSTILE,))
    text = text_of(found, tmp_path)
    assert HOSTILE not in text
    assert said_in(text).count(HOSTILE) > 8
    assert text.count("</script>") == 3


def test_scene_files_run(sample: DesignResult, tmp_path: Path) -> None:
    text = text_of(sample, tmp_path)
    files = re.findall(r'href="data:application/yaml;base64,[^"]*" download="([^"]*)"', text)
    assert sorted(files) == [
        "recommended.yaml",
        "recommended_preview.yaml",
        *sorted(f"rig_{number}.yaml" for number in NUMBERS),
    ]
    file = build_scene_file(sample.recommended, "recommended.yaml")
    (tmp_path / file.name).write_text(file.text, encoding="utf-8")
    assert load_scene(tmp_path / file.name) == Scene.from_dict(sample.recommended.scene)
    assert yaml.safe_load(file.text) == sample.recommended.scene
    part = build_preview_file(
        replace(sample, specification={**sample.specification, "confirmation": {"max_size_px": 100}})
    )
    (tmp_path / part.name).write_text(part.text, encoding="utf-8")
    shown = load_scene(tmp_path / part.name)
    assert shown.camera.height < 100 < load_scene(tmp_path / file.name).camera.height
    assert "scenetruth run recommended_preview.yaml -o outputs/recommended_preview" in said_in(text)
    assert "rotations:\n" in file.text
    # Hours and memory of the full images are those of `scenetruth check`, in the words of the page.
    assert re.search(
        r"A run of full images .* takes about [0-9.]+ (s|min) of processor time at reference speed, ",
        said_in(text),
    )
    assert "Predictions include image noise, stage errors and motion during a scan." in said_in(text)
    # Short lists stand on one line.
    assert "size_mm: [40, 30]" in file.text


def test_check_and_the_header_state_the_same_time(
    sample: DesignResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slower = 2.0
    monkeypatch.setattr("scenetruth.resources.cost_estimate.work_s", lambda: slower * REFERENCE_WORK_S)
    scene = dict(sample.recommended.scene)
    scene["frames"] = {**scene["frames"], "count": 400}
    write_design_files(replace(sample, recommended=replace(sample.recommended, scene=scene)), tmp_path)
    file = tmp_path / "recommended.yaml"
    stated = re.search(r"takes about (.*) of processor time at reference speed", file.read_text(encoding="utf-8"))
    assert stated is not None
    cost = json.loads(scenetruth("check", file, "--json").stdout)
    assert stated[1] == format_duration(cost["reference_run_time_s"])
    assert cost["run_time_s"] == pytest.approx(slower * cost["reference_run_time_s"], rel=1e-12)
    assert cost["run_time_s"] == pytest.approx(sum(stage["run_time_s"] for stage in cost["stages"].values()), rel=1e-12)


def test_the_stored_rig_states_the_time_of_check() -> None:
    file = Path(__file__).parents[4] / "docs" / "results" / "worked_examples" / "leaf_growth_rig.yaml"
    cost = json.loads(scenetruth("check", file, "--json").stdout)
    assert f" {format_duration(cost['reference_run_time_s'])} of processor time" in file.read_text(encoding="utf-8")


def test_the_answer_is_judged_by_simulations(sample: DesignResult) -> None:
    depth, growth = summarise_objectives(sample)
    assert (depth.figure, depth.unit, depth.verdict) == ("0.0530", "mm", "")
    assert depth.source == (
        "scaled median absolute error in 6 simulated recordings (95 %: 0.0475 to 0.0600; predicted 0.050; RMSE 0.0637)"
    )
    assert growth.verdict.startswith("Target: 0.3 %/h. Undecided: ")

    def verdict(*values: float, rmse: float = 0.1) -> str:
        figures = {GROWTH: {"scaled_median_abs_error": values, "rmse": (rmse,)}}
        simulated = {**sample.recommended.simulated, GROWTH: compute_prediction_interval(values)}
        best = replace(sample.recommended, simulated=simulated, figures=figures)
        return summarise_objectives(replace(sample, recommended=best))[1].verdict

    assert verdict(0.19, 0.2, 0.21).startswith("Target: 0.3 %/h. Yes: at most 0.2")
    assert verdict(0.39, 0.4, 0.41).startswith("Target: 0.3 %/h. No: at least 0.3")
    assert verdict(0.1, 0.2, 0.4).startswith("Target: 0.3 %/h. Undecided: ")
    assert verdict(0.2) == "Target: 0.3 %/h. Undecided: one recording cannot decide it."
    assert verdict(0.19, 0.2, 0.21, rmse=0.4).endswith("The RMSE, which includes outliers, is above the target.")
    unconfirmed = summarise_objectives(replace(sample, recommended=sample.front[1]))[1].verdict
    assert "Undecided: the prediction" in unconfirmed


def test_what_must_be_known_comes_first(sample: DesignResult, tmp_path: Path) -> None:
    told = [words for words, _ in list_warnings(sample)]
    assert told == [
        f"The recommended rig is not yet shown to meet the target. {GROWTH}: 0.309 %/h, target 0.3 %/h.",
        "Prediction and simulation differ notably in 3 of 6 values, 1 of them for the recommended rig.",
    ]
    last = replace(sample, recommended=sample.front[4])
    assert "The recommended rig violates constraints: stage travel." in dict(list_warnings(last))
    unconfirmed = replace(sample, recommended=sample.front[1], discrepancies=())
    assert "was not simulated" in list_warnings(unconfirmed)[-1][0]
    text = said_in(text_of(unconfirmed, tmp_path))
    assert "predicted scaled median absolute error; not simulated" in text
    assert "No rig was simulated: the predictions are not confirmed." in text


def test_the_front_is_drawn_with_bars_and_told_in_words(sample: DesignResult) -> None:
    (chart,) = build_front_charts(sample)
    cloud, predicted, _, simulated, star = chart.data
    assert predicted["x"] == sorted(rig.predicted[DEPTH] for rig in sample.front)
    # The rigs that hold the constraints, not the others.
    held = set(sample.screened[sample.screened["holds"]][DEPTH])
    assert set(cloud["x"]) <= held
    assert len(cloud["x"]) > 200
    by_depth = sorted((rig for rig in sample.front if rig.is_confirmed), key=lambda rig: rig.predicted[DEPTH])
    figures = [rig.simulated[GROWTH] for rig in by_depth]
    assert simulated["y"] == [one.value for one in figures]
    assert simulated["error_y"]["array"] == [one.pi_high - one.value for one in figures]
    assert simulated["error_x"]["arrayminus"] == [
        rig.simulated[DEPTH].value - rig.simulated[DEPTH].pi_low for rig in by_depth
    ]
    assert [star["x"], star["y"]] == [[sample.recommended.predicted[title]] for title in (DEPTH, GROWTH)]
    assert chart.layout["yaxis"]["type"] == "log"
    assert chart.layout["annotations"][0]["y"] == pytest.approx(math.log10(0.3))
    assert "Recommended: rig 1204 with 0.0500 and 0.238" in chart.alt


def test_alternatives_behind_the_front_are_told_from_it(sample: DesignResult) -> None:
    worse = replace(sample.front[1], predicted={DEPTH: 0.07, GROWTH: 0.192})
    found = replace(sample, front=(sample.front[0], *sample.front[2:]), alternatives=(worse,))
    assert [rig.number for rig in found.rigs] == [642, 530, 1204, 87, 311]
    assert [line[1].text for line in build_front_table(found).lines] == ["yes", "yes", "yes", "no", "yes"]
    (chart,) = build_front_charts(found)
    names = {trace["name"]: trace["x"] for trace in chart.data if "name" in trace}
    assert names["alternatives, predicted"] == [0.07]
    assert len(names["front, predicted"]) == 4
    assert list(found.to_dataframe()["front"]) == [True, True, True, False, True]


def test_three_objectives_have_three_charts_and_one_has_its_parameter(sample: DesignResult) -> None:
    price = replace(sample.objectives[0], title="third", quantity="slope_x")
    screened = sample.screened.assign(third=1.0)
    front = tuple(replace(rig, predicted={**rig.predicted, "third": 1.0}) for rig in sample.front)
    three = replace(
        sample, objectives=(*sample.objectives, price), screened=screened, front=front, recommended=front[2]
    )
    assert [chart.name for chart in build_front_charts(three)] == ["front-0-1", "front-0-2", "front-1-2"]
    # With three objectives there is no line to follow.
    assert all(chart.data[1]["mode"] == "markers" for chart in build_front_charts(three))
    # What nobody simulated has no bars.
    assert [line["name"] for line in build_front_charts(three)[1].data if "error_y" in line] == []
    one = replace(sample, objectives=sample.objectives[1:])
    (chart,) = build_front_charts(one)
    # The interval does more to growth than the baseline.
    assert chart.layout["xaxis"]["title"]["text"] == "frame interval, s"
    assert chart.data[-1]["y"] == [sample.recommended.predicted[GROWTH]]
    # What is a number in some rigs only is no axis.
    mixed = [replace(rig, parameters={**rig.parameters, "frames.frame_interval_s": None}) for rig in one.front[:1]]
    (chart,) = build_front_charts(replace(one, front=(*mixed, *one.front[1:])))
    assert chart.layout["xaxis"]["title"]["text"] == "baseline, mm"
    words = [replace(rig, parameters={"lens": "typical"}) for rig in one.front]
    assert build_front_charts(replace(one, front=tuple(words), recommended=words[2])) == []


def test_points_that_rounding_sets_apart_are_one_place() -> None:
    way = AxisSpec("depth", Objective("depth", "all", "mm", "depth", None))
    for points in ([1.0, np.nextafter(1.0, 2.0)], [0.0, 5e-324], [-1e-40]):
        low, high = build_axis(way, points, [])["range"]
        assert low < min(points) <= max(points) < high
        assert high - low > 0.05


# What is drawn has units: no number that is next to nothing.
@given(
    st.lists(st.floats(-1e3, 1e4).map(lambda value: round(value, 6)), min_size=1, max_size=9),
    st.lists(st.floats(-1e6, 1e6), max_size=6),
    st.one_of(st.none(), st.floats(0.01, 100.0)),
)
def test_axes_hold_all_points_which_long_bars_do_not_push_together(
    points: list[float], ends: list[float], wanted: float | None
) -> None:
    axis = build_axis(AxisSpec("depth", Objective("depth", "all", "mm", "depth", wanted)), points, ends)
    low, high = axis["range"]
    shown = points if wanted is None else [*points, wanted]
    is_log = axis["type"] == "log"
    places = [math.log10(one) for one in shown] if is_log else shown
    assert low < min(places) <= max(places) < high
    assert not is_log or min(shown) > 0
    span = max(places) - min(places)
    # A factor of three to both sides, or three times what the points span; and five per cent.
    least = (2 * math.log10(3) + span) * 1.1 + 0.02 if is_log else 7 * (span or abs(places[0]) or 1.0) * 1.1
    assert high - low <= least * (1 + 1e-9)


def test_sensitivities_are_told_the_largest_first(sample: DesignResult) -> None:
    assert [line.replace("\N{NO-BREAK SPACE}", " ") for line in describe_sensitivities(sample)] == [
        f"{DEPTH}: an increase of the baseline by 10 % changes it by −9.1 % (better), a decrease by +11 %.",
        f"{GROWTH}: an increase of the frame interval by 10 % changes it by −9.1 % (better), "
        "a decrease by +11 %; an increase of the baseline by 10 % changes it by +7.4 % (worse), "
        "a decrease by −7.6 %.",
    ]
    charts = {chart.name: chart for chart in build_sensitivity_charts(sample)}
    assert set(charts) == {"ten-percent-0", "sobol-0", "ten-percent-1", "sobol-1"}
    # Bars are drawn from below; catalogues have no 10 %.
    less, more = charts["ten-percent-1"].data
    assert more["y"] == ["baseline", "frame interval"]
    assert more["x"] == pytest.approx([7.4, -9.09])
    assert less["x"] == pytest.approx([-7.6, 11.1])
    total, first = charts["sobol-1"].data
    assert total["x"] == [0.1, 0.31, 0.7]
    assert total["error_x"]["array"] == [0.3, 0.2, 0.2]
    # What is not known is pale, and told so.
    assert first["marker"]["opacity"] == [0.4, 1.0, 1.0]
    assert first["customdata"][0] == "not significant with 64 samples"
    assert build_sensitivity_table(sample).lines[5][4].text == "not significant with 64 samples"
    assert [cell.text for cell in build_sensitivity_table(sample).lines[1][4:6]] == ["under 0.05", "under 0.05"]


def test_tables_hold_what_was_found(sample: DesignResult) -> None:
    front = build_front_table(sample)
    assert front.marked == 2
    assert [line[0].text for line in front.lines] == ["642", "530", "1204 (recommended)", "87", "311"]
    assert [cell.text for cell in front.lines[2][1:6]] == ["yes", "0.0500", "0.0530", "0.0475 to 0.0600", "0.0637"]
    assert front.lines[0][-3].text == "stage travel: violated"
    assert front.numeric[:7] == [True, False, *[True] * 5]
    constraints = build_constraint_table(sample.recommended)
    assert constraints.lines[0][0].text == "field of view along x"
    assert [cell.text for cell in constraints.lines[0][1:3]] == ["59.9 mm", "at least 55 mm"]
    # Ratios have no unit.
    first = replace(sample.recommended.constraints[0], value=0.494, limit=0.5, unit="1", sense="at most", margin=0.01)
    (ratio,) = build_constraint_table(replace(sample.recommended, constraints=(first,))).lines
    assert [cell.text for cell in ratio[1:3]] == ["0.494", "at most 0.5"]
    # What does not hold comes first, whatever its margin.
    assert build_constraint_table(sample.front[4]).lines[0][4].text == "no"
    assert [line[6].text for line in build_discrepancy_table(sample).lines[:2]] == ["1.06", "1.30"]


@pytest.mark.parametrize(
    ("entry", "value", "told"),
    [
        ({"from": 2, "to": 30, "log": True}, 8.0, ("2 to 30, logarithmic", "no")),
        ({"from": 2, "to": 30}, 29.9, ("2 to 30", "upper end")),
        ({"from": 2, "to": 30}, 2.0, ("2 to 30", "lower end")),
        ({"from": None, "to": None, "log": False, "values": [60, 900]}, 60, ("60, 900", "lower end")),
        ([60, 300, 900], 900, ("60, 300, 900", "upper end")),
        (["a", "b"], "a", ("a, b", "–")),
        ("all", "a", ("all", "–")),
        (None, 3.0, ("–", "–")),
    ],
)
def test_ends_of_ranges_are_told(sample: DesignResult, entry: Any, value: Any, told: tuple[str, str]) -> None:
    free = {} if entry is None else {"x": entry}
    found = replace(
        sample, specification={"variables": free}, recommended=replace(sample.recommended, parameters={"x": value})
    )
    ((_, _, _, *rest),) = build_parameter_table(found).lines
    assert tuple(cell.text for cell in rest) == told


def test_orders_of_pairs_are_told(sample: DesignResult, tmp_path: Path) -> None:
    lines = [[cell.text for cell in line] for line in build_rank_consistency_table(sample).lines]
    assert lines[0][:5] == [DEPTH, "1204", "311", "2.00", "2.00"]
    assert [line[-1] for line in lines] == ["kept"] * 6
    said = said_in(text_of(sample, tmp_path))
    assert f"{DEPTH}: predicted order of 3 pairs of rigs in the simulations: 3 confirmed" in said


def test_places_that_are_far_off_are_warned_of(sample: DesignResult) -> None:
    reached = {**sample.recommended.simulated, GROWTH: PredictionInterval(0.2, 0.15, 0.25, 6)}
    told = [
        words for words, _ in list_warnings(replace(sample, recommended=replace(sample.recommended, simulated=reached)))
    ]
    far_off = (
        f"{GROWTH}: the errors have outliers. The scaled median absolute error is 0.200 %/h, but the RMSE 0.619 %/h."
    )
    assert far_off in told


def test_figures_that_are_missing_are_dashes(sample: DesignResult, tmp_path: Path) -> None:
    broken = {
        DEPTH: PredictionInterval(math.nan, math.nan, math.nan, 1),
        GROWTH: PredictionInterval(0.2, math.nan, math.nan, 1),
    }
    worst = replace(sample.front[0], simulated=broken, predicted={DEPTH: math.inf, GROWTH: 0.1}, price=None)
    found = replace(sample, front=(worst, *sample.front[1:]), sensitivities=(), rules=(), assumptions=(), seconds={})
    line = build_front_table(found).lines[-1]
    assert [cell.text for cell in line[2:5]] == ["∞", "–", "–"]
    assert [cell.text for cell in line[6:9]] == ["0.100", "0.200", "–"]
    # JSON has no numbers that are not finite.
    charts = charts_in(text_of(found, tmp_path))
    assert set(charts) == {"front-0-1"}


def test_what_lies_beside_is_linked(sample: DesignResult, tmp_path: Path) -> None:
    assert "pattern/pattern.pdf" not in text_of(sample, tmp_path)
    (tmp_path / "pattern").mkdir()
    (tmp_path / "pattern" / "pattern.pdf").touch()
    assert '<a href="pattern/pattern.pdf">' in text_of(sample, tmp_path)


def test_what_is_sharp_is_what_the_goal_says() -> None:
    assert derive_blur_limit({}) == 1.0
    assert derive_blur_limit({"constraints": [{"kind": "depth_of_field", "min": 20}]}) == 1.0
    both = [{"kind": "depth_of_field", "blur_px": 2}, {"kind": "defocus_blur", "max": 0.5, "depths_mm": None}]
    assert derive_blur_limit({"constraints": both[:1]}) == 2.0
    assert derive_blur_limit({"constraints": both}) == 0.5
    assert derive_blur_limit({"constraints": [{"kind": "motion_blur", "max": 0.1}]}) == 1.0
