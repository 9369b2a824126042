"""Tests of the projection in which faces are sorted to rays."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from scenetruth.raycast.ray_triangle_kernels import components


def test_components_are_those_along_the_rows_of_the_frame() -> None:
    frame = np.asarray(Rotation.from_rotvec([0.3, -0.7, 0.2]).as_matrix())
    vector = np.array([2.0, -5.0, 11.0])
    np.testing.assert_allclose(components(*vector, frame), frame @ vector, rtol=1e-14)
