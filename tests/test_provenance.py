"""The release that a version belongs to, and hashes that tell runs apart."""

from __future__ import annotations

import shutil
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as some

import scenetruth as st
from scenetruth.provenance import content_hash, own_release, scene_hash
from scenetruth.schema import check_same_run
from tests.helpers.scenes import SCENES, cube

RELEASES = some.lists(some.integers(0, 99), min_size=3, max_size=3).map(lambda parts: ".".join(map(str, parts)))
BEHIND = some.sampled_from(["", "rc1", ".post2"])
COMMITS = some.sampled_from(["", ".dev0", ".dev7+g1a2b3c4", ".dev12+g1a2b3c4d5.d20261123", "+local"])


@given(RELEASES, BEHIND, COMMITS)
def test_commits_between_releases_belong_to_one(release: str, behind: str, commit: str) -> None:
    with patch("scenetruth.provenance.version", return_value=release + behind + commit):
        found = own_release()
    # Only commits after a release are .post1.devN: a release that is named .post2 is one.
    assert found == release + ("" if behind == ".post2" and commit.startswith(".dev") else behind)


TINY = {"camera": {"width": 40, "height": 30, "focal_length_px": 700}, "frames": {"count": 1}}


@pytest.mark.parametrize(
    "changes",
    [
        {"description": "other words"},
        {"estimate": {"window_sigma_px": 4.0}},
        {"estimate": {"method": "opencv_stereo"}},
        {"score": {"interior_margin_px": 5.0}},
        {"format": 1},
    ],
)
def test_what_images_do_not_depend_on_does_not_count(changes: dict[str, object]) -> None:
    assert scene_hash(cube(**changes)) == scene_hash(cube())


@pytest.mark.parametrize("changes", [{"seed": 8}, {"background": 0.1}, {"sensor": {"bit_depth": 8}}])
def test_what_images_depend_on_counts(changes: dict[str, object]) -> None:
    assert scene_hash(cube(**changes)) != scene_hash(cube())


def test_files_count_by_their_content_not_by_their_place(tmp_path: Path) -> None:
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
        shutil.copy(SCENES / "finite_elements.yaml", tmp_path / name / "scene.yaml")
        shutil.copytree(SCENES / "finite_elements", tmp_path / name / "finite_elements")
    here, there = (st.load_scene(tmp_path / name / "scene.yaml") for name in ("here", "there"))
    assert here != there
    assert scene_hash(here) == scene_hash(there) == scene_hash(st.load_scene(SCENES / "finite_elements.yaml"))
    array = tmp_path / "there" / "finite_elements" / "displacements.npy"
    values = np.load(array)
    values[0, 0, 0] += 1e-9
    np.save(array, values)
    assert scene_hash(here) != scene_hash(there)


@pytest.fixture(scope="module")
def runs() -> list[dict[str, xr.Dataset]]:
    found = []
    for seed in (1, 2):
        recording, truth = st.simulate(cube(**TINY, seed=seed))
        estimate = st.make_estimate(recording=recording, depth=truth["depth"].values)
        found.append({"recording": recording, "truth": truth, "estimate": estimate})
    return found


def test_the_hash_of_the_recording_travels(runs: list[dict[str, xr.Dataset]]) -> None:
    for parts in runs:
        assert len({part.attrs["recording_hash"] for part in parts.values()}) == 1
        check_same_run({name: part.attrs for name, part in parts.items()})


def test_parts_of_different_runs_are_refused_by_both_names(runs: list[dict[str, xr.Dataset]]) -> None:
    one, other = runs
    parts = {"a/recording.zarr": one["recording"].attrs, "b/estimate.zarr": other["estimate"].attrs}
    with pytest.raises(st.MismatchError, match=r"b/estimate\.zarr: .* another recording than a/recording\.zarr"):
        check_same_run(parts)
    with pytest.raises(st.MismatchError, match=r"truth(.|\n)*allow_mismatch=True"):
        st.score(other["estimate"], one["truth"])
    st.score(other["estimate"], one["truth"], allow_mismatch=True)


