"""Data sets of tiny scenes: the same bytes however they are made, whole whatever happens."""

from __future__ import annotations

import copy
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

from scenetruth.dataset.catalogue import read_catalogue
from scenetruth.dataset.dataset_estimation import estimate_dataset
from scenetruth.dataset.fingerprint import begin_dataset, compute_fingerprint, compute_recipe_hash
from scenetruth.dataset.generation import read_status, run_dataset
from scenetruth.dataset.layout import DatasetFolder
from scenetruth.dataset.reading import open_dataset
from scenetruth.dataset.recipe_loader import Recipe, load_recipe
from scenetruth.dataset.samples import Partition, make_sample
from scenetruth.dataset.verification import rebuild_catalogue
from scenetruth.errors import MachineError, MismatchError, OutputExistsError, StoreError
from scenetruth.pipeline import verify_run
from scenetruth.resources import Limits
from tests.helpers.dataset_makers import Make
from tests.helpers.nightly import nightly
from tests.helpers.small_recipes import RECIPE

PAIRED = {"sensor.noise_std": [0.05]}


def contents(folder: Path) -> dict[str, str]:
    """Return hashes of all samples' files by their names."""
    samples = folder / "samples"
    files = sorted(path for path in samples.rglob("*") if path.is_file())
    return {str(path.relative_to(samples)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of three draws and their ladders, made by two processes."""
    folder = tmp_path_factory.mktemp("made") / "tiles"
    sampler = Recipe.from_dict({**copy.deepcopy(RECIPE), "samples": 3, "paired_factors": PAIRED}).sampler()
    outcome = run_dataset(sampler.recipe, output=folder, workers=2)
    assert (outcome.made, outcome.present, outcome.failed) == (6, 0, [])
    return folder


def test_a_missing_pyarrow_is_reported_before_any_work(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("pyarrow", "pyarrow.parquet"):
        monkeypatch.setitem(sys.modules, name, None)
    for work in (
        lambda: run_dataset(Recipe.from_dict(copy.deepcopy(RECIPE)), output=tmp_path / "tiles"),
        lambda: estimate_dataset(made, "plane_sweep"),
        lambda: open_dataset(made),
        lambda: rebuild_catalogue(made),
    ):
        with pytest.raises(MachineError, match=r"pip install 'scenetruth\[datasets\]'"):
            work()
    assert list(tmp_path.iterdir()) == []


def test_samples_are_folders_of_runs_and_whole(made: Path) -> None:
    assert read_status(made).missing == 0
    for number in range(6):
        verdicts = verify_run(DatasetFolder(made).sample(number))
        assert len(verdicts) == 3
        assert not any(verdict.problem for verdict in verdicts)
    left = [path.name for path in made.rglob(".*")]
    assert left == []


def test_parts_orders_and_restarts_make_the_same_bytes(made: Path, tmp_path: Path, sampler_with: Make) -> None:
    sampler, folder = sampler_with(samples=3, paired_factors=PAIRED), tmp_path / "again"
    for part in (Partition(3, 3), Partition(1, 3), Partition(2, 3)):
        run_dataset(sampler.recipe, output=folder, workers=1, partition=part)
    assert contents(folder) == contents(made)
    # And from the recipe in the folder itself.
    again = tmp_path / "alone"
    inside = load_recipe(made / "dataset.yaml").sampler()
    assert compute_fingerprint(inside).recipe_hash == compute_fingerprint(sampler).recipe_hash
    make_sample(inside, compute_fingerprint(inside), 4, again)
    files = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in again.iterdir()}
    assert {f"00000/00000004/{name}": value for name, value in files.items()}.items() <= contents(made).items()


def test_steps_of_a_ladder_share_all_but_their_factor(made: Path) -> None:
    rows = read_catalogue(DatasetFolder(made), load_recipe(made / "dataset.yaml").sampler()).to_pylist()
    for drawn, step in zip(rows[::2], rows[1::2], strict=True):
        assert drawn["depth_min_mm"] == step["depth_min_mm"]
        assert drawn["recording_sha256"] != step["recording_sha256"]
        assert step["value.sensor.noise_std"] == 0.05


def test_the_catalogue_tells_what_lies_there(made: Path) -> None:
    table = read_catalogue(DatasetFolder(made), load_recipe(made / "dataset.yaml").sampler())
    assert DatasetFolder(made).catalogue.exists()
    for row in table.to_pylist():
        folder = DatasetFolder(made).sample(row["sample"])
        for name in ("recording", "truth"):
            file = folder / f"{name}.zarr.zip"
            assert row[f"{name}_sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
            assert row[f"{name}_bytes"] == file.stat().st_size
        assert row["depth_min_mm"] == pytest.approx(row["value.objects.1.pose.position_mm.2"], abs=1e-9)
        assert row["depth_max_mm"] == pytest.approx(120, abs=1e-9)
        assert {one["name"] for one in row["objects"]} == {"wall", "tile"}
        assert row["seconds"] > 0


def test_what_is_missing_is_made_again(made: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(made, folder)
    shutil.rmtree(DatasetFolder(folder).sample(2))
    DatasetFolder(folder).catalogue.unlink()
    outcome = run_dataset(None, output=folder, workers=1)
    assert (outcome.made, outcome.present) == (1, 5)
    assert contents(folder) == contents(made)
    rows = read_catalogue(DatasetFolder(folder), load_recipe(folder / "dataset.yaml").sampler())["sample"].to_pylist()
    assert rows == list(range(6))


def test_more_samples_only_if_asked_for(made: Path, tmp_path: Path, sampler_with: Make) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(made, folder)
    more = sampler_with(samples=4, paired_factors=PAIRED)
    with pytest.raises(MismatchError, match="has 3 samples, and the recipe has more; allow this with --extend"):
        run_dataset(more.recipe, output=folder)
    assert run_dataset(more.recipe, output=folder, workers=1, extend=True).made == 2
    assert contents(made).items() < contents(folder).items()
    with pytest.raises(MismatchError, match="recipe has fewer"):
        run_dataset(sampler_with(samples=3, paired_factors=PAIRED).recipe, output=folder)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seed": 12}, "seed changed"),
        ({"distributions": {}}, "distributions changed"),
        ({"set": {"frames.count": 2}}, "base or set changed"),
    ],
)
def test_another_recipe_is_refused(made: Path, sampler_with: Make, changes: dict[str, Any], message: str) -> None:
    before = contents(made)
    with pytest.raises(MismatchError, match=message):
        run_dataset(
            sampler_with(**{"samples": 3, "paired_factors": PAIRED, **changes}).recipe, output=made, extend=True
        )
    assert contents(made) == before


def test_the_recipe_in_a_folder_is_that_of_the_data_set(tmp_path: Path, sampler_with: Make) -> None:
    """What is set for all samples is in the base scenes there; a table's place does not count."""
    table = tmp_path / "runs.csv"
    table.write_text("z\n100\n105\n", encoding="utf-8")
    values = {"depth": {"kind": "table", "file": str(table), "column": "z"}}
    sampler = sampler_with(set={"frames.count": 2}, parameters=values, samples=1)
    begin_dataset(DatasetFolder(tmp_path / "new"), sampler)
    inside = load_recipe(tmp_path / "new" / "dataset.yaml").sampler()
    assert compute_recipe_hash(inside) == compute_recipe_hash(sampler)
    assert begin_dataset(DatasetFolder(tmp_path / "new"), inside).samples == 1
    former = compute_recipe_hash(sampler)
    moved = table.rename(tmp_path / "moved.csv")
    values["depth"]["file"] = str(moved)
    assert compute_recipe_hash(sampler_with(set={"frames.count": 2}, parameters=values, samples=1)) == former
    # What lies in every sample's files counts, though no image depends on it.
    other = sampler_with(set={"frames.count": 2, "score.interior_margin_px": 5}, parameters=values, samples=1)
    assert compute_recipe_hash(other) != former


def test_words_may_change(made: Path, sampler_with: Make) -> None:
    words = {"description": "tiles before a wall", "licence": "CC-BY-4.0"}
    assert run_dataset(sampler_with(samples=3, paired_factors=PAIRED, **words).recipe, output=made).present == 6


def test_foreign_folders_are_left_alone(tmp_path: Path, sampler_with: Make) -> None:
    (tmp_path / "thesis.tex").write_text("mine", encoding="utf-8")
    with pytest.raises(StoreError, match="contains other files"):
        run_dataset(sampler_with().recipe, output=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_what_the_machine_does_not_have_is_refused_first(tmp_path: Path, sampler_with: Make) -> None:
    with pytest.raises(MachineError, match="memory"):
        run_dataset(sampler_with().recipe, output=tmp_path / "new", limits=Limits(memory_gb=0.001))


def test_a_sample_that_fails_is_set_aside_and_told(tmp_path: Path, sampler_with: Make, messages: list[str]) -> None:
    """The tile is behind the camera in the second sample."""
    depth = "objects.1.pose.position_mm.2"
    sampler = sampler_with(samples=3, distributions={depth: {"kind": "sequence", "values": [100, -50, 90]}})
    outcome = run_dataset(sampler.recipe, output=tmp_path / "new", workers=1, retries=1)
    assert (outcome.made, outcome.failed) == (2, [1])
    told = json.loads(DatasetFolder(tmp_path / "new").failure(1).read_text(encoding="utf-8"))
    assert "is behind the camera" in told["message"]
    assert told["values"] == {depth: -50}
    assert told["attempts"] == 2
    assert told["again"].startswith("scenetruth dataset sample ")
    assert "sample 1 failed" in messages[0]
    status = read_status(tmp_path / "new")
    assert (status.done, status.missing, list(status.failed)) == (2, 1, [1])


@nightly
def test_a_killed_run_leaves_whole_samples_and_goes_on(made: Path, tmp_path: Path) -> None:
    recipe, folder = tmp_path / "recipe.yaml", tmp_path / "killed"
    recipe.write_text(yaml.safe_dump({**RECIPE, "samples": 3, "paired_factors": PAIRED}), encoding="utf-8")
    command = [sys.executable, "-m", "scenetruth", "dataset", "run", str(recipe), "-o", str(folder), "--workers", "2"]
    # While some samples are done, and others under way.
    run = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True)
    while run.poll() is None and sum(1 for _ in DatasetFolder(folder).done()) < 2:
        time.sleep(0.02)
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    for group in (folder / "samples").iterdir():
        for sample in group.iterdir():
            if not sample.name.startswith("."):
                assert not any(verdict.problem for verdict in verify_run(sample))
    subprocess.run(command, check=True, capture_output=True)
    assert contents(folder) == contents(made)
    assert not [path.name for path in folder.rglob(".*")]


def test_an_output_that_is_a_file_is_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "tiles").write_text("mine")
    with pytest.raises(OutputExistsError, match="is not a directory"):
        run_dataset(Recipe.from_dict(RECIPE), output=tmp_path / "tiles")
    assert (tmp_path / "tiles").read_text() == "mine"
