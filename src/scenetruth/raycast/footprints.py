"""What the kernels of pixels' footprints need of the surface and of the rays of an image.

numba keeps compiled kernels until their own files change: whoever changes the fields here must change `kernels` and
`walk_kernels` too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["ImageRays", "TexturedMesh"]


class TexturedMesh(NamedTuple):
    """A mesh at one time with texture coordinates."""

    vertices: NDArray[np.float64]
    """World positions in mm, shape (n, 3)."""
    faces: NDArray[np.int32]
    """Corners of the faces, shape (m, 3)."""
    neighbours: NDArray[np.int32]
    """The face across each edge, shape (m, 3); -1 for none (`Topology.face_neighbours`)."""
    face_body: NDArray[np.int32]
    """The body that each face belongs to, shape (m,)."""
    uv: NDArray[np.float64]
    """Texture coordinates of the faces' corners, shape (m, 3, 2)."""


class ImageRays(NamedTuple):
    """The rays through the pixel centres of an image, row by row, and the faces that they meet first."""

    origin: NDArray[np.float64]
    """Where all rays start, shape (3,)."""
    directions: NDArray[np.float64]
    """Their directions, shape (n, 3)."""
    across: NDArray[np.float64]
    """Change of the direction by one pixel to the right, a row for every pixel or one for all, shape (n or 1, 3)."""
    down: NDArray[np.float64]
    """Change of the direction by one pixel down."""
    face: NDArray[np.int32]
    """The face that each ray meets first, -1 for none, shape (n,)."""
    width: int
    """Pixels per row."""
