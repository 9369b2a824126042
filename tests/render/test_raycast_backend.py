"""Images of smooth surfaces of many facets, and rules that average a pixel."""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.camera import Viewpoint, pixel_rays
from scenetruth.raycast import RayCaster, Topology
from scenetruth.render.raycast_backend import RaycastRenderer, even_rule, gauss_rule, lattice_rule
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import BuiltScene, build_scene
from tests.helpers.blurred_edges import edge_displacement, edge_normal
from tests.helpers.faceted_surfaces import ball, relief, scene_of, world_of
from tests.helpers.nightly import by_night, nightly

CAMERA = {"width": 80, "height": 60, "focal_length_px": 600}
LIGHTS: dict[str, dict[str, Any]] = {
    "unlit": {},
    "lit": {
        "lighting": {"ambient": 0.2, "lights": [{"kind": "directional", "direction": [0.3, 0.2, 1], "irradiance": 0.8}]}
    },
    "spot": {
        "lighting": {
            "ambient": 0.1,
            "shadows": False,
            "lights": [
                {
                    "kind": "spot",
                    "position_mm": [10, -20, 400],
                    "target_mm": [0, 0, 660],
                    "inner_angle_deg": 3.0,
                    "outer_angle_deg": 5.0,
                    "reference_distance_mm": 260.0,
                    "irradiance": 0.8,
                }
            ],
        }
    },
}


def both_ways(
    world: BuiltScene, scene: Scene, t: float = 0.0
) -> tuple[NDArray[np.float32], NDArray[np.float32], int, int]:
    """Return an image, the same with rays for all samples, and how many rays each took."""

    def given_up(_self: object, _view: object, pixels: NDArray[np.int64], *_rule: object) -> Any:
        return np.zeros(len(pixels), dtype=bool), np.zeros(len(pixels))

    images, rays = [], []
    original = RayCaster.cast
    for patches in ({"_walk": RaycastRenderer._walk}, {"_walk": given_up}):
        counts: list[int] = []

        def cast(self: RayCaster, *arguments: Any, counted: list[int] = counts, **named: Any) -> Any:
            counted.append(len(arguments[1]))
            return original(self, *arguments, **named)

        with patch.multiple(RaycastRenderer, **patches), patch.object(RayCaster, "cast", cast):
            renderer = RaycastRenderer(world, scene.camera, scene.background, scene.render.samples, scene.lighting)
            images.append(renderer.render(t, Viewpoint.on_axis(3.0)))
        rays.append(sum(counts))
    return images[0], images[1], rays[0], rays[1]


