"""Light of lamps with a size against closed forms, numerical integration, and areas of visible parts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as some
from numpy.typing import NDArray

from scenetruth.raycast.surface_tree_kernels import build_tree
from scenetruth.render.area_lamp_kernels import CERTAIN, VISIBLE, lamp_shares, unshaded_light
from scenetruth.render.area_lamps import pack_lamp
from scenetruth.render.lamp_shadow_kernels import OPAQUE
from scenetruth.render.reflectance_kernels import reflect_light
from scenetruth.render.reflection import pack_materials
from scenetruth.scene.lighting import DiscLight, Lamp, RectangleLight, RingLight, SphereLight
from scenetruth.scene.material import MATT, Material
from tests.helpers.nightly import by_night

Floats = NDArray[np.float64]
FLAT = {"position_mm": (0.0, 0.0, 0.0), "direction": (0.0, 0.0, 1.0), "irradiance": 1.0, "reference_distance_mm": 500.0}
EYE = np.array([120.0, -40.0, 0.0])
UP = (0.0, 0.0, -1.0)


def disc(radius_mm: float = 50.0, **other: Any) -> Lamp:
    return DiscLight.model_validate({"kind": "disc", "radius_mm": radius_mm, **FLAT, **other}).lamp(0.0)


def ring(inner_mm: float, radius_mm: float, **other: Any) -> Lamp:
    return RingLight.model_validate(
        {"kind": "ring", "inner_radius_mm": inner_mm, "radius_mm": radius_mm, **FLAT, **other}
    ).lamp(0.0)


def panel(width_mm: float, height_mm: float, **other: Any) -> Lamp:
    return RectangleLight.model_validate({"kind": "rectangle", "size_mm": (width_mm, height_mm), **FLAT, **other}).lamp(
        0.0
    )


def ball(radius_mm: float) -> Lamp:
    values = {key: value for key, value in FLAT.items() if key != "direction"}
    return SphereLight.model_validate({"kind": "sphere", "radius_mm": radius_mm, **values}).lamp(0.0)


def seen(points: Floats, normals: Floats) -> Any:
    return EYE, np.ascontiguousarray(points), np.ascontiguousarray(normals), np.zeros(len(points), dtype=np.int32)


def surface(material: Material = MATT) -> Any:
    return np.array([[1.0, 0.3, 0.0]]), np.zeros(1, dtype=np.int32), *pack_materials([material])


def light_of(lamp: Lamp, points: Floats, normals: Floats, material: Material = MATT) -> Floats:
    return unshaded_light(pack_lamp(lamp), seen(points, normals), surface(material))


def summed(lamp: Lamp, point: Floats, normal: Floats, material: Material = MATT, count: int = 400) -> Floats:
    """Return the light as the sum over parts of the lamp, each of them a point."""
    area = lamp.area
    assert area is not None
    assert lamp.position_mm is not None
    inner, outer = area.sizes_mm
    axis, across, down, centre = lamp.axis, area.across, area.down, lamp.position_mm
    if area.shape == "sphere":
        away = point - centre
        axis = away / np.linalg.norm(away)
        across = np.cross(axis, [0.3, 0.5, 0.8])
        across /= np.linalg.norm(across)
        down = np.cross(axis, across)
        share = outer / np.linalg.norm(away)
        centre, outer = centre + axis * outer * share, outer * np.sqrt(1 - share**2)
        inner = 0.0
    nodes = (np.arange(count) + 0.5) / count
    if area.shape == "rectangle":
        x, y = np.meshgrid(inner * (2 * nodes - 1), outer * (2 * nodes - 1))
        parts = np.full(x.shape, 4 * inner * outer / count**2)
    else:
        radius, angle = np.meshgrid(inner + (outer - inner) * nodes, 2 * np.pi * nodes)
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        parts = radius * (outer - inner) * 2 * np.pi / count**2
    places = centre + x.reshape(-1, 1) * across + y.reshape(-1, 1) * down
    ways = places - point
    far = np.linalg.norm(ways, axis=1)
    towards = ways / far[:, None]
    irradiance = area.radiance * parts.ravel() * np.maximum(-(towards @ axis), 0) / far**2
    factors, gloss = np.zeros((2, len(far)))
    many = seen(np.tile(point, (len(far), 1)), np.tile(normal, (len(far), 1)))
    reflect_light(irradiance, np.ascontiguousarray(towards), many, surface(material), factors, gloss)
    return np.array([factors.sum(), gloss.sum()])


def unit(values: Any) -> Floats:
    return np.asarray(values, dtype=np.float64) / np.linalg.norm(values)


def in_front(lamp: Lamp, *triangles: Any, points: Floats, depth: float = OPAQUE, near: float = 0.0) -> Any:
    """Return shares and states of points that face the lamps, with triangles in front of them."""
    corners = np.concatenate([np.array([[[0, 0, 900], [1, 0, 900], [0, 1, 900]]]), *triangles]).astype(np.float64)
    count = len(corners)
    neighbours, bodies = np.full((count, 3), -1, dtype=np.int32), np.arange(count, dtype=np.int32)
    tree = build_tree(corners, neighbours, bodies)
    depths = np.full(count, depth)
    normals = np.tile(UP, (len(points), 1))
    place = seen(points, normals)
    tables = (np.tile([1.0, 0.3, 0.0], (count, 1)), np.zeros(count, dtype=np.int32), *pack_materials([MATT]))
    return lamp_shares(pack_lamp(lamp), tree, depths, place, (place[1], np.full(len(points), near)), tables)


def half_plane(edge_mm: float, distance_mm: float) -> Floats:
    """Return a large sheet across the axis with an edge along y at x, which covers smaller x."""
    low, high = edge_mm - 1e5, 1e5
    corners = np.array([[edge_mm, -high], [edge_mm, high], [low, high], [low, -high]])
    points = np.column_stack([corners, np.full(4, distance_mm)])
    return points[[[0, 1, 2], [0, 2, 3]]]


def test_irradiance_on_the_axis_is_the_specified_one_at_the_reference_distance() -> None:
    point = np.array([[0.0, 0.0, 500.0]])
    for lamp in (disc(50.0), disc(400.0), ring(30.0, 60.0), panel(80.0, 300.0), ball(60.0), ball(450.0)):
        assert light_of(lamp, point, np.array([UP]))[0, 0] == pytest.approx(1.0, rel=1e-12)


@given(some.floats(1.0, 300.0), some.floats(20.0, 900.0), some.floats(0.0, 500.0))
def test_disc_and_a_parallel_plane(radius: float, height: float, offset: float) -> None:
    # Howell, Catalog of radiation heat transfer configuration factors, B-12.
    lamp = disc(radius)
    assert lamp.area is not None
    square = height**2 + offset**2
    factor = 0.5 * (1 - (square - radius**2) / np.sqrt((square + radius**2) ** 2 - 4 * radius**2 * offset**2))
    found = light_of(lamp, np.array([[offset, 0.0, height]]), np.array([UP]))[0, 0]
    assert found == pytest.approx(np.pi * lamp.area.radiance * factor, rel=1e-6)


@given(some.floats(1.0, 400.0), some.floats(-600.0, 600.0), some.floats(0.0, 0.6))
def test_sphere_above_the_horizon_is_a_point(radius: float, offset: float, tilt: float) -> None:
    point = np.array([offset, 200.0, 500.0])
    far = float(np.linalg.norm(point))
    normal = unit([-np.sin(tilt), 0.0, -np.cos(tilt)])
    cosine = float(-(point @ normal) / far)
    if radius >= 0.99 * far or cosine * far < radius:
        return
    found = light_of(ball(radius), point[None], normal[None])[0, 0]
    assert found == pytest.approx((500.0 / far) ** 2 * cosine, rel=1e-9)


def test_ring_is_the_difference_of_discs() -> None:
    point, normal = np.array([[150.0, 30.0, 260.0]]), unit([0.1, -0.3, -1.0])[None]
    parts = [light_of(lamp, point, normal)[0, 0] / lamp.area.radiance for lamp in (disc(60.0), disc(25.0))]  # type: ignore[union-attr]
    lamp = ring(25.0, 60.0)
    assert lamp.area is not None
    assert light_of(lamp, point, normal)[0, 0] / lamp.area.radiance == pytest.approx(parts[0] - parts[1], rel=1e-10)


LAMPS = {"disc": disc(80.0), "ring": ring(70.0, 140.0), "panel": panel(60.0, 240.0), "ball": ball(90.0)}
PLACES = (
    ((30.0, -20.0, 500.0), (0.2, 0.1, -1.0)),
    ((300.0, 100.0, 150.0), (-1.0, 0.3, -0.1)),
    ((-60.0, 0.0, 130.0), (1.0, 0.2, -0.4)),
)


@pytest.mark.parametrize("name", LAMPS)
@pytest.mark.parametrize(("point", "normal"), PLACES)
def test_light_is_the_sum_over_the_lamp_also_at_the_horizon(name: str, point: Any, normal: Any) -> None:
    lamp, place = LAMPS[name], np.array(point)
    found = light_of(lamp, place[None], unit(normal)[None])[0]
    # The midpoint rule misses the border of the horizon by a part of a cell.
    assert found == pytest.approx(summed(lamp, place, unit(normal)), rel=1e-3, abs=1e-4)


def test_light_from_behind_passes_a_sheet() -> None:
    sheet = Material(transmittance=0.4)
    point, normal = np.array([20.0, 0.0, 300.0]), unit([0.1, 0.0, 1.0])
    for lamp in LAMPS.values():
        front = light_of(lamp, point[None], -normal[None])[0, 0]
        assert light_of(lamp, point[None], normal[None], sheet)[0, 0] == pytest.approx(0.4 * front, rel=1e-9)


@pytest.mark.parametrize("name", LAMPS)
@pytest.mark.parametrize("roughness", [0.1, *by_night(0.2, 0.4), 0.6])
def test_gloss_shows_the_lamp(name: str, roughness: float) -> None:
    lamp, material = LAMPS[name], Material(refractive_index=1.5, roughness=roughness)
    # In the direction of the reflected centre, at its border, and outside.
    for x in (-120.0, -60.0, -20.0, 60.0):
        point, normal = np.array([x, 30.0, 520.0]), np.array(UP)
        expected = summed(lamp, point, normal, material)
        found = light_of(lamp, point[None], normal[None], material)[0]
        assert found[0] == pytest.approx(expected[0], rel=2e-4)
        assert found[1] == pytest.approx(expected[1], abs=1e-3 * expected.sum())


@pytest.mark.parametrize("roughness", [0.05, 0.1, 0.3])
@pytest.mark.parametrize("normal", [(0.2, 0.1, -1.0), (0.9, -0.3, -0.5), (-0.5, 0.6, -0.2)])
def test_white_surfaces_among_lamps_reflect_all_light(normal: Any, roughness: float) -> None:
    """Six panels, each of which is 90° wide, enclose a point: it sees equal radiance in all directions."""
    material, total = Material(refractive_index=1.5, roughness=roughness), 0.0
    at = np.array([[0.0, 0.0, 600.0]])
    for axis in range(3):
        for sign in (-1.0, 1.0):
            ahead, across = np.roll([1.0, 0.0, 0.0], axis), np.roll([0.0, 1.0, 0.0], axis)
            place = {"position_mm": tuple(at[0] - 400 * sign * ahead), "direction": tuple(sign * ahead)}
            lamp = panel(800.0, 800.0, width_direction=tuple(across), **place)
            assert lamp.area is not None
            total += light_of(lamp, at, unit(normal)[None], material).sum() / (np.pi * lamp.area.radiance)
    # At 75° from the normal, the highlight is narrower than the points of the lamp resolve; elsewhere, sums have 1e-3.
    assert total == pytest.approx(1.0, abs=5e-3 if normal[2] > -0.5 else 1e-3)


def test_a_tiny_lamp_is_a_point() -> None:
    material = Material(refractive_index=1.5, roughness=0.3)
    point, normal = np.array([[80.0, 30.0, 450.0]]), unit([0.2, 0.0, -1.0])[None]
    far = np.linalg.norm(point[0])
    facing = point[0, 2] / far
    factors, gloss = np.zeros((2, 1))
    reflect_light(np.array([(500 / far) ** 2]), -point / far, seen(point, normal), surface(material), factors, gloss)
    for lamp, share in ((disc(0.05), facing), (panel(0.1, 0.1), facing), (ring(0.02, 0.05), facing), (ball(0.05), 1.0)):
        found = light_of(lamp, point, normal, material)[0]
        assert found == pytest.approx([share * factors[0], share * gloss[0]], rel=1e-6)


def test_total_flux() -> None:
    # Lambert's law: the flux of a flat lamp is π times its area and radiance; through a sphere around it.
    cosines, weights = np.polynomial.legendre.leggauss(40)
    level = 0.5 + 0.5 * cosines
    points = 300.0 * np.column_stack([np.sqrt(1 - level**2), np.zeros(40), level])
    lamp = disc(120.0)
    assert lamp.area is not None
    found = light_of(lamp, points, -points / 300.0)[:, 0]
    flux = float(2 * np.pi * 300.0**2 * 0.5 * weights @ found)
    assert flux == pytest.approx(np.pi * lamp.area.radiance * np.pi * 120.0**2, rel=2e-4)


def segment(x: Floats) -> Floats:
    """Return the part of a disc of radius 1 beyond x."""
    x = np.clip(x, -1, 1)
    return (np.arccos(x) - x * np.sqrt(1 - x**2)) / np.pi


def penumbra(lamp: Lamp, depth: float = OPAQUE) -> tuple[Floats, Floats]:
    """Return places of a half plane's edge on a lamp, as seen from points along a line, and the shares of its light.

    The lamp is small, seen from the points, so that all its parts give equal light.
    """
    sheet, far = 6e3, 2e4
    on_lamp = np.linspace(-60.0, 60.0, 121) + 0.123
    points = np.column_stack([-on_lamp * (far - sheet) / sheet, np.zeros(121), np.full(121, far)])
    return on_lamp, in_front(lamp, half_plane(0.0, sheet), points=points, depth=depth)[0][:, 0]


STRAIGHT = (
    (disc(50.0), lambda x: segment(x / 50)),
    (ring(20.0, 50.0), lambda x: (2500 * segment(x / 50) - 400 * segment(x / 20)) / 2100),
    (panel(80.0, 30.0), lambda x: np.clip(0.5 - x / 80, 0, 1)),
)


@pytest.mark.parametrize(("lamp", "analytic"), STRAIGHT, ids=["disc", "ring", "rectangle"])
def test_penumbra_of_a_straight_edge(lamp: Lamp, analytic: Callable[[Floats], Floats]) -> None:
    x, shares = penumbra(lamp)
    # Light differs over the lamp by the square of 50 / 2e4, 6e-6.
    assert shares == pytest.approx(analytic(x), abs=2e-5)
    assert (shares[0], shares[-1]) == (1.0, 0.0)


def test_sheets_let_light_through() -> None:
    x, shares = penumbra(disc(50.0), depth=-float(np.log(0.3)))
    assert shares == pytest.approx(0.3 + 0.7 * segment(x / 50), abs=2e-5)


@example(1766)  # corners of outlines inside the lamp
@given(some.integers(0, 2**32 - 1))
def test_triangles_hide_their_area(seed: int) -> None:
    generator = np.random.default_rng(seed)
    triangles = np.concatenate(
        [generator.uniform(-40, 40, (4, 3, 2)), generator.uniform(4e3, 1.6e4, (4, 3, 1))], axis=2
    )
    lamp, point = disc(50.0), np.array([[0.0, 0.0, 2e4]])
    shares, state = in_front(lamp, triangles, points=point)
    radius, angle = np.meshgrid(np.sqrt((np.arange(150) + 0.5) / 150), 2 * np.pi * (np.arange(400) + 0.5) / 400)
    places = 50 * np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1).reshape(-1, 2)
    flat = triangles[..., :2] * 2e4 / (2e4 - triangles[..., 2:])
    hidden = np.zeros(len(places), dtype=bool)
    for a, b, c in flat:
        sides = [
            (q[0] - p[0]) * (places[:, 1] - p[1]) - (q[1] - p[1]) * (places[:, 0] - p[0])
            for p, q in ((a, b), (b, c), (c, a))
        ]
        hidden |= (np.min(sides, axis=0) > 0) | (np.max(sides, axis=0) < 0)
    assert shares[0, 0] == pytest.approx(1 - hidden.mean(), abs=3e-3)
    assert (state[0] == 0) == (shares[0, 0] < 1) or hidden.mean() < 5e-3


@given(some.integers(0, 2**32 - 1), some.sampled_from([0.0, 20.0]), some.sampled_from([0.4, OPAQUE]))
def test_sheets_that_overlap_weaken_the_light_one_after_the_other(seed: int, inner: float, depth: float) -> None:
    generator = np.random.default_rng(seed)
    triangles = np.concatenate(
        [generator.uniform(-50, 50, (5, 3, 2)), generator.uniform(4e3, 1.6e4, (5, 3, 1))], axis=2
    )
    lamp = ring(inner, 50.0) if inner else disc(50.0)
    shares, _ = in_front(lamp, triangles, points=np.array([[0.0, 0.0, 2e4]]), depth=depth)
    square, angle = np.meshgrid((np.arange(150) + 0.5) / 150, 2 * np.pi * (np.arange(400) + 0.5) / 400)
    radius = np.sqrt(inner**2 + square * (50.0**2 - inner**2))
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    number = np.zeros_like(x)
    for a, b, c in triangles[..., :2] * 2e4 / (2e4 - triangles[..., 2:]):
        sides = [(q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) for p, q in ((a, b), (b, c), (c, a))]
        number += (np.min(sides, axis=0) > 0) | (np.max(sides, axis=0) < 0)
    # Of 60,000 equal parts, those at the 15 edges, of 100 each, are seen or hidden as a whole.
    assert shares[0, 0] == pytest.approx(np.exp(-depth * number).mean(), abs=2e-3)


def test_states_of_points() -> None:
    lamp, sheet = disc(50.0), half_plane(-60.0, 300.0)
    points = np.array([[0.0, 0.0, 900.0]])
    shares, state = in_front(lamp, sheet, points=points)
    assert (shares[0, 0], state[0]) == (1.0, CERTAIN)
    # The point may move to where the sheet is in front of the lamp.
    _, state = in_front(lamp, sheet, points=points, near=200.0)
    assert state[0] == VISIBLE
    _, state = in_front(lamp, half_plane(0.0, 300.0), points=points)
    assert state[0] == 0
