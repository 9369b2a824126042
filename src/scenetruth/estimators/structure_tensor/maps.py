"""Arrays of the kernels: filters, best registration of every pixel, maps of an estimate, and texture of an image."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["STRIDE", "BestRegistration", "EstimateMaps", "Filters", "Texture"]


STRIDE = 4
"""Distance in px of the points at which the texture spectrum is measured."""

Floats = NDArray[np.float32]


class Texture(NamedTuple):
    """Noise transfer of the filters for the texture at each grid point; arrays (y / stride, x / stride).

    numba keeps compiled kernels until their own files change; a change of the fields requires a change of
    `world_coordinate_kernels`.
    """

    passed_x: Floats
    """|Ŝ_x Ŝ_y|², averaged over the energy of g_x."""
    passed_xy: Floats
    """|Ŝ_x Ŝ_y|², averaged over the energy of g_x and g_y."""
    wave_number_x2: Floats
    """Mean square of the wave number k_x, rad² per px²."""
    wave_number_y2: Floats
    """Mean square of the wave number k_y, rad² per px²."""
    widened: Floats
    """Factor by which the noise increases for a window weighted by coordinates."""
    stride: int = STRIDE
    """Distance of the grid points in px."""

    def cropped(self, rows: slice, columns: slice = slice(None)) -> Texture:
        """Return a part of the grid points."""
        arrays = {name: getattr(self, name)[rows, columns] for name in self._fields if name != "stride"}
        return Texture(**arrays, stride=self.stride)


Flags = NDArray[np.uint8]


class Filters(NamedTuple):
    """Filters and windows as correlation kernels; those along s have one value per camera and scale to grey values."""

    smoothing_s: Floats
    """S along s."""
    derivative_s: Floats
    """D along s."""
    moment_s: Floats
    """Moment of S along s: S times the offset of the principal point of a camera from that of the reference."""
    smoothing_t: Floats
    """S along t."""
    derivative_t: Floats
    """D along t."""
    kernels: Floats
    """S, D, M (the moment of D) and M - 2 S along x and y, shape (4, taps)."""
    window_t: Floats
    """Window along t."""
    channels: Floats
    """Weights of the channels."""
    windows: Floats
    """w, the window along x and y, w ξ, w ξ² and 2 w ξ, shape (4, taps)."""
    with_correction: bool
    """Whether the correction of the divergence term is added."""


class BestRegistration(NamedTuple):
    """Output of the structure-tensor kernel for a row band: the values of the best registration of every pixel.

    All arrays have the shape (frame, y, x), the eigenvalues (frame, 5, y, x). Motion is in the scales of the
    derivatives (`EstimationInputs.scales`). Disparity and flow are those of the registration with the smallest residual
    displacement, the divergence that of the registration with the smallest uncertainty.
    """

    to_move: Floats
    """Smallest residual displacement so far: square of the residual disparity, optionally plus that of the flow."""
    uncertainty: Floats
    """Smallest uncertainty of the divergence so far."""
    choice: NDArray[np.int16]
    """Number of the registration with the smallest residual displacement; -1 for none."""
    kind_disparity: Flags
    kind_motion: Flags
    model_violation: Flags
    v_x: NDArray[np.float64]
    """v_x: minus the residual disparity of the registration."""
    flow_x: NDArray[np.float64]
    """u_x + x_0 u_z: residual flow of the registration along x."""
    flow_y: NDArray[np.float64]
    """u_y + y_0 u_z."""
    u_z: NDArray[np.float64]
    """u_z of the registration with the smallest residual displacement."""
    certain_u_z: NDArray[np.float64]
    """u_z of the registration with its smallest uncertainty."""
    eigenvalues: Floats
    """λ1 to λ5."""
    residual_s: Floats
    """p_sᵀ J p_s, the residual of the null vector of disparity."""
    variance_v_x: Floats
    """Variance of v_x for unit noise in the constraint."""
    length_s: Floats
    """Length of the image components of p_s."""
    residual_t: Floats
    """p_tᵀ J p_t; like all below, of the registration with the smallest uncertainty of u_z."""
    variance_flow_x: Floats
    """Variances of the motion components for unit noise in the constraint."""
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
        """Reset all pixels."""
        self.to_move.fill(np.inf)
        self.uncertainty.fill(np.inf)
        self.choice.fill(-1)


class EstimateMaps(NamedTuple):
    """Maps (..., frame, y, x) in units of `scenetruth.schema.VARIABLES`, in pixels of the estimated images."""

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
    """Offset of the image point in the reference relative to each pixel, right and down, in px, if the estimate is
    centred between cameras or frames; else of size 0."""

    @classmethod
    def invalid(cls, frames: int, height: int, width: int, *, shifted: bool) -> EstimateMaps:
        """Return maps without any valid pixel."""
        shape = (frames, height, width)
        components = {"velocity": 3, "velocity_std": 3, "flow": 2, "eigenvalues": 5, "shift": 2}
        flags = ("kind", "kind_disparity", "kind_motion", "model_violation")
        shapes = {name: (count, *shape) for name, count in components.items()}
        if not shifted:
            shapes["shift"] = (2, 0, 0, 0)
        maps: dict[str, NDArray[Any]] = {
            name: np.full(shapes.get(name, shape), np.nan, dtype=np.float32) for name in cls._fields
        }
        maps |= {name: np.zeros(shape, dtype=np.uint8) for name in flags}
        return cls(**maps | {"confidence": np.zeros(shape, dtype=np.float32)})
