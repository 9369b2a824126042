"""Verification of data sets: every change of a value is found, and the catalogue is rebuilt from the samples."""

from __future__ import annotations

import copy
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import scenetruth as st
from scenetruth.cli.app import app
from scenetruth.dataset.fingerprint import begin_dataset
from scenetruth.dataset.generation import read_status
from scenetruth.dataset.layout import DatasetFolder
from scenetruth.dataset.recipe_loader import Recipe
from scenetruth.dataset.verification import VerificationFailure, rebuild_catalogue, verify_dataset
from scenetruth.errors import StoreError
from tests.helpers.flipped_bits import flipped_bit, read_everything, select_bits
from tests.helpers.nightly import by_night, nightly
from tests.helpers.small_recipes import RECIPE, SCENE
from tests.helpers.undrawn_figures import leave_undrawn

# Cards are drawn in `tests.dataset.pages`.
pytestmark = pytest.mark.usefixtures("undrawn_figures")

DEPTH = "objects.1.pose.position_mm.2"


def recipe(**changes: Any) -> Recipe:
    base = {**copy.deepcopy(SCENE), "frames": {"count": 5}}
    return Recipe.from_dict({**copy.deepcopy(RECIPE), "base": base, "samples": 2, "licence": "CC0-1.0", **changes})


