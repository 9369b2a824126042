"""The results pages hold what their data say; a method gets its row as its page describes."""

from __future__ import annotations

import json
import math
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from benchmarks.results import __main__ as command
from benchmarks.results import jobs
from benchmarks.results.comparison import losses, relative_values, value_of, values
from benchmarks.results.contestants import BUILT_IN, CONTESTANTS, PROGRAM, submitted
from benchmarks.results.data import (
    COLUMNS,
    MethodData,
    read_methods_data,
    spelled,
    table_of,
    write_method_data,
)
from benchmarks.results.four_images import COLUMNS as FOUR_COLUMNS
from benchmarks.results.four_images import JOBS
from benchmarks.results.fragments import FRAGMENTS, Results
from benchmarks.results.jobs import Job, list_jobs, measure_jobs, result_key, stored_rows
from benchmarks.results.pages import PAGES, fragments_of, read_results, with_fragments, write_pages
from scenetruth import load_scene
from scenetruth.benchmark.cases import ALL, BOUND, METHOD_VALID, BenchmarkRecord, all_cases
from scenetruth.jobs.results import ResultStore
from tests.helpers.nightly import nightly

DOCS = Path(__file__).parents[2] / "docs"
HOW_TO = (DOCS / "how_to" / "compare_methods.md").read_text(encoding="utf-8").partition("## Add a row")[2]


def method(key: str, group: str, cells: list[tuple[Any, ...]]) -> MethodData:
    """Return a method of which (case, level, quantity, rmse, valid_percent) are known."""
    names = ["case", "level", "quantity", "rmse", "valid_percent"]
    table = pd.DataFrame(cells, columns=names).reindex(columns=list(COLUMNS))
    return MethodData(key, key, group, "4", "", "", "1", "2026-01-01", "a processor", 0.0, table=table)


def test_pages_hold_what_the_data_say() -> None:
    results = read_results(DOCS / "results")
    assert len(results.methods) >= len(CONTESTANTS)
    names: list[str] = []
    for name in PAGES:
        text = (DOCS / "results" / name).read_text(encoding="utf-8")
        names += fragments_of(text)
        assert with_fragments(text, results) == text, f"{name}: run `python -m benchmarks.results --pages`"
    assert set(FRAGMENTS) <= set(names)
    assert len(set(names)) == len(names)


def test_a_fragment_is_replaced_and_the_text_around_it_stays() -> None:
    page = "before\n<!-- results: one -->\nold\n\n<!-- end -->\nafter"
    results: Any = None
    made = with_fragments(page, results, {"one": lambda _: "new"})
    assert made == "before\n<!-- results: one -->\n\nnew\n\n<!-- end -->\nafter"
    # That of another program stays.
    assert with_fragments(page, results, {}) == page


def test_a_program_is_ahead_on_the_levels_that_it_has_and_with_half_of_the_pixels() -> None:
    own = method(
        "refined_4", BUILT_IN, [("slope", "30", "disparity", 0.1, 80.0), ("slope", "60", "disparity", 0.3, 80.0)]
    )
    # Better than the median 0.2 of both levels, but not where it has a result.
    easy = method(
        "easy", PROGRAM, [("slope", "30", "disparity", 0.15, 80.0), ("slope", "60", "disparity", math.nan, 0.0)]
    )
    few = method("few", PROGRAM, [("slope", "30", "disparity", 0.05, 39.0), ("slope", "60", "disparity", 0.05, 39.0)])
    good = method("good", PROGRAM, [("slope", "30", "disparity", 0.1, 41.0), ("slope", "60", "disparity", 0.2, 41.0)])
    found = losses([own, easy, few, good])
    rows = found[found["statistic"] == "rmse"]
    assert list(rows["program"]) == ["few", "good"]
    assert list(rows["counts"]) == [False, True]
    assert rows["refined_4_value"].tolist() == pytest.approx([0.2, 0.2])
    assert rows["ratio"].tolist() == pytest.approx([0.25, 0.75])


