"""Simulated captures: contents, agreement of images and truth, determinism, resumption and rejected input."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

import scenetruth as st
from scenetruth.capture import Capture, check_capture, measure_linearity, open_capture, simulate_capture
from scenetruth.errors import ArgumentError, OutputExistsError, SceneError
from tests.helpers.nightly import by_night, nightly
from tests.helpers.scenes import cube

Array = NDArray[np.float64]

WIDTH, HEIGHT = 240, 180
LENS = {"k1": -0.3, "k2": 1.5, "p1": 1e-3, "p2": -8e-4}
SCENE: dict[str, Any] = {
    "camera": {
        "width": WIDTH,
        "height": HEIGHT,
        "focal_length_px": 1900,
        "principal_point_px": [122.4, 86.1],
        "distortion": LENS,
    },
    "optics": {"psf": {"kind": "gaussian", "sigma_px": 0.7}},
    "stage": {
        "positions": 3,
        "baseline_mm": 4.0,
        "axis_tilt_urad": [900, -2000],
        "errors": {"preset": "screw_stage", "yaw_urad": 800},
    },
    "frames": {"count": 2, "frame_interval_s": 60},
    "sensor": {"kind": "emva1288", "preset": "industrial_cmos"},
    "seed": 11,
}
BOARD = {"kind": "dots", "dots": [6, 5], "spacing_mm": 9, "diameter_mm": 4.5}
SETTINGS: dict[str, Any] = {
    "board": BOARD,
    "poses": 3,
    "dark": 2,
    "flat": 2,
    "static": 3,
    "strip": True,
    "scale_std": 1e-3,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_capture(cube(**SCENE), tmp_path_factory.mktemp("capture") / "c", **SETTINGS)


def read(path: Path) -> Array:
    with Image.open(path) as image:
        return np.asarray(image, dtype=np.float64)


def parameters(folder: Path) -> dict[str, Any]:
    values: dict[str, Any] = yaml.safe_load((folder / "truth" / "parameters.yaml").read_text())
    return values


def project(world: Array, camera: dict[str, Any], visit: dict[str, Any]) -> Array:
    """Project points by the formulas of the conventions."""
    axes = Rotation.from_rotvec(visit["rotation_rad"]).as_matrix()
    points = (world - visit["position_mm"]) @ axes
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    lens, square = camera["distortion"], x * x + y * y
    radial = 1 + lens["k1"] * square + lens["k2"] * square**2
    x_d = x * radial + 2 * lens["p1"] * x * y + lens["p2"] * (square + 2 * x * x)
    y_d = y * radial + lens["p1"] * (square + 2 * y * y) + 2 * lens["p2"] * x * y
    return np.asarray(camera["focal_length_px"] * np.column_stack([x_d, y_d]) + camera["principal_point_px"])


def centroid(image: Array, place: Array, radius: float, paper: float) -> Array:
    """Return the centroid of a dark dot."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    near = np.hypot(x - place[0], y - place[1]) < radius
    weights = paper - image[near]
    return np.asarray(np.array([(weights * x[near]).sum(), (weights * y[near]).sum()]) / weights.sum())


def test_folder_holds_what_its_file_describes(folder: Path) -> None:
    plain = yaml.safe_load((folder / "capture.yaml").read_text())
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("*.tif")}
    expected = {f"board/p{pose:02d}_s{s:+d}.tif" for pose in range(3) for s in (-1, 0, 1)}
    expected |= {f"images/s{s:+d}_t{t:+d}.tif" for s in (-1, 0, 1) for t in (0, 1)}
    expected |= {f"static/n00{n}.tif" for n in (0, 1, 2)}
    expected |= {f"dark/d00{n}.tif" for n in (0, 1)} | {f"flat/f00{n}.tif" for n in (0, 1)}
    assert names == expected
    assert plain["camera"]["bit_depth"] == 12
    assert plain["camera"]["black_level_dn"] == 16
    assert {name: plain["stage"][name] for name in ("positions", "baseline_mm")} == {"positions": 3, "baseline_mm": 4}
    assert plain["board"] == {**BOARD, "spacing_mm": 9.0, "scale_std": 1e-3, "warp_mm": 0.02}
    assert plain["files"]["board"] == "board/p{pose:02d}_s{s:+d}.tif"
    # The data sheet is right to about 1 %, and no true parameter is in the file.
    assert 0 < abs(plain["camera"]["focal_length_px"] / 1900 - 1) < 0.02
    assert not {"distortion", "principal_point_px"} & plain["camera"].keys()
    assert not {"poses", "axis_tilt_urad"} & plain["stage"].keys()


