"""Make the files of finite_elements.yaml: a plate with a hole, pulled and bent, by linear finite elements.

    python scenes/make_finite_elements.py

writes ``finite_elements/plate.obj`` and ``finite_elements/displacements.npy`` (frames, nodes, 3), in mm. The left edge
is clamped; the right one is pulled evenly by a force that grows steadily, and bent towards the camera by one that
swells and fades. In the plane: plane stress, triangles of constant strain. Out of it: a thin (Kirchhoff) plate,
Morley's triangles of constant curvature. Both are linear, so that each state is a sum of two solutions.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

FOLDER = Path(__file__).parent / "finite_elements"
FRAMES = 9


@dataclass(frozen=True)
class Plate:
    """A rectangular plate about the origin with a round hole in its middle; silicone rubber by default.

    Parameters
    ----------
    size_mm
        Lengths along X and Y.
    hole_mm
        Radius of the hole.
    spacing_mm
        Distance of nodes along the outer edge, about.
    rings
        Number of rings of elements around the hole.
    thickness_mm, young_mpa, poisson
        Thickness, Young's modulus (N / mm²) and Poisson's ratio.
    """

    size_mm: tuple[float, float] = (72.0, 52.0)
    hole_mm: float = 9.0
    spacing_mm: float = 4.0
    rings: int = 7
    thickness_mm: float = 2.0
    young_mpa: float = 2.0
    poisson: float = 0.45


def mesh(plate: Plate) -> tuple[Floats, Integers]:
    """Return nodes (n, 2), ring by ring from the hole outwards, and triangles (m, 3) with normals to -Z."""
    length, height = plate.size_mm
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (length / 2, height / 2)
    border = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        pieces = max(round(float(np.linalg.norm(end - start)) / plate.spacing_mm), 1)
        border.append(start + (end - start) * np.arange(pieces)[:, None] / pieces)
    outer = np.concatenate(border)
    inner = outer / np.linalg.norm(outer, axis=1, keepdims=True) * plate.hole_mm
    # Elements grow with their distance from the hole.
    share = (np.arange(plate.rings + 1) / plate.rings) ** 1.4
    nodes = inner + share[:, None, None] * (outer - inner)
    count = len(outer)
    first = (np.arange(plate.rings)[:, None] * count + np.arange(count)).ravel()
    along = first // count * count + (first + 1) % count
    triangles = np.stack(
        [np.column_stack([first, along, along + count]), np.column_stack([first, along + count, first + count])], axis=1
    )
    return nodes.reshape(-1, 2), triangles.reshape(-1, 3)


def doubled_areas(nodes: Floats, triangles: Integers) -> Floats:
    """Return twice the area of every triangle, with the sense of its corners as sign, shape (m,)."""
    one, two = nodes[triangles[:, 1]] - nodes[triangles[:, 0]], nodes[triangles[:, 2]] - nodes[triangles[:, 0]]
    result: Floats = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    return result


def assemble(elements: Floats, numbers: Integers, count: int) -> sparse.csr_array:
    """Add up matrices of elements, shape (m, k, k), whose unknowns have these numbers, shape (m, k)."""
    rows = np.repeat(numbers, numbers.shape[1], axis=1).ravel()
    columns = np.tile(numbers, (1, numbers.shape[1])).ravel()
    return sparse.csr_array((elements.ravel(), (rows, columns)), shape=(count, count))


def elasticity(plate: Plate) -> Floats:
    """Return the matrix of plane stress, from strains (xx, yy, 2 xy) to stresses."""
    nu = plate.poisson
    return plate.young_mpa / (1 - nu**2) * np.array([[1, nu, 0], [nu, 1, 0], [0, 0, (1 - nu) / 2]])


def membrane(plate: Plate, nodes: Floats, triangles: Integers) -> sparse.csr_array:
    """Return the stiffness in the plane; unknowns are (u_X, u_Y) node by node."""
    twice = doubled_areas(nodes, triangles)
    x, y = nodes[triangles].transpose(2, 0, 1)
    by_x = (np.roll(y, -1, axis=1) - np.roll(y, -2, axis=1)) / twice[:, None]
    by_y = (np.roll(x, -2, axis=1) - np.roll(x, -1, axis=1)) / twice[:, None]
    strain = np.zeros((len(triangles), 3, 6))
    strain[:, 0, 0::2], strain[:, 1, 1::2] = by_x, by_y
    strain[:, 2, 0::2], strain[:, 2, 1::2] = by_y, by_x
    volume = np.abs(twice) / 2 * plate.thickness_mm
    elements = np.einsum("m,mai,ab,mbj->mij", volume, strain, elasticity(plate), strain)
    numbers = np.stack([2 * triangles, 2 * triangles + 1], axis=2).reshape(-1, 6)
    return assemble(elements, numbers, 2 * len(nodes))


def edges_of(triangles: Integers) -> tuple[Integers, Integers]:
    """Return the edges as ordered pairs of nodes (k, 2), and the edges of every triangle from each corner on (m, 3)."""
    sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    edges, numbers = np.unique(np.sort(sides, axis=1), axis=0, return_inverse=True)
    return edges, numbers.reshape(-1, 3)


def bending(plate: Plate, nodes: Floats, triangles: Integers) -> sparse.csr_array:
    """Return the stiffness out of the plane; unknowns are w at the nodes, then dw/dn at the middles of the edges."""
    edges, sides = edges_of(triangles)
    middle, normal = nodes[edges].mean(axis=1), np.diff(nodes[edges], axis=1)[:, 0] @ np.array([[0.0, -1], [1, 0]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # In each triangle w is a quadratic about its centre: what each monomial contributes to each unknown.
    centre = nodes[triangles].mean(axis=1)[:, None]
    x, y = (nodes[triangles] - centre).transpose(2, 0, 1)
    values = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2)
    x, y = (middle[sides] - centre).transpose(2, 0, 1)
    nx, ny = normal[sides].transpose(2, 0, 1)
    slopes = np.stack([np.zeros_like(x), nx, ny, 2 * x * nx, y * nx + x * ny, 2 * y * ny], axis=2)
    monomials = np.linalg.inv(np.concatenate([values, slopes], axis=1))
    # Curvatures w_xx, w_yy, 2 w_xy.
    curvature = 2 * monomials[:, [3, 5, 4]]
    stiffness = elasticity(plate) * plate.thickness_mm**3 / 12
    area = np.abs(doubled_areas(nodes, triangles)) / 2
    elements = np.einsum("m,mai,ab,mbj->mij", area, curvature, stiffness, curvature)
    return assemble(elements, np.concatenate([triangles, len(nodes) + sides], axis=1), len(nodes) + len(edges))


def solve(stiffness: sparse.csr_array, load: Floats, fixed: NDArray[np.bool_]) -> Floats:
    """Return the unknowns under a load; fixed ones are zero."""
    free = np.flatnonzero(~fixed)
    result = np.zeros(len(load))
    result[free] = spsolve(sparse.csc_array(stiffness[free][:, free]), load[free])
    return result


def pulled_and_bent(plate: Plate, nodes: Floats, triangles: Integers) -> tuple[Floats, Floats]:
    """Return displacements (n, 2) under 1 N / mm along +X at the right edge, and w (n,) under 1 N / mm across it."""
    edges, _ = edges_of(triangles)
    half = plate.size_mm[0] / 2
    left, right = np.isclose(nodes[:, 0], -half), np.isclose(nodes[:, 0], half)
    share = np.zeros(len(nodes))
    loaded = edges[right[edges].all(axis=1)]
    lengths = np.linalg.norm(np.diff(nodes[loaded], axis=1)[:, 0], axis=1)
    np.add.at(share, loaded.ravel(), np.repeat(lengths / 2, 2))
    pull = np.column_stack([share, np.zeros_like(share)]).ravel()
    moved = solve(membrane(plate, nodes, triangles), pull, np.repeat(left, 2)).reshape(-1, 2)
    clamped = np.concatenate([left, left[edges].all(axis=1)])
    across = np.concatenate([share, np.zeros(len(edges))])
    bent = solve(bending(plate, nodes, triangles), across, clamped)[: len(nodes)]
    return moved, bent


def states(plate: Plate) -> tuple[Floats, Integers, Floats]:
    """Return nodes (n, 2), triangles (m, 3) and displacements (frames, n, 3)."""
    nodes, triangles = mesh(plate)
    moved, bent = pulled_and_bent(plate, nodes, triangles)
    phase = np.arange(FRAMES) / (FRAMES - 1)
    # At the end of the pull the right edge has moved by 1.2 mm; half-way its middle is bent by 3 mm.
    pull, bend = 1.2 / moved[:, 0].max() * phase, -3.0 / bent.max() * np.sin(np.pi * phase) ** 2
    flat = pull[:, None, None] * moved
    return nodes, triangles, np.concatenate([flat, (bend[:, None] * bent)[:, :, None]], axis=2)


def main() -> None:
    """Write the files."""
    nodes, triangles, displacements = states(Plate())
    FOLDER.mkdir(exist_ok=True)
    lines = [f"v {x:.10g} {y:.10g} 0" for x, y in nodes]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    (FOLDER / "plate.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    np.save(FOLDER / "displacements.npy", displacements)
    print(f"{len(nodes)} nodes, {len(triangles)} triangles, {FRAMES} frames in {FOLDER}")


if __name__ == "__main__":
    main()
