"""Sheets that show something else on their back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenetruth.camera import Viewpoint
from scenetruth.errors import BackendUnavailableError
from scenetruth.render.pyrender_backend import PyrenderRenderer
from scenetruth.render.raycast_backend import RaycastRenderer, visible_uv
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import BuiltScene
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.mesh.sheets import make_plane
from scenetruth.scene.mesh.solids import make_box
from tests.nightly import by_night
from tests.surfaces import relief, scene_of, world_of

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
    assert visible_uv(world, world.at(0).vertices_mm, np.zeros(3)) is world.uv
    other = np.ones_like(world.bodies[1].uv)
    sided = BuiltScene((world.bodies[0], replace(world.bodies[1], uv_back=other)))
    np.testing.assert_array_equal(sided.uv_back, np.concatenate([world.bodies[0].uv, other]))
    vertices = sided.at(0).vertices_mm
    # `plane` is wound so that its normal points to -Z.
    np.testing.assert_array_equal(visible_uv(sided, vertices, np.zeros(3)), sided.uv)
    np.testing.assert_array_equal(visible_uv(sided, vertices, np.array([0, 0, 2000.0])), sided.uv_back)
