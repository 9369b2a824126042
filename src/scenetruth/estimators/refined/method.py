"""Method ``refined`` over the frames of a recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.method_settings import PhotonTransferNoise, RefinedSettings
from scenetruth.estimators.refined.acquisition import corrects_poses, read_priors, read_schedule, remove_delay_bias
from scenetruth.estimators.refined.common_uncertainty import has_common_part, read_calibration_uncertainty
from scenetruth.estimators.refined.image_stack import FramesNeeded, Splines, frames_needed
from scenetruth.estimators.refined.output_maps import (
    CORRECTIONS,
    compute_correction_maps,
    compute_maps,
    list_map_types,
    make_invalid_maps,
)
from scenetruth.progress import Progress
from scenetruth.schema import REASONS, Put, blank_map, compute_pixel_grid, label, read_intrinsics
from scenetruth.schema.validity import compute_validity, excluded_pixels

if TYPE_CHECKING:
    from scenetruth.estimators.refined.image_stack import ImageStack
    from scenetruth.estimators.refined.pixel_defects import DefectFilteredFrames
    from scenetruth.estimators.refined.pose_consistency import PoseErrors

__all__ = ["blank_estimate", "fill_estimate"]


def blank_estimate(recording: xr.Dataset, settings: RefinedSettings) -> xr.Dataset:
    """Return the estimate of a recording with blank maps."""
    sizes = recording["image"].sizes
    places = [frames.output for frames in _needed(sizes["t"], settings)]
    shape = (len(places), sizes["y"], sizes["x"])
    frames = min(sizes["t"], settings.window_frames)
    common = has_common_part(recording, settings)
    types = list_map_types(sizes.get("s_y", 1) * sizes["s"], frames, settings, common=common)
    x, y = (recording[name].values if name in recording.coords else None for name in ("x", "y"))
    maps = {name: blank_map(dtype, (*components, *shape)) for name, (components, dtype) in types.items()}
    cameras: dict[str, Any] = {}
    if corrects_poses(recording, settings):
        for name, components in CORRECTIONS.items():
            maps[name] = blank_map(np.float64, (*components, *_cameras(recording), len(places)))
        names = ("s", "stage_x_mm", *(("stage_y_mm",) if "s_y" in recording["image"].dims else ()))
        cameras = {name: recording[name].values for name in names}
    times = recording["t"].values[places]
    return label("estimate", maps, read_intrinsics(recording), t=times, x=x, y=y, **cameras)


def fill_estimate(
    recording: xr.Dataset, settings: RefinedSettings, put: Put, progress: Progress | None = None
) -> dict[str, Any]:
    """Estimate surface and motion of every pixel, frame by frame."""
    from scenetruth.estimators.refined.discontinuity_refit import empty_discontinuity_context, refit_discontinuities
    from scenetruth.estimators.refined.growth_comparison import add_growth_bias
    from scenetruth.estimators.refined.image_consistency import ExclusionReport, describe_missing_contrast
    from scenetruth.estimators.refined.image_stack import ImageStack
    from scenetruth.estimators.refined.initialisation import (
        CameraLayout,
        initialise_by_structure_tensor,
        initialise_robustly,
    )
    from scenetruth.estimators.refined.iterations import refine
    from scenetruth.estimators.refined.lens_distortion import as_pinhole, read_lens
    from scenetruth.estimators.refined.motion_model_selection import refit_motion_models
    from scenetruth.estimators.refined.noise_estimation import photon_transfer_variance
    from scenetruth.estimators.refined.pixel_defects import DefectFilteredFrames
    from scenetruth.estimators.refined.pose_consistency import estimate_pose_errors, warn_of_pose_errors
    from scenetruth.estimators.refined.systematic_error import estimate_systematic_errors

    grid = compute_pixel_grid(recording)
    intrinsics = grid.in_columns(read_intrinsics(recording))
    reader = DefectFilteredFrames(recording)
    cameras = reader.shape[1]
    baseline_mm = read_intrinsics(recording).baseline_mm if cameras > 1 else 1.0
    across_mm = recording["stage_x_mm"].values
    below_mm = recording["stage_y_mm"].values if "s_y" in recording["image"].dims else np.zeros(1)
    placed = np.stack([np.tile(across_mm, len(below_mm)), np.repeat(below_mm, len(across_mm))], axis=-1) / baseline_mm
    placed = placed if cameras > 1 else np.zeros((1, 2))
    rig = CameraLayout(placed, baseline_mm, intrinsics.focal_length_px, intrinsics.principal_point_px)
    calibration = read_calibration_uncertainty(recording) if has_common_part(recording, settings) else None
    splines, schedule = Splines(reader, settings.spline_order), read_schedule(recording, placed)
    times, lens = schedule.times, read_lens(recording)
    needed = _needed(reader.shape[2], settings)
    rounds, curved, noted = [], [], ExclusionReport(recording)
    unstated: list[PoseErrors | None] = []
    for number, frames in enumerate(needed):
        entries = None if progress is None else _later(progress, number, len(needed), settings.max_iterations)
        if entries is not None:
            entries(0)
        taken = times[frames.first : frames.last] - times[frames.output]
        images = ImageStack(
            splines.frames(frames.first, frames.last),
            placed,
            taken,
            intrinsics.focal_length_px,
            intrinsics.principal_point_px,
            np.zeros((len(placed) * len(taken), 4)),
            reader.bad(frames.first, frames.last),
            spline=settings.spline_order,
            delays=schedule.delays_of(frames.first, frames.last),
            shutter=schedule.shutter,
            lens=lens,
        )
        if isinstance(settings.noise, PhotonTransferNoise):
            images = replace(
                images, variance=photon_transfer_variance(**settings.noise.model_dump(), grey=images.mean_grey())
            )
        try:
            reason = describe_missing_contrast(images)
            if reason:
                raise EstimateError([Problem("image", reason)])
            if settings.initialisation == "plane_sweep":
                farthest = None if settings.max_motion_px is None else settings.max_motion_px / grid.step_px
                start = initialise_robustly(reader, frames, images, rig, settings.window_sigma_px, farthest)
            else:
                part = reader.part(frames.first, frames.last)
                part = part.sel(s_y=0) if "s_y" in part.dims else part
                part = as_pinhole(part, lens)
                start = initialise_by_structure_tensor(part, frames.output - frames.first, baseline_mm)
                # From camera pixels to columns.
                start.fields[slice(1) if cameras > 1 else slice(1, None)] /= grid.step_px
            if images.delays is not None:
                frame, _ = images.reference()
                remove_delay_bias(start.fields, placed, images.delays[frame], rig.focal, rig.centre[0])
            px_per_mm = abs(float(np.median(start.fields[0])) / baseline_mm)
            priors = read_priors(recording, settings, intrinsics.focal_length_px, px_per_mm, grid.step_px)
            images = replace(images, priors=priors)
        except EstimateError as error:
            noted.report_invalid_frame(frames.output, error.problems[0].message)
            nothing = make_invalid_maps(cameras, len(taken), settings, images.shape, common=calibration is not None)
            for name, values in _state_defects(nothing, recording, reader, images, frames.output).items():
                put(name, {"t": number}, values)
            if corrects_poses(recording, settings):
                for name, components in CORRECTIONS.items():
                    put(name, {"t": number}, np.full((*components, *_cameras(recording)), np.nan))
            rounds.append(0)
            curved.append(0.0)
            continue
        found = refine(images, start.fields, settings, entries)
        found = refit_motion_models(found, settings)
        found, systematic = estimate_systematic_errors(found, settings)
        images, beside = found.images, empty_discontinuity_context(found.images.shape)
        noted.leave_out(frames.first, images.left_out)
        if settings.discontinuity_refit:
            found, beside = refit_discontinuities(images, start.fields, found, settings, entries)
        found = add_growth_bias(found)
        found = replace(found, fit=systematic.added(found.fit, beside.where))
        errors = None
        if settings.pose_corrections == "auto" and images.priors is None:
            # Pixels that show several surfaces are displaced by any pose.
            theta = np.where(beside.where & ~beside.sound, np.nan, found.fit.theta)
            errors = estimate_pose_errors(replace(found, fit=found.fit._replace(theta=theta)), settings)
            unstated.append(errors)
        maps = compute_maps(images, found, beside, start, settings, grid.step_px, baseline_mm, calibration, errors)
        if lens is not None:
            maps = lens.put_back(maps, grid.step_px)
        for name, values in _state_defects(maps, recording, reader, images, frames.output).items():
            put(name, {"t": number}, values)
        if found.cameras is not None:
            for name, values in compute_correction_maps(found.cameras, images, grid.step_px).items():
                put(name, {"t": number}, values.reshape(*values.shape[:-1], *_cameras(recording)))
        rounds.append(found.rounds)
        curved.append(round(float(found.curved.mean()), 4))
        if entries is not None:
            entries(settings.max_iterations)
    warn_of_pose_errors(unstated, grid.step_px)
    return {
        "iterations": rounds,
        "curved_fraction": curved,
        "excluded_pixel_counts": reader.counts,
        **noted.attributes(),
    }


def _state_defects(
    maps: dict[str, Any], recording: xr.Dataset, reader: DefectFilteredFrames, images: ImageStack, frame: int
) -> dict[str, Any]:
    """Return the maps of a frame, with defects of the reference image as reasons for invalidity."""
    excluded = excluded_pixels(recording, recording["t"].values[frame])
    saturated = reader.saturated(frame, images.reference()[1])
    stated = maps["invalid_reason"]
    stated = stated if saturated is None else np.where(saturated, REASONS.index("saturated"), stated)
    given = {"status": maps["status"], "invalid_reason": stated}
    return maps | compute_validity(given, None if excluded is None else excluded[0])


def _cameras(recording: xr.Dataset) -> list[int]:
    """Return the numbers of rows, for a grid, and columns of cameras."""
    return [recording.sizes[dim] for dim in ("s_y", "s") if dim in recording["image"].dims]


def _needed(count: int, settings: RefinedSettings) -> list[FramesNeeded]:
    return frames_needed(count, settings.window_frames, every=settings.frames == "all")


def _later(progress: Progress, number: int, frames: int, rounds: int) -> Callable[[int], None]:
    """Return a function that reports the iterations of one frame as part of the total progress."""
    return lambda done: progress("estimate", number * rounds + done, frames * rounds)
