"""Simulation: what the recording says of itself, that it is the same every time, and what is refused."""

from __future__ import annotations

import gc
import hashlib
import json
import os
import subprocess
import sys
import weakref
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import scenetruth as st
from scenetruth.compilation import thread_count
from scenetruth.provenance import scene_hash
from scenetruth.truth import TruthTasks
from tests.helpers.nightly import nightly
from tests.helpers.scenes import SCENES, cube

SMALL = {"frames": {"count": 2}, "stage": {"positions": 3, "baseline_mm": 5.0}}


def test_recording_and_truth_describe_the_scene() -> None:
    scene = cube(**SMALL)
    recording, truth = st.simulate(scene)
    assert recording["image"].shape == (3, 2, 120, 160)
    assert recording["image"].dtype == np.float32
    assert truth["depth"].shape == (2, 120, 160)
    for dataset in (recording, truth):
        assert json.loads(dataset.attrs["scene"]) == scene.to_dict()
        assert dataset.attrs["scene_hash"] == scene_hash(scene)
        assert dataset.attrs["focal_length_px"] == 1254
        assert json.loads(dataset.attrs["versions"])["scenetruth"] == st.__version__
    assert recording.attrs["render_backend"] == "raycast"


def test_images_and_truth_show_the_same_surface() -> None:
    recording, truth = st.simulate(cube(**SMALL, background=0.0))
    lit = recording["image"].sel(s=0).values > 0
    seen = np.isfinite(truth["depth"].values)
    sure = ~truth["mixed"].values
    assert (lit == seen)[sure].all()


STAGED = {
    "positions": 3,
    "baseline_mm": 5.0,
    "scan": "bidirectional",
    "time_per_position_s": 0.1,
    "errors": {"preset": "screw_stage"},
}


LAG = {"after": "full_well", "effect": {"kind": "readout_lag", "lag": 0.05}}
REPEATED: dict[str, dict[str, Any]] = {
    "ideal": {},
    "sensor": {"sensor": {"bit_depth": 8, "noise_std": 0.01}},
    "preset": {"sensor": {"kind": "emva1288", "preset": "ccd_2002"}},
    "stage": {"stage": STAGED},
    # Frames enough for several threads to render one each, whose images depend on the previous one.
    "lag": {"sensor": {"kind": "emva1288", "preset": "industrial_cmos", "insert": [LAG]}, "frames": {"count": 5}},
}


def hashes_of(scenes: list[tuple[str, Any]]) -> dict[str, str]:
    """Return the hashes of what is made of scenes, in their order."""
    found = {}
    for name, plain in scenes:
        recording, truth = st.simulate(st.Scene.from_dict(plain))
        data = recording["image"].values.tobytes() + truth["depth"].values.tobytes()
        found[name] = hashlib.sha256(data).hexdigest()
    return found


@pytest.fixture(scope="module")
def hashes() -> list[dict[str, str]]:
    """Return the hashes of all scenes by this process and by another one, which takes them in the opposite order."""
    scenes = [(name, cube(**{**SMALL, **changes}).to_dict()) for name, changes in REPEATED.items()]
    code = (
        "import sys, json\n"
        "from tests.test_simulation import hashes_of\n"
        "print(json.dumps(hashes_of(json.loads(sys.stdin.read()))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        input=json.dumps(scenes[::-1]),
        env={
            # Unless the user says otherwise, that of this process is drawn by chance.
            "PYTHONHASHSEED": "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1",
            "NUMBA_NUM_THREADS": "1" if thread_count() > 1 else "2",
            "PATH": "",
            "PYTHONPATH": os.pathsep.join(str(file.parents[1]) for file in (Path(st.__file__), Path(__file__))),
        },
        capture_output=True,
        text=True,
        check=True,
    )
    return [hashes_of(scenes), json.loads(done.stdout)]


@pytest.mark.parametrize("name", REPEATED)
def test_same_scene_same_bytes_in_another_process_and_with_another_hash_seed(
    hashes: list[dict[str, str]], name: str
) -> None:
    one, two = hashes
    assert one[name] == two[name]


def test_every_image_has_noise_of_its_own() -> None:
    uniform = {
        "name": "wall",
        "mesh": {"kind": "plane", "size_mm": [400, 400]},
        "pose": {"position_mm": [0, 0, 660]},
        "texture": {"kind": "uniform"},
    }
    recording, _ = st.simulate(cube(**SMALL, objects=[uniform], sensor={"bit_depth": None, "noise_std": 0.1}))
    noise = recording["image"].values.reshape(6, -1) - 0.5
    correlation = np.corrcoef(noise) - np.eye(6)
    # Independent images of 19,200 pixels: a correlation beyond 5 / sqrt(19,200) would be chance once in a million.
    assert np.abs(correlation).max() < 5 / np.sqrt(noise.shape[1])
    assert noise.std() == pytest.approx(0.1, rel=0.02)


def test_another_seed_gives_another_texture_and_the_same_truth() -> None:
    (one, truth_one), (two, truth_two) = (st.simulate(cube(**SMALL, seed=seed)) for seed in (1, 2))
    assert abs(np.corrcoef(one["image"].values.ravel(), two["image"].values.ravel())[0, 1]) < 0.9
    xr.testing.assert_equal(truth_one, truth_two)


def test_truth_of_all_cameras_on_request() -> None:
    _, truth = st.simulate(cube(**SMALL), truth_views="all")
    assert truth["depth"].dims == ("s", "t", "y", "x")


