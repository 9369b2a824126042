from __future__ import annotations

import copy
import pickle
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scenetruth as st
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.scene_report import check_scene, describe_scene
from tests.helpers.mesh_files import gltf
from tests.helpers.nightly import nightly
from tests.helpers.scenes import LIBRARY, SCENES, cube


def test_a_scene_is_one_line() -> None:
    scene = cube(description="A cube", stage={"positions": 5, "baseline_mm": 5, "rows": 2, "row_spacing_mm": 3})
    assert repr(scene) == "Scene('A cube'; 160 x 120 px; 2 x 5 positions x 9 frames; objects: cube)"
    assert str(scene) == repr(scene)


def test_a_scene_is_a_table() -> None:
    html = st.load_scene(SCENES / "rosette.yaml")._repr_html_()
    for head, text in {
        "camera": "640 x 480 px, f = 2900 px",
        "stage": "5 positions, 5 mm apart",
        "frames": "9, 60 s apart",
        "object &#x27;pot&#x27;": "cylinder; texture noise",
        "plant &#x27;plant&#x27;": "rosette of 9 leaves; texture leaf; deformation growth",
        "light": "ambient 0.35, directional",
        "sensor": "gaussian; 12 bits",
    }.items():
        assert f"<tr><th>{head}</th><td>{text}</td></tr>" in html


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, "unlit: radiance equals the texture"),
        ({"sensor": "ideal"}, "<td>ideal</td>"),
        ({"sensor": {"kind": "emva1288", "preset": "ccd_2002"}}, "<td>emva1288; ccd_2002; 12 bits</td>"),
        (
            {"sensor": {"kind": "chain", "effects": [{"kind": "full_scale"}]}},
            "<td>chain; full_scale</td>",
        ),
        ({"stage": {"positions_mm": [-4, 0, 6], "baseline_mm": 5}}, "3 positions, 5 mm apart on average"),
        ({}, "box; texture noise; motion velocity"),
    ],
)
def test_the_table_tells_of_the_parts(changes: dict[str, Any], text: str) -> None:
    assert text in cube(**changes)._repr_html_()


def test_names_cannot_inject_markup() -> None:
    item = cube().to_dict()["objects"][0] | {"name": "<script>"}
    html = cube(description="<b>", objects=[item])._repr_html_()
    assert "&lt;b&gt;" in html
    assert "&lt;script&gt;" in html
    assert "<b>" not in html
    assert "<script>" not in html


@pytest.mark.parametrize("file", LIBRARY, ids=lambda file: file.stem)
def test_scenes_stay_values(file: Any) -> None:
    scene = st.load_scene(file)
    again = pickle.loads(pickle.dumps(scene))
    assert again == scene == copy.deepcopy(scene)
    assert repr(again) == repr(scene)
    assert "\n" not in repr(scene)
    assert scene.model_copy(update={"seed": scene.seed + 1}) != scene


def test_extensions_of_mesh_files_that_are_not_read_are_warned_of(tmp_path: Path) -> None:
    text = gltf({"p": np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0]], np.float32)}, {"attributes": {"POSITION": "@p"}},
                extensionsUsed=["VENDOR_fur", "KHR_materials_unlit"])  # fmt: skip
    (tmp_path / "a.gltf").write_text(text, encoding="utf-8")
    plain = {
        "camera": {"width": 64, "height": 48, "focal_length_px": 400},
        "stage": {"positions": 3, "baseline_mm": 2},
        "frames": {"count": 1},
        "objects": [{"name": "card", "mesh": {"kind": "file", "file": str(tmp_path / "a.gltf")},
                     "pose": {"position_mm": [0, 0, 200]},
                     "texture": {"kind": "noise", "wavelength_mm": [2, 8]}}],
    }  # fmt: skip
    with pytest.warns(
        st.SceneWarning, match="mesh file of 'card' uses extensions of glTF that are not read: VENDOR_fur;"
    ):
        st.simulate(st.Scene.from_dict(plain))


@nightly
def test_surfaces_that_send_out_more_light_than_they_receive_are_refused() -> None:
    lit = ["lighting.ambient=1", "plants.0.material.transmittance=1.5", "plants.0.leaves=3"]
    with pytest.raises(st.SceneError, match=r"plants\.0\.material\.transmittance: the texture reaches") as caught:
        st.simulate("rosette", overrides=[*lit, "frames.count=1"])
    # One problem for all leaves of the plant, with the value that is possible.
    assert len(caught.value.problems) == 1

    possible = caught.value.problems[0].message.rsplit(" ", 1)[1]
    scene = st.load_scene("rosette", overrides=[*lit, f"plants.0.material.transmittance={possible}"])
    check_scene(scene, build_scene(scene))