def test_points_follow_from_the_true_parameters(folder: Path) -> None:
    true, points = parameters(folder), np.load(folder / "truth" / "points.npz")
    board, (a, b, c) = true["board"], true["board"]["warp_mm"]
    u = 9.0 * (np.arange(30) % 6) - 22.5
    v = 9.0 * (np.arange(30) // 6) - 18.0
    w = (a * u * u + b * u * v + c * v * v) / 22.5**2
    assert (board["half_width_mm"], abs(board["scale"]) < 5e-3) == (22.5, True)
    flat = np.column_stack([(1 + board["scale"]) * u, (1 + board["scale"]) * v, w])
    for visit in board["visits"]:
        pose = board["poses"][visit["pose"]]
        world = flat @ np.array(pose["rotation"]).T + pose["position_mm"]
        expected = project(world, true["camera"], visit)
        np.testing.assert_allclose(points["board"][visit["pose"], visit["s"] + 1], expected, rtol=0, atol=1e-8)
    strip = np.loadtxt(folder / "strip.csv", delimiter=",", skiprows=1)
    for visit in true["stage"]["visits"]:
        middle = (strip.max(axis=0) + strip.min(axis=0)) / 2
        world = (1 + true["strip"]["scale"]) * (strip - middle) @ np.array(true["strip"]["rotation"]).T
        expected = project(world + true["strip"]["position_mm"], true["camera"], visit)
        np.testing.assert_allclose(points["strip"][visit["s"] + 1, visit["t"]], expected, rtol=0, atol=1e-8)


def test_dots_in_the_images_are_where_the_truth_puts_them(folder: Path) -> None:
    points = np.load(folder / "truth" / "points.npz")
    errors = []
    for pose in range(3):
        for s in (-1, 0, 1):
            image = read(folder / "board" / f"p{pose:02d}_s{s:+d}.tif")
            places = points["board"][pose, s + 1]
            paper = np.median(image[image > np.median(image)])
            errors.append([centroid(image, place, 9.0, paper) - place for place in places])
    # Noise of 1 % in 250 pixels of a dot of 12.8 px moves its centroid by about 0.01 px; tilts of 40° by up to 0.02 px.
    mean, scatter = np.mean(errors, axis=(0, 1)), np.std(errors, axis=(0, 1))
    assert np.abs(mean).max() < 0.01
    assert scatter.max() < 0.03
    errors = []
    for s in (-1, 0, 1):
        for t in (0, 1):
            image, places = read(folder / "images" / f"s{s:+d}_t{t:+d}.tif"), points["strip"][s + 1, t]
            paper = np.percentile(image[np.hypot(*(np.indices(image.shape)[::-1] - places[8][:, None, None])) < 11], 80)
            errors.append([centroid(image, place, 9.0, paper) - place for place in places])
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.01
    assert np.std(errors, axis=(0, 1)).max() < 0.03


def test_dark_and_flat_images_are_those_of_the_sensor(folder: Path) -> None:
    true = parameters(folder)
    effects = {effect["kind"]: effect for effect in true["sensor"]["effects"]}
    rate, time = (effects["photon_conversion"][name] for name in ("photon_rate_per_s", "exposure_time_s"))
    electrons = true["flat_radiance"] * rate * time * effects["quantum_efficiency"]["quantum_efficiency"]
    expected = {"dark": 0.0, "flat": electrons}
    for name, light in expected.items():
        images = [read(path) for path in sorted((folder / name).iterdir())]
        level = effects["gain"]["black_level_dn"] + effects["gain"]["gain_dn_per_e"] * (light + 0.05)
        # Shot noise of 86,400 pixels, and the fixed pattern of 43,200.
        assert np.mean(images) == pytest.approx(level, abs=0.2 + 1e-4 * level)
        assert (images[0] != images[1]).mean() > 0.5


def test_static_images_differ_by_noise_alone(folder: Path) -> None:
    effects = {effect["kind"]: effect for effect in parameters(folder)["sensor"]["effects"]}
    gain, black = (effects["gain"][name] for name in ("gain_dn_per_e", "black_level_dn"))
    images = np.array([read(path) for path in sorted((folder / "static").iterdir())])
    mean, variance = images.mean(axis=0) - black, images.var(axis=0, ddof=1)
    dark = gain**2 * (effects["readout_noise"]["temporal_dark_noise_e"] ** 2 + 0.05) + 1 / 12
    # Photon transfer: the variance of shot noise is K times the mean. 43,200 variances with 2 degrees of freedom are
    # known to 0.5 %.
    assert variance.mean() == pytest.approx(gain * mean.mean() + dark, rel=0.025)
    reference = read(folder / "images" / "s+0_t+0.tif")
    error = (reference - images.mean(axis=0)) / np.sqrt((gain * np.maximum(mean, 0) + dark) * 4 / 3)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(1, abs=0.03)


@nightly
def test_a_noise_seed_repeats_a_capture_with_other_noise(folder: Path, tmp_path: Path) -> None:
    given = {**SETTINGS, "poses": 0, "static": 0, "noise_seed": 5, "truth_maps": False}
    again = simulate_capture(cube(**SCENE), tmp_path / "again", **given)
    assert not (again / "truth" / "truth.zarr").exists()
    for name in ("stage", "strip"):
        first, second = (parameters(each)[name] for each in (folder, again))
        assert {key: value for key, value in first.items() if key != "step_scale"} == {
            key: value for key, value in second.items() if key != "step_scale"
        }
    images = [read(each / "images" / "s+1_t+0.tif") for each in (folder, again)]
    mean = np.maximum(images[0] + images[1], 0) / 2 - 16.0
    bright = mean > 200
    assert bright.sum() > 1000
    # Shot noise of both with the gain of the preset, and up to 30 % more by fixed patterns, readout and rounding.
    difference = (images[0] - images[1])[bright] / np.sqrt(2 * 0.39 * mean[bright])
    assert 0.95 < np.median(np.abs(difference)) * 1.4826 < 1.3


@nightly
def test_images_and_truth_are_those_of_the_true_scene(tmp_path: Path) -> None:
    scene = cube(**SCENE)
    folder = simulate_capture(scene, tmp_path / "c", board=BOARD, poses=0, dark=0, flat=0, static=0, step_std=1e-3)
    assert not (folder / "board").exists()
    recording, truth = st.simulate(st.load_scene(folder / "truth" / "scene.yaml"))
    for s in (-1, 0, 1):
        for t in (0, 1):
            image = read(folder / "images" / f"s{s:+d}_t{t:+d}.tif")
            np.testing.assert_array_equal(image, recording["image"].sel(s=s, t=t))
    stored = st.load_store(folder / "truth" / "truth.zarr", kind="truth")
    np.testing.assert_array_equal(stored["depth"], truth["depth"])
    # The true poses are those that the scene draws, but for the step length.
    drawn = st.make_truth(scene)
    off = truth["camera_position_mm"] - drawn["camera_position_mm"]
    scale = parameters(folder)["stage"]["step_scale"]
    assert 1e-5 < abs(scale) < 5e-3
    np.testing.assert_allclose(off.sel(t=0).values, scale * np.array([[-4, 0, 0], [0, 0, 0], [4, 0, 0]]), atol=1e-9)
    np.testing.assert_allclose(truth["camera_rotation_rad"], drawn["camera_rotation_rad"], rtol=0, atol=1e-12)
    assert st.load_scene(folder / "truth" / "scene.yaml").stage.errors == scene.stage.errors


LAG = {"after": "full_well", "effect": {"kind": "readout_lag", "lag": 0.05}}
GRID: dict[str, Any] = {
    "rows": 2,
    "row_spacing_mm": 3,
    "scan": "bidirectional",
    "time_per_position_s": 2,
    "errors": {"preset": "screw_stage"},
}
SMALL = {"width": 96, "height": 72, "focal_length_px": 760}


@nightly
@pytest.mark.parametrize(
    "changes",
    [
        {"stage": {"positions": 3, "baseline_mm": 3, **GRID}},
        {"sensor": {"kind": "emva1288", "preset": "industrial_cmos", "insert": [LAG]}},
        {"shutter": {"exposure_time_s": 0.01, "readout_time_s": 0.01, "stage_speed_mm_per_s": 5, "samples": 2}},
        {"optics": {"defocus": {"aperture_mm": 3, "focus_distance_mm": 680, "samples": 4}, "vignetting": {}}},
    ],
    ids=["grid", "image lag", "shutter", "lens"],
)
def test_other_rigs_give_the_images_of_their_true_scene(changes: dict[str, Any], tmp_path: Path) -> None:
    scene = cube(**{**SCENE, "camera": SMALL, "optics": {}, **changes})
    counts: dict[str, Any] = {"poses": 1, "dark": 0, "flat": 0, "static": 0}
    folder = simulate_capture(scene, tmp_path / "c", board="checkerboard", **counts)
    recording, _ = st.simulate(st.load_scene(folder / "truth" / "scene.yaml"))
    names = {path.name for path in (folder / "images").iterdir()}
    image = recording["image"].stack(index=[dim for dim in recording["image"].dims if dim not in ("y", "x")])
    for index in image["index"].values:
        row = f"r{index[0]:+d}_" if len(index) == 3 else ""
        name = f"{row}s{index[-2]:+d}_t{index[-1]:+d}.tif"
        names.remove(name)
        np.testing.assert_array_equal(read(folder / "images" / name), image.sel(index=index))
    assert not names


def test_interrupted_captures_are_resumed_with_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    files = {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    missing = {Path("board/p01_s+0.tif"), Path("images/s+1_t+1.tif"), Path("capture.yaml"), Path("truth/points.npz")}
    for name, content in files.items():
        if name not in missing:
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_bytes(content)
    (tmp_path / "notes.txt").write_text("mine")
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}
    simulate_capture(cube(**SCENE), tmp_path, **SETTINGS)
    for name in missing:
        assert (tmp_path / name).read_bytes() == files[name]
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_other_folders_are_left_alone(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(OutputExistsError, match="another scene, other settings"):
        simulate_capture(cube(**{**SCENE, "seed": 12}), folder, **SETTINGS)
    (tmp_path / "mine").write_text("mine")
    with pytest.raises(OutputExistsError, match="not a directory of a simulated capture"):
        simulate_capture(cube(**SCENE), tmp_path, **SETTINGS)
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


@nightly
@pytest.mark.parametrize("kind", ["charuco", *by_night("checkerboard", "dots", "asymmetric_dots")])
def test_boards_of_default_size_fit(kind: str, tmp_path: Path) -> None:
    if kind == "charuco":
        pytest.importorskip("cv2")
    folder = simulate_capture(cube(**{**SCENE, "frames": {"count": 1}}), tmp_path / "c", board=kind, dark=0, flat=0)
    points = np.load(folder / "truth" / "points.npz")["board"]
    inside = ((points > 0) & (points < (WIDTH - 1, HEIGHT - 1))).all(axis=-1).mean()
    assert inside > (0.8 if kind == "charuco" else 0.999)
    # Boards fill the field of view: it is covered in every direction.
    assert (np.ptp(points.reshape(-1, 2), axis=0) > 0.6 * np.array([WIDTH, HEIGHT])).all()


def test_all_wrong_settings_are_named_together(tmp_path: Path) -> None:
    board = {"kind": "dots", "dots": [5, 4], "spacing_mm": -3}
    with pytest.raises(ArgumentError) as caught:
        simulate_capture(cube(**SCENE), tmp_path / "c", board=board, scale_std=0, flats=3)
    paths = [problem.path for problem in caught.value.problems]
    assert paths == ["board.spacing_mm", "scale_std", "flats"]
    assert "flats: unknown key; did you mean 'flat'?" in str(caught.value)
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        ({"position_mm": [0, 0, -660]}, "must lie in front of the camera"),
        ({"position_mm": [0, 0, 660], "rotation_deg": [180, 0, 0]}, "shows the back of the board"),
        ({"position_mm": [0, 0, 20], "rotation_deg": [80, 0, 0]}, "must lie in front of the camera"),
    ],
)
def test_poses_that_no_camera_sees_are_rejected(pose: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=rf"poses\.0: {message}"):
        simulate_capture(cube(**SCENE), tmp_path / "c", board=BOARD, poses=[pose])
    assert not (tmp_path / "c").exists()


