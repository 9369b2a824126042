"""Light against closed forms: planes, cones, shadows, and what changes in time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.camera import Viewpoint
from scenetruth.errors import BackendUnavailableError
from scenetruth.render import Renderer
from scenetruth.render import shading as shading_module
from scenetruth.render.raycast_backend import RaycastRenderer
from scenetruth.render.reflection import pack_materials
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.material import Material
from tests.helpers.scenes import SCENES, cube

Image = NDArray[np.float32]
Points = NDArray[np.float64]
Rotations = list[dict[str, Any]]
# float32 images of values below about 1.
ROUNDING = 3e-7
DISTANCE = 660.0


def render_raycast(scene: Scene, t: float = 0.0, x_mm: float = 0.0) -> Image:
    settings = scene.render.samples
    with RaycastRenderer(build_scene(scene), scene.camera, scene.background, settings, scene.lighting) as renderer:
        return renderer.render(t, Viewpoint.on_axis(x_mm))


def render_pyrender(scene: Scene, t: float = 0.0, x_mm: float = 0.0) -> Image:
    from scenetruth.render.pyrender_backend import PyrenderRenderer

    settings = scene.render.samples
    try:
        renderer: Renderer = PyrenderRenderer(
            build_scene(scene), scene.camera, scene.background, settings, "auto", scene.lighting
        )
    except BackendUnavailableError as error:
        pytest.skip(str(error))
    with renderer:
        return renderer.render(t, Viewpoint.on_axis(x_mm))


backends = pytest.mark.parametrize("render", [render_raycast, render_pyrender], ids=["raycast", "pyrender"])


def plane(
    lighting: dict[str, Any], *, rotations: Rotations | None = None, others: tuple[dict[str, Any], ...] = (),
    texture: dict[str, Any] | None = None, supersampling: int = 4, **changes: Any,
) -> Scene:  # fmt: skip
    """Return a white plane that fills the view of 160 x 120 px at 660 mm, and lights."""
    item = {
        "name": "plane",
        "mesh": {"kind": "plane", "size_mm": [400, 400]},
        "pose": {"position_mm": [0, 0, DISTANCE], "rotations": rotations or []},
        "texture": texture or {"kind": "uniform", "radiance": 1.0},
    }
    render = {"backend": "raycast", "supersampling": supersampling}
    return cube(objects=[item, *others], lighting=lighting, render=render, **changes)


def samples_mm(scene: Scene, n: int = 16) -> NDArray[np.float64]:
    """Return where n x n samples of all pixels meet the plane at 660 mm, shape (height, width, n * n, 2)."""
    camera = scene.camera
    steps = (np.arange(n) + 0.5) / n - 0.5
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    pixels = camera.pixel_grid()[:, :, None] + offsets
    return (pixels - camera.principal_point) / camera.focal_px * DISTANCE


def point(x: float, y: float, z: float, **more: Any) -> dict[str, Any]:
    return {
        "kind": "point",
        "position_mm": [x, y, z],
        "irradiance": 0.9,
        "reference_distance_mm": 200.0,
        **more,
    }


def test_plane_under_a_point_light() -> None:
    scene = plane({"lights": [point(20, -10, 560)]})
    away = np.hypot(*np.moveaxis(samples_mm(scene) - (20, -10), -1, 0))
    # E (d0 / d)² cos θ with cos θ = h / d and h = 100 mm: E (d0 / h)² cos³ θ.
    expected = 0.9 * (200 / 100) ** 2 * np.cos(np.arctan(away / 100)) ** 3
    image = render_raycast(scene)
    # Values up to 3.6 in float32; beside the plane's diagonal, whose pixels are traced, slopes are taken from one side.
    np.testing.assert_allclose(image, expected.mean(axis=2), atol=1e-5)
    assert np.percentile(np.abs(image - expected.mean(axis=2)), 99) < 4 * ROUNDING


def test_irradiance_falls_with_the_square_of_the_distance() -> None:
    scenes = [plane({"lights": [point(0.0, 0.0, DISTANCE - far)]}, supersampling=1) for far in (100, 200, 400)]
    centres = [float(render_raycast(scene)[59:61, 79:81].mean()) for scene in scenes]
    away = np.hypot(0.5, 0.5) * DISTANCE / 1254
    expected = [0.9 * (200 / far) ** 2 * np.cos(np.arctan(away / far)) ** 3 for far in (100, 200, 400)]
    assert centres == pytest.approx(expected, rel=1e-6)


@backends
@pytest.mark.parametrize("angle_deg", [0.0, 30.0, -60.0])
def test_directional_light_on_a_turned_plane_is_the_cosine(render: Callable[..., Image], angle_deg: float) -> None:
    sun = {"kind": "directional", "direction": [0, 0, 3], "irradiance": 0.8}
    turned: Rotations = [{"axis": [0, 1, 0], "angle_deg": angle_deg}]
    image = render(plane({"ambient": 0.1, "lights": [sun]}, rotations=turned))
    np.testing.assert_allclose(image, 0.1 + 0.8 * np.cos(np.deg2rad(angle_deg)), atol=ROUNDING)


def test_a_surface_lit_from_behind_is_dark_and_lights_add_up() -> None:
    behind = {"kind": "directional", "direction": [0, 0, -1], "irradiance": 5.0}
    front = {"kind": "directional", "direction": [0, 0, 1], "irradiance": 0.25}
    for shadows in (True, False):
        lighting = {"ambient": 0.125, "lights": [behind, front, front], "shadows": shadows}
        assert (render_raycast(plane(lighting)) == np.float32(0.625)).all()


def test_the_profile_of_a_spot() -> None:
    spot = point(0, 0, 560, kind="spot", direction=[0, 0, 1], inner_angle_deg=6.0, outer_angle_deg=16.0)
    scene = plane({"lights": [spot]})
    angle = np.arctan(np.hypot(*np.moveaxis(samples_mm(scene), -1, 0)) / 100)
    inner, outer = np.cos(np.deg2rad([6.0, 16.0]))
    share = np.clip((np.cos(angle) - outer) / (inner - outer), 0, 1)
    expected = (0.9 * 4 * np.cos(angle) ** 3 * share**2 * (3 - 2 * share)).mean(axis=2)
    image = render_raycast(scene)
    # The border is 35 px wide; where it bends most (its two ends) pixels are sampled one by one,
    # with 4 x 4 even samples, which lack 1/16 of the 1/12 px² that multiplies half the bend (about 0.04 per px²).
    np.testing.assert_allclose(image, expected, atol=2.5e-4)
    assert image[60, 80] > 3.5
    assert image[60, 0] == 0


def test_a_hard_spot_covers_its_cone() -> None:
    spot = point(0, 0, 560, kind="spot", target_mm=[0, 0, 700], inner_angle_deg=15.0, outer_angle_deg=15.0)
    image = render_raycast(plane({"ambient": 0.0, "lights": [spot]}, supersampling=8))
    away = np.hypot(*np.moveaxis(samples_mm(plane({}, supersampling=1), 1)[..., 0, :], -1, 0))
    lit = image / (3.6 * np.cos(np.arctan(away / 100)) ** 3)
    radius_px = 100 * np.tan(np.deg2rad(15)) / DISTANCE * 1254
    # Samples cut the circle at 1/8 px; their errors average out along its 320 px.
    assert np.sqrt(lit.sum() / np.pi) == pytest.approx(radius_px, abs=0.01)


SHADE_CASTER = {
    "name": "caster",
    "mesh": {"kind": "box", "size_mm": [40, 30, 12]},
    "pose": {"position_mm": [-30, 3, 606], "rotations": [{"axis": [0, 0, 1], "angle_deg": 10}]},
    "texture": {"kind": "uniform", "radiance": 1.0},
}


def shadow_border_px(scene: Scene, cast_mm: Callable[[Points], Points]) -> Any:
    """Return the right border x(y) of the box's shadow in pixels, from where its corners cast it on the plane."""
    turn = np.deg2rad(10)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    corners = np.array([[20, -15], [20, 15]]) @ axes + (-30, 3)
    top, bottom = (scene.camera.project(cast_mm(np.column_stack([corners, np.full(2, z)]))) for z in (600.0, 612.0))
    border = max((top, bottom), key=lambda ends: ends[:, 0].mean())
    return np.poly1d(np.polyfit(border[:, 1], border[:, 0], 1))


