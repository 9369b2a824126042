"""Cramér-Rao bound of depth and motion at every pixel of a scene with ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.bound.fisher_information import (
    GROWTH_BIAS,
    Window,
    compute_brightness_modes,
    compute_pixel_information,
    compute_window_deviations,
    compute_window_sums,
    window_weights,
)
from scenetruth.bound.image_gradients import (
    GreyNoise,
    compute_noise_variance,
    compute_signed_textures,
    compute_visibility,
)
from scenetruth.bound.motion_selection import MapNeighbourhood, combine_motion_models, is_biased
from scenetruth.bound.surface_geometry import (
    compute_image_times,
    compute_interior_mask,
    compute_reference_points,
    label_surface_segments,
)
from scenetruth.bound.unknowns import (
    Brightness,
    MotionChoice,
    Surface,
    WindowUnknowns,
    add_error_products,
    compute_functionals,
)
from scenetruth.errors import Problem, RecordingError
from scenetruth.schema import COMPONENTS, check_dataset, check_same_run, compute_pixel_grid, read_intrinsics

__all__ = ["bound_maps", "cramer_rao_bound"]


_NEEDED = ("depth", "velocity", "normal", "mixed")


def setting_problems(
    words: Mapping[str, str], noise_std: float | None, window_sigma_px: float, step_px: int
) -> list[Problem]:
    """Return the problems of the settings of `cramer_rao_bound`."""
    choices = {"surface": Surface, "motion": MotionChoice, "window": Window, "brightness": Brightness}
    problems = [
        Problem(name, f"must be one of {', '.join(get_args(choices[name]))}", word)
        for name, word in words.items()
        if word not in get_args(choices[name])
    ]
    for name, value in (("noise_std", noise_std), ("window_sigma_px", window_sigma_px)):
        if value is not None and not (isinstance(value, int | float | np.number) and 0 < value < np.inf):
            problems.append(Problem(name, "must be a positive number", value))
    if not isinstance(step_px, int | np.integer) or step_px < 1:
        problems.append(Problem("step_px", "must be an integer of at least 1", step_px))
    return problems


def data_problems(truth: xr.Dataset, recording: xr.Dataset, brightness: Brightness) -> list[Problem]:
    """Return the problems of a checked truth and recording that prevent the computation of the bound."""
    problems = [
        Problem(f"truth.{name}", "is missing: the bound requires the surface and its motion")
        for name in _NEEDED
        if name not in truth
    ]
    places = {"truth.t": truth["t"], "recording.t": recording["t"], "recording.s": recording["s"]}
    problems += [
        Problem(name, "must contain 0, the reference", index.values.tolist())
        for name, index in places.items()
        if 0 not in index.values
    ]
    if "visible" in truth:
        untold = {
            dim: sorted(set(recording[dim].values.tolist()) - set(truth[dim].values.tolist()))
            for dim in ("s_y", "s", "t")
            if dim in truth["visible"].dims and dim in recording["image"].dims
        }
        problems += [
            Problem(f"truth.visible.{dim}", "does not contain all images of the recording", missing)
            for dim, missing in untold.items()
            if missing
        ]
    if recording.sizes["s"] * recording.sizes.get("s_y", 1) < 2:
        problems.append(Problem("recording.s", "has one camera; depth needs two", recording["s"].values.tolist()))
    if not all(np.array_equal(truth[dim].values, recording[dim].values) for dim in ("y", "x")):
        problems.append(Problem("recording", "must have the pixels of the truth: select the same pixels of both"))
    elif compute_pixel_grid(recording).step_px != 1.0:
        problems.append(Problem("recording.x", "must be consecutive pixels: gradients are computed from the images"))
    invalid = int((~np.isfinite(recording["image"])).sum()) if recording["image"].dtype.kind == "f" else 0
    if invalid:
        message = f"contains {invalid} values that are not finite, from which no gradient follows"
        problems.append(Problem("recording.image", f"{message}: select rows and columns without them, of both"))
    if "distortion" in recording.attrs:
        problems.append(Problem("recording", "has lens distortion; the bound is defined for a pinhole camera"))
    if brightness == "per_image" and recording.sizes.get("channel", 1) > 1:
        problems.append(Problem("brightness", "per_image requires grey images; the recording has colour images"))
    return problems


Map = NDArray[np.float64]

# Windows per batch: their matrices fit into the cache of the processor.
_WINDOWS_PER_BATCH = 4096
_STATED = "lowest standard deviation of {} given the image noise"
_OUTPUTS: dict[str, tuple[str | None, str, str]] = {
    "disparity": (None, "px/step", "disparity"),
    "depth": (None, "mm", "depth"),
    "slope": ("slope_component", "1", "the slopes"),
    "flow": ("image_component", "px/frame", "optical flow"),
    "velocity": ("component", "mm/frame", "velocity"),
    "growth_rate": (None, "1/frame", "the growth rate"),
    "principal_growth_rates": ("principal", "1/frame", "the principal growth rates"),
}


def cramer_rao_bound(
    truth: xr.Dataset,
    recording: xr.Dataset,
    *,
    noise_std: float | None = None,
    window_sigma_px: float = 6.0,
    window: Window = "gaussian",
    surface: Surface = "plane",
    motion: MotionChoice = "rigid",
    brightness: Brightness = "fixed",
    step_px: int = 1,
) -> xr.Dataset:
    """Compute the Cramér-Rao bound of depth and motion from all images, at every pixel of the reference.

    Model: within a window around a pixel, the surface is a plane whose points move with constant velocity and a
    velocity gradient; the texture is unknown at every pixel; noise is white and Gaussian. Let a be the derivatives of
    the image intensities with respect to the unknowns, ā their mean over the images that show the point of a pixel,
    H = Σ w Σ_i (a_i - ā)(a_i - ā)ᵀ / σ², and S the same sum with w². A least-squares fit with the weights w has the
    covariance H⁻¹ S H⁻¹, the minimum for estimators with these weights. With uniform weights this is H⁻¹, the
    Cramér-Rao bound for any unbiased estimator that uses only the pixels of the window. A Gaussian window does not use
    all information of its outer pixels; its bound is that of methods with such a window.

    Parameters
    ----------
    truth
        Ground truth of the recording with ``depth``, ``velocity``, ``normal`` and ``mixed``. With ``object_id``,
        windows do not cross object boundaries; ``visible`` specifies which images show a point.
    recording
        Images from which the texture gradients are computed. With ``radiance`` or a noise-free sensor, gradients are
        those of the reference image, by quintic splines (0.03 % too small at wavelengths of 6 px, 0.5 % at 4 px).
        Gradients of noisy images would be too large; products of gradients are then computed from two means of up to
        four images each, warped to the reference, with independent noise. They are unbiased, but scatter where the
        texture contrast is low.
    noise_std
        Standard deviation of the image noise, in grey values of the recording. Default: that of the sensor. For
        ``emva1288`` it depends on the grey value, and pixels are weighted by the inverse variance.
    window_sigma_px
        Standard deviation of the window, in px.
    window
        ``"gaussian"``, truncated at two standard deviations as in the built-in methods, or ``"even"``: a square with
        uniform weights and this standard deviation.
    surface
        ``"plane"``: unknown slopes; ``"constant"``: given slopes.
    motion
        Unknowns of the velocity gradient: none (``"translation"``), a rotation (``"rigid"``), a rotation and isotropic
        growth (``"growing"``), or all components (``"affine"``). ``"auto"``, as in the refined method: ``"growing"``,
        and ``"affine"`` where the bias of isotropic growth exceeds the noise that the affine model adds. Where it does
        not, the bias is included in the growth rate.
    brightness
        ``"per_image"``: every image has an unknown gain and offset per window, as far as these correlate with depth
        and motion; grey images only.
    step_px
        The bound is computed in every n-th row and column.

    Returns
    -------
    xarray.Dataset
        At t = 0, dimensions (t, y, x): ``disparity_std`` in px per step, ``depth_std`` in mm, ``flow_std`` in px per
        frame, ``velocity_std`` in mm per frame, ``slope_std``, ``growth_rate_std`` per frame and, for affine motion,
        ``principal_growth_rates_std`` per frame, where the model and the images define them; ``image_count``, the
        number of images that show the point of the pixel. NaN where there is no surface, at silhouettes and creases,
        and where the images do not determine all unknowns.

    Raises
    ------
    RecordingError
        If the data sets are incomplete or a setting is invalid; lists all errors.
    MismatchError
        If truth and recording belong to different scenes.

    See Also
    --------
    closed_form_bound : The bound of a flat surface in closed form.

    Notes
    -----
    Slopes and the velocity gradient are linearised: the effect of slope errors on the motion of a rotating surface is
    neglected, except for growth with affine motion, where the variance of products of both errors is added; without
    it, the bound would be far below the error of any method. Camera positions are assumed to be the planned positions.

    Examples
    --------
    A wall at a distance of 100 mm, 3 positions and 3 frames, noise of 1 % of full scale:

    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 100]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> plain = {"camera": {"width": 60, "height": 50, "focal_length_px": 60}, "objects": [wall], "sensor": "ideal"}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 3}, "render": {"backend": "raycast"}}
    >>> recording, truth = st.simulate(st.Scene.from_dict(plain))
    >>> bound = cramer_rao_bound(truth, recording, noise_std=0.01)
    >>> at = bound.sel(t=0).isel(y=25, x=30)
    >>> at.depth_std.round(2).item(), at.velocity_std.values.round(3).tolist(), at.image_count.item()
    (0.07, [0.004, 0.004, 0.019], 9.0)

    The bound is proportional to the noise:

    >>> twice = cramer_rao_bound(truth, recording, noise_std=0.02)
    >>> (twice.depth_std / bound.depth_std).median().round(6).item()
    2.0
    """
    settings = {"surface": surface, "motion": motion, "window": window, "brightness": brightness}
    problems = setting_problems(settings, noise_std, window_sigma_px, step_px)
    if problems:
        raise RecordingError(problems, source="the Cramér-Rao bound")
    check_dataset(truth, "truth")
    check_dataset(recording, "recording")
    check_same_run({"recording": recording.attrs, "truth": truth.attrs})
    problems = data_problems(truth, recording, brightness)
    noise = GreyNoise(np.nan) if problems else compute_noise_variance(recording, noise_std, problems)
    if problems:
        raise RecordingError(problems, source="the Cramér-Rao bound")
    scene = _Scene(truth, recording, noise)
    ways = 2 * len(compute_brightness_modes(scene.views)) if brightness == "per_image" else 0
    moving = recording.sizes["t"] > 1
    model = WindowUnknowns(surface, "growing" if motion == "auto" else motion, moving=moving, brightness=ways)
    weights = window_weights(window, window_sigma_px)
    if motion == "auto":
        maps = scene.bound_of_selected(model, weights, window_sigma_px, step_px)
    else:
        maps = scene.bound(model, weights, step_px)
    more = {"window_sigma_px": float(window_sigma_px), **settings, "noise_std": scene.noise_std()}
    return _labelled(maps, scene, model, step_px, more)


def bound_maps(
    truth: xr.Dataset,
    recording: xr.Dataset,
    noise: GreyNoise,
    model: WindowUnknowns,
    window_sigma_px: float,
    step_px: int = 1,
    *,
    selected: bool = False,
) -> dict[str, Map]:
    """Return bound maps (y, x) for any model and noise, without checks; see `cramer_rao_bound`.

    ``selected``: Whether the affine model replaces a model with isotropic growth, as with ``motion="auto"``.
    """
    scene, weights = _Scene(truth, recording, noise), window_weights("gaussian", window_sigma_px)
    if selected:
        return scene.bound_of_selected(model, weights, window_sigma_px, step_px)
    return scene.bound(model, weights, step_px)


class _Scene:
    """A scene at the reference camera and frame."""

    def __init__(self, truth: xr.Dataset, recording: xr.Dataset, noise: GreyNoise) -> None:
        self.recording, self.noise = recording, noise
        self.intrinsics = read_intrinsics(recording)
        reference = {dim: 0 for dim in ("s_y", "s", "t") if dim in truth["depth"].dims}
        self.truth = truth.drop_vars("visible", errors="ignore").sel(reference)
        self.pieces = label_surface_segments(self.truth)
        self.views = compute_image_times(recording, self.intrinsics.baseline_mm)
        self.points = compute_reference_points(self.truth, self.intrinsics, self.pieces)
        shown = truth
        if "visible" in truth:
            # The truth may have more images than the recording.
            dims = [dim for dim in ("s_y", "s", "t") if dim in truth["visible"].dims and dim in recording["image"].dims]
            shown = xr.Dataset({"visible": truth["visible"].sel({dim: recording[dim].values for dim in dims})})
        self.shown = compute_visibility(shown, recording, self.views, self.points, self.pieces)
        usable = compute_interior_mask(self.pieces)
        self.layers = compute_signed_textures(recording, self.views, self.points, self.shown, usable, noise)

    def noise_std(self) -> float:
        """Return the effective noise of the weighted pixels, in grey values of the recording; NaN without pixels."""
        weights = np.concatenate([layer.weight[layer.weight > 0] for layer in self.layers])
        return float(1.0 / np.sqrt(weights.mean())) if weights.size else float("nan")

    def bound_of_selected(self, model: WindowUnknowns, weights: Map, sigma_px: float, step_px: int) -> dict[str, Map]:
        """Return the maps of a model with isotropic growth, or of the affine model where that is selected."""
        isotropic = self.bound(model, weights, step_px, biased=model.surface == "plane")
        if not is_biased(isotropic):
            return {name: values for name, values in isotropic.items() if name != GROWTH_BIAS}
        affine = self.bound(replace(model, motion="affine"), weights, step_px)
        around = MapNeighbourhood(self.pieces[::step_px, ::step_px], sigma_px / step_px)
        return combine_motion_models(isotropic, affine, around)

    def bound(self, model: WindowUnknowns, weights: Map, step_px: int, *, biased: bool = False) -> dict[str, Map]:
        """Return the maps of the lowest standard deviations, each of shape (..., y, x).

        ``biased``: Whether to add the bias of isotropic growth.
        """
        products = compute_pixel_information(self.points, self.views, self.shown, self.layers, model)
        shape = self.pieces.shape
        found: dict[str, Map] = {}
        for part in compute_window_sums(products, self.pieces, weights, model, step_px):
            for first in range(0, len(part.rows), _WINDOWS_PER_BATCH):
                some = slice(first, first + _WINDOWS_PER_BATCH)
                at = part.rows[some], part.columns[some]
                points = self.points.at(at)
                sums, squares = (
                    {key: values[some] for key, values in each.items()} for each in (part.sums, part.squares)
                )
                std = compute_window_deviations(sums, squares, points, self.intrinsics, model, biased=biased)
                for name, values in std.items():
                    found.setdefault(name, np.full(shape, np.nan))[at] = values
        if not found:
            nothing = self.points.at((np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)))
            names = add_error_products(
                {name: np.zeros(0) for name in compute_functionals(nothing, self.intrinsics, model)}
            )
            found = {name: np.full(shape, np.nan) for name in names}
        return {name: values[::step_px, ::step_px] for name, values in found.items()}


def _labelled(
    maps: dict[str, Map], scene: _Scene, model: WindowUnknowns, step_px: int, attrs: dict[str, Any]
) -> xr.Dataset:
    """Return the maps with names, coordinates and units."""
    pixels = ("t", "y", "x")
    dataset = xr.Dataset(
        coords={
            "t": ("t", [0]),
            **{dim: (dim, scene.truth[dim].values[::step_px]) for dim in ("y", "x")},
        }
    )
    for name, (dim, units, what) in _OUTPUTS.items():
        parts = [values for key, values in maps.items() if key.partition(".")[0] == name]
        if not parts:
            continue
        if dim is not None:
            dataset = dataset.assign_coords({dim: COMPONENTS[dim]})
        stacked = np.stack(parts)[:, None] if dim else parts[0][None]
        dims = (dim, *pixels) if dim else pixels
        dataset[f"{name}_std"] = (dims, stacked, {"units": units, "long_name": _STATED.format(what)})
    shown = scene.shown.sum(axis=0)[None, ::step_px, ::step_px].astype(np.float32)
    entries = {"units": "1", "long_name": "number of images that show the surface point of the pixel"}
    dataset["image_count"] = (pixels, shown, entries)
    kept = ("scene_hash", "recording_hash")
    hashes = {name: scene.recording.attrs[name] for name in kept if name in scene.recording.attrs}
    dataset.attrs = {"scenetruth": "bound", **scene.intrinsics.to_attrs(), **hashes, **attrs}
    return dataset