def test_steps_of_a_program_that_coincide_with_a_constant_truth_do_not_count() -> None:
    own = method("refined_4", BUILT_IN, [("slope", "30", "disparity", 0.1, 80.0)])
    steps = method("steps", PROGRAM, [("slope", "30", "disparity", 6e-16, 100.0)])
    good = method("good", PROGRAM, [("slope", "30", "disparity", 0.05, 80.0)])
    found = losses([own, steps, good]).query("statistic == 'rmse'")
    assert dict(zip(found["program"], found["counts"], strict=True)) == {"steps": False, "good": True}


def test_relative_values_are_those_of_medians_of_all_programs() -> None:
    own = method(
        "refined_4", BUILT_IN, [("slope", "30", "disparity", 0.1, 80.0), ("slope", "60", "disparity", 0.3, 80.0)]
    )
    worse = method("worse", PROGRAM, [("slope", "30", "disparity", 0.5, 40.0)])
    without = method("without", PROGRAM, [("slope", "30", "disparity", math.nan, 0.0)])
    (line,) = relative_values([own, worse, without]).to_dict("records")
    assert (line["program"], line["case"], line["statistic"]) == ("worse", "slope", "rmse")
    assert [line[name] for name in ("value", "refined_4_value", "ratio")] == pytest.approx([0.5, 0.2, 2.5])


def test_a_built_in_method_without_a_result_is_a_loss() -> None:
    own = method("refined_4", BUILT_IN, [("slope", "30", "disparity", math.nan, 0.0)])
    other = method("other", PROGRAM, [("slope", "30", "disparity", 0.4, 90.0)])
    (line,) = losses([own, other]).query("statistic == 'rmse'").to_dict("records")
    assert (line["program"], line["counts"], math.isnan(line["ratio"])) == ("other", True, True)
    # A few pixels are no result of the other program either.
    few = method("few", PROGRAM, [("slope", "30", "disparity", 0.1, 0.1)])
    assert not losses([own, few]).query("statistic == 'rmse'")["counts"].any()
    # One that was not measured yet is none.
    assert losses([replace(own, missing=("slope",)), other]).empty


def test_the_most_accurate_program_is_named_also_where_the_built_in_method_has_no_result() -> None:
    own = method("refined_4", BUILT_IN, [("slope", "30", "disparity", math.nan, 0.0)])
    whole = replace(own, key="refined", title="refined")
    programs = [
        method(f"program_{number}", PROGRAM, [("slope", "30", "disparity", error, 90.0)])
        for number, error in enumerate((0.4, 0.1, 0.3, 0.2))
    ]
    best = Results([own, whole, *programs], pd.DataFrame()).best_losses
    (line,) = best[best["statistic"] == "rmse"].to_dict("records")
    assert (line["program"], line["value"]) == ("program_1", 0.1)


def test_places_of_small_bars_are_named_once() -> None:
    cells = [("slope", "30", "disparity", 0.1, 80.0), ("slope", "60", "disparity", 0.1, 80.0)]
    cells += [("gallery", "cube", "disparity", 0.1, 80.0), ("gallery", "leaf", "disparity", 0.1, 80.0)]
    own = method("refined_4", BUILT_IN, cells)
    own.table["rms_z"], own.table["beyond_3_std_percent"] = 2.0, [5.0, 4.0, 3.0, 2.0]
    table = FRAGMENTS["error-bars"](Results([own, replace(own, key="refined")], pd.DataFrame()))
    assert "slope (5.0\N{NO-BREAK SPACE}%), cube (3.0\N{NO-BREAK SPACE}%), leaf (2.0\N{NO-BREAK SPACE}%)" in table


def test_results_are_of_the_code_of_the_methods_and_of_scenes_wherever_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (job,) = (one for one in list_jobs() if one.name == "gallery/finite_elements")
    (own,) = (one for one in CONTESTANTS if one.key == "structure_tensor")
    (program,) = (one for one in CONTESTANTS if one.key == "mudic")
    former = [result_key(job, one) for one in (own, program)]
    # The same files elsewhere.
    (point,) = job.points
    shutil.copytree(DOCS.parent / "scenes", tmp_path / "scenes")
    moved = json.loads(json.dumps(job.scene(point).to_dict()).replace(str(DOCS.parent), str(tmp_path)))
    assert moved != job.scene(point).to_dict()
    elsewhere = replace(job, name="elsewhere")
    monkeypatch.setattr(Job, "scene", lambda *_: load_scene(moved))
    assert [result_key(elsewhere, one) for one in (own, program)] == former
    # Another code of the built-in methods.
    monkeypatch.setattr(jobs, "estimators_hash", lambda: "another")
    assert result_key(job, own) != former[0]
    assert result_key(job, program) == former[1]


