"""The choice of a method and its settings, as scene files and the JSON Schema have it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import scenetruth as st
from scenetruth.scene import Scene


def test_models_within_settings_are_told_in_the_schema() -> None:
    variants = Scene.model_json_schema()["$defs"]["MethodChoice"]["oneOf"]
    refined = next(each for each in variants if each["properties"]["method"]["const"] == "refined")
    assert "$defs" not in refined
    corrections = refined["properties"]["pose_corrections"]
    model = next(each for each in corrections["anyOf"] if each["type"] == "object")
    assert {"x_px", "roll_urad"} < set(model["properties"])
    assert "yaw" in model["properties"]["x_px"]["description"]
    assert corrections["description"].startswith("Prior standard deviations of camera-pose errors")


def test_a_file_imports_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "trap.py").write_text("raise SystemExit('imported')")
    monkeypatch.chdir(tmp_path)
    scene = tmp_path / "scene.yaml"
    for method in ("trap:method", "os:system"):
        scene.write_text(f"estimate: {{method: '{method}'}}")
        with pytest.raises(st.SceneError, match=f"is code.*--method {method}"):
            st.load_scene(scene)
    assert "trap" not in sys.modules
