"""The refined estimator over the frames of a recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.refined.frames import FramesNeeded, Splines, frames_needed
from scenetruth.estimators.refined.maps import CORRECTIONS, corrections_of, maps_of, types_of, unknown_maps
from scenetruth.estimators.refined.settings import PhotonTransferNoise, RefinedSettings
from scenetruth.progress import Progress
from scenetruth.schema import Put, blank_map, intrinsics_of, label, pixel_grid_of

__all__ = ["blank_estimate", "fill_estimate"]


def blank_estimate(recording: xr.Dataset, settings: RefinedSettings) -> xr.Dataset:
    """Return the estimate of a recording with maps that are still blank.

    Parameters
    ----------
    recording
        A checked recording.
    settings
        Which frames are estimated, and which maps follow from the model.
    """
    sizes = recording["image"].sizes
    places = [frames.output for frames in _needed(sizes["t"], settings)]
    shape = (len(places), sizes["y"], sizes["x"])
    frames = min(sizes["t"], settings.window_frames)
    types = types_of(sizes.get("s_y", 1) * sizes["s"], frames, settings)
    x, y = (recording[name].values if name in recording.coords else None for name in ("x", "y"))
    maps = {name: blank_map(dtype, (*components, *shape)) for name, (components, dtype) in types.items()}
    cameras: dict[str, Any] = {}
    if settings.corrections is not None:
        for name, components in CORRECTIONS.items():
            maps[name] = blank_map(np.float64, (*components, *_cameras(recording), len(places)))
        names = ("s", "stage_x_mm", *(("stage_y_mm",) if "s_y" in recording["image"].dims else ()))
        cameras = {name: recording[name].values for name in names}
    times = recording["t"].values[places]
    return label("estimate", maps, intrinsics_of(recording), t=times, x=x, y=y, **cameras)


def fill_estimate(
    recording: xr.Dataset, settings: RefinedSettings, put: Put, progress: Progress | None = None
) -> dict[str, Any]:
    """Estimate surface and motion of every pixel, frame by frame.

    Parameters
    ----------
    recording
        As of `blank_estimate`.
    settings
        Window, model and rounds; the window counts in columns of the recording.
    put
        Takes the maps of `blank_estimate`.
    progress
        Called with (what, done, total).

    Returns
    -------
    dict
        Attributes: the rounds that each frame took, the share of its pixels with a curved surface, how many pixels of
        the images were not used for which cause, which images were left out, and of which frames nothing is known and
        why.

    Raises
    ------
    RecordingError
        If the recording's pixels are no even grid.
    """
    from scenetruth.estimators.refined.bad.pixels import SoundFrames
    from scenetruth.estimators.refined.bad.start import sound_start
    from scenetruth.estimators.refined.bad.telling import Told, nothing_to_tell
    from scenetruth.estimators.refined.images import Images
    from scenetruth.estimators.refined.refits.outlines import nothing_beside, refit_beside_outlines
    from scenetruth.estimators.refined.refits.richer import refit_richer_motion
    from scenetruth.estimators.refined.rounds import refine
    from scenetruth.estimators.refined.start import Rig, tensor_fields
    from scenetruth.estimators.refined.variance import known_variance

    grid = pixel_grid_of(recording)
    intrinsics = grid.in_columns(intrinsics_of(recording))
    reader = SoundFrames(recording)
    cameras = reader.shape[1]
    baseline_mm = intrinsics_of(recording).baseline_mm if cameras > 1 else 1.0
    across_mm = recording["stage_x_mm"].values
    below_mm = recording["stage_y_mm"].values if "s_y" in recording["image"].dims else np.zeros(1)
    placed = np.stack([np.tile(across_mm, len(below_mm)), np.repeat(below_mm, len(across_mm))], axis=-1) / baseline_mm
    placed = placed if cameras > 1 else np.zeros((1, 2))
    rig = Rig(placed, baseline_mm, intrinsics.focal_length_px, intrinsics.principal_point_px)
    if settings.corrections is not None:
        settings = settings.model_copy(update={"corrections": settings.corrections.in_columns(grid.step_px)})
    splines, times = Splines(reader, settings.spline_order), recording["t"].values.astype(np.float64)
    needed = _needed(reader.shape[2], settings)
    rounds, curved, noted = [], [], Told(recording)
    for number, frames in enumerate(needed):
        told = None if progress is None else _later(progress, number, len(needed), settings.rounds)
        if told is not None:
            told(0)
        taken = times[frames.first : frames.last] - times[frames.output]
        images = Images(
            splines.frames(frames.first, frames.last),
            placed,
            taken,
            intrinsics.focal_length_px,
            intrinsics.principal_point_px,
            np.zeros((len(placed) * len(taken), 4)),
            reader.bad(frames.first, frames.last),
            spline=settings.spline_order,
        )
        if isinstance(settings.noise, PhotonTransferNoise):
            images = replace(images, variance=known_variance(**settings.noise.model_dump(), grey=images.mean_grey()))
        try:
            reason = nothing_to_tell(images)
            if reason:
                raise EstimateError([Problem("image", reason)])
            if settings.start == "plane_sweep":
                start = sound_start(reader, frames, images, rig, settings.window_sigma_px)
            else:
                part = reader.part(frames.first, frames.last)
                part = part.sel(s_y=0) if "s_y" in part.dims else part
                start = tensor_fields(part, frames.output - frames.first, baseline_mm)
                # From the camera's pixels to columns.
                start.fields[slice(1) if cameras > 1 else slice(1, None)] /= grid.step_px
        except EstimateError as error:
            noted.nothing_known(frames.output, error.problems[0].message)
            for name, values in unknown_maps(cameras, len(taken), settings, images.shape).items():
                put(name, {"t": number}, values)
            if settings.corrections is not None:
                for name, components in CORRECTIONS.items():
                    put(name, {"t": number}, np.full((*components, *_cameras(recording)), np.nan))
            rounds.append(0)
            curved.append(0.0)
            continue
        found = refine(images, start.fields, settings, told)
        found = refit_richer_motion(found, settings)
        images, beside = found.images, nothing_beside(found.images.shape)
        noted.leave_out(frames.first, images.left_out)
        if settings.outlines:
            found, beside = refit_beside_outlines(images, start.fields, found, settings, told)
        for name, values in maps_of(images, found, beside, start, settings, grid.step_px, baseline_mm).items():
            put(name, {"t": number}, values)
        if found.cameras is not None:
            for name, values in corrections_of(found.cameras, images, grid.step_px).items():
                put(name, {"t": number}, values.reshape(*values.shape[:-1], *_cameras(recording)))
        rounds.append(found.rounds)
        curved.append(round(float(found.curved.mean()), 4))
        if told is not None:
            told(settings.rounds)
    return {"rounds": rounds, "curved_share": curved, "pixels_masked": reader.counts, **noted.attributes()}


def _cameras(recording: xr.Dataset) -> list[int]:
    """Return the numbers of rows, if there are such, and columns of cameras."""
    return [recording.sizes[dim] for dim in ("s_y", "s") if dim in recording["image"].dims]


def _needed(count: int, settings: RefinedSettings) -> list[FramesNeeded]:
    return frames_needed(count, settings.window_frames, every=settings.frames == "all")


def _later(progress: Progress, number: int, frames: int, rounds: int) -> Callable[[int], None]:
    """Return what reports the rounds of one frame as a part of all."""
    return lambda done: progress("estimate", number * rounds + done, frames * rounds)