def test_missing_jobs_are_named_with_their_methods_and_counted() -> None:
    own = method("refined_4", BUILT_IN, [("slope", "30", "disparity", 0.1, 80.0)])
    whole, other = replace(own, key="refined", title="refined"), replace(own, key="other", title="other", group=PROGRAM)
    gaps = [
        replace(own, missing=("star", "blur")),
        replace(whole, missing=("star",)),
        replace(other, missing=("star",)),
    ]
    page = FRAGMENTS["not-measured"](Results(gaps, pd.DataFrame()))
    assert "| `star` | all 3 | 3 |" in page
    assert "| `blur` | refined_4 | 1 |" in page
    assert "jobs (4 in all)" in page
    assert FRAGMENTS["not-measured"](Results([own, whole, other], pd.DataFrame())) == "All jobs are measured."
    words = FRAGMENTS["summary"](Results(gaps, pd.DataFrame())).split("\n\n")
    assert words[0].startswith("With the same four images, at least one other program is more accurate")
    assert f"4 of {3 * len(list_jobs())} jobs" in words[-1]
    assert "not complete" not in FRAGMENTS["summary"](Results([own, whole, other], pd.DataFrame()))


def test_runs_on_four_images_that_are_not_measured_are_named() -> None:
    own = method("refined_4", BUILT_IN, [("slope", "30", "disparity", 0.1, 80.0)])
    empty = pd.DataFrame(columns=list(FOUR_COLUMNS))
    words = FRAGMENTS["star"](Results([own], empty))
    names = [name.partition(":")[0] for name, job in JOBS.items() if job.scene == "star"]
    assert words == f"Not measured yet ({len(names)} runs): {', '.join(names)}."
    line = {"job": "dis: star", "method": "opencv", "scene": "star", "options": "flow=dis", "quantity": "flow_y"}
    there = pd.DataFrame([line | {"cutoff_period_first": 70.0, "noise_std": 0.0056}], columns=list(FOUR_COLUMNS))
    table, words = FRAGMENTS["star"](Results([own], there)).split("\n\n")
    assert "| OpenCV, `flow=dis` | 70 | 0.0056 | 0.39 |" in table
    assert words == f"Not measured yet ({len(names) - 1} runs): {', '.join(name for name in names if name != 'dis')}."
    assert "refined default" in FRAGMENTS["cube"](Results([own], there))


def test_failures_are_explained_by_map_or_by_the_last_message() -> None:
    own = method("mine", PROGRAM, [("slope", "30", "disparity", 0.1, 80.0)])
    problems = (
        "3 problems with the estimate in method 'mine':\n  - depth_t+0.npy: contains only NaN: no valid pixel\n"
        "  - velocity_t+0.npy: contains only NaN: no valid pixel\n"
        "  - flow_t+0.npy: must be finite: 3 pixels are not; mark invalid pixels as NaN"
    )
    failures = {"star": problems, "gallery/leaf": problems, "penumbra": "iterations: 200\nmore"}
    page = FRAGMENTS["made"](Results([replace(own, failures=failures)], pd.DataFrame()))
    assert (
        "- mine: `star`, `gallery/leaf`: depth, velocity: no valid pixel; flow: must be finite: 3 pixels are not; "
        in page
    )
    assert page.endswith("`penumbra`: the program ended with the message “iterations: 200”")


