from __future__ import annotations

import copy
import hashlib
import io
import json
import pickle
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scenetruth as st
from scenetruth.dataset import SceneDataset, read_arrays, run_dataset, write_webdataset
from scenetruth.dataset.training_data import MAPS, TensorsOf
from scenetruth.errors import ArgumentError, MachineError, OutputExistsError
from tests.helpers.small_recipes import RECIPE

HEIGHT, WIDTH = 36, 48


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> SceneDataset:
    folder = tmp_path_factory.mktemp("made") / "tiles"
    recipe = {
        **copy.deepcopy(RECIPE),
        "samples": 3,
        "splits": {"train": 2, "test": 1},
        "truth": {"content": "complete"},
    }
    run_dataset(recipe, output=folder)
    return st.open_dataset(folder)


def test_arrays_have_channels_before_rows_and_full_scale_one(made: SceneDataset) -> None:
    sample = made.sample(1)
    arrays = read_arrays(sample, ("depth", "velocity", "object_id"))
    assert {name: values.dtype.name for name, values in arrays.items()} == {
        "image": "float32",
        "depth": "float32",
        "velocity": "float32",
        "object_id": sample.truth["object_id"].dtype.name,
    }
    assert arrays["image"].shape == (3, 3, 1, HEIGHT, WIDTH)
    image = sample.recording["image"]
    assert arrays["image"][1, 2, 0] * 255 == pytest.approx(image.isel(s=1, t=2).values, abs=1e-4)
    np.testing.assert_array_equal(arrays["depth"], sample.truth["depth"].values.astype(np.float32))


def test_unknown_maps_are_refused_with_those_that_exist(made: SceneDataset) -> None:
    with pytest.raises(ArgumentError, match=r"contains.*depth") as caught:
        read_arrays(made.sample(0), ("depht", "velocity", "flaw"))
    assert {problem.value for problem in caught.value.problems} == {"depht", "flaw"}


def test_a_stereo_pair_shows_the_same_points_at_its_disparity(made: SceneDataset) -> None:
    pairs = pickle.loads(pickle.dumps(made.stereo_pairs()))
    assert len(pairs) == len(made)
    left, right, disparity, valid = pairs[0]
    truth = made.sample(0).truth
    f, baseline = truth.attrs["focal_length_px"], truth.attrs["baseline_mm"]
    depth = truth["depth"].sel(t=0).values
    assert disparity[0] == pytest.approx(np.where(valid, f * baseline / depth, 0), rel=1e-6)
    assert _residual(left[0], right[0], -disparity[0], np.zeros_like(disparity[0]), valid) < 0.03


def test_a_flow_pair_shows_the_same_points_at_its_flow(made: SceneDataset) -> None:
    first, second, flow, valid = made.flow_pairs()[2]
    sample = made.sample(2)
    expected = sample.truth["flow_next"].sel(t=0).values
    assert valid.sum() > 0.9 * valid.size
    assert flow[:, valid] == pytest.approx(expected[:, valid], abs=1e-5)
    assert _residual(first[0], second[0], flow[0], flow[1], valid) < 0.03


def _residual(first: Any, second: Any, u: Any, v: Any, valid: Any) -> float:
    """Return the median difference of points in two images: their noise is 0.01, textures have a contrast of 0.1."""
    from scipy.ndimage import map_coordinates

    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    seen = map_coordinates(second, [rows + v, columns + u], order=1, cval=np.nan)
    return float(np.nanmedian(np.abs(np.where(valid, seen - first, np.nan))))


def test_pairs_of_a_grid_of_cameras_are_those_of_the_row_of_the_reference(tmp_path: Path) -> None:
    recipe = copy.deepcopy(RECIPE)
    recipe["base"][0]["scene"]["stage"] |= {"positions": 2, "rows": 2, "row_spacing_mm": 5}
    recipe["base"][0]["scene"]["frames"]["count"] = 2
    run_dataset({**recipe, "samples": 1, "truth": {"content": "complete"}}, output=tmp_path / "grid")
    grid = st.open_dataset(tmp_path / "grid")
    image = grid.sample(0).recording["image"].sel(s_y=0)
    first, second, flow, valid = grid.flow_pairs()[0]
    left, right, disparity, _ = grid.stereo_pairs(left=0)[0]
    for found, place in ((first, (0, 0)), (second, (0, 1)), (left, (0, 0)), (right, (1, 0))):
        assert found[0] * 255 == pytest.approx(image.sel(s=place[0], t=place[1]).values, abs=1e-4)
    assert (flow.shape, disparity.shape) == ((2, HEIGHT, WIDTH), (1, HEIGHT, WIDTH))
    assert _residual(left[0], right[0], -disparity[0], np.zeros_like(disparity[0]), valid) < 0.03


def test_pairs_that_do_not_exist_are_refused(made: SceneDataset) -> None:
    with pytest.raises(ArgumentError, match="one of \\[-1, 0\\]") as caught:
        _ = made.flow_pairs(frame=1, camera=5)[0]
    assert [problem.path for problem in caught.value.problems] == ["frame", "camera"]
    with pytest.raises(ArgumentError, match=r"right neighbour|position with maps"):
        _ = made.stereo_pairs(left=1)[0]


