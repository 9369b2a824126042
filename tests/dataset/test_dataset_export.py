from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest

import scenetruth as st
from scenetruth.dataset.dataset_export import export_dataset
from scenetruth.dataset.generation import run_dataset
from scenetruth.dataset.recipe_loader import Recipe
from scenetruth.errors import ExportError, Problem, StoreError
from scenetruth.pipeline import export_run
from tests.helpers.small_recipes import RECIPE


@pytest.fixture(scope="module", params=["folder", "shards"])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("made") / request.param
    plain = {**copy.deepcopy(RECIPE), "samples": 3, "layout": request.param, "samples_per_shard": 2}
    run_dataset(Recipe.from_dict(plain), output=folder, workers=1)
    return folder


def test_every_sample_has_a_folder_and_is_written_once(made: Path, tmp_path: Path) -> None:
    first = export_dataset(made, tmp_path / "npz", "npz", numbers=[1], workers=1)
    again = export_dataset(made, tmp_path / "npz", "npz", workers=1)
    assert (first.done, again.done, again.present, again.failed) == (1, 2, 1, {})
    for sample in st.open_dataset(made):
        (file,) = (tmp_path / "npz" / f"{sample.number:08d}").glob("*truth*.npz")
        with np.load(file) as written:
            assert np.array_equal(written["depth"], sample.truth["depth"].values, equal_nan=True)


def test_what_cannot_be_is_told_first(made: Path, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="nzp"):
        export_dataset(made, tmp_path / "new", "nzp", workers=1)
    with pytest.raises(StoreError, match="inside the data set"):
        export_dataset(made, made / "new", "npz", workers=1)


def test_what_no_sample_has_is_told_before_any_work(made: Path, tmp_path: Path, messages: list[str]) -> None:
    """A truth of standard content has no finite flow."""
    with pytest.raises(ExportError, match=r"every sample.*\n.*flow_next: is missing") as caught:
        export_dataset(made, tmp_path / "flo", "flo", workers=1)
    assert len(caught.value.problems) == 1
    assert messages == []
    assert not (tmp_path / "flo").exists()


def test_what_one_sample_lacks_keeps_no_other(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse_last(folder: object, target: Path, *rest: object, **options: object) -> object:
        if target.name == "00000002":
            raise ExportError([Problem("depth", "is too far for this format")])
        return export_run(folder, target, *rest, **options)  # type: ignore[arg-type]

    monkeypatch.setattr("scenetruth.dataset.dataset_export.export_run", refuse_last)
    found = export_dataset(made, tmp_path / "npz", "npz", numbers=[2, 0], workers=1)
    assert (found.done, found.present, sorted(found.failed)) == (1, 0, [2])
    assert "too far" in found.failed[2]
