"""Photometric files (IESNA LM-63): what is read from them, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.camera import Viewpoint
from scenetruth.provenance import scene_hash
from scenetruth.render import choose_renderer
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.light_distribution import load_distribution
from scenetruth.scene.lighting import Lighting
from scenetruth.scene.scene_report import find_lighting_problems
from tests.helpers.scenes import cube

Floats = NDArray[np.float64]
VERTICAL = np.arange(0.0, 91.0, 1.0)
POWER = 4
AT = {"kind": "ies", "position_mm": [0, 0, -50], "direction": [0, 0, 1], "irradiance": 1, "reference_distance_mm": 700}


def ies(
    vertical: Floats, horizontal: Floats, intensity: Floats, head: str = "IESNA:LM-63-2002\n[TEST] none\nTILT=NONE"
) -> str:
    """Return the text of a file; intensity: shape (horizontal, vertical)."""
    text = f"{head}\n1 -1 2.5 {len(vertical)} {len(horizontal)} 1 2 0 0 0\n1.0 1.0 50\n"
    rows = [vertical, horizontal, *intensity]
    return text + "".join(" ".join(f"{value:.10g}" for value in row) + "\n" for row in rows)


def cosine() -> str:
    """Return the file of a lamp with the intensity cos^n."""
    return ies(VERTICAL, np.zeros(1), 800 * np.cos(np.deg2rad(VERTICAL))[None] ** POWER)


def write(folder: Path, text: str) -> Path:
    file = folder / "lamp.ies"
    file.write_bytes(text.encode("latin-1"))
    return file


def test_flux_of_a_lamp_with_a_power_of_the_cosine(tmp_path: Path) -> None:
    found = load_distribution(write(tmp_path, cosine()))
    nodes, weights = np.polynomial.legendre.leggauss(200)
    cosines = 0.5 * (nodes + 1)
    relative = found.at(np.rad2deg(np.arccos(cosines)), np.full(200, 77.0))
    # Linear interpolation between angles h apart: the error of a function f is at most h² max |f''| / 8.
    limit = np.deg2rad(1.0) ** 2 * POWER**2 / 8
    assert relative == pytest.approx(cosines**POWER, abs=limit)
    assert np.pi * weights @ relative == pytest.approx(2 * np.pi / (POWER + 1), abs=2 * np.pi * limit)
    assert found.at(np.array([90.1, 180.0]), np.zeros(2)).tolist() == [0.0, 0.0]


def test_irradiance_of_a_plane_by_a_lamp_with_a_power_of_the_cosine(tmp_path: Path) -> None:
    """E cos^n (θ) cos^3 (θ) on a plane in front of the lamp, with E at the foot of its axis."""
    file = write(tmp_path, cosine())
    plane = {"name": "plane", "mesh": {"kind": "plane", "size_mm": [900, 900]}, "pose": {"position_mm": [0, 0, 650]}}
    scene = st.Scene.from_dict(
        {
            "camera": {"width": 25, "height": 21, "focal_length_px": 20},
            "stage": {"positions": 1, "baseline_mm": 1},
            "frames": {"count": 1},
            "sensor": "ideal",
            "render": {"backend": "raycast"},
            "objects": [{**plane, "texture": {"kind": "uniform", "radiance": 0.5}}],
            "lighting": {"lights": [{**AT, "file": str(file)}]},
        }
    )
    with choose_renderer(scene, build_scene(scene)).renderer as renderer:
        found = renderer.render(0.0, Viewpoint.on_axis(0.0))
    x, y = (np.arange(25) - 12) / 20 * 650, (np.arange(21) - 10) / 20 * 650
    cosines = 700 / np.sqrt(x[None] ** 2 + y[:, None] ** 2 + 700**2)
    # The mean over a pixel differs from its centre by the second derivatives times 1/24 px².
    pixel = (650 / 20 / 700) ** 2 * (POWER + 3) ** 2 / 12
    expected = 0.5 * cosines ** (POWER + 3)
    assert found == pytest.approx(expected, abs=0.5 * (np.deg2rad(1.0) ** 2 * POWER**2 / 8 + pixel))
    # Along the axis, where all angles of the file are exact.
    assert found[10, 12] == pytest.approx(0.5, rel=pixel)


@pytest.mark.parametrize("last", [90.0, 180.0, 300.0, 360.0])
def test_symmetries(tmp_path: Path, last: float) -> None:
    """A pattern that has the symmetry which the last horizontal angle states."""

    def pattern(around: Floats) -> Floats:
        wave = {90.0: 2, 180.0: 1}.get(last)
        turned = np.deg2rad(around)
        return 2 + (np.cos(wave * turned) if wave else np.sin(turned))

    horizontal = np.arange(0.0, last + 1, 10.0)
    rows = pattern(horizontal)[:, None] * np.array([1.0, 0.5, 0.25])
    found = load_distribution(write(tmp_path, ies(np.array([0.0, 45.0, 90.0]), horizontal, rows)))
    around = np.arange(-180.0, 180.0, 10.0)
    if last == 300.0:
        around = around[(around % 360 <= 300)]
    for vertical, level in ((0.0, 1.0), (45.0, 0.5), (67.5, 0.375)):
        value = found.at(np.full(len(around), vertical), around)
        assert value == pytest.approx(level * pattern(around) / rows.max(), rel=1e-9)


def test_frame_of_the_lamp(tmp_path: Path) -> None:
    """As seen from behind the lamp, horizontal angles increase counter-clockwise from `zero_direction`."""
    rows = np.array([4.0, 3.0, 2.0, 1.0, 4.0])[:, None] * np.ones(2)
    file = write(tmp_path, ies(np.array([0.0, 90.0]), np.arange(0.0, 361.0, 90.0), rows))
    light = {**AT, "file": str(file), "position_mm": [0, 0, 0], "zero_direction": [1, 0, 3]}
    (lamp,) = Lighting.model_validate({"lights": [light]}).lamps_at(0.0)
    # With z forward, x right and y down, counter-clockwise leads from right to up.
    towards = np.array([[1.0, 0, 1], [0, -1, 1], [-1, 0, 1], [0, 1, 1]]) / np.sqrt(2)
    assert lamp.relative_intensity(-towards) == pytest.approx([1.0, 0.75, 0.5, 0.25])
    turn = {"kind": "rotation", "axis": [0, 0, 1], "rate_deg_per_frame": 45.0}
    (lamp,) = Lighting.model_validate({"lights": [{**light, "motion": [turn]}]}).lamps_at(2.0)
    # x turns to y.
    assert lamp.relative_intensity(-towards) == pytest.approx([0.75, 0.5, 0.25, 1.0])


@pytest.mark.parametrize(
    "head", ["TILT=NONE", "IESNA91\n[MANUFAC] x\nTILT = none", "IESNA:LM-63-1995\r\n[MORE] 1 2\r\nTILT=NONE\r"]
)
def test_versions_and_commas(tmp_path: Path, head: str) -> None:
    text = ies(VERTICAL, np.zeros(1), np.cos(np.deg2rad(VERTICAL))[None], head).replace(" ", ", ")
    found = load_distribution(write(tmp_path, text.replace("TILT, =, ", "TILT = ")))
    assert found.at(np.array([60.0]), np.zeros(1)) == pytest.approx([0.5])


WRONG = {
    "no tilt": (("TILT=NONE", ""), "lamp.ies: is not an IES file"),
    "tilted": (("TILT=NONE", "TILT=INCLUDE"), r"line 3: .*export the file with TILT=NONE \(got 'TILT=INCLUDE'\)"),
    "word": (("1.0 1.0 50", "1.0 x 50"), r"line 5: must be a finite number \(got 'x'\)"),
    "endless": (("1.0 1.0 50", "1.0 inf 50"), r"line 5: must be a finite number \(got 'inf'\)"),
    "type B": ((" 91 1 1 2", " 91 1 2 2"), r"line 4: photometry of type A .*convert it to type C \(1\) \(got 2"),
    "fraction": ((" 91 1 1 2", " 91.5 1 1 2"), r"line 4: the number of vertical angles must be a whole number"),
    "too many": ((" 91 1 1 2", " 91 1e9 1 2"), r"line 4: the number of horizontal angles must be a whole number"),
    "dark": (("2.5", "-2.5"), r"line 4: the multiplier of the intensities must be positive \(got -2.5\)"),
    "missing": ((" 91 1 1 2", " 90 1 1 2"), r"line 4: has 183 numbers .* are 181; export it again"),
    "falling": (("0 1 2 3 4", "0 1 3 2 4"), r"line 6: vertical angles must ascend \(got 2.0\)"),
    "begin": (("\n0 1 2", "\n0.5 1 2"), r"line 6: the first vertical angle must be 0 or 90° \(got 0.5\)"),
    "end": (("89 90", "89 91"), r"line 6: the last vertical angle must be 90 or 180° \(got 91.0\)"),
    "around": (("90\n0\n", "90\n5\n"), r"line 7: the first horizontal angle must be 0; .*\(got 5.0\)"),
    "negative": (("800 ", "-800 "), r"line 8: intensities must not be negative \(got -800.0\)"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_named(tmp_path: Path, name: str) -> None:
    (old, new), message = WRONG[name]
    text = cosine()
    assert old in text
    scene = cube(lighting={"lights": [{**AT, "file": str(write(tmp_path, text.replace(old, new, 1)))}]})
    problems = find_lighting_problems(scene, build_scene(scene))
    assert [problem.path for problem in problems] == ["lighting.lights.0.file"]
    with pytest.raises(st.SceneError, match=message):
        raise st.SceneError(problems)


def test_problems_of_all_files_and_lines_at_once(tmp_path: Path) -> None:
    text = cosine().replace("\n0 1 2", "\n0.5 1 2").replace("800 ", "-800 ")
    lights = [{**AT, "file": str(write(tmp_path, text))}, {**AT, "file": "none.ies"}, {**AT, "file": str(tmp_path)}]
    scene = cube(lighting={"lights": lights})
    messages = [str(problem) for problem in find_lighting_problems(scene, build_scene(scene))]
    assert [message.partition(":")[0] for message in messages] == [f"lighting.lights.{n}.file" for n in (0, 0, 1, 2)]
    assert "no such IES file" in messages[2]
    assert "is a directory" in messages[3]


def test_axes_that_are_not_given(tmp_path: Path) -> None:
    lights = [
        {**AT, "file": "a.ies", "zero_direction": [0, 0, 2]},
        {**AT, "file": "a.ies", "target_mm": [0, 0, 600]},
    ]
    with pytest.raises(st.SceneError) as raised:
        cube(lighting={"lights": lights})
    assert "zero_direction must not be parallel to the axis" in str(raised.value)
    assert "specify either direction or target_mm" in str(raised.value)


def test_the_content_of_the_file_is_part_of_the_scene(tmp_path: Path) -> None:
    scene = cube(lighting={"lights": [{**AT, "file": str(write(tmp_path, cosine()))}]})
    before = scene_hash(scene)
    write(tmp_path, cosine().replace("800 ", "801 "))
    assert scene_hash(scene) != before


PIECES = some.sampled_from(
    ["1", "-1", "0", "90", "1e400", "nan", "TILT=NONE", "TILT=", "\n", "x", "\0", "999999999", ""]
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(some.lists(some.tuples(some.integers(0, 400), PIECES), min_size=1, max_size=4), some.integers(0, 2000))
def test_broken_files_are_read_or_refused(
    tmp_path: Path, changes: list[tuple[int, str]], length: int
) -> None:  # fmt: skip
    words = cosine().replace("\n", " \n ").split(" ")
    for place, piece in changes:
        words[place % len(words)] = piece
    file = write(tmp_path, " ".join(words)[: max(length, 0) or None])
    problems = []
    try:
        found = load_distribution(file)
    except st.SceneError as error:
        problems = list(error.problems)
    assert all(problem.path == "file" and "lamp.ies" in problem.message for problem in problems)
    if problems:
        return
    value = found.at(np.linspace(0, 180, 50), np.linspace(-180, 180, 50))
    assert np.isfinite(value).all()
    assert value.min() >= 0
    assert value.max() <= 1


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_line_is_named_once_with_its_number_of_wrong_values(tmp_path: Path, count: int) -> None:
    *before, line = cosine().rstrip("\n").split("\n")
    words = line.split()
    file = write(tmp_path, "\n".join([*before, " ".join([f"-{each}" for each in words[:count]] + words[count:])]))
    with pytest.raises(st.SceneError) as caught:
        load_distribution(file)
    (problem,) = caught.value.problems
    assert "intensities must not be negative" in problem.message
    assert (f", {count} numbers" in problem.message) == (count > 1)
    assert problem.value == -float(words[0])
