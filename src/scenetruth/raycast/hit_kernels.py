"""Kernels for ray hits: refinement of Embree's candidates, interpolation and pixel footprints."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel, subkernel
from scenetruth.raycast.mesh_topology import ImageRays, TexturedMesh
from scenetruth.raycast.ray_triangle_kernels import (
    DISTANCE,
    FORMS,
    blurs,
    edge_functions,
    inside,
    rounding,
    slope,
    write_forms,
)
from scenetruth.threads import in_bands

__all__ = ["MOST_STEPS", "footprint_forms", "mix_vertices", "refine_hits", "walk_footprints", "ways_out"]


_MOST_CANDIDATES = 40  # maximum number of faces tested per ray
# Rows of footprint forms: numerators of u and v, and their denominator. Columns: coefficients of 1 and of the offsets
# across and down from the pixel centre. `scene.texture.texture_kernels` relies on this order.
_U, _V, _DENOMINATOR = range(3)
_CENTRE, _ACROSS, _DOWN = range(3)


@subkernel()
def _meet(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], face: int, origin: NDArray[np.float64],
    dx: float, dy: float, dz: float,
) -> Any:  # fmt: skip
    """Return whether a ray is inside a face, its depth, b1, b2, and the sine of its angle to the nearest edge."""
    i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
    ax, ay, az = vertices[i, 0] - origin[0], vertices[i, 1] - origin[1], vertices[i, 2] - origin[2]
    bx, by, bz = vertices[j, 0] - origin[0], vertices[j, 1] - origin[1], vertices[j, 2] - origin[2]
    cx, cy, cz = vertices[k, 0] - origin[0], vertices[k, 1] - origin[1], vertices[k, 2] - origin[2]
    # Normals of the planes through the origin and each edge.
    abx, aby, abz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    bcx, bcy, bcz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    cax, cay, caz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
    w2 = dx * abx + dy * aby + dz * abz
    w0 = dx * bcx + dy * bcy + dz * bcz
    w1 = dx * cax + dy * cay + dz * caz
    total = w0 + w1 + w2
    # The plane normal from two sides of the face is more accurate than the sum of the edge functions.
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    slope = nx * dx + ny * dy + nz * dz
    if total == 0.0 or slope == 0.0:
        return False, np.inf, 0.0, 0.0, 0.0
    depth = (nx * ax + ny * ay + nz * az) / slope
    blur_x, blur_y, blur_z = blurs(ax, ay, az, bx, by, bz, cx, cy, cz)
    within = depth > 0.0 and inside(w0, w1, w2, abs(dx) * blur_x + abs(dy) * blur_y + abs(dz) * blur_z)
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    nearest = min(
        abs(w2) / np.sqrt(abx * abx + aby * aby + abz * abz + 1e-300),
        abs(w0) / np.sqrt(bcx * bcx + bcy * bcy + bcz * bcz + 1e-300),
        abs(w1) / np.sqrt(cax * cax + cay * cay + caz * caz + 1e-300),
    )
    return within, depth, w1 / total, w2 / total, nearest / length


def refine_hits(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    neighbours: NDArray[np.int32],
    origin: NDArray[np.float64],
    directions: NDArray[np.float64],
    guesses: NDArray[np.int32],
    width: int,
    margin: float,
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """Compute the exact first face, depth and barycentric coordinates of every ray.

    Where a ray passes close to an edge, or where neighbouring rays hit other faces, all nearby faces are tested in
    float64 and the nearest hit is taken.

    ``vertices``: World positions in mm, shape (n, 3).
    ``faces``: Vertex indices of the faces, shape (m, 3).
    ``neighbours``: Face across each edge, shape (m, 3), -1 for none (`Topology.face_neighbours`).
    ``origin``: Origin of the rays in mm, shape (3,).
    ``directions``: Directions of the rays, shape (k, 3).
    ``guesses``: Candidate face of each ray from Embree, -1 for none, shape (k,).
    ``margin``: Angle in rad to an edge below which adjacent faces are also tested.
    """
    count = directions.shape[0]
    face = np.empty(count, dtype=np.int32)
    depth = np.empty(count, dtype=np.float64)
    weights = np.empty((count, 2), dtype=np.float64)
    rays = (origin, directions, guesses, width, margin)
    out = (face, depth, weights)
    in_bands(_refine_hits, count, vertices, faces, neighbours, *rays, out)
    return out


@kernel()
def _refine_hits(
    low: int, high: int, vertices: NDArray[np.float64], faces: NDArray[np.int32], neighbours: NDArray[np.int32],
    origin: NDArray[np.float64], directions: NDArray[np.float64], guesses: NDArray[np.int32], width: int, margin: float,
    out: tuple[NDArray[Any], ...],
) -> None:  # fmt: skip
    face_out, depth_out, weights = out
    height = directions.shape[0] // width if width > 0 else 0
    candidates = np.empty(_MOST_CANDIDATES, dtype=np.int32)
    for n in range(low, high):
        dx, dy, dz = directions[n, 0], directions[n, 1], directions[n, 2]
        own = guesses[n]
        best, best_depth, best_1, best_2 = -1, np.inf, 0.0, 0.0
        own_depth, own_1, own_2, close = np.inf, 0.0, 0.0, True
        if own >= 0:
            inside, own_depth, own_1, own_2, gap = _meet(vertices, faces, own, origin, dx, dy, dz)
            close = gap < margin
            if inside:
                best, best_depth, best_1, best_2 = own, own_depth, own_1, own_2
        used = 0
        if close and own >= 0:
            for k in range(3):
                if neighbours[own, k] >= 0:
                    candidates[used] = neighbours[own, k]
                    used += 1
        if width > 0:
            y, x = n // width, n % width
            for v in range(max(y - 1, 0), min(y + 2, height)):
                for u in range(max(x - 1, 0), min(x + 2, width)):
                    other = guesses[v * width + u]
                    if other < 0 or other == own:
                        continue
                    known = False
                    for k in range(used):
                        if candidates[k] == other:
                            known = True
                    if known or used >= _MOST_CANDIDATES - 4:
                        continue
                    candidates[used] = other
                    used += 1
                    if close:
                        for k in range(3):
                            if neighbours[other, k] >= 0:
                                candidates[used] = neighbours[other, k]
                                used += 1
        for k in range(used):
            face = candidates[k]
            within, depth, b1, b2, _gap = _meet(vertices, faces, face, origin, dx, dy, dz)
            if within and (depth < best_depth or (depth == best_depth and face < best)):
                best, best_depth, best_1, best_2 = face, depth, b1, b2
        if best < 0 and own >= 0 and width == 0:
            # Without a grid there are no neighbours: a ray that narrowly misses its face keeps the hit of Embree.
            best, best_depth, best_1, best_2 = own, own_depth, own_1, own_2
        face_out[n] = best
        depth_out[n] = best_depth if best >= 0 else np.nan
        weights[n, 0], weights[n, 1] = best_1, best_2


def footprint_forms(
    mesh: TexturedMesh, rays: ImageRays, pixels: NDArray[np.int64], reach: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Map pixel footprints to texture coordinates through the plane of the face at the pixel centre.

    The ray at offset (x, y) from the pixel centre is the centre ray plus x and y times the steps across and down.
    Texture coordinates are therefore quotients of linear forms in (1, x, y).

    ``pixels``: Pixel indices, shape (n,); each must have a hit.
    ``reach``: Half-width of the footprint in px.
    Returns: Forms: numerators of u and v and their denominator (rows), coefficients of 1, x and y (columns), shape (n,
    3, 3); and whether the square of half-width ``reach`` around the centre is inside the face, shape (n,).
    """
    count = pixels.shape[0]
    forms = np.empty((count, 3, 3), dtype=np.float64)
    whole = np.empty(count, dtype=np.bool_)
    in_bands(_footprint_forms, count, mesh, rays, pixels, reach, forms, whole)
    return forms, whole


