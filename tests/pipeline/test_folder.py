from __future__ import annotations

from pathlib import Path

import pytest

import scenetruth as st

METHODS = ("structure_tensor", "opencv_flow", "mine:depth", "mine:flow")


def test_files_of_several_methods_stand_side_by_side() -> None:
    run = st.RunFolder("runs/one", "structure_tensor")
    names = [path for method in METHODS for path in (run.of(method).estimate, *run.of(method).after_estimate)]
    assert len(set(names)) == len(names)
    assert {path.parent for path in names} == {Path("runs/one")}


def test_the_scenes_own_method_has_plain_names() -> None:
    run = st.RunFolder("runs/one", "opencv_flow")
    assert run.of("opencv_flow").estimate.name == "estimate.zarr"
    assert run.of("structure_tensor").estimate.name == "estimate.structure_tensor.zarr"


def test_an_empty_folder_has_no_estimates(tmp_path: Path) -> None:
    with pytest.raises(st.StoreError, match=r"estimate\.zarr: no such store; make it with `scenetruth estimate`"):
        st.RunFolder(tmp_path).estimated()
