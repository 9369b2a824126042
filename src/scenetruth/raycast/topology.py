"""Which faces of a mesh share which edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Topology"]


@dataclass(frozen=True, eq=False)
class Topology:
    """Faces, edges, and who meets whom; constant while a mesh moves.

    Parameters
    ----------
    faces
        Vertex indices, shape (m, 3), int32.
    edges
        The two vertices of every edge, shape (k, 2), int32.
    edge_faces
        The two faces at every edge, shape (k, 2), int32; -1 where a boundary edge has no second face.
    edge_flipped
        Whether the two faces at the edge run around it in the same sense, so that one of them is turned inside out.
    edge_crowded
        Whether more than two faces meet at the edge.
    face_neighbours
        The face across each of the three edges of every face, shape (m, 3), int32; -1 for none.
    """

    faces: NDArray[np.int32]
    edges: NDArray[np.int32]
    edge_faces: NDArray[np.int32]
    edge_flipped: NDArray[np.bool_]
    edge_crowded: NDArray[np.bool_]
    face_neighbours: NDArray[np.int32]

    @classmethod
    def of(cls, vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> Topology:
        """Find the edges of a mesh; vertices at the same place count as one, as at the seams of a texture.

        Parameters
        ----------
        vertices
            Positions, shape (n, 3).
        faces
            Vertex indices, shape (m, 3).
        """
        _, first, welded = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
        corners = welded.reshape(-1)[faces]
        count = len(faces)
        half = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)
        owner = np.repeat(np.arange(count, dtype=np.int32), 3)
        pairs, edge_of_half, uses = np.unique(np.sort(half, axis=1), axis=0, return_inverse=True, return_counts=True)
        edge_of_half = edge_of_half.reshape(-1)
        order = np.argsort(edge_of_half, kind="stable")
        start = np.concatenate([[0], np.cumsum(uses)[:-1]])
        one = order[start]
        two = np.where(uses > 1, order[np.minimum(start + 1, len(order) - 1)], -1)
        has_two = two >= 0
        edge_faces = np.stack([owner[one], np.where(has_two, owner[two], -1)], axis=1).astype(np.int32)
        flipped = has_two & (half[one, 0] == half[two, 0])
        neighbours = np.full(len(half), -1, dtype=np.int32)
        neighbours[one[has_two]] = owner[two[has_two]]
        neighbours[two[has_two]] = owner[one[has_two]]
        return cls(
            faces=faces,
            edges=first[pairs].astype(np.int32),
            edge_faces=edge_faces,
            edge_flipped=flipped,
            edge_crowded=uses > 2,
            face_neighbours=neighbours.reshape(count, 3),
        )