@backends
@pytest.mark.parametrize("kind", ["directional", "point"])
def test_the_border_of_a_shadow_is_where_geometry_puts_it(render: Callable[..., Image], kind: str) -> None:
    if kind == "directional":
        light: dict[str, Any] = {"kind": "directional", "direction": [0.5, 0.1, 1], "irradiance": 0.8}
        way = np.array([0.5, 0.1, 1.0])

        def cast_mm(points: Points) -> Points:
            return np.asarray(points + (DISTANCE - points[:, 2:]) * way)
    else:
        light = point(-130, -10, 400)
        lamp = np.array([-130.0, -10.0, 400.0])

        def cast_mm(points: Points) -> Points:
            return np.asarray(lamp + (points - lamp) * (DISTANCE - lamp[2]) / (points[:, 2:] - lamp[2]))

    scene = plane({"ambient": 0.1, "lights": [light]}, others=(SHADE_CASTER,), supersampling=8)
    bare = plane({"ambient": 0.1, "lights": [light]}, supersampling=8)
    image, unshaded = render(scene), render(bare)
    border = shadow_border_px(scene, cast_mm)
    rows = np.arange(62, 96)
    first, last = round(border(78.5)) - 12, round(border(78.5)) + 12
    lit = ((image - 0.1) / (unshaded - 0.1))[rows, first : last + 1]
    assert (abs(lit[:, 0]) < 1e-5).all()
    assert (abs(lit[:, -1] - 1) < 1e-5).all()
    found = last + 0.5 - lit.sum(axis=1)
    # Columns of 8 samples place the border in a row to 1/16 px, averaged over the 1.4 px or so that a row is slanted.
    assert np.abs(found - border(rows)).max() < 1 / 16
    assert abs((found - border(rows)).mean()) < 0.01


