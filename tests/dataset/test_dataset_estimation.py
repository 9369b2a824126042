from __future__ import annotations

import copy
import json
import sys
from pathlib import Path

import numpy as np
import pytest

import scenetruth as st
from scenetruth.dataset.dataset_estimation import estimate_dataset
from scenetruth.dataset.generation import run_dataset
from scenetruth.dataset.recipe_loader import Recipe
from scenetruth.dataset.verification import verify_dataset
from scenetruth.errors import EstimateError
from tests.helpers.nightly import by_night, nightly
from tests.helpers.small_recipes import RECIPE, SCENE

FIVE_FRAMES = {**copy.deepcopy(SCENE), "frames": {"count": 5}}


@pytest.fixture(scope="module", params=["folder", *by_night("shards")])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("made") / request.param
    plain = {**copy.deepcopy(RECIPE), "base": FIVE_FRAMES, "samples": 2, "layout": request.param}
    run_dataset(Recipe.from_dict(plain), output=folder, workers=1)
    return folder


@pytest.mark.filterwarnings("ignore")
def test_scores_land_in_the_catalogue_and_are_those_of_the_method(made: Path) -> None:
    found = estimate_dataset(made, settings={"working_point_px": "auto", "tau": 1e-4}, workers=1)
    assert (found.made, found.present, found.failed) == (2, 0, [])
    dataset = st.open_dataset(made)
    column = dataset.catalogue["score.structure_tensor.all.depth.rmse"]
    for sample in dataset:
        estimate = st.estimate(sample.recording, working_point_px="auto", tau=1e-4)
        score = st.score(estimate, sample.truth, sample.recording)
        assert column[sample.number] == score.regions["all"]["depth"]["rmse"]
        if made.name == "folder":
            assert sample.estimate().attrs["estimate_hash"] == estimate.attrs["estimate_hash"]
    # What lay there before is as it was.
    assert verify_dataset(made, regenerate=0) == []


@pytest.mark.filterwarnings("ignore")
def test_what_has_a_score_is_not_estimated_again_nor_mixed_with_other_settings(made: Path) -> None:
    method = "plane_sweep"
    (first,) = [estimate_dataset(made, method, numbers=[0], workers=1)]
    assert (first.made, first.present) == (1, 0)
    again = estimate_dataset(made, method, workers=1)
    assert (again.made, again.present) == (1, 1)
    settings = json.loads((made / "scores" / method / "settings.json").read_text(encoding="utf-8"))
    assert settings == st.estimators.choose({"method": method}).settings.model_dump(mode="json")
    name, value = next((key, one) for key, one in settings.items() if isinstance(one, int | float) and one > 1)
    with pytest.raises(EstimateError, match="has scores with other settings"):
        estimate_dataset(made, method, settings={name: type(value)(value + 1)}, workers=1)


WALL = "def f(recording):\n    return {'depth': 0.0 * recording.image[0].values + DEPTH}\n"


@nightly
@pytest.mark.filterwarnings("ignore")
def test_a_method_that_is_mended_is_measured_again(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, messages: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def estimate(depth: str, numbers: list[int] | None = None) -> tuple[int, int, int]:
        (tmp_path / "wall_of_datasets.py").write_text(WALL.replace("DEPTH", depth))
        sys.modules.pop("wall_of_datasets", None)
        found = estimate_dataset(made, "wall_of_datasets:f", workers=1, numbers=numbers)
        return found.made, found.present, len(found.failed)

    def biases() -> list[float]:
        return list(st.open_dataset(made).catalogue["score.wall_of_datasets-f.all.depth.bias"])

    assert estimate("{}['nokey']") == (0, 0, 2)
    assert estimate("100") == (2, 0, 0)
    before = np.array(biases())
    assert estimate("100") == (0, 2, 0)
    messages.clear()
    assert estimate("120", [0]) == (1, 0, 0)
    assert messages == ["the code of 'wall_of_datasets:f' has changed: 2 scores of the former code are recomputed"]
    assert np.isnan(biases()).tolist() == [False, True], "no table mixes both"
    assert estimate("120") == (1, 1, 0)
    np.testing.assert_allclose(np.array(biases()) - before, 20, atol=1e-3)
    sys.modules.pop("wall_of_datasets")


def test_no_such_method_is_told_first(made: Path) -> None:
    with pytest.raises(EstimateError, match="structure_tnsor"):
        estimate_dataset(made, "structure_tnsor", workers=1)
