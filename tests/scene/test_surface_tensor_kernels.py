"""Normal, deformation, rotation and curvature of surfaces: against closed forms, with and without a formula."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from scenetruth.scene.mesh import make_box
from scenetruth.scene.motion import PointMap, Points, rotate_points
from scenetruth.scene.reference_configuration import (
    FittedConfiguration,
    ReferenceConfiguration,
    SheetConfiguration,
    fit_quadrics,
)
from scenetruth.scene.surface_tensor_kernels import surface_tensors
from scenetruth.scene.taylor import Jet

Array = NDArray[np.float64]


def lattice(count: int, size: float = 2.0) -> tuple[Array, NDArray[np.int32]]:
    """Return points of a square, skewed so that nothing is symmetric, and triangles."""
    i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    a, b = i.ravel() / count * size - size / 2, j.ravel() / count * size - size / 2
    corner = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    quads = np.stack([corner, corner + count + 1, corner + count + 2, corner + 1], axis=1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    return np.column_stack([a + 0.1 * b, b + 0.05 * a * a]), faces


def tensors(start: ReferenceConfiguration, maps: list[PointMap], t: float = 0.0) -> Array:
    time = Jet.variable(np.array([t]), 0, 3)
    points = start.surface(time)
    for item in maps:
        points = item(points, time)
    return np.asarray(surface_tensors(*(field.coefficients for field in points)))


def matrices(values: Array) -> Array:
    xx, yy, zz, xy, xz, yz = values.T
    return np.moveaxis(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), -1, 0)


def bowl(points: Points, t: object) -> Points:
    """A cap of a sphere of radius 3 that is z = 3 - sqrt(9 - x^2 - y^2)."""
    x, y, _ = points
    return x, y, 3 - np.sqrt(9 - x * x - y * y)


def flow_of(rate: Array) -> PointMap:
    """Return the motion with the velocity ``rate @ point`` at t = 0."""

    def move(points: Points, t: object) -> Points:
        return tuple(x + sum(float(rate[i, j]) * points[j] for j in range(3)) * t for i, x in enumerate(points))

    return move


RATE = np.array([[0.02, 0.05, -0.01], [0.01, -0.03, 0.04], [0.03, 0.02, 0.06]])


def expected(points: Array, normals: Array) -> tuple[Array, Array, Array]:
    """Return D, ω and the growth of a linear flow on a surface with given normals, by projections."""
    project = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    strain = project @ ((RATE + RATE.T) / 2) @ project
    # A material surface's normal changes by -(∇V)ᵀ n, less its part along n.
    change = -np.einsum("ji,nj->ni", RATE, normals)
    change -= normals * np.einsum("ni,ni->n", change, normals)[:, None]
    vorticity = np.array([RATE[2, 1] - RATE[1, 2], RATE[0, 2] - RATE[2, 0], RATE[1, 0] - RATE[0, 1]]) / 2
    spin = np.einsum("ni,i->n", normals, vorticity)
    turning = np.cross(normals, change) + spin[:, None] * normals
    return strain, turning, np.trace(strain, axis1=1, axis2=2)


def test_a_sheet_with_a_formula_is_exact() -> None:
    material, faces = lattice(12)
    found = tensors(SheetConfiguration(material, faces), [bowl, flow_of(RATE)])
    x, y = material.T
    normals = np.column_stack([-x, -y, np.sqrt(9 - x * x - y * y)]) / 3
    np.testing.assert_allclose(found[:, :3], normals, atol=1e-13)
    strain, turning, growth = expected(material, normals)
    np.testing.assert_allclose(matrices(found[:, 3:9]), strain, atol=1e-14)
    np.testing.assert_allclose(found[:, 9:12], turning, atol=1e-14)
    np.testing.assert_allclose(found[:, 3:6].sum(axis=1), growth, atol=1e-14)
    # The surface curves towards its normal, everywhere by 1/3 in every direction.
    project = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    np.testing.assert_allclose(matrices(found[:, 12:18]), project / 3, atol=1e-13)


def test_fits_to_a_mesh_converge_at_second_order() -> None:
    errors = []
    for count in (8, 16, 32):
        material, faces = lattice(count)
        x, y = material.T
        vertices = np.column_stack(bowl((x, y, 0 * x), None))
        start = FittedConfiguration(vertices, faces, 60.0)
        found = tensors(start, [flow_of(RATE)])
        x, y = material[start.osculation.vertices].T
        normals = np.column_stack([-x, -y, np.sqrt(9 - x * x - y * y)]) / 3
        strain, turning, _ = expected(material, normals)
        project = np.eye(3) - normals[:, :, None] * normals[:, None, :]
        inner = np.maximum(np.abs(x), np.abs(y)) < 0.8
        errors.append(
            [
                np.abs(matrices(found[:, 3:9]) - strain)[inner].max(),
                np.abs(found[:, 9:12] - turning)[inner].max(),
                np.abs(matrices(found[:, 12:18]) - project / 3)[inner].max(),
            ]
        )
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert errors[-1] < [1e-3, 1e-3, 1e-2]
    assert (orders[-1] > 1.7).all(), (errors, orders)


def test_rigid_motion_neither_grows_nor_bends_but_turns() -> None:
    axis, rate = np.array([0.3, -0.5, 0.8]), 0.07
    axis /= np.linalg.norm(axis)

    def spin(points: Points, t: object) -> Points:
        return rotate_points(points, tuple(axis), rate * t, (0.5, 0.2, 7.0))  # type: ignore[operator]

    material, faces = lattice(6)
    found = tensors(SheetConfiguration(material, faces), [bowl, spin], t=2.5)
    np.testing.assert_allclose(found[:, 3:9], 0, atol=1e-15)
    np.testing.assert_allclose(found[:, 9:12], np.tile(rate * axis, (len(found), 1)), atol=1e-14)
    curvature = np.linalg.eigvalsh(matrices(found[:, 12:18]))
    np.testing.assert_allclose(curvature, np.tile([0, 1 / 3, 1 / 3], (len(found), 1)), atol=1e-13)


def test_sides_of_a_box_are_surfaces_of_their_own() -> None:
    sides = make_box((10, 20, 30))
    found = fit_quadrics(sides.vertices_mm, sides.faces, 1.0)
    assert len(found.vertices) == 24
    np.testing.assert_array_equal(found.vertices[found.corners], sides.faces)
    flat = tensors(FittedConfiguration(sides.vertices_mm, sides.faces, 1.0), [])
    np.testing.assert_allclose(np.abs(flat[:, :3]).max(axis=1), 1, atol=1e-14)
    np.testing.assert_allclose(flat[:, 12:18], 0, atol=1e-14)
    # With a crease angle of more than its edges a box counts as one smooth surface.
    assert len(fit_quadrics(sides.vertices_mm, sides.faces, 91.0).vertices) == 8


def test_seams_and_flipped_faces_do_not_cut_a_surface() -> None:
    material, faces = lattice(5)
    vertices = np.column_stack([material, np.zeros(len(material))])
    torn = vertices[faces].reshape(-1, 3)
    own = np.arange(len(torn), dtype=np.int32).reshape(-1, 3)
    own[::3] = own[::3, ::-1]
    found = fit_quadrics(torn, own, 1.0)
    assert len(found.vertices) == len(vertices)


def test_fits_are_made_around_two_rings_where_one_has_too_few_neighbours() -> None:
    rng = np.random.default_rng(3)
    faces = np.array([rng.choice(60, 3, replace=False) for _ in range(70)], dtype=np.int32)
    found = fit_quadrics(rng.normal(size=(60, 3)), faces, 180.0)
    graph: dict[int, set[int]] = {point: set() for point in range(len(found.vertices))}
    for corners in found.corners.tolist():
        for point in corners:
            graph[point] |= {other for other in corners if other != point}
    wide = 0
    for point, ring in graph.items():
        near = {int(vertex) for vertex in found.neighbours[found.starts[point] : found.starts[point + 1]]}
        one = {int(found.vertices[other]) for other in ring}
        two = {int(found.vertices[far]) for other in ring for far in graph[other] if far != point}
        assert near in (one, one | two)
        # Five neighbours are the least that can determine a quadratic function.
        assert near == one | two or len(ring) >= 5
        wide += near != one
    assert 0 < wide < len(graph)
    # Surface points are the components of the graph whose edges are the sides that faces share.
    positions, sides = faces.ravel(), dict[tuple[int, int], list[tuple[int, int]]]()
    for face in range(len(faces)):
        for one_end, other_end in ((0, 1), (1, 2), (2, 0)):
            ends = (3 * face + one_end, 3 * face + other_end)
            sides.setdefault(tuple(sorted(int(positions[end]) for end in ends)), []).append(ends)  # type: ignore[arg-type]
    links = sparse.lil_array((faces.size, faces.size))
    for pair in (found for found in sides.values() if len(found) == 2):
        for here in pair[0]:
            for there in pair[1]:
                links[here, there] = positions[here] == positions[there]
    label = sparse.csgraph.connected_components(links, directed=False)[1]
    np.testing.assert_array_equal(found.corners.ravel(), label)
    assert faces.size > len(found.vertices) > 60


def test_fits_are_exact_on_quadratic_fields() -> None:
    material, faces = lattice(7)
    vertices = np.column_stack([material, np.zeros(len(material))])
    found = fit_quadrics(vertices, faces, 1.0)
    field = 2 + material @ [0.3, -0.7] + 0.5 * material[:, 0] ** 2 - material[:, 0] * material[:, 1]
    a, b, aa, ab, bb = found.derivatives(field)
    x, y = material[found.vertices].T
    # Tangents are any two; the gradient's length and the Hessian's invariants are not.
    np.testing.assert_allclose(np.hypot(a, b), np.hypot(0.3 + x - y, -0.7 - x), atol=1e-11)
    np.testing.assert_allclose(aa + bb, 1, atol=1e-10)
    np.testing.assert_allclose(aa * bb - ab * ab, -1, atol=1e-10)


def test_a_surface_without_an_area_has_no_tensors() -> None:
    zero = np.zeros((10, 1))
    assert np.isnan(surface_tensors(zero, zero, zero)).all()


@pytest.mark.parametrize("dtype", [np.float64, np.longdouble])
def test_starts_are_of_the_kind_of_the_time(dtype: type) -> None:
    material, faces = lattice(2)
    rest = FittedConfiguration(np.column_stack([material, material[:, 0]]), faces, 1.0)
    for start in (SheetConfiguration(material, faces), rest):
        plain = start.at(np.array([0.5], dtype=dtype))
        assert all(field.dtype == dtype and len(field) == len(material) for field in plain)
        moving = start.at(Jet.variable(np.array([0.5], dtype=dtype), 0, 1))
        assert all(field.coefficients.dtype == dtype and not field.coefficients[1:].any() for field in moving)