def test_without_shadows_nothing_is_shaded() -> None:
    sun = {"kind": "directional", "direction": [0.5, 0.1, 1], "irradiance": 0.8}
    with_box = render_raycast(plane({"lights": [sun], "shadows": False}, others=(SHADE_CASTER,)))
    without_box = render_raycast(plane({"lights": [sun]}))
    # To the right of the box itself.
    np.testing.assert_allclose(with_box[:, 70:], without_box[:, 70:], atol=ROUNDING)
    assert render_raycast(plane({"lights": [sun]}, others=(SHADE_CASTER,)))[61].min() == 0


def test_a_cube_does_not_shade_its_own_lit_sides() -> None:
    sun = {"kind": "directional", "direction": [0.2, 0.4, 1], "irradiance": 1.0}
    item = cube().to_dict()["objects"][0] | {"texture": {"kind": "uniform", "radiance": 1.0}}
    images = [render_raycast(cube(objects=[item], lighting={"lights": [sun], "shadows": on})) for on in (True, False)]
    assert (images[0] == images[1]).all()
    assert len(np.unique(images[0][images[0] > 0])) > 3


def textured(lighting: dict[str, Any]) -> Scene:
    plaid = {"kind": "plaid", "wavelength_mm": [6 * DISTANCE / 1254, 8 * DISTANCE / 1254], "amplitude": 0.4}
    return plane(lighting, texture=plaid)


def test_pixels_shaded_at_their_centres_equal_samples_shaded_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    spot = point(15, -8, 560, kind="spot", direction=[0, 0, 1], inner_angle_deg=4.0, outer_angle_deg=20.0)
    scene = textured({"lights": [{**spot, "irradiance": 0.25}]})
    fast = render_raycast(scene)
    monkeypatch.setattr(shading_module, "_STEEPEST", -1.0)
    difference = np.abs(fast - render_raycast(scene))
    # A texture of 6 px under light that falls from 1 to 0 within 56 px. To first order (A S alone) the rms is 2.4e-4,
    # the maximum 9e-4; of the second, slopes by differences leave 5 % at 6 px, and 40 % where taken from one side.
    assert np.sqrt((difference**2).mean()) < 0.1 * 2.4e-4
    assert difference.max() < 0.5 * 9e-4


