"""Every backend puts the same scene on the same pixels, and shows sheets from both sides."""

from __future__ import annotations

import gc
import math
import os
import weakref
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenetruth.camera import Viewpoint
from scenetruth.errors import BackendUnavailableError
from scenetruth.raycast import RayCaster, scene_topology
from scenetruth.render import Renderer
from scenetruth.render.pyrender_backend import PyrenderRenderer
from scenetruth.render.raycast_backend import RaycastRenderer, visible_uv
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import BuiltScene, build_scene
from scenetruth.scene.mesh import TriangleMesh, make_box, make_plane
from scenetruth.scene.texture import PlaidTexture
from tests.helpers.faceted_surfaces import relief, scene_of, world_of
from tests.helpers.nightly import by_night, nightly
from tests.helpers.scenes import cube

Opener = Callable[[BuiltScene, Scene], Renderer]


def open_raycast(world: BuiltScene, scene: Scene) -> Renderer:
    return RaycastRenderer(world, scene.camera, scene.background, scene.render.samples)


def open_pyrender(world: BuiltScene, scene: Scene) -> Renderer:
    from scenetruth.render.pyrender_backend import PyrenderRenderer

    try:
        return PyrenderRenderer(world, scene.camera, scene.background, scene.render.samples)
    except BackendUnavailableError as error:
        pytest.skip(str(error))


backends = pytest.mark.parametrize("opener", [open_raycast, open_pyrender], ids=["raycast", "pyrender"])


def plaid_plane(**changes: Any) -> Scene:
    """Return a fronto-parallel plaid that fills the view, with an off-centre principal point."""
    plain: dict[str, Any] = {
        "camera": {"width": 160, "height": 120, "focal_length_px": 1254, "principal_point_px": [90.25, 41.6]},
        "objects": [
            {
                "name": "plaid",
                "mesh": {"kind": "plane", "size_mm": [400, 400]},
                "pose": {"position_mm": [3.0, -2.0, 660]},
                "texture": {"kind": "plaid", "wavelength_mm": [4.7, 5.3], "amplitude": 0.4},
                "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.07, 0.11, -1.5]}],
            }
        ],
        "render": {"backend": "raycast", "supersampling": 4},
    }
    return cube(**(plain | changes))


def analytic_plaid(scene: Scene, t: float, x_mm: float, dx: float = 0.0, dy: float = 0.0) -> NDArray[np.float64]:
    """Return the pattern of `plaid_plane`, averaged over each pixel's footprint; written from the projection alone."""
    camera, item = scene.camera, scene.objects[0]
    assert isinstance(item.texture, PlaidTexture)
    (c_x, c_y), focal = camera.principal_point, camera.focal_px
    velocity = np.array(item.motion[0].velocity_mm_per_frame)  # type: ignore[attr-defined]
    x0, y0, z = np.array(item.pose.position_mm) + velocity * t
    result = np.full((camera.height, camera.width), item.texture.amplitude)
    y, x = np.mgrid[: camera.height, : camera.width]
    for pixels, centre, origin, wavelength in (
        (x + dx, c_x, x0 - x_mm, item.texture.wavelength_mm[0]),
        (y + dy, c_y, y0, item.texture.wavelength_mm[1]),
    ):
        per_px = z / focal / wavelength
        result *= np.cos(2 * np.pi * ((pixels - centre) * per_px - origin / wavelength)) * np.sinc(per_px)
    return item.texture.mean + result


@backends
@pytest.mark.parametrize(("t", "x_mm"), [(0.0, 0.0), (-3.0, 10.0), (1.5, -7.3)])
def test_registration_against_the_analytic_image(opener: Opener, t: float, x_mm: float) -> None:
    scene = plaid_plane()
    with opener(build_scene(scene), scene) as renderer:
        image = renderer.render(t, Viewpoint.on_axis(x_mm))
    assert image.dtype == np.float32
    expected = analytic_plaid(scene, t, x_mm)
    h = 1e-4
    slopes = [
        (analytic_plaid(scene, t, x_mm, *(h * axis)) - analytic_plaid(scene, t, x_mm, *(-h * axis))) / (2 * h)
        for axis in np.eye(2)
    ]
    # Least squares for shift and gain (bilinear texels and n x n samples attenuate a little).
    design = np.column_stack([expected.ravel() - 0.5, *(slope.ravel() for slope in slopes)])
    gain, shift_x, shift_y = np.linalg.lstsq(design, image.ravel() - expected.ravel(), rcond=None)[0]
    assert abs(shift_x) < 1e-3
    assert abs(shift_y) < 1e-3
    assert abs(gain) < 0.01


