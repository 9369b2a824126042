"""After the warm-up nothing is left to compile."""

from __future__ import annotations

import pytest

import scenetruth as st
from scenetruth import pipeline
from scenetruth.compilation import announced_compilation
from scenetruth.pipeline import warm_up
from tests.cli.calling import scenetruth
from tests.nightly import nightly

SCENE = {
    "camera": {"width": 40, "height": 30, "focal_length_px": 200.0},
    "stage": {"positions": 3, "baseline_mm": 4.0},
    "frames": {"count": 3},
    "objects": [
        {
            "name": "box",
            "mesh": {"kind": "box", "size_mm": [80, 60, 40]},
            "pose": {"position_mm": [0, 0, 420]},
            "texture": {"kind": "noise", "wavelength_mm": [4, 20], "rms_contrast": 0.2},
            "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0, 0, -1]}],
        }
    ],
    "sensor": {"bit_depth": 8, "noise_std": 0.005},
    "render": {"backend": "raycast"},
}


@nightly
@pytest.mark.filterwarnings("ignore::scenetruth.SceneWarning")
def test_what_comes_after_is_compiled_already() -> None:
    told: list[tuple[str, int, int]] = []
    done = warm_up(lambda what, at, of: told.append((what, at, of)))
    assert {f"{scene}: {method}" for scene in ("cube", "leaf") for method in ("structure_tensor", "refined")} < {*done}
    assert [at for _, at, _ in told] == list(range(len(done) + 1))
    assert {of for _, _, of in told} == {len(done)}
    compiled: list[str] = []
    with announced_compilation(lambda name, before: compiled.append(name)):
        recording, truth = st.simulate(st.scene_from_plain(SCENE))
        for method in ("structure_tensor", "refined"):
            st.score(st.estimate(recording, method), truth, margin_px=2)
    assert not compiled


def test_the_command_says_when_all_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "warm_up", lambda progress: [])
    done = scenetruth("warm-up")
    assert done.returncode == 0
    assert "everything is compiled" in done.stdout