def test_ambient_light_alone_is_the_unlit_image() -> None:
    assert (render_raycast(textured({"ambient": 1.0})) == render_raycast(textured({}))).all()


@backends
def test_an_unlit_scene_is_untouched(render: Callable[..., Image]) -> None:
    scene = cube(background=0.3)
    with RaycastRenderer(build_scene(scene), scene.camera, scene.background, scene.render.samples) as renderer:
        bare = renderer.render(1.0, Viewpoint.on_axis(5.0))
    if render is render_raycast:
        assert (render(scene, 1.0, 5.0) == bare).all()
    assert (render(cube(background=0.3, lighting={"shadows": False}), 1.0, 5.0) == render(scene, 1.0, 5.0)).all()


@backends
def test_brightness_changes_everything_alike(render: Callable[..., Image]) -> None:
    still = cube(background=0.3)
    lighting = {"drift_per_frame": 0.02, "flicker": {"amplitude": 0.1, "period_frames": 4}}
    changing = cube(background=0.3, lighting=lighting)
    assert (render(changing) == render(still)).all()
    np.testing.assert_allclose(render(changing, 1.0), (1.02 + 0.1) * render(still, 1.0), rtol=ROUNDING)
    lit = cube(background=0.3, lighting={**lighting, "ambient": 0.5})
    np.testing.assert_allclose(render(lit, -1.0)[0, 0], (0.98 - 0.1) * render(still)[0, 0], rtol=ROUNDING)


def test_a_moving_light_is_the_resting_one_of_that_time() -> None:
    turn = {"kind": "rotation", "axis": [0, 0, 1], "rate_deg_per_frame": 30, "point_mm": [0, 0, 0]}
    moving = textured({"lights": [point(30, 0, 560, motion=[turn])]})
    resting = textured({"lights": [point(0, 30, 560)]})
    np.testing.assert_allclose(render_raycast(moving, 3.0), render_raycast(resting), atol=ROUNDING)
    assert np.abs(render_raycast(moving) - render_raycast(resting)).max() > 0.1


def test_a_camera_beside_sees_the_same_light_on_the_same_points() -> None:
    step_px = 3
    scene = textured({"lights": [point(20, -10, 560, irradiance=0.2)]})
    moved = render_raycast(scene, x_mm=step_px * DISTANCE / 1254)
    np.testing.assert_allclose(moved[2:-2, 2:-5], render_raycast(scene)[2:-2, 5:-2], atol=1e-6)


def test_backends_agree_within_a_hundredth() -> None:
    spot = point(0, -40, 450, kind="spot", target_mm=[0, 0, 670], inner_angle_deg=4.0, outer_angle_deg=9.0)
    sun = {"kind": "directional", "direction": [0.6, 0.3, 1], "irradiance": 0.3}
    wall = {
        "name": "wall",
        "mesh": {"kind": "plane", "size_mm": [300, 300]},
        "pose": {"position_mm": [0, 0, 740]},
        "texture": {"kind": "noise", "wavelength_mm": [3.2, 12.0]},
    }
    item = cube().to_dict()["objects"][0]
    lighting = {"ambient": 0.1, "lights": [spot, sun]}
    scene = cube(objects=[item, wall], lighting=lighting, render={"backend": "raycast", "supersampling": 4})
    for t, x_mm in ((0.0, 0.0), (-4.0, 10.0)):
        first, second = render_raycast(scene, t, x_mm), render_pyrender(scene, t, x_mm)
        # Edges are rendered by the same code; elsewhere the unlit images differ by textures and frames of 8 bits.
        assert np.abs(first - second).max() < 0.01


