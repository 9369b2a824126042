from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scenetruth as st
from scenetruth.dataset import catalogue
from scenetruth.dataset.generation import read_status, run_dataset
from scenetruth.dataset.layout import DatasetFolder
from scenetruth.dataset.reading import Sample, SceneDataset
from scenetruth.dataset.recipe_loader import Recipe
from scenetruth.dataset.samples import Partition
from scenetruth.dataset.verification import verify_dataset
from tests.helpers.nightly import by_night
from tests.helpers.small_recipes import RECIPE

DEPTH = "objects.1.pose.position_mm.2"
LISTED = {DEPTH: {"kind": "sequence", "values": [95, 100, 105, 110, 115]}}
SPLITS = {"splits": {"train": 1, "test": 1}}


def recipe(**changes: Any) -> Any:
    return Recipe.from_dict(
        {**copy.deepcopy(RECIPE), "samples": 5, "distributions": LISTED, **SPLITS, **changes}
    ).sampler()


@pytest.fixture(scope="module", params=["folder", *by_night("shards")])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("made") / request.param
    run_dataset(recipe(layout=request.param, samples_per_shard=2).recipe, output=folder, workers=1)
    return folder


def first_depth(sample: Sample) -> float:
    return float(sample.truth["depth"].sel(t=0).min())


def test_a_data_set_is_a_sequence_of_samples(made: Path) -> None:
    dataset = st.open_dataset(made)
    assert len(dataset) == 5
    assert [sample.number for sample in dataset] == [0, 1, 2, 3, 4]
    assert [sample.values[DEPTH] for sample in dataset[1:3]] == [100, 105]
    assert dataset[-1].number == dataset[np.int64(4)].number == 4
    with pytest.raises(IndexError):
        dataset[5]
    assert dataset[2].recording["image"].sizes == {"s": 3, "t": 3, "y": 36, "x": 48}
    assert first_depth(dataset[2]) == pytest.approx(105, abs=1e-9)
    assert dataset[2].scene.objects[1].pose.position_mm[2] == 105


def test_samples_are_selected_by_the_catalogue(made: Path) -> None:
    dataset = st.open_dataset(made)
    assert [sample.number for sample in dataset.select(f"`value.{DEPTH}` > 100 and bytes > 0")] == [2, 3, 4]
    assert len(dataset.split("train")) + len(dataset.split("test")) == 5
    # An unfinished data set may have no samples of a split yet.
    assert len(dataset.select("split == 'train'").split("test")) == 0
    with pytest.raises(st.ArgumentError, match=r"must be one of train, test \(got 'trian'\)"):
        dataset.split("trian")
    with pytest.raises(st.RecipeError, match="is an invalid query"):
        dataset.select("depht > 3")