def test_problems_of_lamps_are_reported_together(tmp_path: Path) -> None:
    (tmp_path / "lamp.ies").write_text("no lamp")
    at_depth = {"irradiance": 1, "reference_distance_mm": 600}
    lamps: list[dict[str, Any]] = [
        {"kind": "ies", "file": str(tmp_path / "lamp.ies"), "position_mm": [0, 300, 0], "direction": [0, 0, 1]},
        {"kind": "sphere", "position_mm": [0, 0, 0], "radius_mm": 30},
        {"kind": "point", "position_mm": [0, 0, 692]},
    ]
    plain = cube(frames={"count": 1}).to_dict() | {"lighting": {"lights": [lamp | at_depth for lamp in lamps]}}
    scene = st.Scene.from_dict(plain)
    with pytest.raises(st.SceneError) as caught:
        check_scene(scene, build_scene(scene))
    paths = [problem.path.removeprefix("lighting.lights.") for problem in caught.value.problems]
    assert paths == ["0.file", "1.position_mm", "2.position_mm"]
    # Textures that cannot be read do not hide those that do not depend on the objects.
    plain["objects"][0]["texture"] = {"kind": "image", "file": str(tmp_path / "nowhere.png")}
    with pytest.raises(st.SceneError) as caught:
        st.simulate(st.Scene.from_dict(plain))
    paths = [problem.path for problem in caught.value.problems]
    assert paths == ["objects.0.texture.file", "lighting.lights.0.file", "lighting.lights.1.position_mm"]


def test_materials_without_light_are_warned_of() -> None:
    scene = st.load_scene("cube", overrides=["objects.0.material.preset=printed_foil"])
    with pytest.warns(st.SceneWarning, match=r"material: no effect on 'cube', because the scene is unlit"):
        check_scene(scene, build_scene(scene))


@pytest.mark.parametrize(
    ("estimate", "difference"),
    [
        ({"method": "refined"}, None),
        ({"method": "plane_sweep"}, None),
        # The registration of each pixel is chosen.
        ({"method": "structure_tensor"}, None),
        ({"method": "structure_tensor", "working_point_px": "auto", "pyramid_levels": 1}, None),
        # Disparities are 20 and 28 px: 24 px is in the middle.
        ({"method": "structure_tensor", "working_point_px": "auto"}, 4.0),
        ({"method": "structure_tensor", "working_point_px": 20}, 8.0),
        ({"method": "structure_tensor", "working_point_px": 27}, 7.0),
    ],
)
def test_warnings_about_disparities_fit_the_method(estimate: dict[str, Any], difference: float | None) -> None:
    scene = cube(estimate=estimate)
    product = scene.camera.focal_px * scene.stage.baseline_mm
    report = describe_scene(scene, build_scene(scene), np.array([[product / 20, product / 28]]))
    found = [message for message in report.warnings if "derivative" in message]
    if difference is None:
        assert found == []
    else:
        (message,) = found
        assert f"by up to {difference:.1f} px; derivative filters are accurate up to about 1 px" in message


def test_disparities_within_two_pixels_are_no_problem() -> None:
    scene = cube(estimate={"method": "structure_tensor", "working_point_px": 20})
    product = scene.camera.focal_px * scene.stage.baseline_mm
    report = describe_scene(scene, build_scene(scene), np.array([[product / 19, product / 22]]))
    assert not any("derivative" in message for message in report.warnings)


def shaded_wall(place: tuple[float, float, float], lamp: dict[str, Any], width: int = 60, **light: Any) -> st.Scene:
    """Return a wall at Z = 700 mm and a box, with an image of the wall's middle."""
    wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [300, 300]}, "pose": {"position_mm": [0, 0, 700]}}
    box = {"name": "box", "mesh": {"kind": "box", "size_mm": [30, 20, 20]}, "pose": {"position_mm": [*place]}}
    return st.Scene.from_dict(
        {
            "camera": {"width": width, "height": 40, "focal_length_px": 350},
            "stage": {"positions": 2, "baseline_mm": 5},
            "frames": {"count": 1},
            "lighting": {"lights": [{**lamp, "irradiance": 0.3}], **light},
            "objects": [item | {"texture": {"kind": "uniform", "radiance": 0.8}} for item in (wall, box)],
            "render": {"backend": "raycast"},
        }
    )


