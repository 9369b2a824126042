"""Images with as many samples as texture and edges require, against exact images and many samples."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray
from PIL import Image

import scenetruth as st
from scenetruth.camera import Viewpoint
from scenetruth.render import choose_renderer
from scenetruth.render.adaptive_raycast import AdaptiveRenderer
from scenetruth.render.raycast_backend import RaycastRenderer
from scenetruth.scene.built_scene import build_scene
from scenetruth.validation_studies.noise_plane import noise_plane, reference_image
from tests.helpers.blurred_edges import edge_displacement, edge_normal
from tests.helpers.faceted_surfaces import ball, relief, scene_of, world_of
from tests.helpers.nightly import by_night, nightly
from tests.helpers.pixel_areas import area_beyond

ON_AXIS = Viewpoint.on_axis(0.0)


def plane(name: str, radiance: float, size_mm: tuple[float, float], **pose: Any) -> dict[str, Any]:
    """Return a uniform plane at a pose."""
    texture = {"kind": "uniform", "radiance": radiance}
    return {"name": name, "mesh": {"kind": "plane", "size_mm": size_mm}, "texture": texture, "pose": pose}


def scene_with(*objects: dict[str, Any], camera: dict[str, Any] | None = None, **values: Any) -> st.Scene:
    """Return a scene of one small image."""
    small = {"width": 40, "height": 32, "focal_length_px": 100} | (camera or {})
    plain = {"camera": small, "stage": {"positions": 1, "baseline_mm": 1}, "frames": {"count": 1}}
    return st.Scene.from_dict({**plain, "objects": list(objects), **values})


def image_of(scene: st.Scene) -> NDArray[np.float32]:
    """Return the image of a scene by ray casting, with samples chosen automatically."""
    assert scene.render.supersampling == "auto"
    return AdaptiveRenderer(build_scene(scene), scene.camera, scene.background, scene.lighting).render(0.0, ON_AXIS)


def rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("shift", [0.0, 0.37])
def test_noise_is_within_the_stated_error_of_the_exact_image(shift: float) -> None:
    scene = noise_plane((6.0, 30.0), (60, 80))
    renderer = AdaptiveRenderer(build_scene(scene), scene.camera, scene.background)
    image = renderer.render(shift, ON_AXIS)
    exact = reference_image(scene).values(shift)
    assert rms(image - exact) < 1e-4
    # One sample per pixel would be wrong by more than the stated error.
    single = RaycastRenderer(build_scene(scene), scene.camera, scene.background, 1).render(shift, ON_AXIS)
    assert rms(single - exact) > 1e-3


@pytest.mark.parametrize("error", [1e-3, *by_night(1e-5)])
def test_a_larger_error_needs_fewer_samples_and_is_kept(error: float) -> None:
    scene = noise_plane((2.5, 30.0), (60, 80))
    world = build_scene(scene)
    image = AdaptiveRenderer(world, scene.camera, scene.background, image_error=error).render(0.37, ON_AXIS)
    assert rms(image - reference_image(scene).values(0.37)) < error


@given(
    x=some.floats(-3, 3), y=some.floats(-3, 3), angle_deg=some.floats(0, 90), turn_deg=some.floats(-60, 60)
)  # fmt: skip
@settings(max_examples=12, deadline=None)
def test_the_area_of_a_plane_is_exact(x: float, y: float, angle_deg: float, turn_deg: float) -> None:
    rotations = [{"axis": [0, 0, 1], "angle_deg": angle_deg}, {"axis": [0, 1, 0], "angle_deg": turn_deg}]
    scene = scene_with(plane("sheet", 1.0, (12.0, 9.0), position_mm=[x, y, 100.0], rotations=rotations))
    corners = scene.camera.project(build_scene(scene).at(0).vertices_mm)
    hull = corners[np.argsort(np.arctan2(*(corners - corners.mean(axis=0)).T[::-1]))]
    before = np.roll(hull, 1, axis=0)
    area = abs(np.sum(before[:, 0] * hull[:, 1] - before[:, 1] * hull[:, 0])) / 2
    # Values are float32, of about 100 mixed pixels.
    assert image_of(scene).sum(dtype=np.float64) == pytest.approx(area, abs=2e-5)


@pytest.mark.parametrize("kind", ["checkerboard", "silhouette"])
@pytest.mark.parametrize("angle_deg", [0.0, 0.3, 20.0, *by_night(3.0, 45.0, 90.0)])
@pytest.mark.filterwarnings("ignore::scenetruth.SceneWarning")
def test_edges_are_in_their_place(kind: str, angle_deg: float) -> None:
    normal, px_mm = edge_normal(angle_deg), 0.25
    along = np.array([-normal[1], normal[0]])
    for distance in (-0.36, 0.013, 0.41):
        middle = px_mm * (distance * normal + (10 * along if kind == "checkerboard" else 20 * normal))
        rotations = [{"axis": [0, 0, 1], "angle_deg": angle_deg}]
        sheet = plane("sheet", 1.0, (10.0, 20.0), position_mm=[*middle.tolist(), 100.0], rotations=rotations)
        if kind == "checkerboard":
            sheet["texture"] = {"kind": "checkerboard", "square_mm": 5.0, "radiances": [0.0, 1.0]}
        scene = scene_with(
            sheet,
            camera={"width": 24, "height": 24, "focal_length_px": 400},
            optics={"psf": {"kind": "gaussian", "sigma_px": 0.6}},
            render={"backend": "raycast"},
        )
        world = build_scene(scene)
        image = choose_renderer(scene, world).renderer.render(0.0, ON_AXIS).astype(np.float64)
        assert abs(edge_displacement(image, normal, distance, 0.6, radius_px=6.0)) < 1e-3


@nightly
@pytest.mark.parametrize("distortion", [None, {"k1": -0.2}])
def test_edges_with_distortion_and_intersections_agree_with_brute_force(distortion: dict[str, float] | None) -> None:
    camera = {"distortion": distortion} if distortion else None
    tilted = {"position_mm": [0, 0, 100], "rotations": [{"axis": [0.2, 1, 0], "angle_deg": 35}]}
    scene = scene_with(
        plane("wall", 0.3, (40.0, 30.0), position_mm=[0, 0, 102.0], rotations=[{"axis": [0, 0, 1], "angle_deg": 5}]),
        plane("blade", 0.9, (24.0, 12.0), **tilted),
        camera=camera,
    )
    parts = 32
    fine = scene.camera.refined(parts, 0)
    expected = RaycastRenderer(build_scene(scene), fine, supersampling=1).render(0.0, ON_AXIS)
    expected = expected.reshape(32, parts, 40, parts).mean(axis=(1, 3), dtype=np.float64)
    # 32 x 32 samples of a step of at most 0.9 are wrong by at most 0.9 / 32 in a pixel, at random in most.
    assert rms(image_of(scene) - expected) < 0.1 * 0.9 / parts
    # Where two edges cross a pixel, both errors add.
    assert np.abs(image_of(scene) - expected).max() < 2 * 0.9 / parts


def test_textures_with_steps_on_a_curved_surface_agree_with_brute_force() -> None:
    item = {
        "name": "ball",
        "mesh": {"kind": "sphere", "radius_mm": 20, "resolution_mm": 1},
        "texture": {"kind": "checkerboard", "square_mm": 4},
        "pose": {"position_mm": [0, 0, 300]},
    }
    scene = scene_with(item, camera={"width": 32, "height": 24, "focal_length_px": 170})
    parts = 40
    fine = RaycastRenderer(build_scene(scene), scene.camera.refined(parts, 0), supersampling=1).render(0.0, ON_AXIS)
    expected = fine.reshape(24, parts, 32, parts).mean(axis=(1, 3), dtype=np.float64)
    # Brute force itself is wrong by up to 0.8 / 40 in a pixel.
    assert rms(image_of(scene) - expected) < 0.1 * 0.8 / parts


@pytest.mark.parametrize("lit", ["directional", *by_night("spot")])
def test_lit_facets_and_shadows_agree_with_many_samples(lit: str) -> None:
    lamps: dict[str, dict[str, Any]] = {
        "directional": {"kind": "directional", "direction": [0.3, 0.2, 1], "irradiance": 0.8},
        "spot": {
            "kind": "spot",
            "position_mm": [10, -20, 400],
            "target_mm": [0, 0, 660],
            "inner_angle_deg": 8.0,
            "outer_angle_deg": 12.0,
            "reference_distance_mm": 260.0,
            "irradiance": 0.8,
        },
    }
    scene = scene_of(
        {"pose": {"position_mm": [-15, 0, 660], "rotations": [{"axis": [0.3, 1, 0], "angle_deg": 25}]}},
        {"pose": {"position_mm": [15, 5, 640]}},
        camera={"width": 80, "height": 60, "focal_length_px": 600},
        lighting={"ambient": 0.2, "lights": [lamps[lit]]},
    )
    world = world_of(scene, relief(3, 40), ball(3, 3))
    parts = (scene.camera, scene.background)
    exact = RaycastRenderer(world, *parts, 16, scene.lighting).render(0.0, ON_AXIS)
    image = AdaptiveRenderer(world, *parts, scene.lighting).render(0.0, ON_AXIS)
    fixed = RaycastRenderer(world, *parts, 4, scene.lighting).render(0.0, ON_AXIS)
    # Near lamps are not constant on a facet: their expansion about the pixel centre, which a fixed number of samples
    # uses, too, is wrong by as much as the stated error again.
    assert np.median(np.abs(image - exact)) < (1e-4 if lit == "directional" else 2e-4)
    assert rms(image - exact) < rms(fixed - exact)


def test_ambient_light_without_lamps_is_the_same_everywhere() -> None:
    behind = {"kind": "directional", "direction": [0, 0, -1], "irradiance": 5.0}
    white = plane("white", 1.0, (1000, 1000), position_mm=[0, 0, 600])
    for lamps in ([], [behind]):
        image = image_of(scene_with(white, lighting={"ambient": 0.625, "lights": lamps}))
        np.testing.assert_array_equal(image, np.float32(0.625))


def shaded_floor(angle_deg: float, distance: float, *, beyond_mm: float = 0.0) -> st.Scene:
    """Return a floor of 1 mm per px, with the border of a shadow at a distance from the middle of the image.

    The sheet that casts it lies outside the image; ``beyond_mm`` moves it behind the floor.
    """
    towards, gap, normal = np.array([0.9, 0.1, 0.3]), 30.0, edge_normal(angle_deg)
    middle = (distance - 20) * normal - towards[:2] / towards[2] * (gap - beyond_mm)
    rotations = [{"axis": [0, 0, 1], "angle_deg": angle_deg}]
    position = [*middle.tolist(), 100.0 - gap + beyond_mm]
    return scene_with(
        plane("floor", 1.0, (400.0, 400.0), position_mm=[0, 0, 100.0]),
        plane("sheet", 1.0, (40.0, 60.0), position_mm=position, rotations=rotations),
        camera={"width": 24, "height": 20, "focal_length_px": 100},
        lighting={
            "ambient": 0.2,
            "lights": [{"kind": "directional", "direction": towards.tolist(), "irradiance": 0.8}],
        },
    )


@given(angle_deg=some.one_of(some.floats(0, 360), some.sampled_from([0, 45, 90])), distance=some.floats(-6, 6))
@settings(max_examples=8, deadline=None)
def test_the_area_in_the_light_is_exact(angle_deg: float, distance: float) -> None:
    scene = shaded_floor(angle_deg, distance)
    image, normal = image_of(scene), edge_normal(angle_deg)
    contrast = 0.8 * 0.3 / float(np.linalg.norm([0.9, 0.1, 0.3]))
    x, y = np.meshgrid(np.arange(24) - 11.5, np.arange(20) - 9.5)
    lit = np.array(
        [area_beyond(normal, distance - float(normal @ place)) for place in zip(x.flat, y.flat, strict=True)]
    )
    expected = (0.2 + contrast * lit).reshape(image.shape)
    # Values are float32, and shadows begin within 1e-9 of the diagonal of the scene.
    np.testing.assert_allclose(image, expected, atol=1e-5 * contrast)


def test_a_sheet_behind_the_floor_casts_no_shadow_on_it() -> None:
    hidden = image_of(shaded_floor(20.0, 1.3, beyond_mm=50.0))
    alone = scene_with(
        plane("floor", 1.0, (400.0, 400.0), position_mm=[0, 0, 100.0]),
        camera={"width": 24, "height": 20, "focal_length_px": 100},
        lighting=shaded_floor(0.0, 0.0).to_dict()["lighting"],
    )
    np.testing.assert_array_equal(hidden, image_of(alone))
    assert np.ptp(hidden) < 1e-6 < np.ptp(image_of(shaded_floor(20.0, 1.3)))


def test_image_textures_are_exact_to_the_stated_error(tmp_path: Path) -> None:
    """Against 48 x 48 samples, for texels as large as pixels, with and without light."""
    noise = np.random.default_rng(3).integers(0, 256, (96, 96)).astype(np.uint8)
    Image.fromarray(noise).save(tmp_path / "noise.png")
    texture = {"kind": "image", "file": str(tmp_path / "noise.png"), "encoding": "linear"}
    pose = {"position_mm": [0, 0, 100], "rotations": [{"axis": [0.3, 1, 0.5], "angle_deg": 30}]}
    flat = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [96, 96]}, "texture": texture, "pose": pose}
    lamp = {"lights": [{"kind": "directional", "direction": [0.3, 0.2, 1], "irradiance": 0.8}]}
    for lit in ({}, {"lighting": lamp}):
        scene = scene_with(flat, **lit)
        world, rest = build_scene(scene), (scene.background, scene.lighting)
        many = RaycastRenderer(world, scene.camera, scene.background, 48, scene.lighting).render(0.0, ON_AXIS)
        found = AdaptiveRenderer(world, scene.camera, *rest).render(0.0, ON_AXIS)
        # The samples of bends of 0.5 are wrong by about 0.5 / (27 · 48²) = 8e-6.
        assert rms(found - many) < 2e-5
        few = RaycastRenderer(world, scene.camera, scene.background, 4, scene.lighting).render(0.0, ON_AXIS)
        assert rms(few - many) > 5e-4


def test_images_do_not_depend_on_the_number_of_threads() -> None:
    scene = scene_of({}, camera={"width": 80, "height": 60, "focal_length_px": 600})
    world, images, before = world_of(scene, relief(1, 40)), [], numba.get_num_threads()
    try:
        for count in {1, before}:
            numba.set_num_threads(count)
            images.append(AdaptiveRenderer(world, scene.camera).render(0.0, ON_AXIS))
    finally:
        numba.set_num_threads(before)
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])


def test_settings_without_the_new_fields_are_written_as_before() -> None:
    fixed = scene_with(plane("sheet", 1.0, (12.0, 9.0)), render={"backend": "raycast", "supersampling": 4})
    assert fixed.to_dict()["render"] == {"backend": "raycast", "platform": "auto", "supersampling": 4}
    world = build_scene(fixed)
    assert type(choose_renderer(fixed, world).renderer) is RaycastRenderer
    finer = scene_with(plane("sheet", 1.0, (12.0, 9.0)), render={"backend": "raycast", "image_error": 1e-5})
    assert st.Scene.from_dict(finer.to_dict()) == finer
    assert type(choose_renderer(finer, world).renderer) is AdaptiveRenderer


def test_strips_as_narrow_as_pixels_have_enough_samples() -> None:
    """Pixels between two outlines: the texture along the other axis is far finer than that from pixel to pixel."""
    strip = {"name": "strip", "mesh": {"kind": "plane", "size_mm": [60, 60]}}
    strip |= {"texture": {"kind": "noise", "wavelength_mm": [6.0, 20.0]}}
    strip |= {"pose": {"position_mm": [0.2, 0, 660], "rotations": [{"axis": [0, 1, 0], "angle_deg": 87.2}]}}
    scene = scene_with(strip, camera={"focal_length_px": 660})
    world = build_scene(scene)
    fine = RaycastRenderer(world, scene.camera.refined(64, 0), 0.0, 1).render(0.0, ON_AXIS)
    expected = fine.reshape(32, 64, 40, 64).mean(axis=(1, 3), dtype=np.float64)
    inner = fine.reshape(32, 64, 40, 64).min(axis=(1, 3)) > 0
    assert np.count_nonzero(inner) > 60
    assert np.abs(image_of(scene) - expected)[inner].max() < 1e-4


@pytest.mark.parametrize("error", [4e-4, *by_night(1e-4)])
def test_rules_use_the_error_that_is_allowed_for_the_image(error: float) -> None:
    """On an oblique plane, the texture steps of pixels are between the longest of two rules."""
    noise = {"kind": "noise", "wavelength_mm": [1.5, 10.0], "mean": 0.5, "rms_contrast": 0.3}
    oblique = {"position_mm": [0, 0, 100], "rotations": [{"axis": [0, 1, 0], "angle_deg": 40}]}
    # The image shows 180 mm x 92 mm of it.
    wall = plane("wall", 1.0, (200, 110), **oblique) | {"texture": noise}
    scene = scene_with(wall, camera={"width": 96, "height": 64, "focal_length_px": 110})
    world = build_scene(scene)
    renderer = AdaptiveRenderer(world, scene.camera, scene.background, image_error=error)
    found = renderer.render(0.0, ON_AXIS)
    renderer._longer = [np.zeros_like(renderer._longest)]
    finer = renderer.render(0.0, ON_AXIS)
    exact = RaycastRenderer(world, scene.camera, scene.background, 16).render(0.0, ON_AXIS)
    # Coarser rules in some pixels.
    assert np.count_nonzero(found != finer) > 0.05 * found.size
    assert rms(finer - exact) < rms(found - exact) < error