def test_steps_that_no_stage_makes_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="step_std: gives positions that the stage cannot have"):
        simulate_capture(cube(**SCENE), tmp_path / "c", poses=0, step_std=100)


def test_boards_beyond_the_images_are_rejected(tmp_path: Path) -> None:
    far = [{"position_mm": [0, 0, 660]}, {"position_mm": [30, 0, 660]}]
    with pytest.raises(ArgumentError, match=r"poses\.1: must have all of its points inside all images"):
        simulate_capture(cube(**SCENE), tmp_path / "c", board={**BOARD, "spacing_mm": 7, "diameter_mm": 3}, poses=far)


def test_sensors_without_digital_numbers_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"sensor: must return digital numbers"):
        simulate_capture(cube(**{**SCENE, "sensor": "ideal"}), tmp_path / "c", **SETTINGS)


def test_poses_of_the_board_are_scanned_like_frames(tmp_path: Path) -> None:
    stage = {"positions": 3, "baseline_mm": 4.0, "scan": "bidirectional", "errors": {"backlash_um": 200}}
    scene = cube(**{**SCENE, "camera": SMALL, "stage": stage, "frames": {"count": 1}})
    settings: dict[str, Any] = {"board": BOARD, "poses": 3, "dark": 0, "flat": 0, "static": 0, "step_std": 0}
    visits = parameters(simulate_capture(scene, tmp_path / "c", **settings))["board"]["visits"]
    off_um = {(one["pose"], one["s"]): 1e3 * one["position_mm"][0] - 4e3 * one["s"] for one in visits}
    # The camera stops short by 100 µm. Where a scan reverses, it has not moved since the former image.
    expected = {(0, 0): -100, (0, 1): -100, (1, 1): -100, (1, 0): 100, (1, -1): 100, (2, -1): 100, (2, 0): -100}
    assert {at: off_um[at] for at in expected} == pytest.approx(expected, abs=1e-6)