def test_the_spotlight_scene_runs_and_its_brightness_changes() -> None:
    changes = ["camera.width=160", "camera.height=120", "camera.focal_length_px=1254", "frames.count=3"]
    # Longer waves than the scene's, which a quarter of the pixels could not resolve.
    changes.append("objects.0.texture.wavelength_mm=[3.2, 16]")
    more = ["render.backend=raycast", "stage.positions=1", "sensor=ideal", "render.supersampling=2"]
    scene = st.load_scene(SCENES / "cube_spotlight.yaml", overrides=[*changes, *more])
    recording, truth = st.simulate(scene)
    image, ids = recording["image"].values[0], truth["object_id"].values
    left = [float(image[n, :, :75][ids[n, :, :75] == 0].mean()) for n in range(3)]
    right = [float(image[n, :, 85:][ids[n, :, 85:] == 0].mean()) for n in range(3)]
    # The lamp goes from the right to the left.
    assert left[0] < left[1] < left[2]
    assert right[0] > right[1] > right[2]
    assert image.max() < 1


def test_light_beyond_full_scale_is_warned_of() -> None:
    sun = {"kind": "directional", "direction": [0, 0, 1], "irradiance": 3.0}
    with pytest.warns(st.SceneWarning, match=r"reach a radiance of 3, but the sensor's full scale is 1"):
        st.simulate(plane({"lights": [sun]}, frames={"count": 1}, stage={"positions": 1, "baseline_mm": 5}))


def test_steps_between_faces_are_mean_squares() -> None:
    from scenetruth.render.shading_kernels import face_steps

    light = np.array([[0.2, 0.1], [0.5, 0.1], [np.nan, 0.4]])
    neighbours = np.array([[1, -1, -1], [0, 2, -1], [1, -1, -1]], dtype=np.int32)
    # Differences: 0.3 between the first two; 0.3 of the second lamp between the last two.
    own = np.array([0.09, 0.18, 0.09]) / 3
    around = np.array([(own[1] + 2 * own[0]) / 3, (own[0] + own[2] + own[1]) / 3, (own[1] + 2 * own[2]) / 3])
    np.testing.assert_allclose(face_steps(light, neighbours), (own + around) / 2)


def test_means_of_the_faces_of_samples() -> None:
    from scenetruth.render.shading_kernels import mean_by_owner

    owner, face = np.array([1, -1, 1, 0, 1]), np.array([0, 1, 2, 1, 1], dtype=np.int32)
    assert mean_by_owner(owner, face, np.array([3.0, 5.0, 7.0]), 3).tolist() == [5.0, 5.0, 0.0]


def test_light_on_faces_against_a_plain_reading() -> None:
    from scenetruth.raycast.shadow_kernels import BLOCKED, LIT, UNSURE
    from scenetruth.render.shading_kernels import light_up_faces

    generator = np.random.default_rng(8)
    vertices, origin = generator.normal(size=(40, 3)), np.array([0.2, -0.1, 3.0])
    faces = generator.integers(0, 40, (60, 3)).astype(np.int32)
    normals, axes = generator.normal(size=(60, 3)), generator.normal(size=(3, 3))
    irradiances, states = generator.random(3), generator.integers(0, 3, (3, 60)).astype(np.uint8)
    lamps = irradiances, axes @ normals.T, states
    by_lamp, total, bits = light_up_faces((vertices, faces, normals), origin, lamps, 0.1)
    side = np.where(((origin - vertices[faces[:, 0]]) * normals).sum(axis=1) > 0, 1.0, -1.0)
    light = irradiances * np.maximum(-(normals @ axes.T) * side[:, None], 0)
    for row, state in enumerate((LIT, BLOCKED, UNSURE)):
        expected = ((states == state).T & (light > 0)) @ np.array([1, 2, 4])
        np.testing.assert_array_equal(bits[row], expected)
    np.testing.assert_allclose(np.abs(by_lamp), np.where(states.T == BLOCKED, 0, light), rtol=1e-14)
    np.testing.assert_array_equal(by_lamp < 0, (states.T == UNSURE) & (light > 0))
    np.testing.assert_allclose(total, 0.1 + np.where(states.T == BLOCKED, 0, light).sum(axis=1), rtol=1e-14)