def test_parts_of_the_catalogue_that_a_run_merges_meanwhile_are_read_from_it(
    made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = [DatasetFolder(made).parts / "part-1of1-000000.parquet"]
    listed, list_files = [gone], catalogue._files
    monkeypatch.setattr(catalogue, "_files", lambda folder: listed.pop() if listed else list_files(folder))
    assert len(st.open_dataset(made)) == 5
    monkeypatch.setattr(catalogue, "_files", lambda folder: gone)
    with pytest.raises(st.StoreError, match=r"part-1of1-000000.parquet: is damaged"):
        st.open_dataset(made)


def test_it_serves_loaders_that_copy_it_to_other_processes(made: Path) -> None:
    dataset = pickle.loads(pickle.dumps(st.open_dataset(made, transform=first_depth)))
    assert isinstance(dataset, SceneDataset)
    assert [dataset[index] for index in range(5)] == pytest.approx([95, 100, 105, 110, 115], abs=1e-9)


def test_a_variable_of_all_samples_is_one_array_that_reads_when_used(
    made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = st.open_dataset(made)
    depth = dataset.stack("depth")
    assert depth.dims == ("sample", "t", "y", "x")
    assert depth.isel(sample=[3, 1], y=slice(4, 9), x=7).shape == (2, 3, 5)
    for number in (0, 4):
        own = dataset[number].truth["depth"].isel(t=1)
        assert np.array_equal(depth.sel(sample=number).isel(t=1).values, own.values, equal_nan=True)
    assert dataset.stack("image", "recording").isel(sample=0).dtype == np.uint8
    with pytest.raises(st.StoreError, match="has no 'dpeth'"):
        dataset.stack("dpeth")
    opened: list[int] = []
    monkeypatch.setattr(Sample, "_opened", lambda self, *rest: opened.append(self.number))
    with pytest.raises(TypeError):
        depth.isel(sample=3).values  # noqa: B018
    assert opened == [3]


def test_samples_of_other_shapes_do_not_stack(tmp_path: Path) -> None:
    vary = {"camera.width": {"kind": "sequence", "values": [48, 40]}}
    run_dataset(recipe(distributions=vary, samples=2).recipe, output=tmp_path / "new", workers=1)
    with pytest.raises(st.StoreError, match=r"sample 1 has a 'depth' of shape \(3, 36, 40\)"):
        st.open_dataset(tmp_path / "new").stack("depth").values  # noqa: B018


def test_both_layouts_hold_the_same_bytes_and_verify(made: Path) -> None:
    assert verify_dataset(made, regenerate=2) == []
    rows = st.open_dataset(made).catalogue
    assert rows["recording_sha256"].nunique() == 5
    if made.name == "shards":
        assert sorted(path.name for path in (made / "shards").iterdir()) == [f"{n:08d}.tar" for n in range(3)]
        assert list(DatasetFolder(made).done()) == []
        with pytest.raises(st.StoreError, match="contains many samples"):
            st.open_dataset(made)[0].run  # noqa: B018


def test_tar_files_are_named_as_webdataset_does_and_the_same_in_any_order(made: Path, tmp_path: Path) -> None:
    if made.name != "shards":
        pytest.skip("of the other layout")
    import tarfile

    again = tmp_path / "again"
    for part in (Partition(2, 2), Partition(1, 2)):
        run_dataset(recipe(layout="shards", samples_per_shard=2).recipe, output=again, workers=1, partition=part)
    for path in (made / "shards").iterdir():
        assert path.read_bytes() == (again / "shards" / path.name).read_bytes()
    with tarfile.open(made / "shards" / "00000001.tar") as archive:
        keys = [name.split(".", 1) for name in archive.getnames()]
    assert [key for key, _ in keys] == ["00000002"] * 4 + ["00000003"] * 4
    assert [rest for _, rest in keys[:4]] == ["sample.json", "scene.yaml", "recording.zarr.zip", "truth.zarr.zip"]


def test_what_a_killed_run_left_beside_a_tar_file_is_put_away(made: Path, tmp_path: Path) -> None:
    if made.name != "shards":
        pytest.skip("of the other layout")
    import shutil

    folder, alone = tmp_path / "copy", tmp_path / "alone"
    shutil.copytree(made, folder)
    wanted = recipe(layout="shards", samples_per_shard=2)
    # Killed between the tar file and the removal of its samples, and before the catalogue.
    st.run_dataset(recipe().recipe, output=alone, workers=1)
    shutil.copytree(alone / "samples", folder / "samples", dirs_exist_ok=True)
    (folder / "samples" / "00000" / "00000001" / "sample.json").unlink()
    (folder / "catalogue.parquet").unlink()
    assert read_status(folder).done == 5
    assert run_dataset(wanted.recipe, output=folder, workers=1).made == 0
    assert list(DatasetFolder(folder).done()) == []
    assert st.open_dataset(folder).catalogue["sample"].tolist() == [0, 1, 2, 3, 4]
    assert verify_dataset(folder, regenerate=0) == []
    with pytest.raises(st.MismatchError, match="its last tar file is not full"):
        run_dataset(
            recipe(layout="shards", samples_per_shard=2, samples=8).recipe, output=folder, workers=1, extend=True
        )


def test_damage_is_found(tmp_path: Path) -> None:
    folder = tmp_path / "new"
    run_dataset(recipe().recipe, output=folder, workers=1)
    places = DatasetFolder(folder)
    recording = places.sample(1) / "recording.zarr.zip"
    changed = bytearray(recording.read_bytes())
    changed[len(changed) // 2] ^= 1
    recording.write_bytes(bytes(changed))
    (places.sample(2) / "truth.zarr.zip").unlink()
    import shutil

    shutil.rmtree(places.sample(3))
    found = verify_dataset(folder, regenerate=5)
    assert {(damage.number, damage.problem.partition(" ")[0]) for damage in found} == {
        (1, "recording.zarr.zip"),
        (2, "truth.zarr.zip"),
        (3, "is"),
    }