def test_black_level_of_a_gamma_curve_is_that_of_its_dark_images(tmp_path: Path) -> None:
    sensor = {"kind": "emva1288", "preset": "industrial_cmos", "bit_depth": 8, "gain_dn_per_e": 0.024, "gamma": 0.45}
    scene = cube(**{**SCENE, "camera": SMALL, "sensor": sensor, "frames": {"count": 1}})
    folder = simulate_capture(scene, tmp_path / "c", poses=0, dark=1, flat=0)
    camera = yaml.safe_load((folder / "capture.yaml").read_text())["camera"]
    assert (camera["encoding"], camera["bit_depth"]) == ("gamma", 8)
    assert camera["gamma"] == pytest.approx(1 / 0.45)
    # Dark current and rounding add less than half a digital number.
    assert read(folder / "dark" / "d000.tif").mean() == pytest.approx(camera["black_level_dn"], abs=0.5)


EXPOSURES = (0.25, 0.5, 1.0, 2.0)
SENSOR: dict[str, Any] = {
    "kind": "emva1288",
    "preset": "industrial_cmos",
    "dark_current_e_per_s": 40_000.0,
    "dsnu_e": 20,
}
SERIES: dict[str, Any] = {"poses": 0, "dark": 12, "flat": 4, "static": 0, "exposures": EXPOSURES, "step_std": 0}


