"""The page is complete, stands alone, and quotes what it is given."""

from __future__ import annotations

import base64
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenetruth.cli.console import print_score
from scenetruth.errors import ScoreError
from scenetruth.number_format import format_measured, format_number, format_percent_value
from scenetruth.schema import STATUS_VALID
from scenetruth.scoring import COMMON_STATISTICS, FIGURES, QUANTITIES, Score, plot_all, score, write_report
from scenetruth.scoring.report import build_score_content, describe_maps, summarise_estimate
from scenetruth.strain import report_good_practice
from tests.helpers.nightly import NIGHTLY, nightly
from tests.helpers.page_words import without_definitions
from tests.helpers.synthetic_case import HELD, OF_ERRORS, Case, make_case, make_growing_case, with_outliers

ONE = ("image",)
"""The picture that is drawn where the page is looked at, and not its pictures."""
REASON = "pyrender (osmesa) does not run here"
METADATA = {
    "versions": {"scenetruth": "0.1.0"},
    "scene_hash": "0123abcd",
    "seed": 77,
    "timings_s": {"simulate": 12.5},
    "render_fallback_reason": REASON,
    "recording_hash": "feed0001",
    "estimate_hash": "feed0002",
    "warnings": ["the texture is <b>coarse</b>"],
}


@nightly
def test_errors_in_common_have_a_table_where_they_are_stated(
    full_case: Case, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case, values = full_case, dict[str, tuple[str, str, Score]]()
    common = case.estimate.assign(depth_std_common=case.estimate["depth_std"] / 2)
    for name, estimate in (("without", case.estimate), ("with", common)):
        found = score(estimate, case.truth)
        page = write_report(
            estimate, case.truth, case.recording, score=found, output=tmp_path / name, figures=ONE
        ).read_text()  # fmt: skip
        print_score(found)
        printed = capsys.readouterr().out
        assert ('id="common-errors"' in page) == ("times the stated standard deviation of the mean" in printed)
        values[name] = page, printed, found
    assert 'id="common-errors"' not in values["without"][0]
    page, printed, found = values["with"]
    for statistic in COMMON_STATISTICS:
        number = found.regions["interior"]["depth"][statistic]
        assert number is not None
        assert f">{format_number(number)}<" in page
        assert f"{number:.3g}" in printed


class Reader(HTMLParser):
    """Collects the text that is read and the attributes of a page, and checks that its tags are closed in order."""

    EMPTY = frozenset({"meta", "img", "br", "input"})

    def __init__(self) -> None:
        super().__init__()
        self.text: list[str] = []
        self.attributes: list[tuple[str, str, str | None]] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += [(tag, name, value) for name, value in attrs]
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"script", "style"} & {*self.open}:
            self.text.append(data)


@pytest.fixture(scope="module")
def page(small_case: Case, tmp_path_factory: pytest.TempPathFactory) -> Path:
    case = small_case
    recording = case.recording.assign_attrs(scene=json.dumps({"description": "a wedge", "note": "</pre><script>"}))
    result = score(case.estimate, case.truth, metadata=METADATA)
    return write_report(
        case.estimate, case.truth, recording, score=result, output=tmp_path_factory.mktemp("report") / "run"
    )


@pytest.fixture(scope="module")
def reader(page: Path) -> Reader:
    reader = Reader()
    reader.feed(without_definitions(page.read_text(encoding="utf-8")))
    reader.close()
    assert not reader.open
    return reader


def test_report_and_figures_are_in_the_folder(page: Path) -> None:
    assert page.name == "report.html"
    assert sorted(path.name for path in page.parent.iterdir()) == ["figures", "report.html"]
    assert len(list((page.parent / "figures").glob("*.png"))) == 9


def test_same_input_draws_the_same_bytes(page: Path, small_case: Case, tmp_path: Path) -> None:
    case, result = small_case, score(small_case.estimate, small_case.truth)
    names = None if NIGHTLY else ["surface", "coherence"]
    figures = plot_all(case.recording, case.estimate, case.truth, result, tmp_path, names=names)
    assert len(figures) == (9 if NIGHTLY else 2)
    for figure in figures:
        assert (page.parent / "figures" / figure.file).read_bytes() == (tmp_path / figure.file).read_bytes()


