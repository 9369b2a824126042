"""Verifying a folder finds what is damaged, and what does not belong."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import scenetruth as st
from tests.helpers.scenes import SMALL_CUBE, cube


def problems(folder: Path) -> dict[str, str]:
    return {verdict.path.name: verdict.problem for verdict in st.verify(folder) if verdict.problem}


def test_a_whole_run_is_whole(finished: Path) -> None:
    assert problems(finished) == {}
    looked_at = {verdict.path.name for verdict in st.verify(finished)}
    stores = {"recording.zarr", "truth.zarr", "estimate.zarr", "estimate.opencv_flow.zarr"}
    assert looked_at == stores | {"scene.yaml", "score.json", "score.opencv_flow.json"}
    assert [verdict.path.name for verdict in st.verify(finished / "truth.zarr")] == ["truth.zarr"]


def test_damage_is_named(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    chunks = max((run / "truth.zarr" / "depth").rglob("*"), key=lambda path: path.stat().st_size)
    content = bytearray(chunks.read_bytes())
    content[len(content) // 2] ^= 4
    chunks.write_bytes(content)
    (run / "score.json").write_text("{}")
    (run / "scene.yaml").write_text("camera: [")
    found = problems(run)
    assert set(found) == {"truth.zarr", "score.json", "scene.yaml"}
    assert "'depth' cannot be read" in found["truth.zarr"]


def test_parts_of_another_run_are_named(finished: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    other = st.make_truth(cube(**SMALL_CUBE, seed=99))
    st.save_store(other, run / "truth.zarr", overwrite=True)
    assert "belongs to another scene than" in problems(run)["truth.zarr"]


def test_nothing_to_verify(tmp_path: Path) -> None:
    with pytest.raises(st.StoreError, match="contains no results of scenetruth"):
        st.verify(tmp_path)
    with pytest.raises(st.StoreError, match="no such directory"):
        st.verify(tmp_path / "nothing")
