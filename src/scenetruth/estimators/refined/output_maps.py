"""Output maps of an estimate from the fits around its pixels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import DTypeLike, NDArray

from scenetruth.estimators.method_settings import RefinedSettings
from scenetruth.estimators.refined.aliasing import enlarge_variances
from scenetruth.estimators.refined.ambiguity import find_ambiguous, find_chance_fits
from scenetruth.estimators.refined.aperture import ApertureContext, compute_normal_flow, find_aperture
from scenetruth.estimators.refined.common_uncertainty import CalibrationUncertainty, compute_common_variance
from scenetruth.estimators.refined.discontinuity_refit import FARTHEST, DiscontinuityContext
from scenetruth.estimators.refined.element_uncertainty import compute_calibration_effect, compute_pose_effect
from scenetruth.estimators.refined.fallback import compute_fallback
from scenetruth.estimators.refined.fit_maps import STEADY_PLACES, extract_fields
from scenetruth.estimators.refined.image_consistency import fine_contrast, replace_reference
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.initialisation import InitialEstimate, fill_gaps
from scenetruth.estimators.refined.iterations import RefinedState
from scenetruth.estimators.refined.kernels.window_solver import FUNCTIONALS, Fit
from scenetruth.estimators.refined.mean_image import find_outlines
from scenetruth.estimators.refined.noise_estimation import spline_transfer
from scenetruth.estimators.refined.pose_consistency import PoseErrors
from scenetruth.estimators.refined.pose_corrections import PoseCorrections
from scenetruth.estimators.refined.row_bands import mark_mostly
from scenetruth.estimators.refined.systematic_error import sees_second_camera
from scenetruth.schema.validity import compute_validity
from scenetruth.schema.variables import (
    MOTION_NONE,
    REASONS,
    STATUS_FALLBACK,
    STATUS_INVALID,
    STATUS_NORMAL,
    STATUS_VALID,
)

__all__ = [
    "CORRECTIONS",
    "FrameEvidence",
    "compute_correction_maps",
    "compute_maps",
    "list_camera_counts",
    "list_map_types",
    "make_invalid_maps",
    "withdraw_chance_results",
]

Map = NDArray[np.float64]

CORRECTIONS: Mapping[str, tuple[int, ...]] = {
    f"{name}{end}": components
    for name, components in {"image_shift": (2,), "image_roll": (), "image_scale": ()}.items()
    for end in ("", "_std")
}
"""Correction maps of the images of the estimated frame: dimensions in addition to camera and frame."""

_SHIFT_PX = 0.25  # residuals up to those of a texture shift by this many px are not distinguished from noise
_LARGEST_STD_PX = 0.5  # largest standard deviation of a valid disparity or flow, in px
_CLEAR_OF_ZERO = 6.0  # smallest ratio of a valid disparity to its standard deviation
# Smallest ratio of fitting pixels to those that violate the model; below, all are invalid. Smallest ratio of valid
# pixels to those that have only a plane sweep; below, there is no fallback: shuffled images reach a few percent.
_BY_CHANCE, _LEAST_FITTED = 0.05, 0.25
# Number of images whose displacements exceed the unknowns by only two, so that residuals hardly reveal a wrong fit;
# and the smaller shift that they may have, relative to that of more images: the interpolation of finest textures.
_FEW_IMAGES, _SHIFT_OF_FEW = 4, 0.04
_BORDER, _LOW_TEXTURE, _AMBIGUOUS, _MODEL_VIOLATION = (
    REASONS.index(name) for name in ("border", "low_texture", "ambiguous_match", "model_violation")
)
_EVERYWHERE = ("residual", "image_count")  # maps that have values everywhere
_NONE, _CONSTANT, _PLANE, _CURVED = range(4)  # values of ``surface_model``
# Standard deviation of windows at discontinuities, relative to that of full windows, and its smallest value in px.
_SMALL_WINDOW, _SMALLEST_PX = 2 / 3, 1.5
# Quantities of the surface, which are valid also where the texture determines the normal component of motion only; and
# quantities of the motion that are then given, as in the structure tensor.
_OF_SURFACE = ("disparity", "depth", "slope", "normal", "mean_curvature", "gaussian_curvature")
_OF_NORMAL_MOTION = ("flow", "divergence", "velocity")


def list_camera_counts(recording: xr.Dataset) -> list[int]:
    """Return the numbers of rows, for a grid, and columns of cameras."""
    return [recording.sizes[dim] for dim in ("s_y", "s") if dim in recording["image"].dims]


def list_map_types(
    cameras: int, frames: int, settings: RefinedSettings, *, common: bool = False
) -> Mapping[str, tuple[tuple[int, ...], DTypeLike]]:
    """Return the maps of an estimate: their dimensions in addition to frame and pixels, and their type.

    ``common``: Whether errors of stage or lens are stated, which pixels have in common.
    """
    single = np.float32
    # Quantities that are undetermined are invalid everywhere.
    found: dict[str, tuple[tuple[int, ...], DTypeLike]] = {
        "depth": ((), single),
        "velocity": ((3,), single),
        "disparity": ((), single),
        "flow": ((2,), single),
    }
    if cameras > 1:
        found |= {"depth_std": ((), single), "disparity_std": ((), single)}
        found |= {"depth_std_common": ((), single)} if common else {}
        found |= {"surface_model": ((), np.uint8)}
        if settings.surface != "constant":
            found |= {"slope": ((2,), single), "slope_std": ((2,), single), "normal": ((3,), single)}
        if settings.surface in ("curved", "auto"):
            found |= _with_std("mean_curvature", ()) | _with_std("gaussian_curvature", ())
    if frames > 1:
        found |= {"divergence": ((), single), "motion_model": ((), np.uint8)}
    if cameras > 1 and frames > 1:
        found |= {"velocity_std": ((3,), single)}
        found |= {"velocity_std_common": ((3,), single)} if common else {}
        if settings.accelerated:
            found |= _with_std("acceleration", (3,))
        motion = "translation" if settings.surface == "constant" else settings.motion
        if motion != "translation":
            found |= _with_std("rotation_rate", (3,))
        if motion in ("auto", "growing", "affine"):
            found |= _with_std("growth_rate", ())
        if motion == "affine":
            found |= _with_std("principal_growth_rates", (2,))
            found |= {"principal_growth_direction": ((3,), single), "principal_growth_direction_std": ((), single)}
    found |= {
        "residual": ((), single),
        "image_count": ((), single),
        "status": ((), np.uint8),
        **({"status_disparity": ((), np.uint8)} if cameras > 1 else {}),
        **({"status_motion": ((), np.uint8)} if frames > 1 else {}),
        "valid": ((), np.bool_),
        "invalid_reason": ((), np.uint8),
    }
    return found


def _with_std(name: str, components: tuple[int, ...]) -> dict[str, tuple[tuple[int, ...], DTypeLike]]:
    return {name: (components, np.float32), f"{name}_std": (components, np.float32)}


def make_invalid_maps(
    cameras: int, frames: int, settings: RefinedSettings, shape: tuple[int, int], *, common: bool = False
) -> dict[str, Any]:
    """Return the maps of a frame without valid pixels."""
    types = list_map_types(cameras, frames, settings, common=common).items()
    nothing = {name: np.zeros((*components, *shape), dtype=dtype) for name, (components, dtype) in types}
    for name, values in nothing.items():
        if values.dtype.kind == "f" and name != "image_count":
            values[:] = np.nan
    return nothing


class FrameEvidence(NamedTuple):
    """Pixels on which the validity of a whole frame depends: masks of a region, or numbers."""

    fitting: Any
    """Pixels that agree with their fit."""
    violated: Any
    """Pixels that violate the model."""
    valid: Any
    """Pixels with valid output."""
    swept: Any
    """Textured pixels without valid output that have a disparity of the plane sweep."""

    def counted(self, part: tuple[slice, slice]) -> FrameEvidence:
        """Return the numbers of pixels in a part of the region."""
        return FrameEvidence(*(int(np.count_nonzero(each[part])) for each in self))

    def plus(self, other: FrameEvidence) -> FrameEvidence:
        """Return the sums of two sets of numbers."""
        return FrameEvidence(*(one + more for one, more in zip(self, other, strict=True)))


def withdraw_chance_results(maps: dict[str, Any], found: FrameEvidence) -> None:
    """Make the maps of a whole frame invalid if almost no pixel fits: those that do fit by chance.

    Without a single scene, the images have no fallback either.

    ``found``: Numbers of pixels.
    """
    if found.violated * _BY_CHANCE >= found.fitting:
        withdrawn = maps["status"] != STATUS_INVALID
    elif found.valid <= _LEAST_FITTED * found.swept:
        withdrawn = maps["status"] == STATUS_FALLBACK
    else:
        return
    if not withdrawn.any():
        return
    for name, values in maps.items():
        if values.dtype.kind == "f" and name not in _EVERYWHERE:
            values[..., withdrawn] = np.nan
        elif name in ("surface_model", "motion_model"):
            values[withdrawn] = 0
        elif name.startswith("status"):
            values[withdrawn] = STATUS_INVALID
    maps |= compute_validity({"status": maps["status"], "invalid_reason": maps["invalid_reason"]})


def compute_maps(
    images: ImageStack,
    refined: RefinedState,
    beside: DiscontinuityContext,
    start: InitialEstimate,
    settings: RefinedSettings,
    step_px: float,
    baseline_mm: float,
    calibration: CalibrationUncertainty | None = None,
    poses: PoseErrors | None = None,
) -> tuple[dict[str, Any], FrameEvidence]:
    """Return the maps of a region, and the pixels that decide on the whole frame.

    ``calibration``: Stated uncertainty, whose part of the standard deviations is returned; None if not stated.
    ``poses``: Pose errors that are not stated, or remain after correction; by default those of the corrections.
    """
    shown = replace_reference(images, extract_fields(refined.fit.theta))
    fit = enlarge_variances(
        shown,
        refined.fit,
        refined.motion,
        settings.window_sigma_px,
        accelerated=settings.accelerated,
        by_aliases=refined.alias_residual,
        coupling=refined.coupling,
    )
    transfers = images.transfers_of(fit.residual[0], refined.alias_residual, refined.coupling)
    height, width = images.shape
    cameras, frames = len(images.positions), len(images.times)
    y, x = np.mgrid[:height, :width].astype(np.float64)
    x -= images.centre[0]
    y -= images.centre[1]
    theta, focal = fit.theta, images.focal
    d, q = theta[0], theta[[6, 9, 12]]
    with np.errstate(invalid="ignore", divide="ignore"):
        left = np.sqrt(refined.noise_residual) / images.transfers
        usual = images.residual_noise(refined.noise_residual) / images.transfer
        variance = fit.variance / transfers**2
        if refined.light_edges is not None:
            variance[3:5] += refined.light_edges / np.asarray(images.transfers) ** 2
        common, of_element = None, None
        if calibration is not None or poses is not None:
            errors, effect = poses or refined.cameras, None
            fitted = np.asarray(np.isfinite(theta).all(axis=0))
            if errors is not None and fitted.any():
                finite = fill_gaps(theta[STEADY_PLACES], fitted)
                effect = errors.effect(images, finite).variance
            of_element = _compute_common_element(images, theta, errors, calibration, settings, beside.where)
            common = compute_common_variance(calibration or CalibrationUncertainty(), effect, d, q)
            variance[0] += common.disparity
            variance[3:6] += common.velocity
        std = np.sqrt(variance)
        shifted = _SHIFT_PX * np.sqrt(fit.residual[1])
        if images.demosaiced is not None:
            # Residuals are divided by a smaller transfer than those of images as recorded.
            shifted *= spline_transfer(images.spline) / images.transfer
        limit = np.maximum(settings.max_residual_ratio * usual, shifted)
        if images.count <= _FEW_IMAGES:
            shifted *= _SHIFT_OF_FEW
            limit = np.maximum(settings.max_residual_ratio * usual, shifted)
        most = np.maximum(settings.max_residual_ratio * fine_contrast(images, settings.window_sigma_px), shifted)
        fitted = np.asarray(np.isfinite(theta).all(axis=0))
        known = fitted & images.is_textured(fit.residual[1], usual, fit.images)
        known &= _in_texture(refined.seen.gradient, usual, images, settings.window_sigma_px)
        reason = np.where(fitted & ~known, _LOW_TEXTURE, 0)
        alone = ~sees_second_camera(images, fill_gaps(theta, fitted), settings.window_sigma_px)
        reason[alone] = _BORDER
        known &= ~alone
        violated = known & (np.where(beside.where, ~beside.sound, left > limit) | (left > most))
        # If almost no pixel around it fits, another one fits by chance.
        violated |= find_chance_fits(violated, known, settings.window_sigma_px)
        violated |= known & (False if refined.unresolved is None else refined.unresolved)
        known &= ~violated
        fitting = known.copy()
        reason[violated] = _MODEL_VIOLATION
        known, normal, ambiguous, aperture = _determined(shown, fit, beside, settings, step_px, usual, known, reason)
        found: dict[str, Any] = {"residual": left}
        depth = focal * baseline_mm / d
        if cameras > 1:
            certain = std[0] < np.minimum(_LARGEST_STD_PX, np.abs(d) / _CLEAR_OF_ZERO)
            reason[(known | normal) & ~certain] = _AMBIGUOUS
            known &= (depth > 0) & certain
            normal &= (depth > 0) & certain
            found |= {"disparity": d * step_px, "disparity_std": std[0] * step_px}
            relative = variance[0] / d**2
            if common is not None:
                relative += common.depth - common.disparity / d**2
                found |= {"depth_std_common": depth * np.sqrt(common.depth)}
            found |= {"depth": depth, "depth_std": depth * np.sqrt(relative)}
            found |= {"normal": _normal(theta, x, y, focal)}
        if frames > 1:
            certain = np.abs(d) * std[3:5].max(axis=0) < _LARGEST_STD_PX
            reason[known & ~certain] = _AMBIGUOUS
            known &= certain
            rate = -d * q[2] / focal if cameras > 1 else 0.5 * (theta[7] + theta[11])
            moved = d * q[:2]
            flow = moved + rate * np.stack([x, y]) if cameras > 1 else moved
            along = compute_normal_flow(flow, aperture.direction)
            found |= {"divergence": rate, "flow": np.where(normal, along, flow) * step_px}
            if cameras > 1:
                q = np.stack([*np.where(normal, (along - rate * np.stack([x, y])) / d, q[:2]), q[2]])
        if cameras > 1 and frames > 1:
            found |= {"velocity": q * baseline_mm, "velocity_std": std[3:6] * abs(baseline_mm)}
            if common is not None:
                found |= {"velocity_std_common": np.sqrt(common.velocity) * abs(baseline_mm)}
            if settings.accelerated:
                # In a window of too few frames, it is zero by definition, hence invalid.
                entries = np.where(np.isfinite(std[6:]), theta[15:], np.nan)
                found |= {"acceleration": entries * baseline_mm, "acceleration_std": std[6:] * abs(baseline_mm)}
        found |= _element(fit, baseline_mm, transfers, of_element)
    fallback = compute_fallback(shown, start, known | normal, theta[0], usual, ambiguous, settings.fallback)
    rough = fallback.where
    order = np.where(refined.curved, _CURVED, _CONSTANT if settings.surface == "constant" else _PLANE)
    maps: dict[str, NDArray[Any]] = {
        "residual": left,
        "image_count": fit.images,
        "surface_model": np.where(known | normal, order, _NONE),
        "motion_model": np.where(known, refined.motion, MOTION_NONE),
        **_validity(known, normal, rough, reason),
    }
    types = list_map_types(cameras, frames, settings, common=calibration is not None)
    for name, (components, _) in types.items():
        if name not in maps:
            values = found.get(name, np.full((*components, height, width), np.nan))
            determined = name.removesuffix("_std") in _OF_SURFACE or name in _OF_NORMAL_MOTION
            maps[name] = np.where(known | normal if determined else known, values, np.nan)
    if rough.any():
        filled, std_filled = fallback.disparity[rough], fallback.std[rough]
        maps["disparity"][rough], maps["depth"][rough] = filled * step_px, focal * baseline_mm / filled
        maps["disparity_std"][rough] = std_filled * step_px
        relative_square = (std_filled / filled) ** 2
        if common is not None:
            relative_square += np.broadcast_to(common.depth, rough.shape)[rough]
        maps["depth_std"][rough] = maps["depth"][rough] * np.sqrt(relative_square)
    evidence = FrameEvidence(fitting, violated, known | normal, fallback.swept)
    return {name: maps[name].astype(dtype) for name, (_, dtype) in types.items()}, evidence


_NEARLY_ALL = 0.85  # share of undetermined pixels around a pixel from which on it is undetermined, too


def _determined(
    images: ImageStack,
    fit: Fit,
    beside: DiscontinuityContext,
    settings: RefinedSettings,
    step_px: float,
    noise: float,
    known: NDArray[np.bool_],
    reason: NDArray[Any],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_], ApertureContext]:
    """Return which of the pixels in a mask are valid, have a normal component only, and are ambiguous; add reasons."""
    sigma = settings.window_sigma_px
    windows = sigma, beside.where, max(_SMALLEST_PX, _SMALL_WINDOW * sigma)
    outlines = find_outlines(images, fit)
    aperture = find_aperture(images, fit.theta, *windows, noise, known, outlines)
    largest = None if settings.max_motion_px is None else settings.max_motion_px / step_px
    tested = known & aperture.disparity
    ambiguous = find_ambiguous(images, fit.theta, *windows, noise, tested, aperture, largest, outlines)
    # Amid textures in one direction, some pixels have a second one by chance.
    single = known & ~(aperture.disparity & aperture.motion)
    ambiguous |= known & ~single & mark_mostly(single, known, 4 * round(sigma) + 1)
    # A few pixels of a repetitive texture differ by what lies at the ends of their windows.
    undetermined = single | ambiguous
    ambiguous |= known & ~undetermined & mark_mostly(undetermined, known, 8 * round(sigma) + 1, _NEARLY_ALL)
    reason[known & ~(aperture.disparity & (aperture.motion | aperture.normal))] = _AMBIGUOUS
    reason[ambiguous] = _AMBIGUOUS
    sound = known & aperture.disparity & ~ambiguous
    return sound & aperture.motion, sound & aperture.normal, ambiguous, aperture


def _validity(
    known: NDArray[np.bool_], normal: NDArray[np.bool_], rough: NDArray[np.bool_], reason: NDArray[Any]
) -> dict[str, Any]:
    """Return the status maps; where the motion has a normal component only, the disparity is valid."""
    surface = np.where(known | normal, STATUS_VALID, np.where(rough, STATUS_FALLBACK, STATUS_INVALID))
    motion = np.where(known, STATUS_VALID, np.where(normal, STATUS_NORMAL, STATUS_INVALID))
    status = np.where(normal, STATUS_NORMAL, surface)
    found = compute_validity({"status": status, "invalid_reason": reason})
    return {**found, "status_disparity": surface, "status_motion": motion}


def compute_correction_maps(cameras: PoseCorrections, images: ImageStack, step_px: float) -> dict[str, Map]:
    """Return the pose corrections of the images of the estimated frame."""
    frame = np.flatnonzero(np.repeat(images.times == 0.0, len(images.positions)))
    found: dict[str, Map] = {}
    for end, each in (("", cameras.values), ("_std", cameras.std)):
        of_frame = each[frame].T
        found |= {f"image_shift{end}": of_frame[:2] * step_px, f"image_roll{end}": of_frame[2]}
        found |= {f"image_scale{end}": of_frame[3]}
    return found


def _in_texture(gradient: NDArray[Any], noise: float, images: ImageStack, sigma_px: float) -> NDArray[np.bool_]:
    """Return where the texture or its centroid is close to a pixel; elsewhere the fit refers to another point.

    The texture centroid of a Gaussian window, weighted by the squared gradient, is at σ² ∇ ln S from the window centre,
    with the window sum S of the squared gradient.
    """
    from scipy.ndimage import gaussian_filter

    texture = gradient.astype(np.float64)
    total = np.maximum(gaussian_filter(texture, sigma_px), 1e-300)
    partial = [gaussian_filter(texture, sigma_px, order=order) / total for order in ((0, 1), (1, 0))]
    middle_px = sigma_px**2 * np.hypot(*partial)
    own = images.is_textured(texture, noise)
    bare = find_open_blanks(
        texture / images.noise_gradient(noise), ~own, images.reference_grey(), noise / images.channels**0.5, sigma_px
    )
    return np.asarray((own | (middle_px < FARTHEST * sigma_px)) & ~bare)


# Standard deviation in px of a neighbourhood; largest mean square gradient in it without texture, relative to that of
# noise (of 99 % of such pixels); distance from texture beyond which an area is open, in units of the window's σ.
_QUIET_PX, _QUIET, _OPEN = 2.0, 1.8, 0.5
# Distance to which an open area extends, in the same units; distance in px to which the gradient of an outline reaches;
# differences of grey values up to which they are the same, in standard deviations of the noise.
_EXTENDED, _OUTLINE_PX, _SAME_GREY = 3.0, 4, 3.0


def find_open_blanks(
    gradient: Map, blank: NDArray[np.bool_], grey: Map, noise: float, sigma_px: float
) -> NDArray[np.bool_]:
    """Return where an area without texture continues beyond a window: as between twigs before a blank wall.

    The texture around it need not be that of its surface, even if it lies on all sides. Blank areas that end within the
    window, as the inside of printed squares, are not open. At outlines, an open area ends where the grey value changes.

    ``gradient``: Mean square gradient relative to that of noise. ``blank``: Where it shows no texture.
    ``grey``, ``noise``: Reference image, and the standard deviation of its noise.
    """
    from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter

    busy = gaussian_filter(gradient, _QUIET_PX) > _QUIET
    quiet = distance_transform_edt(~busy) > _OPEN * sigma_px if busy.any() else ~busy
    if not quiet.any():
        return np.zeros_like(blank)
    square = np.ones((3, 3))
    found = binary_dilation(quiet, square, round(_EXTENDED * sigma_px), mask=blank)
    share = gaussian_filter(found.astype(np.float64), _QUIET_PX)
    mean = gaussian_filter(np.where(found, grey, 0.0), _QUIET_PX) / np.maximum(share, 1e-300)
    same = (share > 0) & (np.abs(grey - mean) < _SAME_GREY * noise)
    return np.asarray(binary_dilation(found, square, _OUTLINE_PX, mask=found | same))


def _normal(theta: Map, x: Map, y: Map, focal: float) -> Map:
    """Return the unit normal towards the camera.

    With the plane d(x, y) = d_0 + d_x ξ + d_y η in the image, the surface is N · P = const with
    N = (f d_x, f d_y, d_0 - d_x x - d_y y).
    """
    normal = np.stack([focal * theta[1], focal * theta[2], theta[0] - theta[1] * x - theta[2] * y])
    normal /= np.linalg.norm(normal, axis=0)
    # Towards the camera: against the viewing ray (x, y, f).
    facing = normal[0] * x + normal[1] * y + normal[2] * focal
    normal *= -np.sign(facing)
    return normal


def _compute_common_element(
    images: ImageStack,
    theta: Map,
    errors: PoseCorrections | PoseErrors | None,
    calibration: CalibrationUncertainty | None,
    settings: RefinedSettings,
    small: NDArray[np.bool_],
) -> Map | None:
    """Return the variances of the quantities of the surface element due to poses and calibration, (11, y, x)."""
    valid = np.asarray(np.isfinite(theta).all(axis=0))
    if settings.surface == "constant" or len(images.positions) == 1 or not valid.any():
        return None
    finite = fill_gaps(theta, valid)
    total = np.zeros((FUNCTIONALS, *images.shape))
    if errors is not None:
        sigma, of_poses = settings.window_sigma_px, (errors.rooted, errors.turned_px)
        total += compute_pose_effect(images, finite, *of_poses, sigma)
        if small.any():
            of_small = compute_pose_effect(images, finite, *of_poses, max(_SMALLEST_PX, _SMALL_WINDOW * sigma))
            total[:, small] = of_small[:, small]
    if calibration is not None:
        total += compute_calibration_effect(images, finite, calibration)
    return total


def _element(fit: Fit, baseline_mm: float, transfer: Map | float, common: Map | None) -> dict[str, Map]:
    """Return the quantities of the surface element with their standard deviations; see `describe_element`.

    ``transfer``: Ratio of the noise after interpolation to that before. ``common``: Variances to be added, shape (11,
    y, x).
    """
    variance = fit.element_variance.astype(np.float64) / transfer**2
    values, std = fit.element.astype(np.float64), np.sqrt(variance if common is None else variance + common)
    # For negative baselines, disparities are negative.
    for place, unit in ((2, abs(baseline_mm)), (3, baseline_mm**2)):
        values[place] /= unit
        std[place] /= unit
    direction = values[10:]
    # The sign with X > 0, as in the ground truth.
    direction *= np.where(direction[0] < 0, -1.0, 1.0)
    parts: dict[str, int | slice] = {
        "slope": slice(0, 2),
        "mean_curvature": 2,
        "gaussian_curvature": 3,
        "rotation_rate": slice(4, 7),
        "growth_rate": 7,
        "principal_growth_rates": slice(8, 10),
    }
    found = {name: values[part] for name, part in parts.items()}
    found |= {f"{name}_std": std[part] for name, part in parts.items()}
    return found | {"principal_growth_direction": direction, "principal_growth_direction_std": std[10]}