def test_a_truth_without_images_belongs_to_those_of_its_scene(runs: list[dict[str, xr.Dataset]]) -> None:
    alone = st.make_truth(cube(**TINY, seed=1))
    assert "recording_hash" not in alone.attrs
    check_same_run({"recording": runs[0]["recording"].attrs, "truth": alone.attrs})
    with pytest.raises(st.MismatchError, match="another scene"):
        check_same_run({"recording": runs[1]["recording"].attrs, "truth": alone.attrs})


def test_data_from_elsewhere_is_taken_as_it_is(runs: list[dict[str, xr.Dataset]]) -> None:
    own = st.make_recording(np.zeros((5, 1, 30, 40)), focal_length_px=300, baseline_mm=5.0)
    check_same_run({"truth": runs[0]["truth"].attrs, "recording": own.attrs})


def test_estimates_are_told_apart_by_method_and_settings() -> None:
    recording = st.make_recording(np.random.default_rng(0).random((2, 2, 40, 40)), 300.0, 5.0)
    sigmas = (6.0, 5.0, 6.0)
    hashes = [
        st.estimate(recording, working_point_px=0, window_sigma_px=sigma).attrs["estimate_hash"] for sigma in sigmas
    ]
    assert hashes[0] == hashes[2] != hashes[1]


def test_made_estimates_are_told_apart_by_what_they_hold() -> None:
    recording = st.make_recording(np.zeros((2, 1, 8, 8)), 300.0, 5.0)
    hashes = [
        st.make_estimate(recording=recording, depth=np.full((8, 8), z)).attrs["estimate_hash"] for z in (1.0, 2.0, 1.0)
    ]
    assert hashes[0] == hashes[2] != hashes[1]


MTL = "newmtl m\nKd 1 1 1\n{}\n"
REFERENCES: dict[str, tuple[str, dict[str, str], str]] = {
    "plain": ("a.obj", {"a.obj": "mtllib a.mtl\n", "a.mtl": MTL.format("map_Kd p.png")}, "p.png"),
    "library": ("a.obj", {"a.obj": "mtllib a.mtl\n"}, "a.mtl"),
    "library with spaces": ("a.obj", {"a.obj": "\tmtllib my own.mtl\n"}, "my own.mtl"),
    "options": (
        "a.obj",
        {"a.obj": "mtllib a.mtl\n", "a.mtl": MTL.format("\tmap_Kd -s 2 2 -clamp on p q.png")},
        "p q.png",
    ),
    "quotes": ("a.obj", {"a.obj": "mtllib a.mtl\n", "a.mtl": MTL.format('map_Kd "p q.png"')}, "p q.png"),
    "percent": ("a.obj", {"a.obj": "mtllib a.mtl\n", "a.mtl": MTL.format("map_Kd p%20q.png")}, "p q.png"),
    "PLY": ("a.ply", {"a.ply": "ply\nformat ascii 1.0\ncomment TextureFile p q.png\nend_header\n"}, "p q.png"),
    "glTF buffer": ("a.gltf", {"a.gltf": '{"asset":{"version":"2.0"},"buffers":[{"uri":"p%20q.bin"}]}'}, "p q.bin"),
    "glTF picture": ("a.gltf", {"a.gltf": '{"asset":{"version":"2.0"},"images":[{"uri":"p.png"}]}'}, "p.png"),
}


@pytest.mark.parametrize("way", REFERENCES)
def test_files_that_a_mesh_file_refers_to_count(tmp_path: Path, way: str) -> None:
    first, texts, last = REFERENCES[way]
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    found = [content_hash(tmp_path / first)]
    for content in ("one", "two"):
        (tmp_path / last).write_text(content)
        found.append(content_hash(tmp_path / first))
    (tmp_path / "other.png").write_text("unnamed")
    assert content_hash(tmp_path / first) == found[-1]
    assert len(set(found)) == 3
