"""The cases of the suite: every scene is one, and is what its case says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from scenetruth.benchmark.benchmark_tasks import list_design_points
from scenetruth.benchmark.cases import SUITES, Case, GalleryCase, all_cases, select_cases
from scenetruth.benchmark.suite import select_available_cases
from scenetruth.errors import ArgumentError
from scenetruth.scene import Scene
from scenetruth.scoring import QUANTITIES
from scenetruth.scoring.regions import visible_throughout
from scenetruth.simulation import simulate
from tests.helpers.nightly import nightly

CASES = list(all_cases().values())


def truth_of(case: Case, value: float) -> xr.Dataset:
    whole = simulate(Scene.from_dict(case.scene(value)), truth_content=case.truth_content)[1]
    return whole.sel(t=0).assign(seen_throughout=(("y", "x"), visible_throughout(whole)))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.kind)
def test_every_case_says_what_it_is(case: Case) -> None:
    assert case.kind.isidentifier()
    assert case.question.endswith("?")
    assert set(case.quantities) <= set(QUANTITIES)
    assert case.headline[0] in {*case.quantities, "growth_rate_windowed"}
    assert case.values("full")
    assert set(case.core) <= set(case.values("full"))
    for suite in SUITES:
        assert case.values(suite) == tuple(sorted(case.values(suite)))
        for value in case.values(suite):
            Scene.from_dict(case.scene(value))


# The wall behind the cylinder is so far away that its texture is aliased, and the sheet is brighter than the full scale
# of its ideal sensor, which clips nothing, near the lamp of penumbrae; neither is measured.
@nightly
@pytest.mark.filterwarnings("ignore:objects. the texture of 'behind':scenetruth.SceneWarning")
@pytest.mark.filterwarnings("ignore:lighting. images reach a radiance of 1.4:scenetruth.SceneWarning")
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.kind)
def test_every_value_has_pixels_to_measure(case: Case) -> None:
    for point in list_design_points([case], "full"):
        truth = truth_of(case, point.values[0])
        for value in point.values:
            # Fewer tell nothing of a method's errors; a crest of the star is as narrow as its period is short.
            least = 0.15 * value**2 if case.kind == "star" else 150
            assert np.count_nonzero(case.region_at(truth, value)) > least, value


def test_steps_lie_where_the_truth_has_them() -> None:
    case = all_cases()["step_of_motion"]
    truth = truth_of(case, 1.5)
    speed = truth["flow"].values[1]
    step = np.abs(np.diff(speed, axis=1)) > 0.5
    assert step.any(axis=1).all()
    region = case.region_at(truth, 1.5)
    assert region.any(axis=1).sum() > 60
    # Two px at most on either side of the step.
    assert region.sum(axis=1).max() <= 6
    case = all_cases()["occlusion"]
    truth = truth_of(case, 0.0)
    hidden, seen = case.region_at(truth, 0.0), case.region_at(truth, 1.0)
    assert not (hidden & seen).any()
    assert np.count_nonzero(hidden) > 500


def test_unknown_cases_are_named() -> None:
    with pytest.raises(ArgumentError, match="no such case; available: blur, brightness"):
        select_cases(["noize", "blurr"])


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.kind)
def test_values_are_named_and_found_by_their_names(case: Case) -> None:
    values = case.values("full")
    labels = [case.get_label(value) for value in values]
    assert len(set(labels)) == len(values)
    assert [case.parse_level(label) for label in labels] == pytest.approx(values, rel=1e-5)
    with pytest.raises(ArgumentError, match="must be"):
        case.parse_level("nothing")


def test_every_scene_of_the_library_is_in_the_gallery() -> None:
    files = sorted(Path(__file__).parents[2].glob("scenes/*.yaml"))
    case = all_cases()["gallery"]
    assert [case.get_label(value) for value in case.values("full")] == [file.stem for file in files]
    assert case.values("core") == ()
    scene = case.scene(case.parse_level("finite_elements"))
    # Wherever the comparison runs, and the same bytes everywhere.
    assert Path(scene["objects"][0]["mesh"]["file"]).is_absolute()
    assert scene["render"]["backend"] == "raycast"


def test_what_cannot_be_measured_here_is_left_out_in_words(
    monkeypatch: pytest.MonkeyPatch, messages: list[str]
) -> None:
    assert [case.kind for case in select_available_cases("full", None, None)] == [case.kind for case in CASES]
    with pytest.raises(ArgumentError, match="no levels in the suite core"):
        select_available_cases("core", ["gallery"], None)
    monkeypatch.setattr(GalleryCase, "files", staticmethod(tuple))
    kinds = {case.kind for case in select_available_cases("full", None, None)}
    assert kinds == {case.kind for case in CASES} - {"gallery"}
    assert messages == [
        "case gallery is skipped: it needs the folder scenes/, which only a checkout of the project has:"
        " run it from one"
    ]
    with pytest.raises(ArgumentError, match="needs the folder scenes/"):
        select_available_cases("full", ["gallery"], None)