def test_a_wall_is_not_clipped_where_a_turned_camera_is_nearer_to_it() -> None:
    item = {
        "name": "plaid",
        "mesh": {"kind": "plane", "size_mm": [1200, 1200]},
        "pose": {"position_mm": [3.0, -2.0, 660]},
        "texture": {"kind": "plaid", "wavelength_mm": [47, 53], "amplitude": 0.4},
    }
    scene = plaid_plane(camera={"width": 160, "height": 120, "focal_length_px": 150}, objects=[item])
    world = build_scene(scene)
    viewpoint = Viewpoint(np.zeros(3), Rotation.from_rotvec([0.0, 0.1, 0.0]).as_matrix())
    with open_raycast(world, scene) as one, open_pyrender(world, scene) as two:
        first, second = one.render(0.0, viewpoint), two.render(0.0, viewpoint)
    # Two roundings to 8 bit; the wall fills the view, and is nowhere darker than 0.1.
    assert np.abs(first - second).max() < 0.01
    assert second.min() > 0.05


def test_raycast_evaluates_the_texture_itself() -> None:
    scene = plaid_plane(render={"backend": "raycast", "supersampling": 1})
    image = open_raycast(build_scene(scene), scene).render(0.0, Viewpoint.on_axis(0.0))
    per_px = 660 / 1254 / np.array([4.7, 5.3])
    # One sample is the value at the pixel's centre: the footprint's mean without its attenuation.
    centre = 0.5 + (analytic_plaid(scene, 0.0, 0.0) - 0.5) / np.sinc(per_px).prod()
    np.testing.assert_allclose(image, centre, atol=1e-7)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_raycast_keeps_to_the_remainder_of_gauss_rule(n: int) -> None:
    scene = plaid_plane(render={"backend": "raycast", "supersampling": n})
    image = open_raycast(build_scene(scene), scene).render(0.0, Viewpoint.on_axis(0.0))
    error = float(np.abs(image - analytic_plaid(scene, 0.0, 0.0)).max())
    # (n!)^4 / ((2n + 1) (2n)!^3) times the derivative of order 2n, along either axis; then float32 rounds.
    share = math.factorial(n) ** 4 / ((2 * n + 1) * math.factorial(2 * n) ** 3)
    bound = 0.4 * share * sum((2 * np.pi * 660 / 1254 / wavelength) ** (2 * n) for wavelength in (4.7, 5.3))
    assert error < bound + 1e-7
    if n < 3:
        assert error > 0.8 * bound


