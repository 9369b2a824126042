"""Multi-image least-squares matching: one fit of all images to a surface that moves, rotates and grows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.estimators.refined.fit_maps import between, blank_fit, every_other, with_bias
    from scenetruth.estimators.refined.image_consistency import fine_contrast
    from scenetruth.estimators.refined.image_stack import NO_DEFECTS, ImageStack, Splines
    from scenetruth.estimators.refined.iterations import refine
    from scenetruth.estimators.refined.kernels.warp import ImageView
    from scenetruth.estimators.refined.noise_estimation import (
        EVEN,
        GreyVariance,
        estimate_variance,
        photon_transfer_variance,
    )
    from scenetruth.estimators.refined.pixel_defects import (
        DefectFilteredFrames,
        fill_defects,
        find_dead_pixels,
        find_saturated_runs,
        spread_defects,
    )
    from scenetruth.estimators.refined.pose_corrections import (
        Blocks,
        Elimination,
        ShiftObservations,
        compute_point_derivatives,
        select_blocks,
    )
    from scenetruth.estimators.refined.row_bands import NO_OCCLUSION

__all__ = [
    "EVEN", "NO_DEFECTS", "NO_OCCLUSION", "Blocks", "DefectFilteredFrames", "Elimination", "GreyVariance", "ImageStack",
    "ImageView", "ShiftObservations", "Splines", "between", "blank_fit", "compute_point_derivatives",
    "estimate_variance", "every_other", "fill_defects", "find_dead_pixels", "find_saturated_runs", "fine_contrast",
    "photon_transfer_variance", "refine", "select_blocks", "spread_defects", "with_bias",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "fit_maps": "between blank_fit every_other with_bias",
        "image_consistency": "fine_contrast",
        "image_stack": "NO_DEFECTS ImageStack Splines",
        "iterations": "refine",
        "kernels.warp": "ImageView",
        "noise_estimation": "EVEN GreyVariance estimate_variance photon_transfer_variance",
        "pixel_defects": "DefectFilteredFrames fill_defects find_dead_pixels find_saturated_runs spread_defects",
        "pose_corrections": "Blocks Elimination ShiftObservations compute_point_derivatives select_blocks",
        "row_bands": "NO_OCCLUSION",
    },
)