def test_progress_counts_images_and_maps() -> None:
    calls: list[tuple[str, int, int]] = []
    st.simulate(cube(**SMALL), progress=lambda *call: calls.append(call))
    assert [call for call in calls if call[0] == "render"] == [("render", n, 6) for n in range(7)]
    assert [call for call in calls if call[0] == "truth"] == [("truth", n, 8) for n in range(9)]


def test_plaid_is_the_papers_formula() -> None:
    """scenes/plaid.yaml against eq. 13 of the paper, in its own symbols."""
    recording, truth = st.simulate(st.load_scene(SCENES / "plaid.yaml"))
    focal, z0, v_x, (u_x, u_y, u_z) = 10.0, 100.0, 1.0, (1.0, 0.0, 0.0)
    k = 2 * np.pi / 80
    s, t, y, x = xr.broadcast(recording.s, recording.t, recording.y - 31.5, recording.x - 31.5)
    z_t = z0 + u_z * t
    pattern = np.cos(k * (x * z_t / focal - u_x * t + v_x * s)) * np.cos(k * (y * z_t / focal - u_y * t))
    np.testing.assert_allclose(2 * recording["image"] - 1, pattern, atol=3e-7)
    assert (truth["depth"] == z0).all()
    assert (truth["disparity"] == 0.1).all()


def test_ideal_images_stand_beside_the_sensed_ones() -> None:
    sensor = {"noise_std": 0.05, "bit_depth": None}
    both, _ = st.simulate(cube(**SMALL, sensor=sensor), save_radiance=True)
    alone, _ = st.simulate(cube(**SMALL, sensor="ideal"))
    np.testing.assert_array_equal(both["radiance"], alone["image"])
    assert both["radiance"].attrs["units"] == "1"
    noise = both["image"].values.astype(np.float64) - both["radiance"].values
    assert noise.std() == pytest.approx(0.05, rel=0.01)
    plain, _ = st.simulate(cube(**SMALL, sensor=sensor))
    assert "radiance" not in plain
    np.testing.assert_array_equal(both["image"], plain["image"])


def test_ideal_images_are_kept_in_a_store(tmp_path: Path) -> None:
    recording, _ = st.simulate(cube(**SMALL, sensor={"noise_std": 0.05}), save_radiance=True)
    st.save_store(recording, tmp_path / "recording.zarr")
    np.testing.assert_array_equal(
        st.load_store(tmp_path / "recording.zarr", kind="recording")["radiance"], recording["radiance"]
    )


def test_scenes_are_rendered_to_disk_without_what_only_some_of_them_need(tmp_path: Path) -> None:
    heavy = ["trimesh", "pyrender", "OpenGL", "matplotlib", "embreex", "xarray", "pandas"]
    imported, rendered = [*heavy, "scipy", "numba", "zarr"], [*heavy, "scipy.sparse", "scipy.linalg"]
    code = (
        "import sys, scenetruth.simulation, scenetruth as st\n"
        f"print([name for name in {imported} if name in sys.modules])\n"
        "from tests.helpers.scenes import cube\n"
        f"st.run_scene(cube(**{SMALL}), stages=('render',), output={str(tmp_path / 'run')!r})\n"
        f"print([name for name in {rendered} if name in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["[]", "[]"]


PATH_WITHOUT_DASK = """
import sys
import scenetruth as st
from scenetruth.dataset.samples import compute_truth_statistics
from tests.helpers.scenes import cube

class NoDask:
    def find_spec(self, name, path=None, target=None):
        assert name.partition(".")[0] != "dask", "Dask is imported"

sys.meta_path.insert(0, NoDask())
recording, truth = st.simulate(cube(), overrides=["camera.width=40", "camera.height=30", "frames.count=2"])
st.save_store(truth, sys.argv[1])
print(compute_truth_statistics(st.open_store(sys.argv[1]))["seen_share"] > 0)
"""


@nightly
def test_neither_simulation_nor_samples_import_dask(tmp_path: Path) -> None:
    # Where it is installed, xarray imports it to recognise its arrays: half a second of every process.
    command = [sys.executable, "-W", "ignore", "-c", PATH_WITHOUT_DASK, str(tmp_path / "truth.zarr")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "True", done.stderr


@pytest.mark.parametrize(
    "call", [st.simulate, st.make_truth, partial(st.run_scene, output="nowhere")], ids=["simulate", "truth", "run"]
)
def test_wrong_arguments_are_named_together(
    call: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(st.ArgumentError) as caught:
        call(cube(), truth_views="al", truth_poses=None, truth_content=2, progress=3)
    names = [problem.path for problem in caught.value.problems]
    assert sorted(names) == ["progress", "truth_content", "truth_poses", "truth_views"]
    with pytest.raises(st.ArgumentError, match=r"scene: must be a scene, its values, .* \(got 'int'\)"):
        call(3)
    assert list(tmp_path.iterdir()) == []


def test_nothing_of_a_simulation_is_left_without_the_garbage_collector(monkeypatch: pytest.MonkeyPatch) -> None:
    # Objects that refer to each other are freed late: 100 to 500 MB for each simulation of a plant.
    made: list[weakref.ref[Any]] = []

    class Watched(TruthTasks):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            made.append(weakref.ref(self))

    monkeypatch.setattr("scenetruth.simulation.TruthTasks", Watched)
    scene = cube(**SMALL)
    gc.collect()
    gc.disable()
    try:
        st.simulate(scene)
        assert [each() for each in made] == [None]
    finally:
        gc.enable()