def test_page_needs_nothing_from_outside(page: Path, reader: Reader) -> None:
    text = re.sub(r"data:image/png;base64,[A-Za-z0-9+/=]+", "", page.read_text(encoding="utf-8"))
    # Packed maps and scripts are long words of letters, digits, / and +.
    text = re.sub(r"[A-Za-z0-9+/=]{200,}", "", text)
    assert not re.search(r"https?:|//[a-z]|url\(|@import|fetch\(|import\(", text)
    assert not {"link", "iframe"} & {tag for tag, _, _ in reader.attributes}
    # What scripts load has an address, and what the page says cannot begin a script.
    assert not [value for tag, name, value in reader.attributes if tag == "script" and name == "src"]
    assert text.count("<script") == text.count("</script>") == 4


def test_figures_are_inside(page: Path, reader: Reader) -> None:
    every = [value for tag, name, value in reader.attributes if (tag, name) == ("img", "src")]
    # The first two show the largest errors of depth and motion: with gap and enlargement, no more than this.
    hotspots, sources = every[:2], every[2:]
    for source in hotspots:
        with Image.open(io.BytesIO(base64.b64decode(str(source).removeprefix("data:image/png;base64,")))) as shown:
            assert shown.size[0] <= 2 * 65 * 3 + 6
    files = [
        page.parent / "figures" / f"{name}.png" for name in FIGURES if name not in ("flow", "disparity", "growth_rate")
    ]
    assert len(sources) == len(files) == 9
    for source, file in zip(sources, files, strict=True):
        inside = Image.open(io.BytesIO(base64.b64decode(str(source).removeprefix("data:image/png;base64,"))))
        with Image.open(file) as drawn:
            assert inside.size == drawn.size
            # 256 colours: nearly the same to the eye.
            difference = np.abs(np.asarray(inside.convert("RGB"), float) - np.asarray(drawn.convert("RGB"), float))
        assert difference.mean() < 4
    text = " ".join(reader.text)
    titles = [str(value) for tag, name, value in reader.attributes if (tag, name) == ("img", "alt")]
    assert len(titles) == 11
    assert all(title in text for title in titles[2:])


def test_every_quantity_is_in_the_tables_of_both_regions(reader: Reader) -> None:
    for name in HELD:
        assert reader.text.count(QUANTITIES[name].title) == 2
    assert reader.text.count("px/step") >= 2


def test_error_bars_are_in_the_tables_of_both_regions(small_case: Case, reader: Reader) -> None:
    assert reader.text.count("stated std") == reader.text.count("RMS of z") - 1 == 2
    regions = score(small_case.estimate, small_case.truth).regions
    for values in (regions["all"], regions["interior"]):
        assert format_number(values["depth"]["rms_z"]) in reader.text
        assert format_percent_value(values["depth"]["coverage_2_std"]) in reader.text


def test_origin_and_warnings_are_told_and_quoted(page: Path, reader: Reader) -> None:
    text = " ".join(reader.text)
    needles = ("0123abcd", "recording hash", "feed0001", "estimate hash", "feed0002", "scenetruth 0.1.0", "77")
    for needle in (*needles, "simulate 12.5", REASON, "the texture is <b>coarse</b>"):
        assert needle in text
    assert "Estimate against truth: a wedge" in text
    assert "<b>coarse" not in page.read_text(encoding="utf-8")


def test_data_from_elsewhere_have_a_report_too(tmp_path: Path) -> None:
    case = make_case(32, 24, 250.0)
    estimate = case.estimate[["disparity"]]
    # Without a score, it is made.
    text = write_report(estimate, case.truth, case.recording, output=tmp_path, figures=ONE).read_text(encoding="utf-8")
    assert "Full scene" not in text
    assert "<h1>Estimate against truth</h1>" in text
    assert format_number(score(estimate, case.truth).regions["all"]["disparity"]["rmse"]) in text


def read(page: Path) -> Reader:
    reader = Reader()
    reader.feed(without_definitions(page.read_text(encoding="utf-8")))
    reader.close()
    assert not reader.open
    return reader