def _members(path: Path) -> dict[str, bytes]:
    with tarfile.open(path) as tar:
        return {entry.name: tar.extractfile(entry).read() for entry in tar.getmembers()}  # type: ignore[union-attr]


def test_shards_hold_all_samples_of_a_split_and_are_the_same_bytes(made: SceneDataset, tmp_path: Path) -> None:
    shards = write_webdataset(made, tmp_path / "a", maps=("depth",), samples_per_shard=2)
    again = write_webdataset(made, tmp_path / "b", maps=("depth",), samples_per_shard=2)
    assert [path.read_bytes() for path in shards] == [path.read_bytes() for path in again]
    found: dict[int, str] = {}
    for path in shards:
        entries = _members(path)
        keys = list(dict.fromkeys(name.partition(".")[0] for name in entries))
        # The files of a sample follow each other, as readers require.
        assert list(entries) == [f"{key}.{end}" for key in keys for end in ("image.npy", "depth.npy", "json")]
        for key in keys:
            about = json.loads(entries[f"{key}.json"])
            assert path.name.startswith(f"{about['split']}-")
            found[about["sample"]] = about["split"]
            sample = made.sample(made.catalogue["sample"].tolist().index(int(key)))
            assert about["values"] == pytest.approx(sample.values)
            for name, values in read_arrays(sample, ("depth",)).items():
                np.testing.assert_array_equal(np.load(io.BytesIO(entries[f"{key}.{name}.npy"])), values)
    assert found == dict(zip(made.catalogue["sample"], made.catalogue["split"], strict=True))


def test_an_interrupted_run_resumes_and_other_shards_are_refused(made: SceneDataset, tmp_path: Path) -> None:
    shards = write_webdataset(made, tmp_path / "a", samples_per_shard=1)
    whole = [path.read_bytes() for path in shards]
    shards[1].unlink()
    kept = shards[0].stat().st_mtime_ns
    assert write_webdataset(made, tmp_path / "a", samples_per_shard=1) == shards
    assert [path.read_bytes() for path in shards] == whole
    assert shards[0].stat().st_mtime_ns == kept
    for other, maps, message in (
        (made, "depth", "the maps depth, velocity"),
        (made[:2], MAPS, "of 3 samples instead of 2"),
    ):
        with pytest.raises(OutputExistsError, match=message):
            write_webdataset(other, tmp_path / "a", maps=maps, samples_per_shard=1)
    with pytest.raises(OutputExistsError, match="another number of samples"):
        write_webdataset(made, tmp_path / "a", samples_per_shard=2)
    with pytest.raises(ArgumentError, match="at least 1"):
        write_webdataset(made, tmp_path / "c", samples_per_shard=0)


def test_a_damaged_shard_is_written_again(made: SceneDataset, tmp_path: Path) -> None:
    shards = write_webdataset(made, tmp_path, maps="depth", samples_per_shard=2)
    whole = [path.read_bytes() for path in shards]
    shards[0].write_bytes(whole[0][: len(whole[0]) // 2])
    flipped = bytearray(whole[1])
    flipped[len(flipped) // 2] ^= 1
    shards[1].write_bytes(flipped)
    assert write_webdataset(made, tmp_path, maps="depth", samples_per_shard=2) == shards
    assert [path.read_bytes() for path in shards] == whole
    lists = [path.with_suffix(".sha256").read_text() for path in shards]
    assert lists == [f"{hashlib.sha256(b).hexdigest()}  {p.name}\n" for b, p in zip(whole, shards, strict=True)]


def test_unknown_motions_are_refused(made: SceneDataset) -> None:
    with pytest.raises(ArgumentError, match="finite, instantaneous"):
        made.flow_pairs(motion="instant")  # type: ignore[arg-type]


def test_tensors_of_unknown_maps_are_refused_before_a_sample_is_read(
    made: SceneDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "torch", object())
    with pytest.raises(ArgumentError, match="depht"):
        made.to_torch(("depth", "depht"))
    # The name of a single map is no sequence of letters.
    assert made.to_torch("depth")._transform == TensorsOf(("depth",))


def test_a_missing_torch_is_reported(made: SceneDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "torch", None)
    with pytest.raises(MachineError, match="pip install torch"):
        made.to_torch()


def test_a_loader_of_pytorch_makes_batches(made: SceneDataset) -> None:
    torch = pytest.importorskip("torch")
    from torch.utils.data import DataLoader

    batch = next(iter(DataLoader(made.to_torch(("depth",)), batch_size=3, num_workers=0)))
    assert batch["image"].shape == (3, 3, 3, 1, HEIGHT, WIDTH)
    assert batch["depth"].dtype == torch.float32
    np.testing.assert_array_equal(batch["depth"][1].numpy(), read_arrays(made.sample(1), ("depth",))["depth"])
    flows = next(iter(DataLoader(made.flow_pairs(), batch_size=2)))
    assert flows[2].shape == (2, 2, HEIGHT, WIDTH)