def test_costs_that_are_not_measured_say_so() -> None:
    own = method("refined_4", BUILT_IN, [("slope", "30", "disparity", 0.1, 80.0)])
    methods = [own, replace(own, key="refined", cost={"processor_s": 3.0, "memory_mb": 400.0})]
    methods += [replace(own, key="quick", title="quick", group=PROGRAM, cost={"processor_s": 1.0, "memory_mb": 500.0})]
    methods += [replace(own, key="late", title="late", group=PROGRAM)]
    time, memory = FRAGMENTS["cost"](Results(methods, pd.DataFrame())).splitlines()
    assert time == "- **Time**: `refined` with 4 images: not measured yet, with all: 3.0 s. Not measured yet: late."
    methods[0] = replace(own, cost={"processor_s": 2.0, "memory_mb": 450.0})
    time, memory = FRAGMENTS["cost"](Results(methods, pd.DataFrame())).splitlines()
    assert "2.0 s, with all: 3.0 s. Less: quick (1.0 s). Not measured yet: late." in time
    assert "Less: none." in memory


def test_records_become_one_line_for_each_level_and_quantity() -> None:
    def row(statistic: str, value: float, **more: Any) -> BenchmarkRecord:
        given = {"pixels": METHOD_VALID, "unit": "px", "method": "mine"} | more
        return BenchmarkRecord("noise", 0.005, quantity="disparity", statistic=statistic, value=value, **given)

    records = [
        row("rmse", 0.25, ci_low=0.2, ci_high=0.3),
        row("rmse", 9.0, pixels="common_valid"),
        row("density", 0.8, unit="1"),
        row("inlier_rate", 0.7, pixels=ALL, unit="1"),
        row("coverage", 0.5, threshold=1.0, unit="1"),
        row("coverage", 0.99, threshold=3.0, unit="1"),
        row("noise_std", 0.01, method=BOUND),
        BenchmarkRecord("noise", 0.005, "mine", "", METHOD_VALID, "seconds", 3.0),
    ]
    (line,) = table_of(records).to_dict("records")
    wanted = {"level": "0.005", "unit": "px", "rmse": 0.25, "rmse_ci_low": 0.2, "bound_std": 0.01}
    assert {name: line[name] for name in wanted} == wanted
    assert line["valid_percent"] == pytest.approx(80)
    assert line["bad_percent"] == pytest.approx(30)
    assert line["beyond_3_std_percent"] == pytest.approx(1)


def test_data_are_read_as_written(tmp_path: Path) -> None:
    one = method(
        "mine", PROGRAM, [("gallery", "leaf", "disparity", 0.123456, 50.0), ("star", "", "flow_y", math.inf, 1.0)]
    )
    write_method_data(tmp_path, one)
    (again,) = read_methods_data(tmp_path)
    assert again == one
    assert again.table["level"].tolist() == ["leaf", ""]
    assert again.table["rmse"].tolist() == [0.1235, math.inf]
    (value,) = (one for one in values([again]) if one.scene == "leaf")
    assert value_of(again, value) == (0.1235, 50.0)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.012345, "0.012"),
        (1.0, "1.0"),
        (123.0, "120"),
        (0.00012, "1.2e-4"),
        (0.0, "0.0"),
        (math.inf, "∞"),
        (math.nan, "–"),
    ],
)
def test_numbers_have_two_digits(value: float, words: str) -> None:
    assert spelled(value) == words


def test_every_case_has_a_job_with_levels() -> None:
    jobs = list_jobs()
    assert {job.case.kind for job in jobs} == {kind for kind, case in all_cases().items() if not case.lacks()}
    assert len({job.name for job in jobs}) == len(jobs)
    assert all(job.points for job in jobs)


def test_all_levels_and_noise_realisations_of_the_suite_are_measured() -> None:
    levels: dict[str, list[float]] = {}
    for job in list_jobs():
        levels.setdefault(job.case.kind, []).extend(level for point in job.points for level in point.values)
        assert all(point.seeds == tuple(range(job.case.seeds["full"])) for point in job.points)
    assert levels == {kind: list(all_cases()[kind].values("full")) for kind in levels}


