"""A design from its design specification to its answer."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

import scenetruth as st
from scenetruth.design.optimisation import (
    DesignResult,
    DesignSpec,
    PredictionInterval,
    evaluate_rig,
    optimise,
    prepare_problem,
    write_design_page,
)
from scenetruth.errors import DesignSpecError, MachineError, OutputExistsError, StoreError
from tests.helpers.nightly import NIGHTLY, nightly
from tests.helpers.small_specification import spec

SMALL = {"predictions": 120 if NIGHTLY else 60, "morris_trajectories": 1, "sobol": 0}
CONFIRMED = {"confirmation": {"rigs": 1, "seeds": 2, "max_size_px": 48}, "search": SMALL}
FEW = {"predictions": 16, "morris_trajectories": 0, "sobol": 0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("design") / "wall"


@pytest.fixture(scope="module")
def found(folder: Path) -> DesignResult:
    return optimise(spec(**CONFIRMED), output=folder, workers=1)


@nightly
def test_it_is_as_good_as_the_best_of_a_grid(found: DesignResult) -> None:
    best = found.recommended
    assert all(one.holds for one in best.constraints)
    assert best.parameters["optics.psf"] is None
    task = prepare_problem(DesignSpec.from_dict(spec())).task
    # The more baseline the better: with any number of positions, the best has all of the travel.
    for positions in (2, 3, 4, 5):
        values = {
            "stage.baseline_mm": min(16 / (positions - 1), 12.0),
            "stage.positions": positions,
            "optics.psf": None,
        }
        assert best.predicted["Depth"] <= 1.05 * evaluate_rig(task, values).predicted["Depth"]


def test_what_was_simulated_is_told_beside_the_prediction(found: DesignResult) -> None:
    told = found.recommended.simulated["Depth"]
    assert told.seeds == 2
    assert told.pi_low < told.value < told.pi_high
    (one,) = found.discrepancies
    assert one.rig == found.recommended.number
    assert one.simulated == found.recommended.simulated["Depth"]
    assert found.orders == ()
    # Wider than 48 px by the disparity between the outermost positions, 16 px at 16 mm.
    assert any(re.search("images cropped from 64 x 48 to 6[0-4] x 3[0-9] px", line) for line in found.assumptions)


@nightly
def test_more_recordings_are_simulated_while_a_target_is_undecided() -> None:
    def simulated(target: float | None, most: int | None = None) -> PredictionInterval:
        goal = {"objectives": [{"quantity": "depth", "target": target}], "search": FEW}
        few = {"confirmation": {**CONFIRMED["confirmation"], "most_seeds": most}}
        return optimise(spec(**{**goal, **few}), workers=1).recommended.simulated["Depth"]

    without = simulated(None, 3)
    assert without.seeds == 2
    # The recordings lie on both sides of such a target.
    assert simulated(without.value, 3).seeds == 3
    assert simulated(1e12 * without.value).seeds == 2


def test_the_answer_lies_in_its_folder(found: DesignResult, folder: Path) -> None:
    names = {path.name for path in folder.iterdir() if not path.name.startswith(".")}
    assert names >= {
        "specification.json",
        "design.json",
        "recommended.yaml",
        "recommended_preview.yaml",
        "pareto_front.csv",
        "evaluations.csv",
        "index.html",
    }
    scene = st.load_scene(folder / "recommended.yaml")
    assert scene == st.Scene.from_dict(dict(found.recommended.scene))
    assert scene.stage.baseline_mm == found.recommended.parameters["stage.baseline_mm"]
    assert "# A run of all images takes about " in (folder / "recommended.yaml").read_text()
    part = st.load_scene(folder / "recommended_preview.yaml")
    # As simulations had it: 48 px and the disparity, of 64.
    assert part.camera.width * part.camera.height < 0.8 * scene.camera.width * scene.camera.height
    assert part.stage == scene.stage
    assert (
        "# Differences from recommended.yaml: images cropped from 64 x 48"
        in (folder / "recommended_preview.yaml").read_text()
    )
    plain = json.loads((folder / "design.json").read_text())
    assert plain["recommended"] == found.recommended.number
    assert plain["summary"] == found.summary().splitlines()
    assert 20 <= len(found.screened) <= SMALL["predictions"]
    assert list(found.to_dataframe()["rig"]) == [rig.number for rig in found.rigs]
    # With one objective, the front is one rig.
    assert len(found.front) == 1
    assert found.to_dataframe()["front"].sum() == 1
    assert found.recommended in found.rigs


def test_a_design_is_loaded_as_it_was(found: DesignResult, folder: Path) -> None:
    again = DesignResult.load(folder)
    # The time of the page itself is not in what was written before it.
    assert {**again.to_dict(), "seconds": {}} == {**found.to_dict(), "seconds": {}}
    for name in ("title", "objectives", "rules", "assumptions", "discrepancies", "orders", "folder"):
        assert getattr(again, name) == getattr(found, name)
    assert again.recommended == found.recommended
    # NaN is no other NaN's equal.
    assert repr(again.sensitivities) == repr(found.sensitivities)
    assert again.summary() == found.summary()
    pd.testing.assert_frame_equal(again.screened, found.screened)
    page = (folder / "index.html").read_text(encoding="utf-8")
    assert write_design_page(again, folder).read_text(encoding="utf-8") == page


def test_folders_that_hold_no_design_are_refused(found: DesignResult, folder: Path, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"design\.json: is missing"):
        DesignResult.load(tmp_path)
    plain = found.to_dict()
    for name, told, message in (
        ("older", {**plain, "format": 1}, "has format 1 instead of 4"),
        ("cut", {"format": 4}, "is damaged \\(KeyError"),
        ("other", {**plain, "recommended": -1}, "is damaged \\(ValueError"),
        ("words", {**plain, "seconds": {"search": "long"}}, "is damaged \\(ValueError"),
        ("table", plain, r"evaluations\.csv: is missing"),
    ):
        place = tmp_path / name
        place.mkdir()
        (place / "design.json").write_text(json.dumps(told))
        with pytest.raises(StoreError, match=message):
            DesignResult.load(place)


def test_words(found: DesignResult) -> None:
    told = found.summary()
    assert f"recommended, rig {found.recommended.number}" in told
    assert "Depth: scaled median absolute error, predicted" in told
    assert "; RMSE " in told
    assert "an increase (decrease) of each parameter by 10 % changes depth by" in told


def test_ten_percent_more_baseline_is_ten_percent_less_noise(found: DesignResult) -> None:
    more = {one.parameter: one.ten_percent for one in found.sensitivities}
    # Depth's noise goes by 1 / d; registrations and windows change it by no more than a few percent.
    assert more["stage.baseline_mm"] == pytest.approx(1 / 1.1 - 1, abs=0.03)
    assert np.isnan(more["optics.psf"])
    less = {one.parameter: one.ten_percent_less for one in found.sensitivities}
    assert less["stage.baseline_mm"] == pytest.approx(1 / 0.9 - 1, abs=0.03)


@nightly
def test_what_was_killed_goes_on_to_the_same_end(found: DesignResult, folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    lines = (copy / "predictions.jsonl").read_text().splitlines(keepends=True)
    (copy / "predictions.jsonl").write_text("".join(lines[: len(lines) // 2]) + lines[-1][:20])
    for name in ("design.json", "index.html", "recommended.yaml"):
        (copy / name).unlink()
    again = optimise(spec(**CONFIRMED), output=copy, workers=1)
    assert again.screened.equals(found.screened)
    assert replace(again.recommended, scene={}) == replace(found.recommended, scene={})
    assert yaml.safe_load((copy / "recommended.yaml").read_text()) == yaml.safe_load(
        (folder / "recommended.yaml").read_text()
    )


def test_goals_that_cannot_be_met_say_why() -> None:
    limits = [{"kind": "stage_travel", "max": 0.5}, {"kind": "images", "max": 40}]
    with pytest.raises(DesignSpecError) as caught:
        optimise(spec(constraints=limits, search=FEW), workers=1)
    told = str(caught.value)
    assert "constraints.0: stage travel must be at most 0.5 mm; the nearest rig has " in told
    assert "it excludes all " in told
    assert "variables: the nearest of" in told
    assert "constraints.1" not in told
    # Each can be met, both together cannot: fewer images need fewer positions.
    limits = [{"kind": "stage_travel", "min": 20}, {"kind": "images", "max": 6}]
    with pytest.raises(DesignSpecError, match="satisfy it, but none of them all other constraints"):
        optimise(spec(constraints=limits, search=FEW), workers=1)


def test_folders_of_others_are_left_alone(folder: Path, found: DesignResult, tmp_path: Path) -> None:
    with pytest.raises(OutputExistsError, match="another scene, other constraints"):
        optimise(spec(constraints=[]), output=folder, workers=1)
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputExistsError, match="not a directory of a design"):
        optimise(spec(), output=tmp_path, workers=1)


def test_libraries_that_are_missing_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(MachineError, match=r"pip install 'scenetruth\[design\]'"):
        optimise(spec(), workers=1)