def exposed(tmp_path: Path, sensor: dict[str, Any], **changes: Any) -> Path:
    stage = {"positions": 2, "baseline_mm": 4.0}
    scene = cube(**{**SCENE, "camera": SMALL, "stage": stage, "frames": {"count": 1}, "sensor": sensor})
    return simulate_capture(scene, tmp_path / "c", **{**SERIES, **changes})


def means(folder: Path, name: str) -> Array:
    """Return the mean images of all levels of a set."""
    files = [sorted((folder / name).glob(f"e{level}_*.tif")) for level in range(len(EXPOSURES))]
    return np.array([np.mean([read(file) for file in each], axis=0) for each in files])


def test_light_and_dark_current_are_proportional_to_the_exposure_time(tmp_path: Path) -> None:
    folder = exposed(tmp_path, SENSOR)
    plain = yaml.safe_load((folder / "capture.yaml").read_text())
    assert plain["files"]["dark"] == "dark/e{level}_*.tif"
    assert plain["files"]["exposure_times_s"] == [0.0025, 0.005, 0.01, 0.02]
    assert plain["camera"]["exposure_time_s"] == 0.01
    dark, flat = means(folder, "dark"), means(folder, "flat")
    gain = 0.39  # DN per electron
    growth = np.polyfit(EXPOSURES, dark.mean(axis=(1, 2)), 1)[0]
    # 400 electrons at the exposure of the images.
    assert growth == pytest.approx(400 * gain, rel=0.01)
    light = (flat - dark).mean(axis=(1, 2))
    # Noise of the mean of 4 x 3,072 pixels is below 1e-3 of the darkest level.
    np.testing.assert_allclose(light / light[2], EXPOSURES, rtol=3e-3)
    assert flat.max() < 4095
    # DSNU of 20 electrons, 7.8 DN, is one pattern; the mean of 12 dark frames has shot noise of up to 3.2 DN.
    assert np.corrcoef(dark.reshape(len(EXPOSURES), -1)).min() > 0.75


