"""Names in the folder of a run, and what of it is ours."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import scenetruth as st
from scenetruth.output import OwnershipResult
from scenetruth.pipeline.run_directory import claim_entry, claim_run

METHODS = ("structure_tensor", "opencv_flow", "mine:depth", "mine:flow")


def test_files_of_several_methods_stand_side_by_side() -> None:
    run = st.RunDirectory("runs/one", "structure_tensor")
    names = [path for method in METHODS for path in (run.paths(method).estimate, *run.paths(method).after_estimate)]
    assert len(set(names)) == len(names)
    assert {path.parent for path in names} == {Path("runs/one")}


def test_the_scenes_own_method_has_plain_names() -> None:
    run = st.RunDirectory("runs/one", "opencv_flow")
    assert run.paths("opencv_flow").estimate.name == "estimate.zarr"
    assert run.paths("structure_tensor").estimate.name == "estimate.structure_tensor.zarr"


def test_an_empty_folder_has_no_estimates(tmp_path: Path) -> None:
    with pytest.raises(st.StoreError, match=r"estimate\.zarr: no such store; compute it with `scenetruth estimate`"):
        st.RunDirectory(tmp_path).estimated()


def test_stores_that_are_missing_are_named_with_those_of_the_run(finished: Path, tmp_path: Path) -> None:
    with pytest.raises(st.StoreError, match=r"none: no such directory; give the directory of a run"):
        st.RunDirectory(tmp_path / "none").check_recording()
    with pytest.raises(st.StoreError, match=r"recording\.zarr: no such store; give the directory of a run"):
        st.RunDirectory(tmp_path).check_recording()
    with pytest.raises(st.StoreError, match=r"estimate\.moon\.zarr: no such store: the run has no estimate"):
        st.RunDirectory(tmp_path).check_estimate("moon")
    run = st.RunDirectory(finished)
    assert run.check_recording() == run.recording
    with pytest.raises(st.StoreError, match=f"the run has estimates of {', '.join(run.estimated())}; compute one"):
        run.check_estimate("moon")


def test_only_our_own_files_of_a_run_are_claimed(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    assert claim_run(run) == OwnershipResult()
    (run / "thesis.txt").write_text("all my work")
    (run / "estimates.zarr").mkdir()
    assert claim_run(run) == OwnershipResult(foreign=("estimates.zarr", "thesis.txt"))
    (run / "figures" / "mine.png").write_bytes(b"\x89PNG drawn elsewhere")
    assert "not written by scenetruth (figures)" in claim_run(run).refusal
    (run / "figures" / "mine.png").unlink()
    (run / "truth.zarr" / "notes.txt").write_text("mine")
    assert "not written by scenetruth (truth.zarr)" in claim_run(run).refusal
    for other in (tmp_path, run / "thesis.txt", run / "figures"):
        assert claim_run(other).refusal


def test_images_as_files_are_ours_by_their_names(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    for name in ("s+0_t-12.png", "r-1_s+0_t+3.tiff"):
        (tmp_path / "images" / name).touch()
    assert claim_entry(tmp_path / "images") == OwnershipResult()
    (tmp_path / "images" / "s0.png").touch()
    claimed = claim_entry(tmp_path / "images")
    assert claimed is not None
    assert claimed.refusal
