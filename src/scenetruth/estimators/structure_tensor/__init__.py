"""4D structure tensor over x, y, s and t for disparity and scene flow: the method of the paper."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.estimators.structure_tensor.execution import MEMORY_LIMITS, carry_to_reference, forget_second_best
    from scenetruth.estimators.structure_tensor.filters import (
        DERIVATIVE,
        DERIVATIVE_MOMENT,
        PAPER,
        SMOOTHING,
        choose_acquisition_axes,
        compact_pair,
        gaussian_window,
        least_squares_pair,
        pair_for,
        transfer,
    )
    from scenetruth.estimators.structure_tensor.maps import STRIDE
    from scenetruth.estimators.structure_tensor.noise_model import propagate_noise, texture_transfer
    from scenetruth.estimators.structure_tensor.registration import (
        CELL,
        Rectangle,
        Registration,
        find_working_point,
        find_working_point_of_flow,
        registrations_along_surfaces,
        split_into_tiles,
    )
    from scenetruth.estimators.structure_tensor.tensor_kernels import estimate_tile

__all__ = [
    "CELL", "DERIVATIVE", "DERIVATIVE_MOMENT", "MEMORY_LIMITS", "PAPER", "SMOOTHING", "STRIDE", "Rectangle",
    "Registration", "carry_to_reference", "choose_acquisition_axes", "compact_pair", "estimate_tile",
    "find_working_point", "find_working_point_of_flow", "forget_second_best", "gaussian_window", "least_squares_pair",
    "pair_for", "propagate_noise", "registrations_along_surfaces", "split_into_tiles", "texture_transfer", "transfer",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "execution": "MEMORY_LIMITS carry_to_reference forget_second_best",
        "filters": (
            "DERIVATIVE DERIVATIVE_MOMENT PAPER SMOOTHING choose_acquisition_axes compact_pair gaussian_window "
            "least_squares_pair pair_for transfer"
        ),
        "maps": "STRIDE",
        "noise_model": "propagate_noise texture_transfer",
        "registration": (
            "CELL Rectangle Registration find_working_point find_working_point_of_flow registrations_along_surfaces "
            "split_into_tiles"
        ),
        "tensor_kernels": "estimate_tile",
    },
)
