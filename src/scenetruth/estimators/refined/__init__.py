"""Multi-image least-squares matching: one fit of all images to a surface that moves, rotates and grows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.estimators.refined.acquisition import derive_priors, read_schedule, remove_delay_bias
    from scenetruth.estimators.refined.alias_residuals import find_aliases, project_aliases, separate
    from scenetruth.estimators.refined.aliasing import (
        combine_displacements,
        compute_phase_error_px,
        enlarge_variances,
        interpolation_error,
        measure_noise_coupling,
    )
    from scenetruth.estimators.refined.ambiguity import find_ambiguous, find_chance_fits, image_motion
    from scenetruth.estimators.refined.aperture import compute_normal_flow, find_aperture
    from scenetruth.estimators.refined.bare_surfaces import find_bare_areas, fit_bare_surfaces
    from scenetruth.estimators.refined.common_uncertainty import (
        CalibrationUncertainty,
        compute_common_variance,
        read_calibration_uncertainty,
    )
    from scenetruth.estimators.refined.discontinuity_refit import (
        continues_on_both_sides,
        fill_beyond_images,
        find_hidden,
        is_supported,
        is_surrounded,
    )
    from scenetruth.estimators.refined.element_uncertainty import compute_calibration_effect, compute_pose_effect
    from scenetruth.estimators.refined.fallback import Sources, fill_holes, near_bare_surfaces, recede
    from scenetruth.estimators.refined.fit_maps import (
        between,
        blank_fit,
        every_other,
        initial_parameters,
        nearest_node,
        with_bias,
    )
    from scenetruth.estimators.refined.growth_comparison import RATES, GrowthComparison, compare_growth
    from scenetruth.estimators.refined.image_consistency import fine_contrast
    from scenetruth.estimators.refined.image_stack import NO_DEFECTS, FramesNeeded, ImageStack, Region, Splines
    from scenetruth.estimators.refined.iterations import RefinedState, fit_round, refine, select_models
    from scenetruth.estimators.refined.kernels.warp import ImageView, corrected, place_of, straightened
    from scenetruth.estimators.refined.kernels.window_solver import Fit, Model
    from scenetruth.estimators.refined.lattice import lattice_step
    from scenetruth.estimators.refined.lens_distortion import Lens, compute_jacobian, distort, lens_problems, undistort
    from scenetruth.estimators.refined.light_edges import FrameDifferences, compare_velocities
    from scenetruth.estimators.refined.mean_image import MeanImage, find_outlines
    from scenetruth.estimators.refined.model_tests import (
        Alternative,
        Linearisation,
        at_nodes,
        enlarged,
        find_far,
        of_nearest_node,
    )
    from scenetruth.estimators.refined.motion_model_selection import (
        MotionModelTrial,
        choose_motion_model,
        find_remainders,
    )
    from scenetruth.estimators.refined.neighbouring_motion import neighbouring_differences
    from scenetruth.estimators.refined.noise_estimation import (
        EVEN,
        GreyVariance,
        estimate_variance,
        photon_transfer_variance,
        resampled_transfer,
        spline_transfer,
    )
    from scenetruth.estimators.refined.other_views import OtherViews, match_views
    from scenetruth.estimators.refined.output_maps import FrameEvidence, find_open_blanks, withdraw_chance_results
    from scenetruth.estimators.refined.pixel_defects import (
        DefectFilteredFrames,
        fill_defects,
        find_dead_pixels,
        find_saturated_runs,
        spread_defects,
    )
    from scenetruth.estimators.refined.pose_consistency import maximise_likelihood
    from scenetruth.estimators.refined.pose_corrections import (
        Blocks,
        Elimination,
        ShiftObservations,
        compute_point_derivatives,
        follow_points,
        select_blocks,
        solve_with_prior,
    )
    from scenetruth.estimators.refined.row_bands import FIT_LIMITS, NO_OCCLUSION
    from scenetruth.estimators.refined.smooth_light import SmoothLight
    from scenetruth.estimators.refined.surface_changes import fit_linear_changes
    from scenetruth.estimators.refined.systematic_error import (
        Quantities,
        SystematicErrors,
        add_contradiction,
        change_at_scales,
        extrapolation_share,
        find_likely_changes,
        list_spans,
        polynomial_bias,
        sees_second_camera,
    )
    from scenetruth.estimators.refined.tiles import RegionImages, choose_tiles, margin_px, spread_regions
    from scenetruth.estimators.refined.time_resolution import choose_frames_beyond, derivative_weights
    from scenetruth.estimators.refined.velocity_curvature import smooth_velocity

__all__ = [
    "EVEN",
    "FIT_LIMITS",
    "NO_DEFECTS",
    "NO_OCCLUSION",
    "RATES",
    "Alternative",
    "Blocks",
    "CalibrationUncertainty",
    "DefectFilteredFrames",
    "Elimination",
    "Fit",
    "FrameDifferences",
    "FrameEvidence",
    "FramesNeeded",
    "GreyVariance",
    "GrowthComparison",
    "ImageStack",
    "ImageView",
    "Lens",
    "Linearisation",
    "MeanImage",
    "Model",
    "MotionModelTrial",
    "OtherViews",
    "Quantities",
    "RefinedState",
    "Region",
    "RegionImages",
    "ShiftObservations",
    "SmoothLight",
    "Sources",
    "Splines",
    "SystematicErrors",
    "add_contradiction",
    "at_nodes",
    "between",
    "blank_fit",
    "change_at_scales",
    "choose_frames_beyond",
    "choose_motion_model",
    "choose_tiles",
    "combine_displacements",
    "compare_growth",
    "compare_velocities",
    "compute_calibration_effect",
    "compute_common_variance",
    "compute_jacobian",
    "compute_normal_flow",
    "compute_phase_error_px",
    "compute_point_derivatives",
    "compute_pose_effect",
    "continues_on_both_sides",
    "corrected",
    "derivative_weights",
    "derive_priors",
    "distort",
    "enlarge_variances",
    "enlarged",
    "estimate_variance",
    "every_other",
    "extrapolation_share",
    "fill_beyond_images",
    "fill_defects",
    "fill_holes",
    "find_aliases",
    "find_ambiguous",
    "find_aperture",
    "find_bare_areas",
    "find_chance_fits",
    "find_dead_pixels",
    "find_far",
    "find_hidden",
    "find_likely_changes",
    "find_open_blanks",
    "find_outlines",
    "find_remainders",
    "find_saturated_runs",
    "fine_contrast",
    "fit_bare_surfaces",
    "fit_linear_changes",
    "fit_round",
    "follow_points",
    "image_motion",
    "initial_parameters",
    "interpolation_error",
    "is_supported",
    "is_surrounded",
    "lattice_step",
    "lens_problems",
    "list_spans",
    "margin_px",
    "match_views",
    "maximise_likelihood",
    "measure_noise_coupling",
    "near_bare_surfaces",
    "nearest_node",
    "neighbouring_differences",
    "of_nearest_node",
    "photon_transfer_variance",
    "place_of",
    "polynomial_bias",
    "project_aliases",
    "read_calibration_uncertainty",
    "read_schedule",
    "recede",
    "refine",
    "remove_delay_bias",
    "resampled_transfer",
    "sees_second_camera",
    "select_blocks",
    "select_models",
    "separate",
    "smooth_velocity",
    "solve_with_prior",
    "spline_transfer",
    "spread_defects",
    "spread_regions",
    "straightened",
    "undistort",
    "with_bias",
    "withdraw_chance_results",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "acquisition": "derive_priors read_schedule remove_delay_bias",
        "alias_residuals": "find_aliases project_aliases separate",
        "aliasing": "combine_displacements compute_phase_error_px enlarge_variances interpolation_error "
        "measure_noise_coupling",
        "ambiguity": "find_ambiguous find_chance_fits image_motion",
        "aperture": "compute_normal_flow find_aperture",
        "bare_surfaces": "find_bare_areas fit_bare_surfaces",
        "common_uncertainty": "CalibrationUncertainty compute_common_variance read_calibration_uncertainty",
        "discontinuity_refit": "continues_on_both_sides fill_beyond_images find_hidden is_supported is_surrounded",
        "fallback": "Sources fill_holes near_bare_surfaces recede",
        "fit_maps": "between blank_fit every_other initial_parameters nearest_node with_bias",
        "element_uncertainty": "compute_calibration_effect compute_pose_effect",
        "growth_comparison": "RATES GrowthComparison compare_growth",
        "image_consistency": "fine_contrast",
        "image_stack": "NO_DEFECTS FramesNeeded ImageStack Region Splines",
        "iterations": "RefinedState fit_round refine select_models",
        "kernels.warp": "ImageView corrected place_of straightened",
        "kernels.window_solver": "Fit Model",
        "lattice": "lattice_step",
        "lens_distortion": "Lens compute_jacobian distort lens_problems undistort",
        "light_edges": "FrameDifferences compare_velocities",
        "mean_image": "MeanImage find_outlines",
        "model_tests": "Alternative Linearisation at_nodes enlarged find_far of_nearest_node",
        "motion_model_selection": "MotionModelTrial choose_motion_model find_remainders",
        "neighbouring_motion": "neighbouring_differences",
        "noise_estimation": (
            "EVEN GreyVariance estimate_variance photon_transfer_variance resampled_transfer spline_transfer"
        ),
        "other_views": "OtherViews match_views",
        "output_maps": "FrameEvidence find_open_blanks withdraw_chance_results",
        "pixel_defects": "DefectFilteredFrames fill_defects find_dead_pixels find_saturated_runs spread_defects",
        "pose_consistency": "maximise_likelihood",
        "pose_corrections": (
            "Blocks Elimination ShiftObservations compute_point_derivatives follow_points select_blocks "
            "solve_with_prior"
        ),
        "row_bands": "FIT_LIMITS NO_OCCLUSION",
        "smooth_light": "SmoothLight",
        "surface_changes": "fit_linear_changes",
        "systematic_error": (
            "Quantities SystematicErrors add_contradiction change_at_scales extrapolation_share list_spans "
            "find_likely_changes polynomial_bias sees_second_camera"
        ),
        "tiles": "RegionImages choose_tiles margin_px spread_regions",
        "time_resolution": "choose_frames_beyond derivative_weights",
        "velocity_curvature": "smooth_velocity",
    },
)