@pytest.mark.parametrize(
    ("held", "titles", "cards"),
    [
        (("depth", "disparity"), ("Depth", "Disparity"), ("Depth, RMSE", "Disparity, RMSE")),
        (("flow",), ("Optical flow in x", "Optical flow in y"), ("Optical flow in x, RMSE",)),
    ],
)
def test_page_tells_what_the_estimate_holds(
    full_case: Case, held: tuple[str, ...], titles: tuple[str, ...], cards: tuple[str, ...], tmp_path: Path
) -> None:
    result = score(full_case.estimate[[*held]], full_case.truth)
    content = build_score_content(result)
    assert set(cards) <= {card["title"] for card in content["headlines"]}
    page = write_report(
        full_case.estimate[[*held]], full_case.truth, full_case.recording, score=result, output=tmp_path, figures=ONE
    )
    reader = read(page)
    for entry in QUANTITIES.values():
        assert reader.text.count(entry.title) == (2 if entry.title in titles else 0)
    # No error is an outlier here, and none could be: the page says why there are no rates.
    assert "the rate is not meaningful" in " ".join(reader.text)
    assert "Outliers" not in reader.text


def test_outliers_are_shown_where_they_say_something(full_case: Case) -> None:
    telling = build_score_content(score(with_outliers(full_case.estimate), full_case.truth))
    assert telling["outliers"]["headings"] == ["disparity", "optical flow", "scene flow"]
    assert "Scene flow outliers" in {card["title"] for card in telling["headlines"]}
    silent = build_score_content(score(full_case.estimate, full_case.truth))
    assert silent["outliers"] == {"headings": [], "rows": []}
    assert "Scene flow outliers" not in {card["title"] for card in silent["headlines"]}


@pytest.fixture(scope="module")
def page_without_truth(full_case: Case, tmp_path_factory: pytest.TempPathFactory) -> Path:
    recording = full_case.recording.assign_attrs(render_fallback_reason=REASON)
    # What all the others show and say without a truth: `test_without_truth_the_estimate_is_drawn_alone`.
    few = ("depth", "coherence", "error_histograms")
    return write_report(full_case.estimate, recording=recording, output=tmp_path_factory.mktemp("report"), figures=few)


def test_page_without_truth_says_so(page_without_truth: Path) -> None:
    reader = read(page_without_truth)
    text = " ".join(reader.text)
    assert "Estimate without truth" in text
    assert "No ground truth is available" in text
    assert REASON in text
    for needle in OF_ERRORS:
        assert needle not in text
    files = {path.name for path in (page_without_truth.parent / "figures").iterdir()}
    assert files == {"depth.png", "coherence.png"}


def test_page_without_truth_has_medians_and_densities(full_case: Case, page_without_truth: Path) -> None:
    reader = read(page_without_truth)
    text = " ".join(reader.text)
    found = describe_maps(full_case.estimate)
    assert list(found) == [*HELD[:-1]]
    cards = {one.title for one in summarise_estimate(found)}
    for name, summary in found.items():
        assert reader.text.count(summary.title) == 1, name
        assert (f"{summary.title}, median" in text) == (summary.title in cards)
        assert format_measured(summary.median, summary.median_std) in text
        assert format_percent_value(summary.density) in text


def test_growth_is_summarised_where_windows_hold_enough() -> None:
    growth = describe_maps(make_growing_case(80, 60, 620.0).estimate)["growth_rate"]
    assert growth.units == "%/h"
    # The leaf grows by 1 %/h at one end, and by 3 %/h at the other.
    assert growth.median == pytest.approx(2, abs=0.2)
    assert 0 < growth.density < 1


def test_summaries_are_those_of_the_known_pixels(full_case: Case) -> None:
    estimate = full_case.estimate
    known = estimate["depth"].values[estimate["status_disparity"].values == STATUS_VALID]
    depth = describe_maps(estimate)["depth"]
    assert (depth.title, depth.units, depth.count) == ("Depth", "mm", known.size)
    assert depth.median == np.median(known)
    assert (depth.low, depth.high) == tuple(np.percentile(known, [5, 95]))
    assert depth.density == known.size / estimate["depth"].size
    assert depth.median_std == np.median(
        estimate["depth_std"].values[estimate["status_disparity"].values == STATUS_VALID]
    )
    nothing = describe_maps(estimate[["flow"]] * np.nan)
    assert list(nothing) == ["flow_x", "flow_y"]
    assert (nothing["flow_x"].median, nothing["flow_x"].density, nothing["flow_x"].median_std) == (None, 0.0, None)


