"""The page of a sweep and its pictures: every figure comes from the rows, and no word in it acts."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenetruth.design.sweeps import (
    Sweep,
    build_chart,
    build_panels,
    find_only_method,
    list_plotted_quantities,
    write_static_plots,
    write_sweep_report,
)
from tests.helpers.page_words import without_definitions
from tests.helpers.sample_sweep import BASELINE, HOSTILE, KIND, NOISE, over_two, rows


def over_one() -> Sweep:
    return Sweep([BASELINE], ["cube"], ["mine", HOSTILE], rows([{BASELINE: b} for b in (1, 2, 20)], ("mine", HOSTILE)))


def test_one_factor_makes_lines_with_error_bars_and_the_bound() -> None:
    (panel,) = build_panels(over_one(), "depth")
    assert [curve.name for curve in panel.curves][:2] == ["mine", "Cramér-Rao bound, mine"]
    assert panel.curves[0].points == (
        (1.0, 1, 0.8, 1.2),
        (2.0, 2, 1.6, 2.4),
        (20.0, 3, 2.4000000000000004, 3.5999999999999996),
    )
    # 20 is more than eight times 1.
    assert panel.x.logarithmic
    assert "mine: 1 at 1, 3 at 20" in panel.words
    data = build_chart(panel)["data"]
    assert data[0]["error_y"]["array"] == pytest.approx([0.2, 0.4, 0.6])
    assert data[1]["y"] == [0.5, 1.0, 1.5]
    assert [trace.get("showlegend", True) for trace in data] == [True, True, True, False]
    (bias,) = build_panels(over_one(), "depth", "bias")
    assert not bias.y.logarithmic
    assert build_panels(over_one(), "depth", "precision_std") == []


def over_methods(*others: str) -> Sweep:
    """A sweep over the method of the scene, with one method at each level, and further factors."""
    found = [
        replace(row, value=factor * row.value, ci_low=factor * row.ci_low, ci_high=factor * row.ci_high)
        for method, factor in (("mine", 1), ("theirs", 3))
        for row in rows(
            [{"estimate.method": method} | dict.fromkeys(others, n) for n in (1, 2)][: 2 if others else 1], (method,)
        )
    ]
    return Sweep(["estimate.method", *others], ["cube"], ["mine", "theirs"], found)


def test_the_method_is_no_axis_with_other_factors(tmp_path: Path) -> None:
    """Every method is a group of its own: maps over the method would be half empty."""
    (lines,) = build_panels(over_methods(BASELINE), "depth")
    assert lines.x.path == BASELINE
    curves = {curve.name: [point[:2] for point in curve.points] for curve in lines.curves}
    assert curves["mine"] == [(1.0, 1), (2.0, 2)]
    assert curves["theirs"] == [(1.0, 3), (2.0, 6)]
    assert curves["Cramér-Rao bound, theirs"] == [(1.0, 1.5), (2.0, 3.0)]
    panels = build_panels(over_methods(BASELINE, NOISE), "depth")
    maps = [panel for panel in panels if panel.map is not None]
    assert [(panel.title, panel.x.path, panel.y.path) for panel in maps] == [
        (method, BASELINE, NOISE) for method in ("mine", "theirs")
    ]
    # With no other factor it is the axis.
    (alone,) = build_panels(over_methods(), "depth")
    assert alone.x.names == ("mine", "theirs")
    text = without_definitions(write_sweep_report(over_methods(BASELINE), tmp_path).read_text(encoding="utf-8"))
    assert "at method mine, baseline 1 mm." in text
    assert "with mine" not in text


def test_missing_cells_of_a_map_keep_their_columns() -> None:
    """Texts of cells are placed by the labels of the map, so that it has all labels of its axes."""
    found = over_two()
    named = [replace(row, values={KIND: f"b{row.values[BASELINE]}", NOISE: row.values[NOISE]}) for row in found.rows]
    kept = [row for row in named if row.values[KIND] != "b1" or row.statistic != "rmse"]
    heat, _ = build_panels(Sweep([KIND, NOISE], ["cube"], ["mine"], kept), "depth")
    data = build_chart(heat)["data"][0]
    assert data["x"] == ["b1", "b2", "b4"]
    assert [row[0] for row in data["text"]] == ["", ""]
    assert data["text"][0][1:] == ["3.00<br>(1.5)", "5.0<br>(2.5)"]


def test_two_factors_make_a_map_and_lines() -> None:
    heat, lines = build_panels(over_two(), "depth")
    assert heat.map is not None
    assert heat.map.names(along_x=True) == ["1", "2", "4"]
    data = build_chart(heat)["data"][0]
    assert (data["x"], data["y"]) == (["1", "2", "4"], ["0.01", "0.02"])
    assert 10 ** np.array(data["z"]) == pytest.approx(np.array([[1, 3, 5], [2, 4, 6]]))
    assert data["text"][1][2] == "6.0<br>(3)"
    assert data["customdata"][0][0] == "1.00, 95 %: 0.80 to 1.20, Cramér-Rao bound 0.5"
    assert "smallest 1 at baseline 1 mm, sensor noise 0.01" in heat.words
    assert [curve.name for curve in lines.curves if not curve.is_bound] == [
        "sensor noise 0.01 of full scale",
        "sensor noise 0.02 of full scale",
    ]


def test_the_first_sentence_counts_points_with_overlapping_intervals(tmp_path: Path) -> None:
    def counted(low: float, folder: str) -> str:
        # Of 1, 2 and 3, the first is the smallest, with the interval 0.8 to 1.2.
        points = rows([{BASELINE: b} for b in (1, 2, 20)])
        found = Sweep([BASELINE], ["cube"], ["mine"], [replace(r, ci_low=low) if r.value == 2 else r for r in points])
        page = write_sweep_report(found, tmp_path / folder).read_text(encoding="utf-8")
        return " ".join(re.findall(r"The intervals? of .*?:", re.sub(r"<[^>]*>", "", page)))

    assert counted(1.1, "one") == "The intervals of 1 of the other 2 points overlap with it:"
    assert counted(1.3, "none") == ""


@pytest.mark.parametrize("values", [(0.103, 0.106), (1.0, 1.004), (1e-3, 0.2)])
def test_ticks_of_colour_bars_differ(values: tuple[float, float]) -> None:
    points = rows([{BASELINE: b, NOISE: n} for b in (1, 2) for n in (0.1, 0.2)])
    levels = {0.1: values[0], 0.2: values[1]}
    of_levels = [replace(row, value=levels[row.values[NOISE]]) for row in points]
    heat, *_ = build_panels(Sweep([BASELINE, NOISE], ["cube"], ["mine"], of_levels), "depth")
    ticks = build_chart(heat)["data"][0]["colorbar"]["ticktext"]
    assert len(set(ticks)) == len(ticks) == 5


def test_a_level_without_a_value_has_an_empty_column() -> None:
    found = over_two()
    kept = [row for row in found.rows if row.values[BASELINE] != 4 or row.statistic != "rmse"]
    heat, *_ = build_panels(replace(found, rows=kept), "depth")
    data = build_chart(heat)["data"][0]
    assert data["x"] == ["1", "2", "4"]
    assert [line[2] for line in data["z"]] == [None, None]
    assert [line[2] for line in data["text"]] == ["", ""]


def test_a_method_of_all_rows_is_named_once() -> None:
    assert find_only_method(["mine", "mine"]) == "mine"
    assert find_only_method(["mine", "theirs"]) == find_only_method([]) == ""


def test_points_that_fill_ranges_make_a_field_and_more_factors_make_points() -> None:
    points = [{BASELINE: b, NOISE: n} for b, n in ((1.5, 0.02), (3.1, 0.01), (2.2, 0.04))]
    filled = Sweep([BASELINE, NOISE], ["cube"], ["mine"], rows(points), is_grid=False, logarithmic=frozenset({NOISE}))
    field, *marginal = build_panels(filled, "depth")
    assert build_chart(field)["data"][0]["mode"] == "markers"
    assert field.y.logarithmic
    assert [panel.x.title for panel in marginal] == ["baseline, mm", "sensor noise, of full scale"]
    assert [point[0] for point in marginal[0].curves[0].points] == [1.5, 2.2, 3.1]
    three = [{BASELINE: b, NOISE: 0.1, KIND: kind} for b in (1, 2) for kind in ("plane", "box")]
    panels = build_panels(Sweep([BASELINE, NOISE, KIND], ["cube"], ["mine"], rows(three)), "depth")
    assert [panel.x.title for panel in panels] == ["baseline, mm", "sensor noise, of full scale", "mesh kind"]
    assert panels[2].x.names == ("plane", "box")
    assert not any(curve.joined for panel in panels for curve in panel.curves)


def test_growth_is_shown_where_something_grows() -> None:
    found = over_one()
    assert list_plotted_quantities(found) == ["depth"]
    growing = Sweep(found.factors, found.scenes, found.methods, found.rows, grows=True)
    assert list_plotted_quantities(growing) == ["depth", "growth_rate"]


@pytest.mark.parametrize(("grows", "quantity"), [(False, "depth"), (True, "growth rate")])
def test_growth_comes_first_where_something_grows(grows: bool, quantity: str, tmp_path: Path) -> None:
    found = over_one()
    page = write_sweep_report(Sweep(found.factors, found.scenes, found.methods, found.rows, grows=grows), tmp_path)
    assert f"The smallest RMSE of {quantity} in" in re.sub(r"<[^>]*>", "", page.read_text(encoding="utf-8"))


@pytest.mark.parametrize(("low", "high", "text"), [(0.01, 42.0, "14"), (13.5, 13.7, "13.6"), (0.001, 0.9, "0.16")])
def test_values_of_wide_intervals_keep_two_digits(low: float, high: float, text: str) -> None:
    points = [replace(one, value=float(text), ci_low=low, ci_high=high) for one in rows([{BASELINE: 1, NOISE: 0.1}])]
    heat, *_ = build_panels(Sweep([BASELINE, NOISE], ["cube"], ["mine"], points), "depth")
    assert build_chart(heat)["data"][0]["text"][0][0].split("<br>")[0] == text


def test_the_page_is_one_file_in_which_no_word_acts(tmp_path: Path) -> None:
    for found in (over_one(), over_two()):
        page = write_sweep_report(found, tmp_path, "scenetruth design sweep 'a b.yaml'")
        text = without_definitions(page.read_text(encoding="utf-8"))
        assert [path.name for path in tmp_path.iterdir()] == ["index.html"]
        assert HOSTILE not in text
        made = re.search(r"^const charts = (.*);$", text, re.MULTILINE)
        assert made is not None
        charts = json.loads(made[1])
        assert set(charts) == {"depth|rmse|interior", "depth|bias|interior"}
        # Nothing is fetched: addresses of plotly's own code are in its script alone.
        outside = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
        assert not re.search(r'(src|href)="(?!#)', outside)
        assert "design sweep &#39;a b.yaml&#39;" in outside
    assert "cube at 3: why" in outside
    # Every point, with its bound; figures of single seeds are in the table of results alone.
    lines = [re.findall(r"<td[^>]*>(.*?)</td>", line) for line in re.findall(r"<tr>(.*?)</tr>", outside)]
    assert ["4", "0.02", "cube", "mine", "Depth", "6.0", "4.8 to 7.2"] in [line[:7] for line in lines]
    assert "77" not in re.sub(r"<style>.*?</style>", "", outside, flags=re.DOTALL)


def test_pictures_are_drawn_of_every_quantity(tmp_path: Path) -> None:
    made = write_static_plots(over_two(), tmp_path / "plots")
    assert [path.name for path in made] == ["depth_rmse.png"]
    with Image.open(made[0]) as picture:
        assert picture.info["Software"] == "scenetruth"
        width, height = picture.size
        assert width > height > 300
        # The cells of the map have the colours of their numbers: the largest is yellow, the least is blue.
        colours = {pixel for _, pixel in picture.convert("RGB").getcolors(1 << 24) or []}
        assert {(253, 231, 36), (68, 1, 84)} <= colours
    # Pictures of an earlier sweep go, and what is not ours stays.
    (tmp_path / "plots" / "flow_x_rmse.png").write_bytes(b"old")
    (tmp_path / "plots" / "mine.txt").write_text("mine")
    write_static_plots(over_one(), tmp_path / "plots")
    assert {path.name for path in (tmp_path / "plots").iterdir()} == {"depth_rmse.png", "mine.txt"}