def test_light_of_faces_that_are_hit() -> None:
    from scenetruth.render.shading_kernels import light_of_faces

    total, unsure = np.array([0.5, 0.25, 2.0]), np.array([False, True, False])
    light, where = light_of_faces(np.array([2, -1, 1, 0, 1], dtype=np.int32), total, unsure)
    assert light.tolist() == [2.0, 1.0, 0.25, 0.5, 0.25]
    assert where.tolist() == [2, 4]


def test_samples_that_stand_for_others() -> None:
    from scenetruth.render.shading_kernels import find_alike

    faces = np.array([4, 4, 2, 4, 2, 4, 4, 4], dtype=np.int32)
    pixels = np.array([7, 7, 7, 7, 7, 8, 8, 8])
    cells = np.array([0, 0, 0, 0, 1, 0, -1, -1], dtype=np.int32)
    chosen, of = find_alike(faces, pixels, cells, 5)
    # Another face, cell or pixel, and samples without a cell.
    assert chosen.tolist() == [0, 2, 4, 5, 6, 7]
    assert of.tolist() == [0, 0, 1, 0, 2, 3, 4, 5]


def test_uneven_pixels_against_a_plain_reading() -> None:
    from scenetruth.render.shading_kernels import uneven_pixels

    generator = np.random.default_rng(5)
    size = (30, 40)
    face = np.repeat(np.repeat(generator.integers(-1, 4, (6, 8)), 5, axis=0), 5, axis=1).astype(np.int32)
    state = (generator.random(size) < 0.03).astype(np.uint64)
    shade = generator.normal(scale=0.02, size=size)
    mixed = generator.random(size) < 0.2
    expected, borders = np.zeros(size, dtype=bool), np.zeros(size, dtype=bool)
    for y, x in np.ndindex(size):
        for v, u in np.ndindex(size):
            if max(abs(v - y), abs(u - x)) == 1 and min(face[y, x], face[v, u]) >= 0:
                same = face[y, x] == face[v, u] or (not mixed[y, x] and not mixed[v, u])
                apart = state[y, x] != state[v, u] or abs(shade[y, x] - shade[v, u]) > 0.05
                expected[y, x] |= same and apart
                borders[y, x] |= same and state[y, x] != state[v, u]
    found = uneven_pixels(shade, state, face, mixed, 0.05)
    assert (found[0] == expected).all()
    assert (found[1] == borders).all()
    assert borders.sum() < expected.sum()
    assert 0.1 < expected.mean() < 0.9


@pytest.mark.parametrize("near", [False, True])
def test_points_behind_a_sphere_by_samples_of_their_rays(near: bool) -> None:
    from scenetruth.render.shading_kernels import behind_sphere

    generator = np.random.default_rng(5)
    points, centre, radius = generator.uniform(-10, 10, (400, 3)), np.array([1.0, -2.0, 0.5]), 3.0
    axis, place = np.array([0.0, 0.6, 0.8]), np.array([2.0, -9.0, -12.0])
    wanted = generator.uniform(size=400) < 0.9
    found = behind_sphere(points, wanted, centre, radius, axis, place if near else None)
    steps = np.linspace(0, 1, 4001)
    along = (place - points if near else -40 * np.broadcast_to(axis, points.shape))[:, None] * steps[:, None]
    nearest = np.linalg.norm(points[:, None] + along - centre, axis=2).min(axis=1)
    clear = np.abs(nearest - radius) > 0.02
    assert np.array_equal(found[clear], (wanted & (nearest < radius))[clear])
    assert 20 < found.sum() < 300


def render_auto(scene: Scene, t: float = 0.0) -> Image:
    from scenetruth.render import choose_renderer

    world = build_scene(scene)
    with choose_renderer(scene, world).renderer as renderer:
        return renderer.render(t, Viewpoint.on_axis(0.0))