@kernel()
def _footprint_forms(
    low: int, high: int, mesh: TexturedMesh, rays: ImageRays, pixels: NDArray[np.int64], reach: float,
    forms: NDArray[np.float64], whole: NDArray[np.bool_],
) -> None:  # fmt: skip
    vertices, faces, uv, origin = mesh.vertices, mesh.faces, mesh.uv, rays.origin
    directions, across, down, hits = rays.directions, rays.across, rays.down, rays.face
    apart = 1 if across.shape[0] > 1 else 0
    for n in range(low, high):
        pixel = pixels[n]
        face = hits[pixel]
        i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
        ax, ay, az = vertices[i, 0] - origin[0], vertices[i, 1] - origin[1], vertices[i, 2] - origin[2]
        bx, by, bz = vertices[j, 0] - origin[0], vertices[j, 1] - origin[1], vertices[j, 2] - origin[2]
        cx, cy, cz = vertices[k, 0] - origin[0], vertices[k, 1] - origin[1], vertices[k, 2] - origin[2]
        # The edge functions of `_meet` are linear in the direction; normalised to sum 1 they are barycentric.
        abx, aby, abz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        bcx, bcy, bcz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        cax, cay, caz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
        u0, u1, u2 = uv[face, 0, 0], uv[face, 1, 0], uv[face, 2, 0]
        v0, v1, v2 = uv[face, 0, 1], uv[face, 1, 1], uv[face, 2, 1]
        step_x, step_y = across[pixel * apart], down[pixel * apart]
        dx, dy, dz = directions[pixel, 0], directions[pixel, 1], directions[pixel, 2]
        w0 = dx * bcx + dy * bcy + dz * bcz
        w1 = dx * cax + dy * cay + dz * caz
        w2 = dx * abx + dy * aby + dz * abz
        w0_x = step_x[0] * bcx + step_x[1] * bcy + step_x[2] * bcz
        w1_x = step_x[0] * cax + step_x[1] * cay + step_x[2] * caz
        w2_x = step_x[0] * abx + step_x[1] * aby + step_x[2] * abz
        w0_y = step_y[0] * bcx + step_y[1] * bcy + step_y[2] * bcz
        w1_y = step_y[0] * cax + step_y[1] * cay + step_y[2] * caz
        w2_y = step_y[0] * abx + step_y[1] * aby + step_y[2] * abz
        forms[n, _U, _CENTRE] = w0 * u0 + w1 * u1 + w2 * u2
        forms[n, _U, _ACROSS] = w0_x * u0 + w1_x * u1 + w2_x * u2
        forms[n, _U, _DOWN] = w0_y * u0 + w1_y * u1 + w2_y * u2
        forms[n, _V, _CENTRE] = w0 * v0 + w1 * v1 + w2 * v2
        forms[n, _V, _ACROSS] = w0_x * v0 + w1_x * v1 + w2_x * v2
        forms[n, _V, _DOWN] = w0_y * v0 + w1_y * v1 + w2_y * v2
        forms[n, _DENOMINATOR, _CENTRE] = w0 + w1 + w2
        forms[n, _DENOMINATOR, _ACROSS] = w0_x + w1_x + w2_x
        forms[n, _DENOMINATOR, _DOWN] = w0_y + w1_y + w2_y
        # Largest change of each edge function up to the corners of the square; inside the face all have the same sign.
        span0, span1, span2 = (
            reach * (abs(w0_x) + abs(w0_y)),
            reach * (abs(w1_x) + abs(w1_y)),
            reach * (abs(w2_x) + abs(w2_y)),
        )
        positive = w0 >= span0 and w1 >= span1 and w2 >= span2 and forms[n, _DENOMINATOR, _CENTRE] > 0.0
        negative = w0 <= -span0 and w1 <= -span1 and w2 <= -span2 and forms[n, _DENOMINATOR, _CENTRE] < 0.0
        whole[n] = positive or negative


