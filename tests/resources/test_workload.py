"""What is counted without being made is what is made."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as some

import scenetruth as st
from scenetruth.resources.workload import compute_workload, list_object_workloads, sharp_images
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.mesh import count_elements
from scenetruth.scene.texture import compute_noise_shape, contains_wavelength, make_band_limited_noise
from tests.helpers.mesh_files import gltf
from tests.helpers.scenes import LIBRARY, SCENES, cube, small

MESHES: list[dict[str, Any]] = [
    {"kind": "box", "size_mm": [3, 4, 5]},
    {"kind": "plane", "size_mm": [30, 40]},
    {"kind": "plane", "size_mm": [30, 41], "resolution_mm": 0.7},
    {"kind": "relief", "size_mm": [30, 40], "amplitude_mm": 1, "wavelength_mm": [9, None]},
    {"kind": "saddle", "size_mm": [30, 40], "curvature_per_mm": 0.01, "resolution_mm": 0.9},
    {"kind": "sphere", "radius_mm": 9},
    {"kind": "sphere", "radius_mm": 9, "cap_deg": 40, "resolution_mm": 0.3},
    {"kind": "cylinder", "radius_mm": 9, "length_mm": 20},
    {"kind": "cylinder", "radius_mm": 9, "length_mm": 20, "caps": True, "resolution_mm": 0.8},
    {"kind": "torus", "ring_radius_mm": 9, "tube_radius_mm": 3},
    {"kind": "stairs", "tread_mm": [5, 9], "steps_mm": [1, -2, 3]},
]
LEAVES: list[dict[str, Any]] = [
    {"outline": "ovate"},
    {"outline": "cordate", "petiole": {"length_mm": 30}},
    {"outline": "elliptic", "serration": {"count_per_side": 12, "depth_mm": 1.5}},
    {"outline": "palmate", "length_mm": 60},
    {"outline": "lanceolate", "resolution_mm": 0.5},
]


def with_mesh(mesh: dict[str, Any], **fields: Any) -> st.Scene:
    plain = cube().to_dict()
    plain["objects"][0] |= {"mesh": mesh, "texture": {"kind": "uniform"}, **fields}
    return st.Scene.from_dict(plain)


@pytest.mark.parametrize("mesh", MESHES, ids=lambda mesh: f"{mesh['kind']} {len(mesh)}")
def test_meshes_have_the_size_that_is_told_and_sketches_their_extent(mesh: dict[str, Any]) -> None:
    model = with_mesh(mesh).objects[0].mesh
    made = model.make()
    assert model.size(Path()) == (len(made.vertices_mm), len(made.faces))
    sketch = model.sketch(Path(), 200)
    assert sketch is not None
    assert len(sketch.faces) <= 200 or mesh["kind"] == "relief"
    for bound in (np.min, np.max):
        extent = np.ptp(made.vertices_mm, axis=0).max()
        np.testing.assert_allclose(
            bound(sketch.vertices_mm, axis=0), bound(made.vertices_mm, axis=0), rtol=0, atol=0.1 * extent
        )


@pytest.mark.parametrize("form", LEAVES, ids=lambda form: form["outline"])
def test_leaves_have_about_the_size_that_is_told(form: dict[str, Any]) -> None:
    model = with_mesh({"kind": "leaf", **form}).objects[0].mesh
    made = model.make()
    size = model.size(Path())
    # Their triangles are equal but for those along the margin.
    assert size.faces == pytest.approx(len(made.faces), rel=0.15)
    assert size.vertices == pytest.approx(len(made.vertices_mm), rel=0.15)
    sketch = model.sketch(Path(), 200)
    assert sketch is not None
    assert len(sketch.faces) < 250
    np.testing.assert_allclose(sketch.vertices_mm.min(axis=0), made.vertices_mm.min(axis=0), rtol=0, atol=5)
    np.testing.assert_allclose(sketch.vertices_mm.max(axis=0), made.vertices_mm.max(axis=0), rtol=0, atol=5)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl", ".glb", ".off"])
def test_files_are_counted_without_being_read_as_meshes(tmp_path: Path, suffix: str) -> None:
    trimesh.creation.icosphere(subdivisions=3).export(tmp_path / f"ball{suffix}")
    model = with_mesh({"kind": "file", "file": str(tmp_path / f"ball{suffix}")}).objects[0].mesh
    size = model.size(Path())
    assert size.faces == 1280
    assert 642 <= size.vertices <= 3 * 1280


def test_lines_are_counted_over_the_borders_of_pieces(tmp_path: Path) -> None:
    file = tmp_path / "grid.obj"
    file.write_text("".join(f"v {n} 0 0\n" for n in range(100)) + "f 1 2 3\nvn 0 0 1\nf 2 3 4\n")
    for size in (1, 2, 3, 7, 64):
        assert count_elements(file, piece_bytes=size) == (100, 2)


@pytest.mark.parametrize("file", LIBRARY, ids=lambda file: file.stem)
def test_rasters_have_the_shape_that_is_told(file: Path) -> None:
    scene = small(file)
    parts, problems = list_object_workloads(scene)
    assert problems == []
    bodies = build_scene(scene).bodies
    assert [part.texels for part in parts] == [body.texture.raster().size for body in bodies]
    faces = sum(len(body.faces) for body in bodies)
    assert compute_workload(scene, parts).faces == pytest.approx(faces, rel=0.1)


def test_textures_that_are_kept_are_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SCENETRUTH_CACHE", str(tmp_path))
    scene = cube()
    assert not list_object_workloads(scene)[0][0].painted
    build_scene(scene)
    (part,) = list_object_workloads(scene)[0]
    assert part.painted
    assert compute_workload(scene, [part]).noise_texels_to_paint == 0


@given(some.floats(0.1, 5), some.floats(1.0001, 3), some.floats(0.5, 60), some.floats(0.5, 60))
def test_a_band_holds_a_wave_where_noise_can_be_made(
    shortest: float, ratio: float, width: float, height: float
) -> None:
    band, size = (shortest, shortest * ratio), (min(width, 20 * shortest), min(height, 20 * shortest))
    with np.errstate(divide="ignore", invalid="ignore"):
        noise = make_band_limited_noise(band, size, np.random.default_rng(1), peak=99.0)
    assert contains_wavelength(band, size) == bool(np.isfinite(noise.coefficients[0, 0]))
    assert noise.coefficients.shape == compute_noise_shape(band, size)


def test_images_are_the_mean_of_as_many_as_aperture_and_exposure_ask_for() -> None:
    blurred = cube(optics={"defocus": {"aperture_mm": 3, "focus_distance_mm": 600, "samples": 20}})
    assert sharp_images(cube()) == 1
    assert sharp_images(blurred) == 20
    both = blurred.model_copy(
        update={"shutter": blurred.shutter.model_copy(update={"exposure_time_s": 0.1, "samples": 50})}
    )
    assert sharp_images(both) == 50
    demand = compute_workload(both, list_object_workloads(both)[0])
    assert (demand.images, demand.pixels, demand.fine_pixels, demand.sharp_images) == (45, 19200, 19200, 50)


def test_the_library_asks_for_what_its_files_say() -> None:
    rosette = st.load_scene(SCENES / "rosette.yaml")
    demand = compute_workload(rosette, list_object_workloads(rosette)[0], views=5, complete=True)
    assert (demand.positions, demand.frames, demand.views, demand.lamps, demand.lit) == (5, 9, 5, 1, True)
    assert demand.sample_bytes == 2


def test_problems_of_the_materials_of_files_are_those_of_their_objects(tmp_path: Path) -> None:
    """Together with those of other objects, and of the texture of the same object."""
    corners = np.array([[-20, -20, 0], [20, -20, 0], [20, 20, 0]], dtype=np.float32)
    primitive = {"attributes": {"POSITION": "@corners"}, "indices": "@index", "material": 0}
    rough = {"pbrMetallicRoughness": {"roughnessFactor": 1.2}}
    arrays = {"corners": corners, "index": np.array([0, 2, 1], dtype=np.uint16)}
    (tmp_path / "sheet.gltf").write_text(gltf(arrays, primitive, materials=[rough]))
    plain = cube(lighting={"ambient": 1}).to_dict()
    mesh = {"kind": "file", "file": str(tmp_path / "sheet.gltf"), "unit_mm": 1}
    picture = {"kind": "image", "file": str(tmp_path / "nowhere.png")}
    box = plain["objects"][0]
    sheet = box | {"mesh": mesh, "material": {"from_file": True}}
    plain["objects"] = [sheet, sheet | {"texture": picture, "name": "b"}, box | {"texture": picture, "name": "c"}]
    scene = st.Scene.from_dict(plain)
    parts, problems = list_object_workloads(scene)
    assert parts == []
    # Without texture coordinates, the sheet cannot have a picture either.
    places = ("0.material.from_file", "1.texture.kind", "1.material.from_file", "1.texture.file", "2.texture.file")
    paths = sorted(f"objects.{place}" for place in places)
    assert sorted(problem.path for problem in problems) == paths
    with pytest.raises(st.SceneError, match=r"roughnessFactor must be a number from 0 to 1, and is 1\.2") as caught:
        st.simulate(scene)
    assert sorted(problem.path for problem in caught.value.problems) == paths