SLANTED = {"kind": "directional", "direction": [-1, 0, 1]}
LAMP = {"position_mm": [650, 0, 50], "reference_distance_mm": 900}
SPOT = LAMP | {"kind": "spot", "direction": [-1, 0, 1], "inner_angle_deg": 20, "outer_angle_deg": 25}
DISC = LAMP | {"kind": "disc", "radius_mm": 8, "target_mm": [0, 0, 700]}


@pytest.mark.parametrize("lamp", [SLANTED, SPOT, DISC], ids=["directional", "spot", "disc"])
def test_objects_outside_every_image_may_cast_shadows(lamp: dict[str, Any]) -> None:
    """The light at the pixel centres is that in the middle of a wide image, which shows the box as well."""
    place = (300.0, 0.0, 400.0)
    with pytest.warns(st.SceneWarning, match=r"objects\.1: 'box' is outside every image; it can only cast shadows"):
        seen = st.simulate(shaded_wall(place, lamp), truth_content="complete_with_light")
    narrow, image = seen.truth["surface_radiance"].values[0], seen.recording["image"].values[0, 0]
    wide = st.simulate(shaded_wall(place, lamp, width=700), truth_content="complete_with_light").truth
    np.testing.assert_allclose(narrow, wide["surface_radiance"].values[0, :, 320:380], atol=1e-9)
    # Pixels inside and outside the shadow.
    assert narrow.min() < 0.1 * narrow.max()
    assert np.median(np.abs(image - narrow)) < 1e-3 * narrow.max()


def test_objects_behind_the_camera_may_cast_shadows() -> None:
    """Along the light, the box is moved without effect on its shadow."""
    with pytest.warns(st.SceneWarning, match="'box' is behind the camera; it can only cast shadows"):
        behind = st.simulate(shaded_wall((750, 0, -50), SLANTED)).recording["image"].values
    with pytest.warns(st.SceneWarning, match="'box' is outside"):
        ahead = st.simulate(shaded_wall((300, 0, 400), SLANTED)).recording["image"].values
    np.testing.assert_allclose(behind, ahead, atol=1e-6)


@pytest.mark.parametrize(
    ("place", "lamp", "light", "message"),
    [
        ((-400, 0, 400), SLANTED, {}, "is outside every image"),
        # Beyond the wall along the light, and beyond the lamp.
        ((-500, 0, 1200), SLANTED, {}, "is outside every image"),
        ((1400, 0, 400), SPOT, {}, "is outside every image"),
        ((300, 0, 400), SLANTED, {"shadows": False}, "is outside every image"),
        ((-750, 0, -50), SLANTED, {}, "is behind the camera"),
        ((700, 0, 0), SLANTED, {}, "reaches behind the camera"),
    ],
)
def test_unseen_objects_without_shadow_on_seen_ones_are_errors(
    place: tuple[float, float, float], lamp: dict[str, Any], light: dict[str, Any], message: str
) -> None:
    scene = shaded_wall(place, lamp, **light)
    with pytest.raises(st.SceneError, match=rf"objects\.1\.pose\.position_mm: 'box' {message}") as caught:
        check_scene(scene, build_scene(scene))
    assert len(caught.value.problems) == 1


@pytest.mark.parametrize(("wavelength_mm", "warned"), [(2.0, False), (1.96, True)])
def test_textures_finer_than_two_pixels_are_warned_of(wavelength_mm: float, warned: bool) -> None:
    """At a focal length of 400 px and a distance of 400.2 mm, 2 mm are 1.999 px, which is printed as 2.00."""
    item = {"name": "card", "mesh": {"kind": "plane", "size_mm": [60, 40]}, "pose": {"position_mm": [0, 0, 400.2]}}
    item["texture"] = {"kind": "noise", "wavelength_mm": [wavelength_mm, 8.0]}
    camera = {"width": 64, "height": 48, "focal_length_px": 400}
    scene = cube(camera=camera, objects=[item], frames={"count": 1})
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        check_scene(scene, build_scene(scene))
    assert any("finer than 2 px" in str(each.message) for each in found) == warned
