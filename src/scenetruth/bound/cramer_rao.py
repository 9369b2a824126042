"""The Cramér-Rao bound of depth and motion at every pixel of a scene with ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_args

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.bound.fisher_information import (
    Window,
    compute_brightness_modes,
    compute_pixel_information,
    compute_variances,
    compute_window_sums,
    normal_matrix,
    window_weights,
)
from scenetruth.bound.image_gradients import (
    GreyNoise,
    compute_noise_variance,
    compute_signed_textures,
    compute_visibility,
)
from scenetruth.bound.surface_geometry import (
    compute_image_times,
    compute_interior_mask,
    compute_reference_points,
    label_surface_segments,
)
from scenetruth.bound.unknowns import (
    Brightness,
    Motion,
    Surface,
    WindowUnknowns,
    add_error_products,
    compute_columns,
    compute_functionals,
)
from scenetruth.errors import Problem, RecordingError
from scenetruth.schema import COMPONENTS, check_dataset, check_same_run, compute_pixel_grid, read_intrinsics

__all__ = ["bound_maps", "cramer_rao_bound"]


_NEEDED = ("depth", "velocity", "normal", "mixed")


def setting_problems(
    words: Mapping[str, str], noise_std: float | None, window_sigma_px: float, step_px: int
) -> list[Problem]:
    """Return what is wrong with the settings of `cramer_rao_bound`."""
    choices = {"surface": Surface, "motion": Motion, "window": Window, "brightness": Brightness}
    problems = [
        Problem(name, f"must be one of {', '.join(get_args(choices[name]))}", word)
        for name, word in words.items()
        if word not in get_args(choices[name])
    ]
    for name, value in (("noise_std", noise_std), ("window_sigma_px", window_sigma_px)):
        if value is not None and not (isinstance(value, int | float | np.number) and 0 < value < np.inf):
            problems.append(Problem(name, "must be a positive number", value))
    if not isinstance(step_px, int | np.integer) or step_px < 1:
        problems.append(Problem("step_px", "must be a whole number of at least 1", step_px))
    return problems


def data_problems(truth: xr.Dataset, recording: xr.Dataset, brightness: Brightness) -> list[Problem]:
    """Return what keeps the bound from being computed from a checked truth and recording."""
    problems = [
        Problem(f"truth.{name}", "is missing: the bound is that of a known surface and motion")
        for name in _NEEDED
        if name not in truth
    ]
    places = {"truth.t": truth["t"], "recording.t": recording["t"], "recording.s": recording["s"]}
    problems += [
        Problem(name, "must hold 0, the reference", index.values.tolist())
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
            Problem(f"truth.visible.{dim}", "does not tell of all images of the recording", missing)
            for dim, missing in untold.items()
            if missing
        ]
    if recording.sizes["s"] * recording.sizes.get("s_y", 1) < 2:
        problems.append(Problem("recording.s", "has one camera, which sees no depth", recording["s"].values.tolist()))
    if not all(np.array_equal(truth[dim].values, recording[dim].values) for dim in ("y", "x")):
        problems.append(Problem("recording", "must have the pixels of the truth: select the same of both"))
    elif compute_pixel_grid(recording).step_px != 1.0:
        problems.append(Problem("recording.x", "must be neighbouring pixels: gradients are those of the images"))
    if "distortion" in recording.attrs:
        problems.append(Problem("recording", "is of a lens with distortion; the bound is that of a pinhole camera"))
    if brightness == "per_image" and recording.sizes.get("channel", 1) > 1:
        problems.append(Problem("brightness", "per_image is for grey images, and these have colours"))
    return problems


Map = NDArray[np.float64]

# Windows that are solved at a time: their matrices stay in a processor's cache.
_WINDOWS_PER_BATCH = 4096
_STATED = "least standard deviation of {} that the images' noise allows"
_OUTPUTS: dict[str, tuple[str | None, str, str]] = {
    "disparity": (None, "px/step", "disparity"),
    "depth": (None, "mm", "depth"),
    "slope": ("slope_component", "1", "the slopes"),
    "flow": ("image_component", "px/frame", "optical flow"),
    "velocity": ("component", "mm/frame", "velocity"),
    "growth_rate": (None, "1/frame", "the growth rate"),
    "principal_growth_rates": ("principal", "1/frame", "the growth of length"),
}


def cramer_rao_bound(
    truth: xr.Dataset,
    recording: xr.Dataset,
    *,
    noise_std: float | None = None,
    window_sigma_px: float = 6.0,
    window: Window = "gaussian",
    surface: Surface = "plane",
    motion: Motion = "rigid",
    brightness: Brightness = "fixed",
    step_px: int = 1,
) -> xr.Dataset:
    """Compute how precisely depth and motion can be known from all images, at every pixel of the reference.

    In a window around a pixel, the surface is a plane whose points move steadily with a velocity gradient; the texture
    is unknown at every pixel, noise is white and Gaussian. Let a be the derivatives of what the images show by all that
    is unknown, ā their mean over the images that show a pixel's point, H = Σ w Σ_i (a_i - ā)(a_i - ā)ᵀ / σ², and S that
    with w². A least squares fit with the weights w has the covariance H⁻¹ S H⁻¹, and no estimator that weighs the
    window's pixels so can do better. With even weights that is H⁻¹, the Cramér-Rao bound: no unbiased estimator at all
    does better from the window's pixels. A Gaussian window does not use its outer pixels to the full; its bound is
    that of methods with such a window.

    Parameters
    ----------
    truth
        The truth of the recording with ``depth``, ``velocity``, ``normal`` and ``mixed``: where the surface is and how
        it moves. ``object_id`` keeps windows to one object, ``visible`` tells which images show a point.
    recording
        The images, from which the texture's gradients come. If it has ``radiance``, or a sensor without noise, that of
        the reference's image: derivatives of quintic splines, 0.03 % too small for waves of 6 px, 0.5 % for 4 px. Of
        noisy images, gradients would be too large; their squares are products of two means of up to four images each,
        warped to the reference, whose noises are independent. That has no bias, but scatters where texture is weak.
    noise_std
        Standard deviation of the images' noise, in grey values of the recording. If not given, that of the sensor that
        made it: of ``emva1288``, it depends on the grey value, and pixels count by the inverse of their variance.
    window_sigma_px
        Standard deviation of the window, in px.
    window
        ``"gaussian"``, cut off at two standard deviations as those of the methods are, or ``"even"``: a square that is
        as wide as gives this standard deviation.
    surface
        ``"plane"``: the slopes are unknown too; ``"constant"``: they are known.
    motion
        What is unknown of the velocity gradient: nothing (``"translation"``), a rotation (``"rigid"``), a rotation and
        isotropic growth (``"growing"``), or all (``"affine"``).
    brightness
        ``"per_image"``: every image has an unknown gain and offset in a window, as far as depth and motion can be
        confused with them; grey images only.
    step_px
        The bound is computed in every n-th row and column.

    Returns
    -------
    xarray.Dataset
        At t = 0, dimensions (t, y, x): ``disparity_std`` in px per step, ``depth_std`` in mm, ``flow_std`` in px per
        frame, ``velocity_std`` in mm per frame, ``slope_std``, ``growth_rate_std`` and, of affine motion,
        ``principal_growth_rates_std`` per frame, as far as the model and the images have them, and ``image_count``, how
        many images show the pixel's point. NaN where there is no surface, at silhouettes and sharp edges, and where the
        images do not tell all that is unknown.

    Raises
    ------
    RecordingError
        If the data sets are not what is needed, or a setting is impossible; lists all that is wrong.
    MismatchError
        If truth and recording say that they are of different scenes.

    See Also
    --------
    closed_form_bound : The same for a flat surface, from a few numbers.

    Notes
    -----
    Slopes and the velocity gradient are known to the first order: that an error of the slopes changes how a rotation
    moves the surface is left out, but for growth with affine motion, where the variance of products of both is added;
    without it, the bound is far under what any method reaches. Real camera positions are taken to be the planned ones.

    Examples
    --------
    A wall 100 mm away, images of three positions and three frames, with noise of 1 % of full scale:

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

    With twice the noise, all is known half as precisely:

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
    model = WindowUnknowns(surface, motion, moving=recording.sizes["t"] > 1, brightness=ways)
    maps = scene.bound(model, window_weights(window, window_sigma_px), step_px)
    more = {"window_sigma_px": float(window_sigma_px), **settings, "noise_std": scene.noise_std()}
    return _labelled(maps, scene, model, step_px, more)