def test_failures_are_those_of_levels(tmp_path: Path) -> None:
    one = submitted(f"mine={__name__}:quarter")
    tiny, whole = list_jobs(["star", "phase_of_flow"])
    assert (len(tiny.points) > 1) != (len(whole.points) > 1)
    store = ResultStore(tmp_path / "jobs" / one.key, "")
    for job in (tiny, whole):
        plain = dict.fromkeys(("date", "machine", "version"), "") | {"processor_s": 1.0, "rows": []}
        store.write(job.name, result_key(job, one), plain | {"failures": {job.points[0].name: "none"}})
    _, failures, missing, _ = stored_rows([tiny, whole], one, tmp_path)
    assert (sorted(failures), missing) == (["phase_of_flow/0", "star"], [])


@pytest.mark.parametrize(("left", "again"), [("error.txt", 0), ("maps.npy", 0), ("", 1)])
def test_a_program_that_ended_is_not_run_again_and_one_that_did_not_start_is(
    left: str, again: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(_: Any, pairs: list[list[str]], __: Path) -> None:
        runs.append(len(pairs))
        for number, (_, output) in enumerate(pairs):
            # The last recording alone has nothing if the program did not start.
            file = Path(output) / "further" / (left if left and number == len(pairs) - 1 else "maps.npy")
            if left or number < len(pairs) - 1:
                file.parent.mkdir()
                file.write_text("Traceback\nValueError: too dark\n", encoding="utf-8")

    (job,) = list_jobs(["noise"], ["0.005"])
    image = xr.DataArray(np.full((1, 1, 4, 4), 0.5, np.float32), dims=("s", "t", "y", "x"))
    measured = SimpleNamespace(rows=[], failures={"mudic": "no valid pixel"})
    monkeypatch.setattr(Job, "simulate", lambda *_: (xr.Dataset({"image": image}), xr.Dataset()))
    monkeypatch.setattr(jobs, "write_recording", lambda recording, source, _: source.mkdir(parents=True))
    monkeypatch.setattr(jobs, "recording_key", lambda recording: str(recording["image"].values.sum()))
    monkeypatch.setattr(jobs, "measure", lambda *_, **__: measured)
    monkeypatch.setattr(jobs, "run_batch", run)
    (one,) = (one for one in CONTESTANTS if one.key == "mudic")
    runs: list[int] = []
    for _ in range(2):
        list(measure_jobs([job], [one], tmp_path, tmp_path))
    assert runs == [8] * (1 + again)
    _, failures, *_ = stored_rows([job], one, tmp_path)
    assert failures == {"noise": "ValueError: too dark" if left == "error.txt" else "no valid pixel"}


def _tiny() -> list[Job]:
    return list_jobs(["phase_of_flow"], ["0.25"])


def commands_of_page() -> list[list[str]]:
    """Return the arguments of the commands of the page."""
    found = [
        shlex.split(line) for line in re.findall(r"^    (python -m benchmarks\.results .*)$", HOW_TO, re.MULTILINE)
    ]
    return [words[3:] for words in found]


def test_stored_results_become_data_without_a_measurement(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: Any, **__: Any) -> Any:
        raise AssertionError("something is measured")

    jobs = _tiny()
    monkeypatch.setattr(command, "list_jobs", lambda *given: jobs)
    for name in ("measure_jobs", "cost_of", "make_environment", "measure_four_images"):
        monkeypatch.setattr(command, name, refuse)
    monkeypatch.setattr(command, "write_pages", lambda docs: [docs / "index.md"])
    (tmp_path / "docs").mkdir()
    for page in PAGES:
        (tmp_path / "docs" / page).touch()
    command.main(["--stored", "--folder", str(tmp_path / "out"), "--docs", str(tmp_path / "docs")])
    found = read_methods_data(tmp_path / "docs" / "data" / "methods")
    assert [one.key for one in found] == [one.key for one in CONTESTANTS]
    assert all(one.missing == tuple(job.name for job in jobs) and not one.cost for one in found)
    assert (tmp_path / "docs" / "data" / "four_images.csv").read_text().startswith("job,method,")
    assert "index.md" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "problems"),
    [
        ("--case moon --level 1", ["--case: must be one of", "'moon'"]),
        ("--case phase_of_flow --level half", ["must be a number", "'half'"]),
        ("--level 0.25", ["--level: needs --case"]),
        ("--method moon", ["--method: must be one of refined,", "'moon'"]),
        ("--add mine=refined --method mine", ["--method: must not be given with --add"]),
        ("--add sun_dic=refined --case star", ["--add: must have a label of its own", "'sun_dic'"]),
        ("--docs /nowhere --pages", ["--docs: has no index.md", "'/nowhere'", "checkout"]),
    ],
)
def test_wrong_arguments_are_rejected_before_anything_is_measured(
    words: str, problems: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("measure_jobs", "make_environment", "write_pages"):
        monkeypatch.delattr(command, name)
    with pytest.raises(SystemExit) as caught:
        command.main(words.split())
    assert all(problem in str(caught.value) for problem in problems), caught.value


@nightly
def test_the_page_on_adding_a_row_is_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", HOW_TO, re.DOTALL)
    (tmp_path / "standstill.py").write_text(code, encoding="utf-8")
    docs = tmp_path / "docs"
    for file in [*(DOCS / "results").glob("*.md"), *(DOCS / "results" / "data").rglob("*.*")]:
        place = docs / file.relative_to(DOCS / "results")
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(file.read_bytes())
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{Path.cwd()}")
    places = ["--folder", str(tmp_path / "out"), "--docs", str(docs)]
    trial, whole = commands_of_page()
    command.main([*trial, *places])
    # Where everything moves by a quarter of a pixel, standstill is wrong by that.
    assert re.search(r"phase_of_flow +0\.25 +flow_x +px/frame +0\.25 ", capsys.readouterr().out)
    assert not (docs / "data" / "methods" / "standstill.csv").exists()

    monkeypatch.setattr(command, "list_jobs", lambda *given: _tiny())
    monkeypatch.setattr(command, "cost_of", lambda *given: {"processor_s": 1.0, "memory_mb": 2.0})
    command.main([*whole, *places])
    (added,) = [one for one in read_methods_data(docs / "data" / "methods") if one.key == "standstill"]
    assert (added.version, added.link) == ("1.0", "https://example.org/standstill")
    (line,) = added.table.query("quantity == 'flow_x'").to_dict("records")
    assert line["rmse"] == pytest.approx(0.25, rel=1e-3)
    page = (docs / "index.md").read_text(encoding="utf-8")
    assert "[standstill](https://example.org/standstill)" in page
    assert "standstill<br>1.0" in page


@nightly
def test_what_is_there_is_not_measured_again(tmp_path: Path) -> None:
    one, peers = submitted(f"mine={__name__}:quarter"), tmp_path / "none"
    assert [job for job, *_ in measure_jobs(_tiny(), [one], tmp_path, peers)] == ["phase_of_flow"]
    assert list(measure_jobs(_tiny(), [one], tmp_path, peers)) == []
    rows, failures, missing, _ = stored_rows(_tiny(), one, tmp_path)
    assert (failures, missing) == ({}, [])
    (error,) = (row.value for row in rows if row.quantity == "flow_x" and row.statistic == "rmse")
    assert error == pytest.approx(0, abs=1e-3)
    assert [job for job, *_ in measure_jobs(_tiny(), [one], tmp_path, peers, fresh=True)] == ["phase_of_flow"]


def quarter(recording: Any) -> dict[str, Any]:
    """Return a flow of a quarter of a pixel to the right."""
    shape = (1, recording.sizes["y"], recording.sizes["x"])
    return {"t": [0], "flow": np.stack([np.full(shape, 0.25), np.zeros(shape)])}


@nightly
def test_pages_are_written_from_data_alone(tmp_path: Path) -> None:
    for file in [*(DOCS / "results").glob("*.md"), *(DOCS / "results" / "data" / "methods").glob("*")]:
        place = tmp_path / file.relative_to(DOCS / "results")
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(file.read_bytes())
    write_pages(tmp_path)
    assert (tmp_path / "data" / "resolution.svg").read_text(encoding="utf-8").lstrip().startswith("<?xml")
    assert len(pd.read_csv(tmp_path / "data" / "overview.csv")) == len(read_methods_data(tmp_path / "data" / "methods"))
