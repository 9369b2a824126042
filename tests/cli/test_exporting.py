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
    assert done.stdout == f"wrote {out} (3 files)\n"
    assert "note: flow is instantaneous" in done.stderr
    assert names(out) == {"export.json", "flow", "images"}
    again = scenetruth("export", run, "--format", "pfm", "-o", out, *method, "--option", "image_bits=16", "--left", "0")
    assert again.returncode == 2
    assert "exists already" in again.stderr
    again = scenetruth("export", run, "--format", "pfm", "-o", out, *method, "--option", "image_bits=16", "--overwrite")
    assert again.returncode == 0, again.stderr
    assert names(out) == {"export.json", "t+0", "t+1"}
    assert json.loads((out / "export.json").read_text())["options"]["image_bits"] == 16


def test_every_input_error_is_listed(run: Path) -> None:
    for missing in ("--format", "--output"):
        given = {"--format": "flo", "--output": str(run.parent / "out")}
        del given[missing]
        done = scenetruth("export", run, *(word for pair in given.items() for word in pair))
        assert done.returncode == 2
        assert missing in done.stderr
    words = ("--option", "left", "--option", "row=1", "--option", "every=[")
    done = scenetruth("export", run, "--format", "flo", "-o", run.parent / "out", *words)
    assert done.returncode == 2
    for problem in ("NAME=VALUE", "row is not an option", "in YAML"):
        assert problem in done.stderr
    done = scenetruth("export", run, "--format", "flo", "-o", run.parent / "out", "--option", "lft=1")
    assert done.returncode == 2
    assert "lft: is not an option" in done.stderr
    done = scenetruth("export", run, "--format", "png", "-o", run.parent / "out")
    assert "select an estimate with --method" in done.stderr


def test_formats_are_listed() -> None:
    done = scenetruth("list", "formats")
    assert done.returncode == 0
    for name in st.export_formats():
        assert name in done.stdout
    assert "flow=finite" in done.stdout