def with_material(scene: Scene, material: dict[str, Any], index: int = 0, **render: Any) -> Scene:
    plain = scene.to_dict()
    plain["objects"][index]["material"] = material
    plain["render"] |= render
    return Scene.from_dict(plain)


def highlight(scene: Scene, lamp: dict[str, Any], n: float, roughness: float) -> NDArray[np.float64]:
    """Return the gloss of the black plane under a point light, GGX with Fresnel reflection, without shadows."""
    x, y = np.moveaxis(samples_mm(scene, 8), -1, 0)
    at = np.stack([x, y, np.full_like(x, DISTANCE)], axis=-1)
    to_light = np.array(lamp["position_mm"]) - at
    far = np.linalg.norm(to_light, axis=-1)
    light, view = to_light / far[..., None], -at / np.linalg.norm(at, axis=-1)[..., None]
    half = light + view
    half /= np.linalg.norm(half, axis=-1)[..., None]
    facing, seen, upright = -light[..., 2], -view[..., 2], -half[..., 2]
    spread = 1 + (roughness**2 - 1) * upright**2
    distribution = roughness**2 / (np.pi * spread**2)
    masking = [2 / (1 + np.sqrt(1 + roughness**2 * (1 / c**2 - 1))) for c in (facing, seen)]
    c = np.einsum("...k,...k->...", half, view)
    g = np.sqrt(n**2 - 1 + c**2)
    fresnel = 0.5 * ((g - c) / (g + c)) ** 2 * (1 + ((c * (g + c) - 1) / (c * (g - c) + 1)) ** 2)
    irradiance = lamp["irradiance"] * (lamp["reference_distance_mm"] / far) ** 2
    radiance = irradiance * np.pi * distribution * fresnel * masking[0] * masking[1] / (4 * seen)
    # Reflections by several facets share what a single one loses.
    optics = pack_materials([Material(refractive_index=n, roughness=roughness)])
    mirror = optics.tables[0, 1, :, 0]
    lost = [1 - np.interp(np.sqrt(c), np.linspace(0, 1, len(mirror)), mirror) for c in (facing, seen)]
    radiance += irradiance * facing * lost[0] * lost[1] / (1 - optics.values[0, 6]) * optics.values[0, 7]
    return np.asarray(radiance.mean(axis=2))


@pytest.mark.parametrize("supersampling", [4, "auto"])
def test_the_highlight_of_a_black_plane_has_its_closed_form(supersampling: Any) -> None:
    lamp = point(20, -10, 560)
    scene = plane({"lights": [lamp]}, texture={"kind": "uniform", "radiance": 0.0})
    glossy = with_material(scene, {"refractive_index": 1.5, "roughness": 0.3}, supersampling=supersampling)
    expected = highlight(scene, lamp, 1.5, 0.3)
    assert expected.max() > 0.3
    np.testing.assert_allclose(render_auto(glossy), expected, atol=2e-5)


def test_texture_loses_what_the_boundary_reflects() -> None:
    # In uniform light, a white surface has radiance 1 with any boundary, and a black one the albedo of the boundary.
    coat = {"refractive_index": 1.6, "roughness": 0.4}
    white = render_auto(with_material(plane({"ambient": 1.0}), coat))
    np.testing.assert_allclose(white, 1.0, atol=2 * ROUNDING)
    black = plane({"ambient": 1.0}, texture={"kind": "uniform", "radiance": 0.0})
    grey = plane({"ambient": 1.0}, texture={"kind": "uniform", "radiance": 0.5})
    parts = [render_auto(with_material(scene, coat)) for scene in (black, grey)]
    np.testing.assert_allclose(parts[1], 0.5 * (parts[0] + white), atol=2 * ROUNDING)
    assert 0.02 < parts[0].min() < parts[0].max() < 0.2


def test_light_behind_a_sheet_shines_through() -> None:
    behind = {"kind": "directional", "direction": [0.6, 0, -0.8], "irradiance": 0.5}
    sheet = with_material(plane({"lights": [behind]}), {"transmittance": 0.3})
    np.testing.assert_allclose(render_auto(sheet), 0.5 * 0.8 * 0.3, atol=ROUNDING)
    assert not render_auto(plane({"lights": [behind]})).any()


