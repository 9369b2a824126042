"""The command that exports."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import scenetruth as st
from tests.cli.calling import names, scenetruth


@pytest.fixture
def run(tmp_path: Path) -> Path:
    images = np.random.default_rng(1).random((2, 2, 12, 16)).astype(np.float32)
    recording = st.make_recording(images, focal_length_px=50, baseline_mm=2)
    st.save_store(recording, tmp_path / "run" / "recording.zarr")
    estimate = st.make_estimate(depth=np.full((2, 12, 16), 80.0), flow=np.zeros((2, 2, 12, 16)), recording=recording)
    st.save_store(estimate, tmp_path / "run" / "estimate.zarr")
    return tmp_path / "run"


def test_an_estimate_is_exported(run: Path) -> None:
    out = run.parent / "out"
    method = ("--method", "structure_tensor")
    done = scenetruth("export", run, "--format", "flo", "-o", out, *method, "--flow", "instantaneous")
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"written: {out} (3 files)\n"
    assert "note: flow is instantaneous" in done.stderr
    assert names(out) == {"export.json", "flow", "images"}
    again = scenetruth("export", run, "--format", "pfm", "-o", out, *method, "--set", "image_bits=16", "--left", "0")
    assert again.returncode == 2
    assert "exists already" in again.stderr
    again = scenetruth("export", run, "--format", "pfm", "-o", out, *method, "--set", "image_bits=16", "--overwrite")
    assert again.returncode == 0, again.stderr
    assert names(out) == {"export.json", "t+0", "t+1"}
    assert json.loads((out / "export.json").read_text())["options"]["image_bits"] == 16


def test_bad_input_is_told_at_once(run: Path) -> None:
    done = scenetruth("export", run, "--set", "left", "--set", "row=1", "--set", "every=[")
    assert done.returncode == 2
    for told in ("--format: is missing", "--output: is missing", "NAME=VALUE", "row is no option", "in YAML"):
        assert told in done.stderr
    done = scenetruth("export", run, "--format", "flo", "-o", run.parent / "out", "--set", "lft=1")
    assert done.returncode == 2
    assert "lft: is no option" in done.stderr
    done = scenetruth("export", run, "--format", "png", "-o", run.parent / "out")
    assert "choose an estimate with --method" in done.stderr


def test_formats_are_listed() -> None:
    done = scenetruth("export", "--list")
    assert done.returncode == 0
    for name in st.export_formats():
        assert name in done.stdout
    assert "flow=finite" in done.stdout