_LEAST_MIXED = 4096  # minimum number of rays per thread


@inlined
def _mixed(first: float, second: float, third: float, b1: float, b2: float) -> float:
    """Interpolate linearly such that a value common to all corners is reproduced exactly."""
    return first + b1 * (second - first) + b2 * (third - first)


def mix_vertices(
    face: NDArray[np.int32], weights: NDArray[np.float64], faces: NDArray[np.int32], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Interpolate vertex values at faces, -1 for none, shape (n,), by weights of the second and third corner."""
    out = np.empty((face.shape[0], values.shape[1]), dtype=np.float64)
    in_bands(_mix_vertices, face.shape[0], face, weights, faces, values, out, least=_LEAST_MIXED)
    return out


@kernel()
def _mix_vertices(
    low: int, high: int, face: NDArray[np.int32], weights: NDArray[np.float64], faces: NDArray[np.int32],
    values: NDArray[np.float64], out: NDArray[np.float64],
) -> None:  # fmt: skip
    size = values.shape[1]
    for n in range(low, high):
        met, b1, b2 = face[n], weights[n, 0], weights[n, 1]
        for k in range(size):
            if met < 0:
                out[n, k] = np.nan
            else:
                first, second, third = faces[met, 0], faces[met, 1], faces[met, 2]
                out[n, k] = _mixed(values[first, k], values[second, k], values[third, k], b1, b2)


MOST_STEPS = 512
"""Maximum number of steps to one sample."""
_LEAST_WALKED = 128  # minimum number of pixels per thread


@subkernel()
def ways_out(w0: float, w1: float, w2: float) -> Any:
    """Return the number of edges that a ray is outside of, one of these edges, and their common corner if two.

    Edge k runs from corner k to corner k + 1; -1 stands for no edge or corner.
    """
    if w0 < 0.0:
        if w1 < 0.0:
            return (3, -1, -1) if w2 < 0.0 else (2, 1, 2)
        return (2, 0, 1) if w2 < 0.0 else (1, 1, -1)
    if w1 < 0.0:
        return (2, 2, 0) if w2 < 0.0 else (1, 2, -1)
    return (1, 0, -1) if w2 < 0.0 else (0, -1, -1)


def walk_footprints(
    mesh: TexturedMesh, rays: ImageRays, pixels: NDArray[np.int64], offsets: NDArray[np.float64], *, places: bool = True
) -> tuple[NDArray[np.bool_], NDArray[np.int32], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Compute the faces hit by the samples of pixels whose footprint crosses no silhouette or sharp edge.

    The walk follows straight lines in the image from the pixel centre to the first sample, then to the second, and so
    on, across the edges on the line. Without a silhouette or sharp edge, the footprint shows one smooth surface that
    contains all faces on the line.

    A walk is abandoned where the surface ends, turns its back or belongs to another body; where one of the eight
    neighbouring pixels hits another body (the two may intersect); where a sample ray passes exactly through an edge and
    is inside two faces; and after the maximum number of steps.

    ``pixels``: Pixel indices, shape (n,).
    ``offsets``: Offsets of the samples from the pixel centre in px, (x, y), shape (k, 2).
    ``places``: Whether to return depth and barycentric coordinates; otherwise both have no rows.
    Returns: Whether the walk reached all samples, shape (n,); face, (n, k), depth, (n, k), and barycentric coordinates,
    (n, k, 2), as in `Hits`; and texture coordinates, (n, k, 2).
    """
    count, samples = pixels.shape[0], offsets.shape[0]
    arrived = np.zeros(count, dtype=np.bool_)
    face = np.full((count, samples), -1, dtype=np.int32)
    depth = np.empty((count * places, samples), dtype=np.float64)
    weights = np.empty((count * places, samples, 2), dtype=np.float64)
    uv = np.empty((count, samples, 2), dtype=np.float64)
    out = (arrived, face, depth, weights, uv)
    in_bands(_walk_footprints, count, mesh, rays, pixels, offsets, *out, least=_LEAST_WALKED)
    return out


@kernel()
def _walk_footprints(
    low: int, high: int, mesh: TexturedMesh, rays: ImageRays, pixels: NDArray[np.int64], offsets: NDArray[np.float64],
    arrived: NDArray[np.bool_], face_out: NDArray[np.int32], depth_out: NDArray[np.float64],
    weights: NDArray[np.float64], uv_out: NDArray[np.float64],
) -> None:  # fmt: skip
    vertices, faces, neighbours, face_body, uv = mesh.vertices, mesh.faces, mesh.neighbours, mesh.face_body, mesh.uv
    origin, directions, across, down = rays.origin, rays.directions, rays.across, rays.down
    hits, width = rays.face, rays.width
    samples = offsets.shape[0]
    height = hits.shape[0] // width
    apart = 1 if across.shape[0] > 1 else 0
    form = np.empty(FORMS, dtype=np.float64)
    for n in range(low, high):
        pixel = pixels[n]
        face = hits[pixel]
        body = face_body[face]
        alone = True
        row, column = pixel // width, pixel % width
        for y in range(max(row - 1, 0), min(row + 2, height)):
            for x in range(max(column - 1, 0), min(column + 2, width)):
                other = hits[y * width + x]
                alone = alone and other >= 0 and face_body[other] == body
        if not alone:
            continue
        write_forms(vertices, faces, face, origin, form)
        side = 1.0 if form[DISTANCE] > 0.0 else -1.0
        step_x, step_y = across[pixel * apart], down[pixel * apart]
        # Start of the line to the next sample.
        px, py, pz = directions[pixel, 0], directions[pixel, 1], directions[pixel, 2]
        for sample in range(samples):
            right, below = offsets[sample, 0], offsets[sample, 1]
            dx = directions[pixel, 0] + (right * step_x[0] + below * step_y[0])
            dy = directions[pixel, 1] + (right * step_x[1] + below * step_y[1])
            dz = directions[pixel, 2] + (right * step_x[2] + below * step_y[2])
            found = False
            for _step in range(MOST_STEPS):
                w0, w1, w2 = edge_functions(form, dx, dy, dz)
                ways, edge, corner = ways_out(side * w0, side * w1, side * w2)
                if ways == 0:
                    found = True
                    break
                if ways == 3:
                    break
                if ways == 2:
                    # The ray is outside both edges at a corner. The line passes the corner on one side: seen along the
                    # line from inside, the edge that ends at the corner is to the right, the one that begins there to
                    # the left.
                    vertex = faces[face, corner]
                    nx, ny, nz = py * dz - pz * dy, pz * dx - px * dz, px * dy - py * dx
                    left = (
                        nx * (vertices[vertex, 0] - origin[0])
                        + ny * (vertices[vertex, 1] - origin[1])
                        + nz * (vertices[vertex, 2] - origin[2])
                    )
                    edge = (corner + 2) % 3 if side * left > 0.0 else corner
                face = neighbours[face, edge]
                if face < 0 or face_body[face] != body:
                    break
                write_forms(vertices, faces, face, origin, form)
                if not side * form[DISTANCE] > 0.0:
                    break
            total = w0 + w1 + w2
            towards = slope(form, dx, dy, dz)
            # A ray through an edge within rounding is inside two faces, which only a search over all faces resolves.
            blur = rounding(form, dx, dy, dz)
            if not found or min(abs(w0), abs(w1), abs(w2)) <= blur or not side * towards > 0.0:
                break
            b1, b2 = w1 / total, w2 / total
            face_out[n, sample] = face
            if depth_out.shape[0] > 0:
                depth_out[n, sample] = form[DISTANCE] / towards
                weights[n, sample, 0], weights[n, sample, 1] = b1, b2
            for k in range(2):
                first = uv[face, 0, k]
                uv_out[n, sample, k] = first + b1 * (uv[face, 1, k] - first) + b2 * (uv[face, 2, k] - first)
            px, py, pz = dx, dy, dz
            arrived[n] = sample == samples - 1
