"""Estimate of one frame: initial fields, fit, and output maps, of the whole image or tile by tile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.channel_noise import read_demosaicing
from scenetruth.estimators.method_settings import PhotonTransferNoise, RefinedSettings
from scenetruth.estimators.refined.acquisition import corrects_poses, read_priors, read_schedule, remove_delay_bias
from scenetruth.estimators.refined.alias_residuals import with_measured_noise
from scenetruth.estimators.refined.common_uncertainty import has_common_part, read_calibration_uncertainty
from scenetruth.estimators.refined.discontinuity_refit import (
    DiscontinuityContext,
    empty_discontinuity_context,
    refit_discontinuities,
)
from scenetruth.estimators.refined.growth_comparison import add_growth_bias
from scenetruth.estimators.refined.image_consistency import describe_missing_contrast
from scenetruth.estimators.refined.image_sample import measure_agreement, sample_images
from scenetruth.estimators.refined.image_stack import FramesNeeded, ImageStack, Region, Splines
from scenetruth.estimators.refined.initialisation import (
    CameraLayout,
    InitialEstimate,
    initialise_by_structure_tensor,
    initialise_robustly,
)
from scenetruth.estimators.refined.iterations import RefinedState, refine
from scenetruth.estimators.refined.lens_distortion import as_pinhole, read_lens
from scenetruth.estimators.refined.light_edges import add_light_edges
from scenetruth.estimators.refined.motion_model_selection import refit_motion_models
from scenetruth.estimators.refined.neighbouring_motion import add_neighbouring_motion
from scenetruth.estimators.refined.noise_estimation import photon_transfer_variance
from scenetruth.estimators.refined.output_maps import (
    CORRECTIONS,
    FrameEvidence,
    compute_correction_maps,
    compute_maps,
    list_camera_counts,
    list_map_types,
    make_invalid_maps,
    withdraw_chance_results,
)
from scenetruth.estimators.refined.pixel_defects import DefectFilteredFrames
from scenetruth.estimators.refined.pose_consistency import PoseErrors, compare_with_stated, estimate_pose_errors
from scenetruth.estimators.refined.smooth_light import compare_without_smooth_light
from scenetruth.estimators.refined.systematic_error import estimate_systematic_errors
from scenetruth.estimators.refined.tiles import RegionImages, choose_tiles
from scenetruth.estimators.refined.time_resolution import LARGEST_UNTESTED, check_time_resolution, join_frames
from scenetruth.memory import release_memory
from scenetruth.schema import REASONS, compute_pixel_grid, read_intrinsics
from scenetruth.schema.validity import compute_validity, excluded_pixels

__all__ = ["FrameEstimate", "FrameTask"]

Report = Callable[[int], None]
_ON_ONE_SIDE = 2  # number of frames that test a velocity at the beginning or end of a recording


@dataclass
class FrameEstimate:
    """Maps of a frame, and properties of its fit."""

    maps: dict[str, Any]
    corrections: dict[str, Any] = field(default_factory=dict)
    """Maps of the pose corrections of the images."""
    left_out: frozenset[tuple[int, int]] = frozenset()
    """Excluded images, as indices of frame and camera."""
    errors: PoseErrors | None = None
    """Pose errors that are not stated."""
    rounds: int = 0
    curved: float = 0.0
    """Fraction of the pixels with a surface of second order."""


class FrameTask:
    """Estimation of the frames of a recording."""

    def __init__(self, recording: xr.Dataset, settings: RefinedSettings) -> None:
        self._recording, self._settings = recording, settings
        self.grid = compute_pixel_grid(recording)
        self._intrinsics = intrinsics = self.grid.in_columns(read_intrinsics(recording))
        self.reader = DefectFilteredFrames(recording)
        self._baseline_mm = read_intrinsics(recording).baseline_mm if self._several else 1.0
        across_mm = recording["stage_x_mm"].values
        below_mm = recording["stage_y_mm"].values if "s_y" in recording["image"].dims else np.zeros(1)
        placed = np.stack([np.tile(across_mm, len(below_mm)), np.repeat(below_mm, len(across_mm))], axis=-1)
        self._positions = placed / self._baseline_mm if self._several else np.zeros((1, 2))
        focal, centre = intrinsics.focal_length_px, intrinsics.principal_point_px
        self._rig = CameraLayout(self._positions, self._baseline_mm, focal, centre)
        common = has_common_part(recording, settings)
        self._calibration = read_calibration_uncertainty(recording) if common else None
        self._splines = Splines(self.reader, settings.spline_order)
        self._schedule, self._lens = read_schedule(recording, self._positions), read_lens(recording)
        height, width = self.reader.shape[3:]
        self.tiles = choose_tiles((height, width), settings.window_sigma_px)
        """Tiles of an image; a single one is the whole image."""

    @property
    def _several(self) -> bool:
        return self.reader.shape[1] > 1

    def estimate(self, frames: FramesNeeded, report: Report | None = None) -> FrameEstimate:
        """Return the estimate of a frame; raise `EstimateError` if there is none."""
        images = self._outline(frames)
        found = self._estimate_tiles(frames, images, report) if len(self.tiles) > 1 else None
        found = found or self._estimate_whole(frames, images, report)
        if self._lens is not None:
            found.maps = self._lens.put_back(found.maps, self.grid.step_px)
        self._state_defects(found.maps, frames, images)
        return found

    def estimate_nothing(self, frames: FramesNeeded) -> FrameEstimate:
        """Return the maps of a frame without an estimate."""
        images, settings = self._outline(frames), self._settings
        common = self._calibration is not None
        maps = make_invalid_maps(self.reader.shape[1], len(images.times), settings, images.shape, common=common)
        self._state_defects(maps, frames, images)
        if corrects_poses(self._recording, settings):
            counts = list_camera_counts(self._recording)
            nothing = {name: np.full((*components, *counts), np.nan) for name, components in CORRECTIONS.items()}
            return FrameEstimate(maps, nothing)
        return FrameEstimate(maps)

    def _outline(self, frames: FramesNeeded) -> ImageStack:
        """Return the images of a frame without coefficients."""
        taken = self._schedule.times[frames.first : frames.last] - self._schedule.times[frames.output]
        height, width = self.reader.shape[3:]
        return ImageStack(
            [],
            self._positions,
            taken,
            self._rig.focal,
            self._rig.centre,
            np.zeros((len(self._positions) * len(taken), 4)),
            spline=self._settings.spline_order,
            delays=self._schedule.delays_of(frames.first, frames.last),
            shutter=self._schedule.shutter,
            lens=self._lens,
            region=Region(0, 0, height, width, (height, width)),
            demosaiced=read_demosaicing(self._recording),
        )

    def _estimate_whole(self, frames: FramesNeeded, images: ImageStack, report: Report | None) -> FrameEstimate:
        settings = self._settings
        wide = self._frames_beyond(frames)
        coefficients, bad = self._splines.frames(wide.first, wide.last), self.reader.bad(wide.first, wide.last)
        beyond = None if wide == frames else replace(self._outline(wide), coefficients=coefficients, bad=bad)
        own = slice(frames.first - wide.first, frames.last - wide.first)
        images = replace(images, coefficients=coefficients[own], bad=bad[own])
        images = self._with_noise(images, images.mean_grey)
        self._require_contrast(images)
        start = self._initialise(frames, images)
        images = replace(images, priors=self._priors(start), noise_share=self._noise_share(frames, start))
        found, beside = _fit(images, start, settings, report, beyond)
        errors = None
        if settings.pose_corrections == "auto" and images.priors is None:
            # Pixels that show several surfaces are displaced by any pose.
            theta = np.where(beside.where & ~beside.sound, np.nan, found.fit.theta)
            errors = estimate_pose_errors([replace(found, fit=found.fit._replace(theta=theta))], settings)
        elif images.priors is not None:
            errors = compare_with_stated([found], found.cameras, settings)
        maps, evidence = self._maps(found, beside, start, errors)
        withdraw_chance_results(maps, evidence.counted((slice(None), slice(None))))
        curved = round(float(found.curved.mean()), 4)
        return FrameEstimate(maps, self._corrections(found), found.images.left_out, errors, found.rounds, curved)

    def _estimate_tiles(self, frames: FramesNeeded, images: ImageStack, report: Report | None) -> FrameEstimate:
        settings = self._settings
        source = RegionImages(self.reader, frames, images)
        self._require_contrast(replace(images, coefficients=source.frames()))
        images = self._with_noise(images, lambda: float(np.mean(source.reference(), dtype=np.float64)))
        source.outline = images
        agreement = lambda fields: measure_agreement(source, fields, settings.window_sigma_px)  # noqa: E731
        start = self._initialise(frames, images, agreement)
        priors, share = self._priors(start), self._noise_share(frames, start)
        source.outline = replace(images, priors=priors, noise_share=share)
        wide = self._frames_beyond(frames)
        wider = None if wide == frames else RegionImages(self.reader, wide, self._outline(wide))
        start = InitialEstimate(start.fields.astype(np.float32), start.known)
        release_memory()
        sample = sample_images(source, start.fields, settings, report)
        common = self._calibration is not None
        types = list_map_types(self.reader.shape[1], len(images.times), settings, common=common)
        maps = {name: np.empty((*size, *images.shape), dtype=dtype) for name, (size, dtype) in types.items()}
        whole = FrameEstimate(maps, left_out=sample.images.left_out, errors=sample.errors)
        curved, evidence = 0, FrameEvidence(0, 0, 0, 0)
        for number, tile in enumerate(self.tiles, 1):
            release_memory()
            region = tile.region
            fields = start.fields[:, region.rows, region.columns].astype(np.float64)
            own = InitialEstimate(fields, start.known[region.rows, region.columns])
            later = None if report is None else _after(report, number * settings.max_iterations)
            beyond = None if wider is None else wider.stack(region, start.fields)
            found, beside = _fit(source.stack(region, start.fields, sample.images), own, settings, later, beyond)
            found = replace(found, cameras=sample.cameras)
            made, of_tile = self._maps(found, beside, own, sample.errors)
            evidence = evidence.plus(of_tile.counted(tile.kept))
            for name, values in made.items():
                maps[name][..., tile.inner.rows, tile.inner.columns] = values[(..., *tile.kept)]
            whole.rounds = max(whole.rounds, found.rounds)
            curved += int(found.curved[tile.kept].sum())
            whole.corrections = self._corrections(found)
            del found, beside, made, of_tile
        withdraw_chance_results(maps, evidence)
        whole.curved = round(curved / (images.shape[0] * images.shape[1]), 4)
        return whole

    def _frames_beyond(self, frames: FramesNeeded) -> FramesNeeded:
        """Return the frames of a fit, and those next to them that test the velocity of two or three frames."""
        if not 1 < frames.last - frames.first <= LARGEST_UNTESTED:
            return frames
        last = self.reader.shape[2]
        before, after = frames.first, last - frames.last
        each = (1, 1) if before and after else (_ON_ONE_SIDE, _ON_ONE_SIDE)
        return replace(frames, first=frames.first - min(each[0], before), last=frames.last + min(each[1], after))

    def _with_noise(self, images: ImageStack, mean_grey: Callable[[], float]) -> ImageStack:
        """Return the images with the noise of the settings."""
        noise = self._settings.noise
        if not isinstance(noise, PhotonTransferNoise):
            return images
        return replace(images, variance=photon_transfer_variance(**noise.model_dump(), grey=mean_grey()))

    def _require_contrast(self, images: ImageStack) -> None:
        reason = describe_missing_contrast(images)
        if reason:
            raise EstimateError([Problem("image", reason)])

    def _initialise(
        self, frames: FramesNeeded, images: ImageStack, agreement: Callable[[NDArray[np.float64]], float] | None = None
    ) -> InitialEstimate:
        """Return the initial estimate of all pixels."""
        settings, step_px = self._settings, self.grid.step_px
        if settings.initialisation == "plane_sweep":
            farthest = None if settings.max_motion_px is None else settings.max_motion_px / step_px
            sigma = settings.window_sigma_px
            start = initialise_robustly(self.reader, frames, images, self._rig, sigma, farthest, agreement)
        else:
            part = self.reader.part(frames.first, frames.last)
            part = as_pinhole(part.sel(s_y=0) if "s_y" in part.dims else part, self._lens)
            start = initialise_by_structure_tensor(part, frames.output - frames.first, self._baseline_mm)
            # From camera pixels to columns.
            start.fields[slice(1) if self._several else slice(1, None)] /= step_px
        if images.delays is not None:
            frame, _ = images.reference()
            remove_delay_bias(start.fields, self._positions, images.delays[frame], self._rig.focal, self._rig.centre[0])
        return start

    def _priors(self, start: InitialEstimate) -> Any:
        px_per_mm = abs(float(np.median(start.fields[0])) / self._baseline_mm)
        return read_priors(self._recording, self._settings, self._rig.focal, px_per_mm, self.grid.step_px)

    def _noise_share(self, frames: FramesNeeded, start: InitialEstimate) -> NDArray[np.float64] | None:
        """Return the noise share of the pixels: mean over all images, and of the reference, shape (2, y, x).

        Pixels of other images are those that show the median disparity.
        """
        demosaiced = read_demosaicing(self._recording)
        both = 1.0 if demosaiced is None else demosaiced.share
        if "noise_share" not in self._recording:
            return None if demosaiced is None else np.full((2, *self.reader.shape[3:]), both)
        share = self._recording["noise_share"] * both
        share = share.isel(t=slice(frames.first, frames.last)).mean("t") if "t" in share.dims else share
        order = ("s_y", "s", "y", "x")
        sizes = [self._recording["image"].sizes.get(dim, 1) for dim in order]
        given = np.broadcast_to(share.values.reshape([share.sizes.get(dim, 1) for dim in order]), sizes)
        each = given.reshape(-1, *sizes[2:]).astype(np.float64)
        disparity = float(np.median(start.fields[0]))
        rows, columns = (np.arange(size) for size in sizes[2:])
        total = np.zeros(sizes[2:])
        for image, (s, s_y) in zip(each, self._positions, strict=True):
            down, right = (np.rint(-disparity * step).astype(int) for step in (s_y, s))
            at = np.clip(rows + down, 0, sizes[2] - 1), np.clip(columns + right, 0, sizes[3] - 1)
            total += image[np.ix_(*at)]
        reference = int(np.argmin(np.abs(self._positions).sum(axis=1)))
        return np.stack([total / len(each), each[reference]])

    def _maps(
        self, found: RefinedState, beside: DiscontinuityContext, start: InitialEstimate, errors: PoseErrors | None
    ) -> tuple[dict[str, Any], FrameEvidence]:
        """Return the maps of a region, and the pixels that decide on the whole frame."""
        calibration, region = self._calibration, found.images.region
        if calibration is not None and calibration.lens is not None and region is not None:
            calibration = replace(calibration, lens=calibration.lens[:, region.rows, region.columns])
        step_px, baseline_mm = self.grid.step_px, self._baseline_mm
        return compute_maps(
            found.images, found, beside, start, self._settings, step_px, baseline_mm, calibration, errors
        )

    def _corrections(self, found: RefinedState) -> dict[str, Any]:
        """Return the maps of the pose corrections."""
        if found.cameras is None:
            return {}
        maps, counts = (
            compute_correction_maps(found.cameras, found.images, self.grid.step_px),
            list_camera_counts(self._recording),
        )
        return {name: values.reshape(*values.shape[:-1], *counts) for name, values in maps.items()}

    def _state_defects(self, maps: dict[str, Any], frames: FramesNeeded, images: ImageStack) -> None:
        """State defects of the reference image as reasons for invalidity."""
        excluded = excluded_pixels(self._recording, self._recording["t"].values[frames.output])
        saturated = self.reader.saturated(frames.output, images.reference()[1])
        stated = maps["invalid_reason"]
        stated = stated if saturated is None else np.where(saturated, REASONS.index("saturated"), stated)
        given = {"status": maps["status"], "invalid_reason": stated}
        maps |= compute_validity(given, None if excluded is None else excluded[0])


def _fit(
    images: ImageStack,
    start: InitialEstimate,
    settings: RefinedSettings,
    report: Report | None,
    beyond: ImageStack | None = None,
) -> tuple[RefinedState, DiscontinuityContext]:
    """Fit surface and motion around every pixel.

    ``beyond``: Images of these frames and of those next to them; None if there are none.
    """
    found = refine(images, start.fields, settings, report)
    beside = empty_discontinuity_context(images.shape)
    if not np.isfinite(found.fit.theta).all(axis=0).any():
        return found, beside
    found = with_measured_noise(refit_motion_models(found, settings), settings)
    found, systematic = estimate_systematic_errors(found, settings)
    found = with_measured_noise(found, settings)
    light = compare_without_smooth_light(found, settings, systematic.whole)
    if settings.discontinuity_refit:
        found, beside = refit_discontinuities(found.images, start.fields, found, settings, report)
        if found.unresolved is not None:
            # Smaller windows were fitted to these pixels.
            found = replace(found, unresolved=found.unresolved & ~beside.where)
    found = add_neighbouring_motion(add_growth_bias(found), settings)
    fit = light.added(found.fit, beside.where, found.noise_ratio)
    found = replace(found, fit=systematic.added(fit, beside.where, found.noise_ratio))
    found = add_light_edges(found, settings)
    wide = found.images if beyond is None else join_frames(found.images, beyond)
    return check_time_resolution(found, beside.where, wide, settings), beside


def _after(report: Report, earlier: int) -> Report:
    """Return a function that reports the iterations of a tile after those of earlier tiles."""
    return lambda done: report(earlier + done)