@pytest.mark.parametrize(("n", "order"), [(2, 2), (4, 4)])
def test_pyrender_samples_converge_to_the_pixel_integral(n: int, order: int) -> None:
    errors = []
    for count in (n // 2, n):
        scene = plaid_plane(render={"backend": "raycast", "supersampling": count})
        with open_pyrender(build_scene(scene), scene) as renderer:
            image = renderer.render(0.0, Viewpoint.on_axis(0.0))
        errors.append(float(np.abs(image - analytic_plaid(scene, 0.0, 0.0)).max()))
    # From three samples on the weights are exact for cubic functions; from two to four the order rises on top.
    assert np.log2(errors[0] / errors[1]) > order - 0.1


def test_backends_agree_on_the_cube_away_from_edges() -> None:
    scene = cube(render={"backend": "raycast", "supersampling": 4}, background=0.2)
    world = build_scene(scene)
    with open_raycast(world, scene) as one, open_pyrender(world, scene) as two:
        for t, x_mm in ((0.0, 0.0), (-4.0, 10.0)):
            first, second = one.render(t, Viewpoint.on_axis(x_mm)), two.render(t, Viewpoint.on_axis(x_mm))
            difference = np.abs(first - second)
            # Texture coordinates of 32 bits; where the faces turn away, wavelengths of 4 px, of which `even_rule`
            # misses 4e-4; some hundredths of the pixels are mixed.
            assert np.median(difference) < 2e-5
            assert np.percentile(difference, 95) < 5e-4
            background = np.abs(first - 0.2) < 1e-6
            assert background.any()
            assert difference[background].max() <= 0.02


@backends
def test_silhouette_pixels_hold_the_covered_share(opener: Opener) -> None:
    # A white square on black whose edges cut pixels at known fractions.
    square = {
        "name": "square",
        "mesh": {"kind": "plane", "size_mm": [10.25, 10.25]},
        "pose": {"position_mm": [0, 0, 100]},
        "texture": {"kind": "uniform", "radiance": 1.0},
    }
    scene = cube(
        camera={"width": 31, "height": 31, "focal_length_px": 100},
        objects=[square],
        render={"backend": "raycast", "supersampling": 8},
    )
    with opener(build_scene(scene), scene) as renderer:
        image = renderer.render(0.0, Viewpoint.on_axis(0.0))
    # 10.25 px: eleven pixels less 3/8 on either side; with 8 equal samples the shares are exact, with
    # `even_rule` wrong by the sum of its outer three weights less 3/8.
    assert image[15, 9:22] == pytest.approx([0, 0.625, *[1] * 9, 0.625, 0], abs=2.5e-3)
    assert image.sum() == pytest.approx(10.25**2, rel=2e-3)


@backends
def test_repeated_renders_are_identical(opener: Opener) -> None:
    scene = cube()
    world = build_scene(scene)
    with opener(world, scene) as renderer:
        first = renderer.render(1.0, Viewpoint.on_axis(5.0))
        renderer.render(-2.0, Viewpoint.on_axis(-5.0))
        assert (renderer.render(1.0, Viewpoint.on_axis(5.0)) == first).all()


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@nightly
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")
@backends
def test_memory_is_flat_over_500_renders(opener: Opener) -> None:
    scene = cube(camera={"width": 64, "height": 48, "focal_length_px": 500})
    world = build_scene(scene)
    sizes = []
    with opener(world, scene) as renderer:
        for n in range(600):
            renderer.render(0.01 * n, Viewpoint.on_axis(0.0))
            if n in (99, 599):
                gc.collect()
                sizes.append(resident_bytes())
    # Leaking the samples of every image (64 x 48 px, 2 x 2 samples of 2 bytes) would already be 12 MB.
    assert sizes[1] - sizes[0] < 12e6


@backends
def test_closing_twice_is_harmless(opener: Opener) -> None:
    scene = cube()
    renderer = opener(build_scene(scene), scene)
    renderer.close()
    renderer.close()


def test_textures_are_freed_without_the_garbage_collector() -> None:
    scene = cube()
    renderer = open_pyrender(build_scene(scene), scene)
    renderer.render(0.0, Viewpoint(np.zeros(3)))
    textures = [weakref.ref(material.baseColorTexture) for material in renderer._drawing._materials]  # type: ignore[attr-defined]
    assert textures
    gc.disable()
    try:
        renderer.close()
        assert [texture() for texture in textures] == [None] * len(textures)
    finally:
        gc.enable()


@backends
def test_images_in_a_row_are_those_that_are_asked_for_one_by_one(
    opener: Callable[[BuiltScene, Scene], Renderer],
) -> None:
    lamp = {"kind": "directional", "direction": [0.3, -0.2, 1.0], "irradiance": 0.7}
    front = {
        "name": "front",
        "mesh": {"kind": "plane", "size_mm": [20, 14]},
        "pose": {"position_mm": [1.0, 0.5, 640], "rotations": [{"axis": [0, 1, 0], "angle_deg": 20}]},
        "texture": {"kind": "plaid", "wavelength_mm": [4.7, 5.3], "amplitude": 0.4},
    }
    plain = plaid_plane().model_dump(mode="json", exclude_unset=True)
    for lighting in ({}, {"ambient": 0.2, "lights": [lamp]}):
        scene = plaid_plane(objects=[*plain["objects"], front], lighting=lighting)
        world = build_scene(scene)
        moments = [(t, Viewpoint(np.array([x, 0.0, 0.0]))) for t in (0.0, 1.5, 0.0) for x in (0.0, 5.0)]
        with opener(world, scene) as renderer:
            one_by_one = [renderer.render(*moment) for moment in moments]
            # The same bits however often the world was placed anew in between.
            assert (one_by_one[0] == one_by_one[4]).all()
            assert (one_by_one[0] != one_by_one[1]).any()
            in_a_row = list(renderer.render_all(iter(moments)))
            assert len(in_a_row) == len(moments)
            assert all((one == other).all() for one, other in zip(one_by_one, in_a_row, strict=True))
            assert list(renderer.render_all([])) == []
            # Whoever stops early may go on with other images.
            rest = renderer.render_all(iter(moments))
            assert (next(rest) == one_by_one[0]).all()
            assert (renderer.render(*moments[1]) == one_by_one[1]).all()
            assert (next(rest) == one_by_one[1]).all()


Image = NDArray[np.float32]
FRONT, BACK = 0.75, 0.25


@pytest.fixture
def halves(tmp_path: Path) -> Path:
    """Return an image whose left half is one grey with stripes, and whose right half another."""
    generator = np.random.default_rng(5)
    coarse = generator.uniform(-0.2, 0.2, (12, 24))
    values = np.kron(coarse, np.ones((8, 8))) + np.repeat([FRONT, BACK], 96)
    file = tmp_path / "leaf.tiff"
    imageio.imwrite(file, values.astype(np.float32))
    return file


def two_sided(mesh: TriangleMesh) -> TriangleMesh:
    """Show the left half of the image on the front, the right half on the back."""
    assert mesh.uv is not None
    inside = 0.05 + 0.9 * mesh.uv
    return replace(mesh, uv=inside * (0.5, 1), uv_back=inside * (0.5, 1) + (0.5, 0))


def scene_with(file: Path, angle_deg: float, axis: tuple[float, float, float] = (0, 1, 0), **changes: object) -> Scene:
    texture = {"kind": "image", "file": str(file), "encoding": "linear"}
    pose = {"position_mm": [0, 0, 660], "rotations": [{"axis": axis, "angle_deg": angle_deg}]}
    camera = {"width": 80, "height": 60, "focal_length_px": 600}
    return scene_of({"texture": texture, "pose": pose}, camera=camera, **changes)


def raycast(world: BuiltScene, scene: Scene, viewpoint: Viewpoint) -> Image:
    return RaycastRenderer(world, scene.camera, scene.background, 4, scene.lighting).render(0.0, viewpoint)


def pyrender(world: BuiltScene, scene: Scene, viewpoint: Viewpoint) -> Image:
    try:
        renderer = PyrenderRenderer(world, scene.camera, scene.background, 4, "auto", scene.lighting)
    except BackendUnavailableError as error:
        pytest.skip(str(error))
    with renderer:
        return renderer.render(0.0, viewpoint)


@pytest.mark.parametrize("render", [raycast, pyrender])
@pytest.mark.parametrize("axis", [(0, 1, 0), (1, 0, 0), (0.6, 0.8, 0)])
@pytest.mark.parametrize(
    ("angle_deg", "mean"), [(80, FRONT), (100, BACK), *by_night((0, FRONT), (180, BACK), (260, BACK))]
)
def test_a_plane_shows_its_back_past_edge_on(
    render: object, halves: Path, axis: tuple[float, float, float], angle_deg: float, mean: float
) -> None:
    scene = scene_with(halves, angle_deg, axis)
    world = world_of(scene, two_sided(make_plane((60, 40))))
    image = render(world, scene, Viewpoint.on_axis(0.0))  # type: ignore[operator]
    # Blocks of the image differ from the mean of their half by at most 0.2.
    assert (image > 0).sum() > 100
    assert image.max() < BACK + 0.201 if mean == BACK else image.max() > FRONT - 0.2
    # All but the pixels at the outline, which hold background.
    assert np.percentile(image[image > 0], 40) > mean - 0.201


@pytest.mark.parametrize("lit", [False, True])
@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.05, -0.03, 1.3)])
@pytest.mark.parametrize("angle_deg", [0.0, 95.0, *by_night(85.0, 110.0, 200.0)])
def test_backends_agree_on_a_wavy_sheet(halves: Path, lit: bool, turn: tuple[float, ...], angle_deg: float) -> None:
    lighting = {"ambient": 0.5, "lights": [{"kind": "directional", "direction": [0.1, 0.2, 1], "irradiance": 0.5}]}
    scene = scene_with(halves, angle_deg, (0.2, 1, 0), **({"lighting": lighting} if lit else {}))
    world = world_of(scene, two_sided(relief(3, 40, height=0.5)))
    viewpoint = Viewpoint(np.array([1.0, 2.0, 0.0]), Rotation.from_rotvec(turn).as_matrix())
    one, two = raycast(world, scene, viewpoint), pyrender(world, scene, viewpoint)
    difference = np.abs(one - two)
    # Inside, the two rules of 4 x 4 samples differ by the blocks' borders; outlines and folds hold shares of samples.
    assert np.median(difference[one > 0.02]) < 0.02
    assert difference.mean() < 0.02
    if angle_deg > 90:
        # Without the back, they would differ by up to 0.5 from this.
        plain = world_of(scene, replace(two_sided(relief(3, 40, height=0.5)), uv_back=None))
        assert np.abs(raycast(plain, scene, viewpoint) - one).max() > 0.1