def bound_maps(
    truth: xr.Dataset,
    recording: xr.Dataset,
    noise: GreyNoise,
    model: WindowUnknowns,
    window_sigma_px: float,
    step_px: int = 1,
) -> dict[str, Map]:
    """Return the bound of any model with any noise; see `cramer_rao_bound`, which checks what it is given.

    Returns: Maps as of `compute_functionals`, each of shape (y, x).
    """
    return _Scene(truth, recording, noise).bound(model, window_weights("gaussian", window_sigma_px), step_px)


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
        """Return the noise as pixels weigh it, in grey values of the recording; NaN if there are none."""
        weights = np.concatenate([layer.weight[layer.weight > 0] for layer in self.layers])
        return float(1.0 / np.sqrt(weights.mean())) if weights.size else float("nan")

    def bound(self, model: WindowUnknowns, weights: Map, step_px: int) -> dict[str, Map]:
        """Return the maps of the least standard deviations, each of shape (..., y, x)."""
        products = compute_pixel_information(self.points, self.views, self.shown, self.layers, model)
        shape = self.pieces.shape
        found: dict[str, Map] = {}
        for part in compute_window_sums(products, self.pieces, weights, model, step_px):
            for first in range(0, len(part.rows), _WINDOWS_PER_BATCH):
                some = slice(first, first + _WINDOWS_PER_BATCH)
                at = part.rows[some], part.columns[some]
                points = self.points.at(at)
                columns = compute_columns(model, points)
                normal, scatter = (
                    normal_matrix({key: values[some] for key, values in each.items()}, columns, model)
                    for each in (part.sums, part.squares)
                )
                told = compute_functionals(points, self.intrinsics, model)
                std = np.sqrt(compute_variances(normal, scatter, columns, list(told.values())))
                for name, values in add_error_products(dict(zip(told, std, strict=True))).items():
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
    told = {"units": "1", "long_name": "number of images that show the surface point of the pixel"}
    dataset["image_count"] = (pixels, shown, told)
    kept = ("scene_hash", "recording_hash")
    hashes = {name: scene.recording.attrs[name] for name in kept if name in scene.recording.attrs}
    dataset.attrs = {"scenetruth": "bound", **scene.intrinsics.to_attrs(), **hashes, **attrs}
    return dataset