@nightly
@pytest.mark.parametrize(
    ("sensor", "exponent"),
    [
        ({**SENSOR, "dark_current_e_per_s": 0.0}, 1.0),
        ({"bit_depth": 12, "noise_std": 0.003}, 1.0),
        ({**SENSOR, "dark_current_e_per_s": 0.0, "gamma": 0.5, "black_level_dn": 0}, 0.5),
    ],
    ids=["linear", "gaussian", "gamma"],
)
def test_a_series_of_exposures_shows_the_response(sensor: dict[str, Any], exponent: float, tmp_path: Path) -> None:
    folder = exposed(tmp_path, sensor)
    # As the capture file of a laboratory that takes the camera for linear.
    plain = yaml.safe_load((folder / "capture.yaml").read_text())
    plain["camera"].pop("encoding", None)
    plain["camera"].pop("gamma", None)
    capture = Capture.from_dict(plain, folder=folder)
    captured = open_capture(capture)
    light = [float(captured.light_of_flat(level).mean()) for level in range(len(EXPOSURES))]
    times = [captured.sets["flat"].exposure_time_s(level) for level in range(len(EXPOSURES))]
    found = measure_linearity([time for time in times if time is not None], light)
    assert found.exponent == pytest.approx(exponent, abs=0.02)
    if exponent == 1.0:
        assert found.error < 3e-3
    report = check_capture(capture)
    assert ("gamma" in report.mistakes("error")) == (exponent != 1.0), [str(each) for each in report.findings]
    if exponent == 1.0:
        assert report.mistakes("error", "warning") == []


@nightly
@pytest.mark.parametrize("bright", [False, True], ids=["linear", "square root"])
def test_even_noise_is_distinguished_from_an_encoding(bright: bool, tmp_path: Path) -> None:
    """Even noise is added, or that of photons in square roots of the light: two exposures distinguish them."""
    sensor = {"bit_depth": 12, "noise_std": 0.003}
    folder = exposed(tmp_path, sensor, exposures=None, static=16, dark=4)
    assert yaml.safe_load((folder / "capture.yaml").read_text())["files"]["exposure_times_s"] == [0.005, 0.01]
    if bright:
        # The light is the square of the values: the fall-off of one exposure is no multiple of the other's.
        for file in (folder / "flat").glob("e0_*.tif"):
            Image.fromarray(np.rint(read(file) * np.sqrt(2.0)).astype(np.uint16)).save(file)
    report = check_capture(folder)
    assert report.mistakes("error", "warning") == (["gamma"] if bright else [])
    assert any("does not depend on the light" in str(each) for each in report.findings) is not bright


@pytest.mark.parametrize("exposures", [(1.0, 0.5), (0.5, 0.5, 1.0), (0.5, 2.0), (0.0, 1.0)])
def test_exposures_increase_and_contain_that_of_the_images(exposures: tuple[float, ...], tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="exposures"):
        exposed(tmp_path, SENSOR, exposures=exposures)