def test_every_path_of_the_ray_caster_tells_sides_apart(halves: Path) -> None:
    # Wavy and tilted: both sides are seen, on whole faces, on walks and in traced pixels at folds.
    for cells in (6, 60):
        scene = scene_with(halves, 80.0, (0.1, 1, 0))
        mesh = two_sided(relief(9, cells, height=0.6))
        world = world_of(scene, mesh)
        image = raycast(world, scene, Viewpoint.on_axis(0.0))
        # Only one of the two sides, the other being black.
        parts = []
        for side in range(2):
            uv = (mesh.uv, mesh.uv_back)[side]
            assert uv is not None
            dark = np.zeros_like(uv)
            other = replace(mesh, uv=uv if side == 0 else dark, uv_back=dark if side == 0 else uv)
            file = halves.parent / "dark.tiff"
            values = imageio.imread(halves)
            values[:8, :8] = 0
            imageio.imwrite(file, values)
            half = scene_with(file, 80.0, (0.1, 1, 0))
            parts.append(raycast(world_of(half, other), half, Viewpoint.on_axis(0.0)))
        np.testing.assert_allclose(parts[0] + parts[1], image, atol=3e-7)
        assert min(part.max() for part in parts) > 0.2


def test_a_closed_box_is_unchanged_by_its_back(halves: Path) -> None:
    scene = scene_with(halves, 35.0, (1, 1, 0))
    plain = make_box((30, 30, 30))
    backed = replace(plain, uv_back=np.zeros_like(plain.uv))
    for render in (raycast, pyrender):
        one, two = (render(world_of(scene, mesh), scene, Viewpoint.on_axis(0.0)) for mesh in (plain, backed))
        # Another program may round otherwise in OpenGL.
        np.testing.assert_allclose(one, two, atol=0 if render is raycast else 2e-7)


def test_coordinates_are_chosen_by_the_order_of_corners() -> None:
    scene = scene_of({"texture": {"kind": "uniform"}}, {"texture": {"kind": "uniform"}})
    world = world_of(scene, make_plane((10, 10)), make_plane((10, 10)))
    assert world.uv_back is world.uv
    assert visible_uv(world, RayCaster(world.at(0).vertices_mm, scene_topology(world)), np.zeros(3)) is world.uv
    other = np.ones_like(world.bodies[1].uv)
    sided = BuiltScene((world.bodies[0], replace(world.bodies[1], uv_back=other)))
    np.testing.assert_array_equal(sided.uv_back, np.concatenate([world.bodies[0].uv, other]))
    caster = RayCaster(sided.at(0).vertices_mm, scene_topology(sided))
    # `plane` is wound so that its normal points to -Z.
    np.testing.assert_array_equal(visible_uv(sided, caster, np.zeros(3)), sided.uv)
    np.testing.assert_array_equal(visible_uv(sided, caster, np.array([0, 0, 2000.0])), sided.uv_back)
