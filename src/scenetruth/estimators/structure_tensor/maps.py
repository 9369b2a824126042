"""Plain arrays that kernels fill and read.

The best registration of every pixel, the maps of an estimate, and the texture of an image.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["STRIDE", "BestRegistration", "EstimateMaps", "Texture"]


STRIDE = 4
"""Distance in px of the points at which the texture's spectrum is measured."""

Floats = NDArray[np.float32]


class Texture(NamedTuple):
    """How image noise passes the filters around the texture of every place; arrays (y / stride, x / stride).

    numba keeps compiled kernels until their own files change: whoever changes the fields here must change
    `kernels.world` too.
    """

    passed_x: Floats
    """|Ŝ_x Ŝ_y|² in the mean over the energy of g_x."""
    passed_xy: Floats
    """|Ŝ_x Ŝ_y|² in the mean over the energy of g_x and g_y."""
    wave_number_x2: Floats
    """Mean square of the wave number k_x, rad² per px²."""
    wave_number_y2: Floats
    """Mean square of the wave number k_y, rad² per px²."""
    widened: Floats
    """By how much more noise passes where coordinates weigh the window."""
    stride: int = STRIDE
    """Distance of the places in px."""

    def cropped(self, rows: slice, columns: slice = slice(None)) -> Texture:
        """Return a part of the places."""
        arrays = {name: getattr(self, name)[rows, columns] for name in self._fields if name != "stride"}
        return Texture(**arrays, stride=self.stride)


Flags = NDArray[np.uint8]


class BestRegistration(NamedTuple):
    """What the kernel of the structure tensor leaves for a band of rows: for every pixel, the best registration's.

    All arrays have the shape (frame, y, x), the eigenvalues (frame, 5, y, x). Motion is counted in the derivatives'
    scales (`Task.scales`). Disparity and flow come from the registration that leaves least to move, divergence from the
    one at which it is most certain.
    """

    to_move: Floats
    """The least that was left to move so far: the square of the disparity left, perhaps with that of the flow."""
    uncertainty: Floats
    """The least uncertainty of the divergence so far."""
    choice: NDArray[np.int16]
    """Number of the registration that leaves least to move; -1 for none."""
    kind_disparity: Flags
    kind_motion: Flags
    model_violation: Flags
    v_x: NDArray[np.float64]
    """v_x: minus the disparity that the registration leaves."""
    flow_x: NDArray[np.float64]
    """u_x + x_0 u_z: the flow along x that the registration leaves."""
    flow_y: NDArray[np.float64]
    """u_y + y_0 u_z."""
    u_z: NDArray[np.float64]
    """u_z of the registration that leaves least to move."""
    certain_u_z: NDArray[np.float64]
    """u_z of the registration at which it is most certain."""
    eigenvalues: Floats
    """λ1 to λ5."""
    residual_s: Floats
    """p_sᵀ J p_s, what the null vector of disparity leaves unexplained."""
    variance_v_x: Floats
    """Variance of v_x for unit noise in the constraint."""
    length_s: Floats
    """Length of the image's part of p_s."""
    residual_t: Floats
    """p_tᵀ J p_t; like all below, of the registration at which u_z is most certain."""
    variance_flow_x: Floats
    """Variances of the components of motion for unit noise in the constraint."""
    variance_flow_y: Floats
    variance_u_z: Floats
    covariance_x_z: Floats
    """Covariances of flow with u_z for unit noise in the constraint."""
    covariance_y_z: Floats

    @classmethod
    def empty(cls, frames: int, rows: int, columns: int) -> BestRegistration:
        """Return arrays for a band of rows, before any registration has been tried."""
        shape = (frames, rows, columns)
        exact = ("v_x", "flow_x", "flow_y", "u_z", "certain_u_z")
        flags = ("kind_disparity", "kind_motion", "model_violation")
        types = dict.fromkeys(exact, np.float64) | dict.fromkeys(flags, np.uint8) | {"choice": np.int16}
        arrays = {name: np.empty(shape, dtype=types.get(name, np.float32)) for name in cls._fields}
        best = cls(**arrays | {"eigenvalues": np.empty((frames, 5, rows, columns), dtype=np.float32)})
        best.clear()
        return best

    def clear(self) -> None:
        """Forget what has been tried."""
        self.to_move.fill(np.inf)
        self.uncertainty.fill(np.inf)
        self.choice.fill(-1)


class EstimateMaps(NamedTuple):
    """The estimate: arrays of the shape (frame, y, x), components and ranks before the frame.

    Units are those of `scenetruth.schema.VARIABLES`, with pixels of the images that were estimated.
    """

    depth: Floats
    velocity: Floats
    disparity: Floats
    flow: Floats
    divergence: Floats
    kind: Flags
    kind_disparity: Flags
    kind_motion: Flags
    model_violation: Flags
    depth_std: Floats
    velocity_std: Floats
    disparity_std: Floats
    confidence: Floats
    working_point: Floats
    eigenvalues: Floats
    shift: Floats
    """By how much the reference sees each pixel's point further right and down, in px, where the estimates belong
    between cameras or frames; of size 0 where they belong to the reference."""

    @classmethod
    def empty(cls, frames: int, height: int, width: int, *, shifted: bool) -> EstimateMaps:
        """Return maps whose values are still to be written."""
        shape = (frames, height, width)
        components = {"velocity": 3, "velocity_std": 3, "flow": 2, "eigenvalues": 5, "shift": 2}
        flags = ("kind", "kind_disparity", "kind_motion", "model_violation")
        shapes = {name: (count, *shape) for name, count in components.items()}
        if not shifted:
            shapes["shift"] = (2, 0, 0, 0)
        return cls(
            **{
                name: np.empty(shapes.get(name, shape), dtype=np.uint8 if name in flags else np.float32)
                for name in cls._fields
            }
        )
