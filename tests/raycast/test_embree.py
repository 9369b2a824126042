"""Tests of the faces that Embree guesses."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np

from scenetruth.raycast import ray_caster
from scenetruth.raycast.ray_caster import EmbreeMesh

# Two squares across Z, far from the origin: the near one covers a part of the far one.
VERTICES = np.array(
    [[-9, -9, 50], [0, -9, 50], [0, 9, 50], [-9, 9, 50], [-20, -20, 80], [20, -20, 80], [20, 20, 80], [-20, 20, 80]],
    dtype=np.float64,
) + np.array([1e4, 0, 0])
FACES = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], dtype=np.int32)
START = np.array([1e4, 0.0, 0.0])
DIRECTIONS = np.array([[-3.0, -6.0, 50.0], [-6.0, 3.0, 50.0], [5.0, 1.0, 80.0], [30.0, 0.0, 50.0]])


def test_the_nearest_face_is_found_from_one_start_and_from_many() -> None:
    mesh = EmbreeMesh(VERTICES, FACES)
    expected = [0, 1, 2, -1]
    assert mesh.first_faces(START, DIRECTIONS).tolist() == expected
    assert mesh.first_faces(np.tile(START, (4, 1)), DIRECTIONS).tolist() == expected
    # From behind, the far square is met first.
    behind = mesh.first_faces(START + 2 * DIRECTIONS[:3], -DIRECTIONS[:3])
    assert (behind >= 2).all()


def test_pieces_give_what_all_rays_at_once_give() -> None:
    mesh = EmbreeMesh(VERTICES, FACES)
    with patch.object(ray_caster, "_PIECE", 3):
        assert mesh.first_faces(START, DIRECTIONS).tolist() == [0, 1, 2, -1]