def test_regions_stand_beside_each_other(small_case: Case, reader: Reader) -> None:
    for region, values in score(small_case.estimate, small_case.truth).regions.items():
        # Regions have words; their names in files are among the definitions only.
        assert (region in reader.text) == (region in ("all", "interior", "nonoccluded", "occluded"))
        assert format_number(values["velocity_z"]["rmse"]) in reader.text
    assert "0 to 5 px from an edge" in reader.text
    assert not any("rowth" in text for text in reader.text)


def test_growth_of_what_moves_rigidly_is_not_shown(tmp_path: Path) -> None:
    case = make_growing_case(48, 36, 380.0)
    rounding = case.truth.assign(growth_rate=1e-17 * case.truth["growth_rate"] / case.truth["growth_rate"].max())
    # What growth follows from.
    estimate = case.estimate[["depth", "velocity"]]
    result = score(estimate, rounding, case.recording, settings={"growth_window_px": 4})
    assert result.regions["all"]["growth_rate"]["count"]
    assert not result.grows
    page = write_report(
        estimate, rounding, case.recording, score=result, output=tmp_path, figures=("image", "growth_rate")
    )
    assert "Growth rate" not in without_definitions(page.read_text(encoding="utf-8"))
    assert [path.name for path in (tmp_path / "figures").iterdir()] == ["image.png"]


def test_growth_is_reported_where_it_is_scored(tmp_path: Path) -> None:
    case = make_growing_case(48, 36, 380.0, velocity_noise=1e-4)
    result = score(case.estimate, case.truth, case.recording, settings={"growth_window_px": 6, "interior_margin_px": 3})
    page = write_report(
        case.estimate, case.truth, case.recording, score=result, output=tmp_path, figures=("image", "growth_rate")
    )
    reader = read(page)
    text = " ".join(reader.text)
    assert "Growth rate, windowed, RMSE" in text
    assert reader.text.count("Growth rate") == 2
    for name in ("growth_rate", "growth_rate_windowed"):
        for region in ("all", "interior"):
            assert format_number(result.regions[region][name]["rmse"]) in reader.text
    assert "Gaussian weights of 6 px" in text
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"image.png", "growth_rate.png"}


def test_fields_of_good_practice_have_a_table_where_they_are_given(tmp_path: Path) -> None:
    case = make_case(80, 60, 620.0)
    practice = report_good_practice(case.recording, case.estimate)
    parts = (case.estimate, case.truth, case.recording)
    page = write_report(*parts, output=tmp_path / "with", figures=ONE, good_practice=practice).read_text()
    table = re.search(r'<table class="stack" id="practice-table">.*?</table>', page, re.DOTALL)
    assert table is not None
    reader = Reader()
    reader.feed(without_definitions(table[0]))
    words = [word.strip() for word in reader.text if word.strip()]
    empty = [each for each in practice.fields if not each.is_stated]
    for each in empty:
        # Fields without data for the same reason have one row.
        places = [n for n, word in enumerate(words) if each.name.casefold() in word.casefold().split(", ")]
        assert [each.value, each.source] in [words[place + 1 : place + 3] for place in places], each.name
    assert len([word for word in words if word == "no strain computed"]) < 5 < len(empty)
    for each in practice.fields:
        if not each.is_stated:
            continue
        place = words.index(each.name)
        cells = [word for word in (each.name, each.value, each.unit, each.source) if word]
        assert words[place : place + len(cells)] == cells
    assert [word for word in words if word in ("Imaging", "Analysis", "Noise floor")] == [
        "Imaging",
        "Analysis",
        "Noise floor",
    ]
    assert 'id="practice-table"' not in write_report(*parts, output=tmp_path / "without", figures=ONE).read_text()
    for wrong in ({"Lens": "50 mm"}, score(case.estimate, case.truth)):
        with pytest.raises(ScoreError, match="good_practice: must be a GoodPracticeReport"):
            write_report(*parts, output=tmp_path / "wrong", figures=ONE, good_practice=wrong)  # type: ignore[arg-type]