@pytest.fixture(scope="module", params=[*by_night("folder"), "shards", "interrupted"])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set with scores and card; or one that is incomplete, with parts of a catalogue and a failed sample."""
    folder: Path = tmp_path_factory.mktemp("made") / request.param
    if request.param == "interrupted":
        depths = {DEPTH: {"kind": "sequence", "values": [100, -50]}}
        st.run_dataset(recipe(distributions=depths), output=folder, retries=0)
        return folder
    st.run_dataset(recipe(layout=request.param, samples_per_shard=2), output=folder)
    st.estimate_dataset(folder)
    with pytest.MonkeyPatch.context() as monkeypatch:
        leave_undrawn(monkeypatch)
        st.write_card(folder)
    return folder


def check_flips(folder: Path, count: int, seed: int) -> dict[str, int]:
    """Return the number of flips that are found, and of those that change no value."""
    before, known = read_everything(folder), set(verify_dataset(folder, regenerate=0))
    counts = {"found": 0, "without effect": 0}
    for file, place in select_bits(folder, count, seed):
        with flipped_bit(file, place):
            try:
                found = set(verify_dataset(folder, regenerate=0)) != known
            except StoreError:
                found = True
            if not found:
                assert read_everything(folder) == before, (file, place)
            counts["found" if found else "without effect"] += 1
    return counts


@pytest.mark.filterwarnings("ignore")
def test_every_flipped_bit_that_changes_a_value_is_found(made: Path) -> None:
    counts = check_flips(made, 6, 1)
    assert counts["found"] > 4


@nightly
@pytest.mark.filterwarnings("ignore")
def test_every_one_of_a_thousand_flipped_bits_is_found(made: Path) -> None:
    assert check_flips(made, 1000, 2)["found"] > 700


def test_records_and_catalogue_are_under_checksums(made: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(made, folder)
    places = DatasetFolder(folder)
    known = verify_dataset(folder, regenerate=0)
    assert [one.number for one in known] == ([1] if made.name == "interrupted" else [])
    (catalogue,) = [places.catalogue] if places.catalogue.exists() else sorted(places.parts.glob("*.parquet"))
    former = catalogue.read_bytes()
    catalogue.write_bytes(former + b" ")
    found = [one for one in verify_dataset(folder, regenerate=0) if one not in known]
    assert [one.name for one in found] == [catalogue.relative_to(folder).as_posix()]
    assert "scenetruth dataset catalogue" in found[0].problem
    with pytest.raises(StoreError, match="does not match its checksum"):
        st.open_dataset(folder)
    catalogue.write_bytes(former)
    if made.name == "shards":
        return
    record = places.sample(0) / "sample.json"
    plain = json.loads(record.read_text(encoding="utf-8"))
    plain["statistics"]["depth_min_mm"] += 1
    for text in ("", json.dumps(plain)):
        record.write_text(text, encoding="utf-8")
        (problem,) = [one.problem for one in verify_dataset(folder, regenerate=0) if one.number == 0]
        assert problem.startswith("sample.json is damaged")
        with pytest.raises(StoreError, match=r"sample 0: sample\.json is damaged"):
            rebuild_catalogue(folder)
    assert catalogue.read_bytes() == former


@pytest.mark.parametrize("name", ["score.json", "score.csv"])
def test_scores_in_the_directories_of_samples_are_under_checksums(made: Path, tmp_path: Path, name: str) -> None:
    if made.name != "folder":
        pytest.skip("of the other layouts")
    folder = tmp_path / "copy"
    shutil.copytree(made, folder)
    assert verify_dataset(folder, regenerate=0) == []
    file = DatasetFolder(folder).sample(1) / name
    former = file.read_bytes()
    digit = next(place for place in range(len(former) - 1, 0, -1) if former[place : place + 1] in b"12345678")
    file.write_bytes(former[:digit] + b"9" + former[digit + 1 :])
    (found,) = verify_dataset(folder, regenerate=0)
    assert (found.number, found.problem.partition(" ")[0]) == (1, name)
    file.unlink()
    assert [one.problem.partition(":")[0] for one in verify_dataset(folder, regenerate=0)] == [f"{name} cannot be read"]
    file.write_bytes(former)
    file.with_suffix(".sha256").unlink()
    assert {one.number for one in verify_dataset(folder, regenerate=0)} == {1}
    (record,) = folder.glob("scores/*/00000/00000001.json")
    record.unlink()
    st.estimate_dataset(folder)
    assert verify_dataset(folder, regenerate=0) == []


def test_the_catalogue_is_rebuilt_from_the_samples(made: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(made, folder)
    places, before = DatasetFolder(folder), st.open_dataset(made).catalogue
    count = 1 if made.name == "interrupted" else 2
    assert rebuild_catalogue(folder) == count
    assert st.open_dataset(folder).catalogue.to_json() == before.to_json(), "run times are kept"
    known = verify_dataset(made, regenerate=0)
    if places.card.exists():
        st.write_card(folder, overwrite=True)
    assert verify_dataset(folder, regenerate=0) == known
    for path in [places.catalogue, *places.parts.glob("*.parquet")]:
        if path.exists():
            path.write_bytes(b"PAR1 no longer")
    output = CliRunner().invoke(app, ["dataset", "catalogue", str(folder)]).output
    assert f"catalogue of {count} samples" in output
    assert ("card is out of date" in output) == places.card.exists()
    after = st.open_dataset(folder).catalogue
    assert after["seconds"].isna().all()
    assert after.drop(columns="seconds").to_json() == before.drop(columns="seconds").to_json()
    assert verify_dataset(folder, regenerate=0) == known


def test_a_data_set_of_an_earlier_version_is_compared_and_told(made: Path, tmp_path: Path) -> None:
    if made.name != "folder":
        pytest.skip("of the other layout")
    folder = tmp_path / "old"
    shutil.copytree(made, folder)
    for listed in folder.rglob("*.sha256"):
        listed.unlink()
    for file in (*folder.rglob("samples/*/*/sample.json"), *folder.rglob("scores/*/*/*.json"), folder / "dataset.json"):
        plain = json.loads(file.read_text(encoding="utf-8"))
        plain.pop("sha256", None)
        if file.name == "dataset.json":
            plain["format"] = 1
            del plain["files"]
        file.write_text(json.dumps(plain), encoding="utf-8")
    (old,) = verify_dataset(folder, regenerate=1)
    assert (old.name, old.problem.partition(",")[0]) == ("dataset.json", "has the format of an earlier version")
    assert len(st.open_dataset(folder)) == 2
    record = DatasetFolder(folder).sample(1) / "sample.json"
    plain = json.loads(record.read_text(encoding="utf-8"))
    plain["statistics"]["seen_share"] -= 0.1
    record.write_text(json.dumps(plain), encoding="utf-8")
    found = verify_dataset(folder, regenerate=0)[1:]
    assert found == [VerificationFailure(1, found[0].problem)]
    assert "sample.json and the catalogue differ in seen_share" in found[0].problem


@nightly
def test_an_empty_data_set_is_told_to_be_empty(tmp_path: Path) -> None:
    """As after a run that was killed before its first sample."""
    folder = tmp_path / "new"
    begin_dataset(DatasetFolder(folder), recipe().sampler())
    assert (read_status(folder).done, read_status(folder).count) == (0, 2)
    for call in (
        lambda: verify_dataset(folder),
        lambda: st.verify(folder),
        lambda: st.open_dataset(folder),
        lambda: st.estimate_dataset(folder),
        lambda: st.export(folder, "npz", output=tmp_path / "npz"),
        lambda: rebuild_catalogue(folder),
    ):
        with pytest.raises(StoreError, match=r"is empty: .* no samples yet; .* scenetruth dataset run"):
            call()
    for words in (["verify", folder], ["dataset", "estimate", folder], ["export", folder, "-o", tmp_path / "x"]):
        words = [*words, "--format", "npz"] if words[0] == "export" else words
        result = CliRunner().invoke(app, [*map(str, words)])
        assert isinstance(result.exception, StoreError)
    st.run_dataset(None, output=folder)
    assert verify_dataset(folder) == []


def test_samples_without_a_catalogue_are_told(made: Path, tmp_path: Path) -> None:
    """As after a run that was killed before the first part of its catalogue."""
    if made.name != "interrupted":
        pytest.skip("of the other layouts")
    folder = tmp_path / "copy"
    shutil.copytree(made, folder)
    shutil.rmtree(folder / "catalogue")
    with pytest.raises(
        StoreError, match=r"has 1 samples, and none of them in its catalogue; a run .*; if none .* rebuild"
    ):
        st.open_dataset(folder)
    assert "is not in the catalogue" in verify_dataset(folder)[0].problem
    assert rebuild_catalogue(folder) == 1
    assert len(st.open_dataset(folder)) == 1


def test_a_run_killed_between_recipe_and_identity_is_begun_again(tmp_path: Path) -> None:
    places = DatasetFolder(tmp_path / "new")
    begin_dataset(places, recipe().sampler())
    places.identity.unlink()
    assert begin_dataset(places, recipe().sampler()).count == 2
    places.identity.unlink()
    places.recipe.write_text("mine: 1\n", encoding="utf-8")
    with pytest.raises(StoreError, match="contains other files"):
        begin_dataset(places, recipe().sampler())
    assert places.recipe.read_text(encoding="utf-8") == "mine: 1\n"
