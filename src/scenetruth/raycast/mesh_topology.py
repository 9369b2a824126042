"""Mesh topology (edges and adjacent faces) and the array bundles passed to kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

__all__ = ["ImageRays", "TexturedMesh", "Topology", "scene_topology"]


CREASE_DEG = 1.0
"""Default crease angle in degrees, which makes almost every edge sharp."""


@dataclass(frozen=True, eq=False)
class Topology:
    """Faces, edges and adjacency of a mesh; constant under motion.

    ``faces``, ``edges``: Vertex indices, shapes (m, 3) and (k, 2), int32.
    ``edge_faces``: The two faces at every edge, shape (k, 2), int32; -1 for the missing face of a boundary edge.
    ``edge_flipped``, ``edge_crowded``: Whether the faces have opposite orientation; whether they are more than two.
    ``face_neighbours``: Face across each of the three edges of every face, shape (m, 3), int32; -1 for none. Edge k
      runs from corner k to corner k + 1.
    ``sides_across``: Side across each of them, 3 times its face + its number, shape (m, 3), int32; -1 for none.
    ``edge_crease_cosine``: Cosine of the angle between the two faces above which the edge is sharp, shape (k,),
      float64; 2 for edges that are always sharp.
    """

    faces: NDArray[np.int32]
    edges: NDArray[np.int32]
    edge_faces: NDArray[np.int32]
    edge_flipped: NDArray[np.bool_]
    edge_crowded: NDArray[np.bool_]
    face_neighbours: NDArray[np.int32]
    sides_across: NDArray[np.int32]
    edge_crease_cosine: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        vertices: NDArray[np.float64],
        faces: NDArray[np.int32],
        crease_deg: float | NDArray[np.float64] = CREASE_DEG,
    ) -> Topology:
        """Compute the topology of a mesh; coincident vertices, as at texture seams, are merged.

        ``crease_deg``: Crease angle of all faces, of each face, shape (m,), or of each face side, shape (m, 3), where
          side k runs from corner k to corner k + 1. An edge is sharp if its faces differ by more than the smaller of
          their two angles, or if that angle is 0.
        """
        first, welded = _weld(vertices)
        corners = welded[faces]
        count = len(faces)
        half = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)
        owner = np.repeat(np.arange(count, dtype=np.int32), 3)
        # A single key per pair sorts faster than pairs, in the same order.
        # Reductions along a short axis take several times as long.
        begin, end = half.T
        keys = np.minimum(begin, end) * len(first) + np.maximum(begin, end)
        order = np.argsort(keys, kind="stable")
        ascending = keys[order]
        start = np.flatnonzero(np.concatenate([[True], ascending[1:] != ascending[:-1]]))
        pairs, uses = ascending[start], np.diff(start, append=len(keys))
        one = order[start]
        two = np.where(uses > 1, order[np.minimum(start + 1, len(order) - 1)], -1)
        has_two = two >= 0
        edge_faces = np.stack([owner[one], np.where(has_two, owner[two], -1)], axis=1).astype(np.int32)
        given = np.asarray(crease_deg, dtype=np.float64)
        creases = np.broadcast_to(given[:, None] if given.ndim == 1 else given, (count, 3)).reshape(-1)
        crease = np.where(has_two, np.minimum(creases[one], creases[two]), creases[one])
        flipped = has_two & (half[one, 0] == half[two, 0])
        across = np.full(len(half), -1, dtype=np.int32)
        across[one[has_two]] = two[has_two]
        across[two[has_two]] = one[has_two]
        return cls(
            faces=faces,
            edges=first[np.stack(np.divmod(pairs, len(first)), axis=1)].astype(np.int32),
            edge_faces=edge_faces,
            edge_flipped=flipped,
            edge_crowded=uses > 2,
            # Of -1, the quotient is -1.
            face_neighbours=(across // 3).reshape(count, 3),
            sides_across=across.reshape(count, 3),
            edge_crease_cosine=np.where(crease > 0, np.cos(np.deg2rad(crease)), 2.0),
        )


class _World(Protocol):
    """Scene with its faces and their crease angles, and the positions of its vertices at a time."""

    @property
    def faces(self) -> NDArray[np.int32]: ...
    @property
    def crease_deg(self) -> NDArray[np.float64]: ...
    def at(self, t: float, /) -> Any: ...


_known: WeakKeyDictionary[_World, Topology] = WeakKeyDictionary()


def scene_topology(world: _World) -> Topology:
    """Return the topology of a scene, which images and truth have in common."""
    found = _known.get(world)
    if found is None:
        found = _known[world] = Topology.of(world.at(0).vertices_mm, world.faces, world.crease_deg)
    return found


def _weld(vertices: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first vertex at every distinct position, in sorted order, and the position index of every vertex."""
    order = np.lexsort(vertices.T[::-1])
    ahead = vertices[order]
    new = np.ones(len(order), dtype=np.bool_)
    x, y, z = (ahead[1:] != ahead[:-1]).T
    new[1:] = x | y | z
    places = np.empty(len(order), dtype=np.int64)
    places[order] = np.cumsum(new) - 1
    return order[new].astype(np.int64), places


class TexturedMesh(NamedTuple):
    """Mesh at one time with texture coordinates."""

    vertices: NDArray[np.float64]
    """World positions in mm, shape (n, 3)."""
    faces: NDArray[np.int32]
    """Vertex indices of the faces, shape (m, 3)."""
    neighbours: NDArray[np.int32]
    """Face across each edge, shape (m, 3); -1 for none (`Topology.face_neighbours`)."""
    face_body: NDArray[np.int32]
    """Body index of each face, shape (m,)."""
    uv: NDArray[np.float64]
    """Texture coordinates of the face corners, shape (m, 3, 2)."""


class ImageRays(NamedTuple):
    """Rays through the pixel centres of an image in row-major order, with their first hits."""

    origin: NDArray[np.float64]
    """Origin of all rays, shape (3,)."""
    directions: NDArray[np.float64]
    """Directions, shape (n, 3)."""
    across: NDArray[np.float64]
    """Change of the direction per pixel to the right, per pixel or common to all, shape (n or 1, 3)."""
    down: NDArray[np.float64]
    """Change of the direction per pixel down."""
    face: NDArray[np.int32]
    """First face hit by each ray, -1 for none, shape (n,)."""
    width: int
    """Pixels per row."""
