"""Scenes to start from: valid, told what they are, never over a file, and meshes in full view."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as any_
from PIL import Image

import scenetruth as st
from scenetruth.cli.scene_templates import mesh_template, place_mesh, scene_text
from tests.helpers.command_line import scenetruth

# Two rectangles, one behind the other, at a slant: corners in units of half sizes.
CORNERS = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=np.float64)
FACES = [(0, 1, 3), (0, 3, 2), (4, 5, 7), (4, 7, 6)]


def write_mesh(
    file: Path, middle: tuple[float, ...] = (0, 0, 0), size: tuple[float, ...] = (40, 30, 20), more: int = 0
) -> Path:
    """Write a mesh in OFF, with some more vertices, far away, that no face uses."""
    vertices = np.vstack([np.array(middle) + CORNERS * np.array(size) / 2, np.full((more, 3), 1e6)])
    lines = ["OFF", f"{len(vertices)} {len(FACES)} 0"]
    lines += [" ".join(map(repr, map(float, vertex))) for vertex in vertices]
    lines += [f"3 {a} {b} {c}" for a, b, c in FACES]
    file.write_text("\n".join(lines) + "\n")
    return file


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("kind", ["cube", "leaf", "mesh"])
def test_what_is_written_passes_check_without_a_warning(kind: str, here: Path) -> None:
    # An off-axis mesh of a size of its own.
    mesh = ("--mesh", write_mesh(here / "body.off", (300, -20, 1000))) if kind == "mesh" else ()
    done = scenetruth("init", "mine.yaml", "--type", kind, *mesh)
    assert done.returncode == 0, done.stderr
    assert "scenetruth check mine.yaml" in done.stdout
    done = scenetruth("check", "mine.yaml")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    text = (here / "mine.yaml").read_text()
    plain = st.load_scene("mine.yaml").to_dict()
    # Every block that is written has a sentence above it.
    lines = text.splitlines()
    blocks = [number for number, line in enumerate(lines) if line[:1].isalpha()]
    assert {lines[number].partition(":")[0] for number in blocks} <= set(plain)
    assert all(lines[number - 1].startswith("# ") for number in blocks)
    assert {"camera", "stage", "frames", "objects", "sensor", "render", "estimate", "score", "seed"} <= {
        lines[number].partition(":")[0] for number in blocks
    }


def test_without_options_it_is_a_cube_in_scene_yaml(here: Path) -> None:
    assert scenetruth("init").returncode == 0
    assert [item.name for item in st.load_scene("scene.yaml").objects] == ["cube"]
    again = scenetruth("init")
    assert again.returncode == 2
    assert "FILE: exists already" in again.stderr


SIZES = any_.builds(
    lambda scale, *sides: tuple(scale * side for side in sides),
    any_.sampled_from([0.01, 1.0, 30.0]),
    *[any_.floats(1, 200)] * 3,
)
PLACES = any_.tuples(*[any_.floats(-3000, 3000)] * 3)


@settings(max_examples=25)
@given(
    middle=PLACES, size=SIZES, unit_mm=any_.sampled_from([1.0, 0.001, 25.4]), far=any_.sampled_from([None, 3.0, 50.0])
)
def test_all_images_show_all_of_a_mesh(
    middle: tuple[float, ...],
    size: tuple[float, ...],
    unit_mm: float,
    far: float | None,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Projected here by x = f X / Z, from every position and at every frame that is written."""
    folder = tmp_path_factory.mktemp("mesh")
    file = write_mesh(folder / "body.off", middle, size, more=1)
    distance_mm = None if far is None else far * max(size) * unit_mm
    found = place_mesh(file, unit_mm, distance_mm)
    np.testing.assert_allclose(found.size_mm, np.array(size) * unit_mm, rtol=1e-6, atol=1e-9 * max(map(abs, middle)))
    text = scene_text(mesh_template(found, file.name, unit_mm), "scene.yaml")
    scene = st.Scene.from_dict(yaml.safe_load(text), folder=folder)
    corners = (np.array(middle) + CORNERS * np.array(size) / 2) * unit_mm + scene.objects[0].pose.position_mm
    # Positions are written to 1e-5 of the size, or to nine digits.
    across = max(size[0], size[1], 1e-3 * size[2]) * unit_mm
    slack = 1e-4 * across + 1e-8 * max(map(abs, middle)) * unit_mm
    assert corners[:, 2].min() == pytest.approx(found.distance_mm, abs=slack)
    extents = []
    for t in (-4, 4):
        for s in (-2, 2):
            moved = corners + np.array([-s * scene.stage.baseline_mm, 0, -t * found.distance_mm / 660])
            extents.append(np.abs(moved[:, :2] / moved[:, 2:]).max(axis=0) * scene.camera.focal_px)
    widest = np.max(extents, axis=0)
    assert widest[0] <= 320 + 1
    assert widest[1] <= 240 + 1
    # And it is not lost in the image: three quarters of it along one side, seen from the middle at t = 0.
    alone = np.abs(corners[:, :2] / corners[:, 2:]).max(axis=0) * scene.camera.focal_px / (320, 240)
    assert 0.7 < alone.max() < 0.78


