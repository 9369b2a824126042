"""Images of facets and borders of light and shadow, against exact areas and many samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.camera import Viewpoint
from scenetruth.render.adaptive_raycast import AdaptiveRenderer
from scenetruth.render.footprint_rules import WIDE
from scenetruth.render.raycast_backend import RaycastRenderer
from scenetruth.render.sampling_rules import GAUSS_ORDERS, WIDE_ORDERS, gauss_rule, square_rule
from scenetruth.render.stepped_light import errors_above, step_errors
from scenetruth.scene.built_scene import BuiltScene, build_scene
from tests.helpers.blurred_edges import edge_normal
from tests.helpers.faceted_surfaces import ball, relief, scene_of, world_of
from tests.helpers.nightly import by_night
from tests.helpers.pixel_areas import area_beyond

ON_AXIS = Viewpoint.on_axis(0.0)
WIDTH, HEIGHT, PARTS = 16, 12, 40
LAMPS: dict[str, dict[str, Any]] = {
    "directional": {"kind": "directional", "direction": [-0.5, 0.3, 1], "irradiance": 0.8},
    "point": {"kind": "point", "position_mm": [160, -120, 400], "irradiance": 0.8, "reference_distance_mm": 330},
}
GLOSS = {"refractive_index": 1.5, "roughness": 0.2}


def facets(seed: int, cells: int, lamp: str, material: dict[str, Any]) -> tuple[st.Scene, BuiltScene]:
    """Return a relief of facets of random slopes that fills the image, with edges of 60 / cells px."""
    white = {"kind": "uniform", "radiance": 0.8}
    scene = scene_of(
        {"texture": white, "material": material},
        camera={"width": WIDTH, "height": HEIGHT, "focal_length_px": 660},
        lighting={"ambient": 0.1, "lights": [LAMPS[lamp]], "shadows": False},
    )
    return scene, world_of(scene, relief(seed, cells))


def even_samples(scene: st.Scene, world: BuiltScene, parts: int = PARTS) -> NDArray[np.float64]:
    """Return the image by equally spaced samples, which does without rules."""
    camera = scene.camera
    fine = RaycastRenderer(world, camera.refined(parts, 0), scene.background, 1, scene.lighting).render(0.0, ON_AXIS)
    return np.asarray(fine.reshape(camera.height, parts, camera.width, parts).mean(axis=(1, 3), dtype=np.float64))


def rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def rendered(scene: st.Scene, world: BuiltScene, error: float = 1e-4) -> NDArray[np.float32]:
    """Return the image with samples chosen automatically."""
    renderer = AdaptiveRenderer(world, scene.camera, scene.background, scene.lighting, image_error=error)
    return renderer.render(0.0, ON_AXIS)


@pytest.mark.parametrize("lamp", ["directional", *by_night("point")])
@pytest.mark.parametrize("material", [{}, *by_night(GLOSS)])
@given(seed=some.integers(0, 1000), edge_px=some.floats(1, 5))
@settings(max_examples=2, deadline=None)
def test_facets_are_within_the_stated_error(lamp: str, material: dict[str, Any], seed: int, edge_px: float) -> None:
    scene, world = facets(seed, round(60 / edge_px), lamp, material)
    expected = even_samples(scene, world)
    # Even samples are wrong by about 0.2 / 40^1.5 = 8e-4 of the steps between facets, of up to 0.1.
    assert rms(rendered(scene, world) - expected) < 1e-4 + 8e-5


@pytest.mark.parametrize("lamp", LAMPS)
def test_images_without_pixels_that_can_be_cut(lamp: str) -> None:
    """Textures too fine for Gauss points: all mixed pixels have a lattice of samples."""
    scene = scene_of(
        {"texture": {"kind": "noise", "wavelength_mm": [0.5, 2.0]}},
        camera={"width": WIDTH, "height": HEIGHT, "focal_length_px": 60},
        lighting={"ambient": 0.1, "lights": [LAMPS[lamp]]},
    )
    world = world_of(scene, relief(5, 4))
    expected = even_samples(scene, world, 48)
    assert np.ptp(expected) > 0.2
    # As far as 521 samples go: the texture, whose standard deviation is 0.125, has 5 to 20 waves per pixel.
    assert rms(rendered(scene, world) - expected) < 0.5 * 0.125 / np.sqrt(521)


def test_few_fixed_samples_are_not() -> None:
    scene, world = facets(7, 20, "directional", {})
    expected = even_samples(scene, world)
    fixed = RaycastRenderer(world, scene.camera, scene.background, 2, scene.lighting).render(0.0, ON_AXIS)
    assert rms(fixed - expected) > 5e-4


def test_errors_follow_the_stated_error() -> None:
    scene, world = facets(3, 25, "directional", {})
    exact = rendered(scene, world, 1e-6).astype(np.float64)
    errors = [rms(rendered(scene, world, error) - exact) for error in (1e-5, 1e-4, 1e-3)]
    assert errors[0] < 1e-5
    assert errors[1] < 1e-4
    assert errors[0] < errors[2] < 1e-3


def test_outlines_of_facets_are_exact() -> None:
    white = {"kind": "uniform", "radiance": 0.8}
    scene = scene_of(
        {"texture": white},
        camera={"width": WIDTH, "height": HEIGHT, "focal_length_px": 200},
        lighting={"ambient": 0.1, "lights": [LAMPS["directional"]]},
    )
    world = world_of(scene, ball(5, 2))
    expected = even_samples(scene, world, 48)
    found = rendered(scene, world)
    # A third of the pixels are mixed, with outlines whose even samples are wrong by 0.2 / 48^1.5 of 0.7.
    assert rms(found - expected) < 1e-4 + 0.7 * 0.2 / 48**1.5


@pytest.mark.parametrize("material", [{}, *by_night(GLOSS)])
@given(angle_deg=some.floats(0, 360), distance=some.floats(-4, 4))
@example(angle_deg=299.0, distance=-1.5)
@settings(max_examples=4, deadline=None)
def test_borders_of_shadows_of_near_lamps_are_exact(
    material: dict[str, Any], angle_deg: float, distance: float
) -> None:
    """A straight edge parallel to the floor has a straight shadow, parallel to the edge."""
    normal, lamp_z, gap = edge_normal(angle_deg), -200.0, 30.0
    # From the lamp above the middle of the image, the edge at height 30 mm is seen at the distance on the floor.
    share = (100.0 - gap - lamp_z) / (100.0 - lamp_z)
    middle = (distance * share - 50) * normal
    floor = {"name": "floor", "mesh": {"kind": "plane", "size_mm": [400, 400]}, "pose": {"position_mm": [0, 0, 100]}}
    sheet = {"name": "sheet", "mesh": {"kind": "plane", "size_mm": [100, 400]}}
    rotations = [{"axis": [0, 0, 1], "angle_deg": angle_deg}]
    pose = {"position_mm": [*middle.tolist(), 100.0 - gap], "rotations": rotations}
    white = {"texture": {"kind": "uniform", "radiance": 1.0}, "material": material}
    lamp = {"kind": "point", "position_mm": [0, 0, lamp_z], "irradiance": 0.8, "reference_distance_mm": 300}
    scene = st.Scene.from_dict(
        {
            "camera": {"width": WIDTH, "height": HEIGHT, "focal_length_px": 100},
            "stage": {"positions": 1, "baseline_mm": 1},
            "frames": {"count": 1},
            "objects": [floor | white, sheet | white | {"pose": pose}],
            "lighting": {"ambient": 0.2, "lights": [lamp]},
        }
    )
    world = build_scene(scene)
    # Without the lamp, and without shadows.
    dark, bright = (
        rendered(scene.model_copy(update={"lighting": scene.lighting.model_copy(update=change)}), world)
        for change in ({"lights": ()}, {"shadows": False})
    )
    found = rendered(scene, world)
    x, y = np.meshgrid(np.arange(WIDTH) - (WIDTH - 1) / 2, np.arange(HEIGHT) - (HEIGHT - 1) / 2)
    areas = [area_beyond(normal, distance - float(normal @ place)) for place in zip(x.flat, y.flat, strict=True)]
    share_lit = np.array(areas).reshape(found.shape)
    # Pixels that show the sheet, which is nearer to the camera.
    beyond = 100.0 / (100.0 - gap)
    hidden = (x * normal[0] + y * normal[1]) < distance * share * beyond + 1
    expected = dark + share_lit * (bright - dark)
    error = np.abs(found - expected)
    # Pixels are divided where the centre of a whole neighbour shows the shadow. Beside the sheet, whose outline divides
    # the neighbours, corners of the shadow below a hundredth of a pixel may therefore be missed.
    across = x * normal[0] + y * normal[1]
    shown = np.pad((across < distance) & (across > distance * share * beyond + np.sqrt(0.5)), 1)
    near = np.lib.stride_tricks.sliding_window_view(shown, (3, 3)).any(axis=(2, 3))
    missed = ~hidden & ~near & (share_lit < 1) & (share_lit > 0.99)
    assert (error - (bright - expected))[missed].max(initial=0.0) < 1e-3
    # Places are within 2^-9 of a cell of a quarter pixel; the light varies by 1e-3 within a pixel.
    assert error[~hidden & ~missed].max(initial=0.0) < 1e-3


def test_the_largest_errors_are_above() -> None:
    squares = np.random.default_rng(1).exponential(1e-7, 1000)
    above = errors_above(squares, 1e-4, 2000)
    assert 0 < above.sum() < 1000
    assert squares[~above].sum() <= 2000 * 1e-8
    assert squares[above].min() > squares[~above].max()
    # One more would be too much.
    assert squares[~above].sum() + squares[above].min() > 2000 * 1e-8
    assert not errors_above(squares * 1e-3, 1e-4, 2000).any()
    # A single large error is above, whatever the mean.
    single = np.append(np.zeros(10), (6e-4) ** 2)
    assert errors_above(single, 1e-4, 10**6).tolist() == [False] * 10 + [True]
    assert errors_above(np.full(3, 1.0), 1e-4, 1).all()


@given(seed=some.integers(0, 1000), count=some.integers(1, 400), spread=some.floats(0.1, 4))
@settings(max_examples=60, deadline=None)
def test_the_smallest_errors_are_kept_up_to_their_sum(seed: int, count: int, spread: float) -> None:
    generator = np.random.default_rng(seed)
    squares = 1e-8 * np.exp(spread * generator.normal(size=generator.integers(0, 300)))
    found = errors_above(squares, 1e-4, count)
    # All of them in ascending order, one after another.
    total, expected = 0.0, np.ones(len(squares), dtype=bool)
    for index in np.argsort(squares):
        total += squares[index]
        expected[index] = total > count * 1e-8 * (1 + 1e-12) or squares[index] > 25e-8
    np.testing.assert_array_equal(found, expected)


@given(seed=some.integers(0, 1000), lamps=some.integers(1, 3))
@settings(max_examples=20, deadline=None)
def test_steps_of_light_are_the_mean_over_the_sides_of_faces_and_their_neighbours(seed: int, lamps: int) -> None:
    from scenetruth.render.shading_kernels import face_steps

    generator = np.random.default_rng(seed)
    light, neighbours = generator.random((30, lamps)), generator.integers(-1, 30, (30, 3)).astype(np.int32)
    light[generator.random(light.shape) < 0.2] = np.nan

    def own(face: int) -> float:
        sides = [np.nansum(light[other] - light[face]) ** 2 for other in neighbours[face] if other >= 0]
        return float(sum(sides)) / 3

    expected = [
        (own(face) + np.mean([own(other if other >= 0 else face) for other in neighbours[face]])) / 2
        for face in range(30)
    ]
    np.testing.assert_allclose(face_steps(light, neighbours), expected, rtol=1e-12)


@pytest.mark.parametrize("order", [2, 3, 4, 5, 6, 7, 8])
def test_errors_of_areas_are_those_of_lines_at_random(order: int) -> None:
    rng = np.random.default_rng(order)
    angle, distance = rng.uniform(0, 2 * np.pi, 4000), rng.uniform(-0.6, 0.6, 4000)
    short, long = np.sort(np.abs([np.cos(angle), np.sin(angle)]), axis=0)

    def ramp(shift: Any) -> Any:
        return np.maximum(distance + shift, 0) ** 2 / 2

    # A unit square is cut by a line: the convolution of two boxes, integrated.
    half, rest = (long + short) / 2, (long - short) / 2
    exact = (ramp(half) - ramp(rest) - ramp(-rest) + ramp(-half)) / (long * short)
    offsets, weights = square_rule(*gauss_rule(order))
    found = (offsets @ [np.cos(angle), np.sin(angle)] < distance).T @ weights
    rules = [1 + GAUSS_ORDERS.index(order)] if order in GAUSS_ORDERS else []
    rules += [WIDE + WIDE_ORDERS.index(order)] if order in WIDE_ORDERS else []
    for rule in rules:
        assert np.sqrt(np.mean((found - exact) ** 2)) == pytest.approx(step_errors()[rule], rel=0.1)
