"""After the precompile nothing is left to compile, and a first run compiles on two processors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import scenetruth as st
from scenetruth import pipeline
from scenetruth.camera.sensor import build_sensor_chain
from scenetruth.compilation import announced_compilation
from scenetruth.estimators import MethodChoice
from scenetruth.estimators.structure_tensor import estimate_tile
from scenetruth.pipeline import FigureWorker, precompile, scene_pipeline
from scenetruth.pipeline.precompilation import compile_late_truth_kernels, compile_method, small_recording
from scenetruth.truth import layer_kernels, visibility_kernels
from tests.helpers.command_line import scenetruth
from tests.helpers.nightly import nightly

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
    done = precompile(lambda what, at, of: told.append((what, at, of)))
    assert {f"{scene}: {method}" for scene in ("cube", "leaf") for method in ("structure_tensor", "refined")} < {*done}
    assert [at for _, at, _ in told] == list(range(len(done) + 1))
    assert {of for _, _, of in told} == {len(done)}
    compiled: list[str] = []
    with announced_compilation(lambda name, before: compiled.append(name)):
        recording, truth = st.simulate(st.Scene.from_dict(SCENE))
        for method in ("structure_tensor", "refined"):
            st.score(st.estimate(recording, method), truth, settings={"interior_margin_px": 2})
    assert not compiled


def test_the_command_says_when_all_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "precompile", lambda progress, helper: [])
    done = scenetruth("precompile")
    assert done.returncode == 0
    assert "compilation finished" in done.stdout


@pytest.mark.filterwarnings("ignore::scenetruth.SceneWarning")
@pytest.mark.parametrize("sensor", [{"bit_depth": 8}, {"bit_depth": 12}, "ideal"], ids=str)
def test_a_method_that_was_compiled_beforehand_compiles_no_more(sensor: object, tmp_path: Path) -> None:
    scene = st.Scene.from_dict({**SCENE, "sensor": sensor})
    compile_method(
        "structure_tensor", scene.estimate.settings.model_dump(mode="json"), build_sensor_chain(scene.sensor).dtype.name
    )
    known = list(estimate_tile.signatures)
    recording, _ = st.simulate(scene)
    st.estimate(recording)
    # Images of a store cannot be written to, those in memory can.
    st.save_store(recording, tmp_path / "recording.zarr")
    st.estimate(st.open_store(tmp_path / "recording.zarr"))
    assert estimate_tile.signatures == known


@pytest.mark.parametrize("method", ["structure_tensor", "refined", "plane_sweep"])
@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_of_its_images_methods_tell_all_they_can(method: str, dtype: str) -> None:
    """Disparity 2 px and flow (1, 0) px per frame: a method that knows nothing would leave kernels out."""
    found = st.estimate(small_recording(dtype), method).sel(t=0)
    known = found["disparity"].notnull()
    assert known.mean() > 0.15  # The images are small: windows of most pixels reach beyond them.
    assert np.median(found["disparity"].values[known]) == pytest.approx(2, abs=0.1)
    if method != "plane_sweep":
        assert np.nanmedian(found["flow"][0]) == pytest.approx(1, abs=0.1)


@pytest.mark.filterwarnings("ignore::scenetruth.SceneWarning")
def test_the_last_of_the_truth_was_compiled_beforehand() -> None:
    compile_late_truth_kernels()
    names = ["find_runs", "_look_at_runs", "_look_at_points", "sort_into_cells", "_hide_points"]
    kernels = [getattr(visibility_kernels, name) for name in names]
    kernels += [getattr(layer_kernels, name) for name in ("_face_sides", "_find_single")]
    known = [list(kernel.signatures) for kernel in kernels]
    assert all(known)
    st.simulate(st.Scene.from_dict(SCENE))
    assert [kernel.signatures for kernel in kernels] == known


def test_the_second_process_compiles_beside_a_first_run_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, str]] = []

    class Helper(FigureWorker):
        def compile_method(self, choice: MethodChoice, dtype: str) -> None:
            asked.append((choice.method, dtype))

        def compile_last_of_truth(self) -> None:
            asked.append(("", ""))

    scene = st.Scene.from_dict(SCENE)
    told: list[Callable[[str, int], None]] = []

    @contextmanager
    def announced(announce: Callable[[str, int], None]) -> Iterator[None]:
        told.append(announce)
        yield

    monkeypatch.setattr(scene_pipeline, "announced_compilation", announced)
    with scene_pipeline._compiling_in_parallel(Helper(), scene, [scene.estimate]):
        assert asked == []
        for before in range(3):
            told[0]("kernel", before)
    assert asked == [("structure_tensor", "uint8"), ("", "")]
    with scene_pipeline._compiling_in_parallel(None, scene, [scene.estimate]):
        pass
    assert len(told) == 1