def test_a_mesh_is_measured_and_told(here: Path) -> None:
    done = scenetruth("init", "--mesh", write_mesh(here / "body.off"))
    assert "8 vertices and 4 faces, 40 x 30 x 20 mm; its nearest point 400 mm from the camera" in done.stdout
    scene = st.load_scene("scene.yaml")
    # 0.75 * 480 px * 400 mm / 30 mm, which is what 640 px and 40 mm give too.
    assert scene.camera.focal_px == 4800
    # 30 px * 400 mm / 4800 px.
    assert scene.stage.baseline_mm == 2.5
    assert math.dist(scene.objects[0].pose.position_mm, (0, 0, 410)) < 1e-9


def test_a_tiny_mesh_is_asked_for_its_unit(here: Path) -> None:
    metres = write_mesh(here / "metres.off", size=(0.04, 0.03, 0.02))
    done = scenetruth("init", "small.yaml", "--mesh", metres)
    assert done.returncode == 0, done.stderr
    assert "warning: the mesh is less than 1 mm wide; if its unit is metres: --unit-mm 1000" in done.stderr
    # Whoever gives the unit knows it, and what is larger is in mm.
    for words in (("--mesh", metres, "--unit-mm", "1"), ("--mesh", write_mesh(here / "mm.off"))):
        assert scenetruth("init", f"{len(words)}.yaml", *words).stderr == ""


def test_images_are_laid_on_cubes(here: Path) -> None:
    Image.new("L", (8, 8), 128).save(here / "a picture: grey.png")
    (here / "deep").mkdir()
    assert scenetruth("init", "deep/scene.yaml", "--texture", "a picture: grey.png").returncode == 0
    assert 'file: "../a picture: grey.png"' in (here / "deep" / "scene.yaml").read_text()
    texture = st.load_scene("deep/scene.yaml").objects[0].texture
    assert Path(texture.file).samefile(here / "a picture: grey.png")  # type: ignore[attr-defined]


def test_images_are_laid_on_meshes_with_texture_coordinates_alone(here: Path) -> None:
    Image.new("L", (8, 8), 128).save(here / "grey.png")
    done = scenetruth("init", "--mesh", write_mesh(here / "body.off"), "--texture", "grey.png")
    assert done.returncode == 2
    for words in ("--texture: the mesh has no UV coordinates", "OBJ", "GLB", "omit --texture", "grey.png"):
        assert words in done.stderr
    assert not (here / "scene.yaml").exists()
    (here / "wall.obj").write_text(
        "v 0 0 0\nv 40 0 0\nv 40 30 0\nv 0 30 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    )
    done = scenetruth("init", "--mesh", "wall.obj", "--texture", "grey.png")
    assert done.returncode == 0, done.stderr
    assert scenetruth("check", "scene.yaml").returncode == 0


@pytest.mark.parametrize("kind", ["cube", "leaf"])
@pytest.mark.parametrize("option", ["--distance-mm", "--unit-mm"])
def test_options_of_meshes_are_refused_without_one(kind: str, option: str, here: Path) -> None:
    done = scenetruth("init", "--type", kind, option, "1")
    assert done.returncode == 2
    assert f"{option}: applies to a mesh; --type {kind} has" in done.stderr
    assert list(here.iterdir()) == []


def test_names_that_yaml_takes_for_something_else_are_quoted(here: Path) -> None:
    mesh = write_mesh(here / 'a: "b" #c {d}.off')
    done = scenetruth("init", "--mesh", mesh)
    assert done.returncode == 0, done.stderr
    assert st.load_scene("scene.yaml").description == 'The mesh of a: "b" #c {d}.off that moves towards the camera'


def test_editors_are_pointed_to_a_schema_if_there_is_one(here: Path) -> None:
    hint = "# yaml-language-server: $schema="
    assert scenetruth("init", "none.yaml").returncode == 0
    # Not at the beginning of a line, where editors would take it.
    assert not any(line.startswith(hint) for line in (here / "none.yaml").read_text().splitlines())
    (here / "scene.schema.json").write_text("{}")
    assert scenetruth("init", "beside.yaml").returncode == 0
    assert (here / "beside.yaml").read_text().startswith(f"{hint}scene.schema.json\n")
    (here / "my editor").mkdir()
    (here / "my editor" / "s.json").write_text("{}")
    assert scenetruth("init", "far.yaml", "--schema", "my editor/s.json").returncode == 0
    assert (here / "far.yaml").read_text().startswith(f"{hint}my%20editor/s.json\n")


def test_all_that_is_wrong_is_told_together(here: Path) -> None:
    options = (
        "--mesh",
        "x.obj",
        "--texture",
        "y.png",
        "--unit-mm",
        "-1",
        "--distance-mm",
        "nan",
        "--schema",
        "no.json",
    )
    done = scenetruth("init", "no/scene.txt", "--type", "leaf", *options)
    assert done.returncode == 2
    for words in ("FILE: must end in .yaml", "--mesh: requires", "--texture: a leaf", "--unit-mm", "--distance-mm"):
        assert words in done.stderr
    assert "create it: scenetruth schema > no.json" in done.stderr
    done = scenetruth("init", "no/scene.yaml", "--type", "mesh")
    assert "its directory does not exist" in done.stderr
    assert "--mesh: is missing" in done.stderr
    done = scenetruth("init", "--mesh", "nothing.obj", "--texture", "nothing.png")
    assert "no such image file" in done.stderr
    assert "no such mesh file" in done.stderr
    assert list(here.iterdir()) == []