@pytest.mark.parametrize("kind", ["directional", "point"])
def test_a_sheet_shades_with_its_transmittance(kind: str) -> None:
    lamp = {"kind": "directional", "direction": [0, 0, 1], "irradiance": 0.8}
    if kind == "point":
        lamp = point(0, 0, -1e6, irradiance=0.8, reference_distance_mm=1e6 + DISTANCE)
    # The sheet hides the upper left quarter of the lamp's light, but stands outside the view.
    sheet = {
        "name": "sheet",
        "mesh": {"kind": "plane", "size_mm": [40, 40]},
        "pose": {"position_mm": [-20, -20, -50]},
        "texture": {"kind": "uniform", "radiance": 0.5},
        "material": {"transmittance": 0.6},
    }
    image = render_auto(plane({"lights": [lamp]}, others=(sheet,)))
    clear = 0.8 * 1.0
    np.testing.assert_allclose(image[70:, 90:], clear, rtol=1e-5)
    np.testing.assert_allclose(image[30:50, 50:70], clear * 0.5 * 0.6, rtol=1e-5)
    opaque = render_auto(plane({"lights": [lamp]}, others=({**sheet, "material": {}},)))
    assert not opaque[30:50, 50:70].any()


@pytest.mark.parametrize("kind", ["directional", "point", "sphere"])
def test_a_sheet_with_a_coat_shades_with_the_light_that_passes_its_boundary(kind: str) -> None:
    """At 60°; a nearly smooth boundary reflects by Fresnel within 3e-4, and metal (a fifth) passes nothing."""
    index, metal, tilt = 1.6, 0.2, np.deg2rad(60)
    lamp: dict[str, Any] = {"kind": "directional", "direction": [0, 0, 1], "irradiance": 0.8}
    if kind != "directional":
        lamp = point(0, 0, -1e6, irradiance=0.8, reference_distance_mm=1e6 + DISTANCE)
    if kind == "sphere":
        lamp |= {"kind": "sphere", "radius_mm": 100.0}
    sheet = {
        "name": "sheet",
        "mesh": {"kind": "plane", "size_mm": [80, 40]},
        "pose": {"position_mm": [-20, -20, -50], "rotations": [{"axis": [0, 1, 0], "angle_deg": 60}]},
        "texture": {"kind": "uniform", "radiance": 0.5},
        "material": {"transmittance": 0.6, "refractive_index": index, "roughness": 0.04, "metallic": metal},
    }
    image = render_auto(plane({"lights": [lamp]}, others=(sheet,)))
    cosine, inside = np.cos(tilt), np.sqrt(1 - (np.sin(tilt) / index) ** 2)
    across = (cosine - index * inside) / (cosine + index * inside)
    along = (index * cosine - inside) / (index * cosine + inside)
    passed = 0.5 * 0.6 * (1 - metal) * (1 - 0.5 * (across**2 + along**2))
    np.testing.assert_allclose(image[70:, 90:], 0.8, rtol=1e-5)
    np.testing.assert_allclose(image[30:50, 50:70], 0.8 * passed, rtol=5e-4)


def test_gloss_of_the_adaptive_renderer_agrees_with_many_samples() -> None:
    lamp = point(20, -10, 560)
    texture = {"kind": "noise", "wavelength_mm": [3.2, 12.0]}
    material = {"refractive_index": 1.5, "roughness": 0.2, "roughness_along": 0.5}
    turned: Rotations = [{"axis": [0, 1, 0], "angle_deg": 30.0}]
    scene = plane({"ambient": 0.1, "lights": [lamp]}, texture=texture, rotations=turned)
    adaptive = render_auto(with_material(scene, material, supersampling="auto"))
    reference = render_auto(with_material(scene, material, supersampling=16))
    assert np.sqrt(np.mean((adaptive - reference) ** 2)) < 1e-4
    assert np.abs(reference - render_auto(scene)).max() > 0.05