def poked_through(world: BuiltScene, scene: Scene) -> NDArray[np.bool_]:
    """Tell in which pixels a body is seen that no ray meets through the centres of the pixel and its neighbours."""
    camera, n = scene.camera, 10
    caster = RayCaster(world.at(0.0).vertices_mm, Topology.of(world.at(0).vertices_mm, world.faces, world.crease_deg))
    rays, origin = pixel_rays(camera), Viewpoint.on_axis(3.0).position_mm
    across, down = rays.steps
    steps = (np.arange(n) + 0.5) / n - 0.5

    def bodies(right: float, below: float) -> NDArray[np.int64]:
        face = caster.cast(origin, rays.directions + right * across + below * down).face
        return np.where(face >= 0, world.face_body[face], -1).reshape(camera.height, camera.width)

    centres = np.pad(bodies(0.0, 0.0), 1, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(centres, (3, 3)).reshape(camera.height, camera.width, 9)
    samples = np.stack([bodies(right, below) for below in steps for right in steps], axis=-1)
    new = ~(samples[..., :, None] == around[..., None, :]).any(axis=-1)
    return np.asarray(new.any(axis=-1))


@nightly
@pytest.mark.parametrize("light", ["lit", *by_night(*sorted({*LIGHTS} - {"lit"}))])
@settings(max_examples=8, deadline=None)
@given(seed=some.integers(0, 10_000), fine=some.booleans(), tilt_deg=some.floats(-70, 70))
def test_a_leaf_and_a_ball_are_the_same_traced(light: str, seed: int, fine: bool, tilt_deg: float) -> None:
    turned = {"position_mm": [-15, 0, 660], "rotations": [{"axis": [0.3, 1, 0], "angle_deg": tilt_deg}]}
    scene = scene_of({"pose": turned}, {"pose": {"position_mm": [15, 5, 680]}}, camera=CAMERA, **LIGHTS[light])
    world = world_of(scene, relief(seed, 60 if fine else 20), ball(seed, 4 if fine else 3))
    walked, traced, few, many = both_ways(world, scene)
    apart = poked_through(world, scene)
    assert np.count_nonzero(apart) < 0.01 * apart.size
    np.testing.assert_array_equal(walked[~apart], traced[~apart])
    assert few < 0.6 * many
    assert np.ptp(walked) > 0.1


def test_what_pokes_through_between_the_centres_of_pixels_is_not_seen() -> None:
    turned = {"position_mm": [-15, 0, 660], "rotations": [{"axis": [0.3, 1, 0], "angle_deg": 12.875}]}
    scene = scene_of({"pose": turned}, {"pose": {"position_mm": [15, 5, 680]}}, camera=CAMERA, **LIGHTS["lit"])
    world = world_of(scene, relief(258, 20), ball(258, 3))
    walked, traced, _few, _many = both_ways(world, scene)
    poked = poked_through(world, scene)
    assert 1 <= np.count_nonzero(poked) <= 6
    np.testing.assert_array_equal(walked[~poked], traced[~poked])
    assert np.any(walked != traced)


def test_a_sheet_through_another_is_traced_where_they_meet() -> None:
    through = {"rotations": [{"axis": [0, 1, 0], "angle_deg": 25}], "position_mm": [0, 0, 660]}
    scene = scene_of({}, {"pose": through}, camera=CAMERA)
    walked, traced, few, many = both_ways(world_of(scene, relief(1, 60), relief(2, 60)), scene)
    np.testing.assert_array_equal(walked, traced)
    assert few < 0.6 * many


def test_the_border_of_a_spot_on_a_smooth_sheet_is_walked_too() -> None:
    scene = scene_of({}, camera=CAMERA, render={"backend": "raycast", "supersampling": 4}, **LIGHTS["spot"])
    walked, traced, _few, _many = both_ways(world_of(scene, relief(4, 40)), scene)
    np.testing.assert_array_equal(walked, traced)


def exact_moment(degree: int) -> float:
    """Return the mean of x ** degree over [-1/2, 1/2]."""
    return 0.0 if degree % 2 else 0.5**degree / (degree + 1)


@pytest.mark.parametrize("n", range(1, 17))
def test_gauss_rule_is_exact_up_to_degree_2n_less_1(n: int) -> None:
    positions, weights = gauss_rule(n)
    for degree in range(2 * n):
        assert np.sum(weights * positions**degree) == pytest.approx(exact_moment(degree), abs=1e-15)


@pytest.mark.parametrize("n", range(1, 17))
def test_even_rule_is_even_and_exact_for_cubics_from_three_samples_on(n: int) -> None:
    positions, weights = even_rule(n)
    np.testing.assert_allclose(positions, (np.arange(n) + 0.5) / n - 0.5, atol=1e-15)
    np.testing.assert_allclose(weights, weights[::-1], atol=1e-15)
    assert (weights > 0).all()
    for degree in (0, 1, 2, 3) if n > 2 else (0, 1):
        assert np.sum(weights * positions**degree) == pytest.approx(exact_moment(degree), abs=1e-15)


@pytest.mark.parametrize("n", [3, 4, 8])
def test_even_rule_is_the_nearest_to_equal_weights(n: int) -> None:
    # The smallest change that mends the moments, from the pseudo-inverse instead of the formula.
    positions, weights = even_rule(n)
    moments = np.stack([positions**degree for degree in range(4)])
    missing = [exact_moment(degree) for degree in range(4)] - moments @ np.full(n, 1 / n)
    np.testing.assert_allclose(weights, 1 / n + np.linalg.pinv(moments) @ missing, atol=1e-13)


def test_a_wave_of_six_pixels_loses_the_error_of_equal_weights() -> None:
    frequency, n = 1 / 6, 4
    positions, weights = even_rule(n)
    exact = np.sinc(frequency)
    equal = np.mean(np.cos(2 * np.pi * frequency * positions))
    assert equal / exact - 1 == pytest.approx((np.pi * frequency / n) ** 2 / 6, rel=0.01)
    assert abs(np.sum(weights * np.cos(2 * np.pi * frequency * positions)) / exact - 1) < 1e-4


@given(some.integers(1, 3000))
def test_lattice_rule_is_even_along_axes_and_diagonals(count: int) -> None:
    offsets, weights = lattice_rule(count)
    size = len(offsets)
    assert size >= count
    assert weights.sum() == pytest.approx(1)
    even = (np.arange(size) + 0.5) / size - 0.5
    np.testing.assert_allclose(np.sort(offsets, axis=0), np.column_stack([even, even]), rtol=0, atol=1e-12)
    for diagonal in (offsets[:, 0] + offsets[:, 1], offsets[:, 0] - offsets[:, 1]):
        # Apart from whole periods, all projections differ.
        assert len(np.unique(np.round(diagonal * size).astype(int) % size)) == size


def edge_scene(kind: str, angle_deg: float, distance_px: float, edges: str) -> Scene:
    """Return a scene with a straight edge, black to white: of a texture, or of a white plane."""
    normal, px_mm = edge_normal(angle_deg), 0.25
    along = np.array([-normal[1], normal[0]])
    # Of 2 x 4 squares of 20 px, or of the plane, the edge passes the image centre with its middle.
    middle = distance_px * normal + (10 * along if kind == "checkerboard" else 20 * normal)
    checkerboard = {"kind": "checkerboard", "square_mm": 5.0, "radiances": [0.0, 1.0]}
    return st.Scene.from_dict(
        {
            "camera": {"width": 24, "height": 24, "focal_length_px": 400},
            "stage": {"positions": 1, "baseline_mm": 1},
            "frames": {"count": 1},
            "optics": {"psf": {"kind": "gaussian", "sigma_px": 0.6}},
            "render": {"backend": "raycast", "edges": edges, **({"supersampling": 4} if edges == "sampled" else {})},
            "objects": [
                {
                    "name": "edge",
                    "mesh": {"kind": "plane", "size_mm": [10.0, 20.0]},
                    "texture": checkerboard if kind == "checkerboard" else {"kind": "uniform", "radiance": 1.0},
                    "pose": {
                        "position_mm": [*(px_mm * middle).tolist(), 100.0],
                        "rotations": [{"axis": [0, 0, 1], "angle_deg": angle_deg}],
                    },
                }
            ],
        }
    )


@pytest.mark.parametrize("kind", ["checkerboard", "silhouette"])
@pytest.mark.parametrize("angle_deg", [0.0, 0.3, 20.0, *by_night(3.0, 45.0, 90.0)])
@pytest.mark.filterwarnings("ignore::scenetruth.SceneWarning")
def test_adaptive_edges_are_in_their_place(kind: str, angle_deg: float) -> None:
    for distance in (-0.36, -0.1, 0.013, 0.2, 0.41):
        assert abs(displacement_in(edge_scene(kind, angle_deg, distance, "adaptive"), angle_deg, distance)) < 1e-3
    if angle_deg in (0.0, 90.0):
        # The last edge, at 0.41 px, is where n x n samples are wrong by several hundredths of a pixel.
        sampled = edge_scene(kind, angle_deg, distance, "sampled")
        assert abs(displacement_in(sampled, angle_deg, distance)) > 5e-3


def displacement_in(scene: st.Scene, angle_deg: float, distance: float) -> float:
    """Return the displacement in px of the edge in the only image of a scene."""
    image = st.simulate(scene).recording["image"].values[0, 0].astype(np.float64)
    return edge_displacement(image, edge_normal(angle_deg), distance, 0.6, radius_px=6.0)


def test_sampled_edges_are_the_default_and_leave_no_trace() -> None:
    scene = edge_scene("silhouette", 0.0, 0.0, "sampled")
    assert "edges" not in scene.to_dict()["render"]
    adaptive = edge_scene("silhouette", 0.0, 0.0, "adaptive")
    assert st.Scene.from_dict(adaptive.to_dict()) == adaptive != scene
    assert adaptive.needs_rays == "adaptive edges"


def test_adaptive_samples_of_curved_surfaces_agree_with_brute_force() -> None:
    ball = {
        "name": "ball",
        "mesh": {"kind": "sphere", "radius_mm": 20, "resolution_mm": 1},
        "texture": {"kind": "checkerboard", "square_mm": 4},
        "pose": {"position_mm": [0, 0, 300]},
    }
    scene = st.Scene.from_dict(
        {
            "camera": {"width": 32, "height": 24, "focal_length_px": 170},
            "stage": {"positions": 1, "baseline_mm": 1},
            "frames": {"count": 1},
            "objects": [ball],
        }
    )
    world, view, parts = build_scene(scene), Viewpoint.on_axis(0.0), 40
    fine = RaycastRenderer(world, scene.camera.refined(parts, 0), supersampling=1).render(0.0, view)
    expected = fine.reshape(24, parts, 32, parts).mean(axis=(1, 3), dtype=np.float64)
    errors = {}
    # One sample per pixel is what subpixels before a point spread function have.
    for adaptive in (True, False):
        image = RaycastRenderer(world, scene.camera, supersampling=1, adaptive=adaptive).render(0.0, view)
        errors[adaptive] = float(np.sqrt(np.mean((image - expected) ** 2)))
    # 149 samples of a step of 0.8 have an error of about 0.8 / 149 (Koksma), of which the RMS value is a part.
    assert errors[True] < 0.8 / 149
    assert errors[False] > 5e-2
