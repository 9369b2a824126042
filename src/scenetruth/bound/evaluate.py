"""The Cramér-Rao bound of depth and motion at every pixel of a scene whose truth is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.bound.checking import data_problems, setting_problems
from scenetruth.bound.functionals import functionals_of, with_products
from scenetruth.bound.geometry import points_of, views_of
from scenetruth.bound.model import Brightness, Model, Motion, Surface, columns_of
from scenetruth.bound.noise import GreyNoise, noise_of
from scenetruth.bound.pieces import inside_of, pieces_of
from scenetruth.bound.products import brightness_of, products_of
from scenetruth.bound.solving import normal_matrix, variances_of
from scenetruth.bound.texture import layers_of, visible_in
from scenetruth.bound.windows import Window, parts_of, window_weights
from scenetruth.errors import RecordingError
from scenetruth.schema import COMPONENTS, check_dataset, check_same_run, intrinsics_of

__all__ = ["bound_maps", "cramer_rao"]

Map = NDArray[np.float64]

# Windows that are solved at a time: their matrices stay in a processor's cache.
_AT_A_TIME = 4096
_STATED = "least standard deviation of {} that the images' noise allows"
_TOLD: dict[str, tuple[str | None, str, str]] = {
    "disparity": (None, "px/step", "disparity"),
    "depth": (None, "mm", "depth"),
    "slope": ("slope_component", "1", "the slopes"),
    "flow": ("image_component", "px/frame", "optical flow"),
    "velocity": ("component", "mm/frame", "velocity"),
    "growth_rate": (None, "1/frame", "the growth rate"),
    "growth_principal": ("principal", "1/frame", "the growth of length"),
}


def cramer_rao(
    truth: xr.Dataset,
    recording: xr.Dataset,
    *,
    noise_std: float | None = None,
    window_sigma_px: float = 6.0,
    window: Window = "gaussian",
    surface: Surface = "plane",
    motion: Motion = "rigid",
    brightness: Brightness = "fixed",
    every_px: int = 1,
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
        The images, from which the texture's gradients come. If it has ``ideal``, or a sensor without noise, that of the
        reference's image: derivatives of quintic splines, 0.03 % too small for waves of 6 px, 0.5 % for 4 px. Of noisy
        images, gradients would be too large; their squares are products of two means of up to four images each, warped
        to the reference, whose noises are independent. That has no bias, but scatters where texture is weak.
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
    every_px
        The bound is computed in every n-th row and column.

    Returns
    -------
    xarray.Dataset
        At t = 0, dimensions (t, y, x): ``disparity_std`` in px per step, ``depth_std`` in mm, ``flow_std`` in px per
        frame, ``velocity_std`` in mm per frame, ``slope_std``, ``growth_rate_std`` and, of affine motion,
        ``growth_principal_std`` per frame, as far as the model and the images have them, and ``images_used``, how many
        images show the pixel's point. NaN where there is no surface, at silhouettes and sharp edges, and where the
        images do not tell all that is unknown.

    Raises
    ------
    RecordingError
        If the data sets are not what is needed, or a setting is impossible; lists all that is wrong.
    MismatchError
        If truth and recording say that they are of different scenes.

    See Also
    --------
    envelope_of : The same for a flat surface, from a few numbers.

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
    >>> recording, truth = st.simulate(st.scene_from_plain(plain))
    >>> bound = cramer_rao(truth, recording, noise_std=0.01)
    >>> at = bound.sel(t=0).isel(y=25, x=30)
    >>> at.depth_std.round(2).item(), at.velocity_std.values.round(3).tolist(), at.images_used.item()
    (0.07, [0.004, 0.004, 0.019], 9.0)

    With twice the noise, all is known half as precisely:

    >>> twice = cramer_rao(truth, recording, noise_std=0.02)
    >>> (twice.depth_std / bound.depth_std).median().round(6).item()
    2.0
    """
    settings = {"surface": surface, "motion": motion, "window": window, "brightness": brightness}
    problems = setting_problems(settings, noise_std, window_sigma_px, every_px)
    if problems:
        raise RecordingError(problems, source="the Cramér-Rao bound")
    check_dataset(truth, "truth")
    check_dataset(recording, "recording")
    check_same_run({"recording": recording.attrs, "truth": truth.attrs})
    problems = data_problems(truth, recording, brightness)
    noise = GreyNoise(np.nan) if problems else noise_of(recording, noise_std, problems)
    if problems:
        raise RecordingError(problems, source="the Cramér-Rao bound")
    scene = _Scene(truth, recording, noise)
    ways = 2 * len(brightness_of(scene.views)) if brightness == "per_image" else 0
    model = Model(surface, motion, moving=recording.sizes["t"] > 1, brightness=ways)
    maps = scene.bound(model, window_weights(window, window_sigma_px), every_px)
    more = {"window_sigma_px": float(window_sigma_px), **settings, "noise_std": scene.noise_std()}
    return _labelled(maps, scene, model, every_px, more)


def bound_maps(
    truth: xr.Dataset, recording: xr.Dataset, noise: GreyNoise, model: Model, window_sigma_px: float, every_px: int = 1
) -> dict[str, Map]:
    """Return the bound of any model with any noise; see `cramer_rao`, which checks what it is given.

    Parameters
    ----------
    truth, recording
        Checked data sets.
    noise
        Of the images, in grey values of the recording.
    model
        What is unknown in a window.
    window_sigma_px, every_px
        As of `cramer_rao`; the window is Gaussian.

    Returns
    -------
    dict
        Maps as of `functionals_of`, each of shape (y, x).
    """
    return _Scene(truth, recording, noise).bound(model, window_weights("gaussian", window_sigma_px), every_px)


class _Scene:
    """A scene at the reference camera and frame."""

    def __init__(self, truth: xr.Dataset, recording: xr.Dataset, noise: GreyNoise) -> None:
        self.recording, self.noise = recording, noise
        self.intrinsics = intrinsics_of(recording)
        reference = {dim: 0 for dim in ("s_y", "s", "t") if dim in truth["depth"].dims}
        self.truth = truth.drop_vars("visible", errors="ignore").sel(reference)
        self.pieces = pieces_of(self.truth)
        self.views = views_of(recording, self.intrinsics.baseline_mm)
        self.points = points_of(self.truth, self.intrinsics, self.pieces)
        shown = truth
        if "visible" in truth:
            # The truth may have more images than the recording.
            dims = [dim for dim in ("s_y", "s", "t") if dim in truth["visible"].dims and dim in recording["image"].dims]
            shown = xr.Dataset({"visible": truth["visible"].sel({dim: recording[dim].values for dim in dims})})
        self.shown = visible_in(shown, recording, self.views, self.points, self.pieces)
        usable = inside_of(self.pieces)
        self.layers = layers_of(recording, self.views, self.points, self.shown, usable, noise)

    def noise_std(self) -> float:
        """Return the noise as pixels weigh it, in grey values of the recording; NaN if there are none."""
        weights = np.concatenate([layer.weight[layer.weight > 0] for layer in self.layers])
        return float(1.0 / np.sqrt(weights.mean())) if weights.size else float("nan")

    def bound(self, model: Model, weights: Map, every_px: int) -> dict[str, Map]:
        """Return the maps of the least standard deviations, each of shape (..., y, x)."""
        products = products_of(self.points, self.views, self.shown, self.layers, model)
        shape = self.pieces.shape
        found: dict[str, Map] = {}
        for part in parts_of(products, self.pieces, weights, model, every_px):
            for first in range(0, len(part.rows), _AT_A_TIME):
                some = slice(first, first + _AT_A_TIME)
                at = part.rows[some], part.columns[some]
                points = self.points.at(at)
                columns = columns_of(model, points)
                normal, scatter = (
                    normal_matrix({key: values[some] for key, values in each.items()}, columns, model)
                    for each in (part.sums, part.squares)
                )
                told = functionals_of(points, self.intrinsics, model)
                std = np.sqrt(variances_of(normal, scatter, columns, list(told.values())))
                for name, values in with_products(dict(zip(told, std, strict=True))).items():
                    found.setdefault(name, np.full(shape, np.nan))[at] = values
        if not found:
            nothing = self.points.at((np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)))
            names = with_products({name: np.zeros(0) for name in functionals_of(nothing, self.intrinsics, model)})
            found = {name: np.full(shape, np.nan) for name in names}
        return {name: values[::every_px, ::every_px] for name, values in found.items()}


def _labelled(maps: dict[str, Map], scene: _Scene, model: Model, every_px: int, attrs: dict[str, Any]) -> xr.Dataset:
    """Return the maps with names, coordinates and units."""
    pixels = ("t", "y", "x")
    dataset = xr.Dataset(
        coords={
            "t": ("t", [0]),
            **{dim: (dim, scene.truth[dim].values[::every_px]) for dim in ("y", "x")},
        }
    )
    for name, (dim, units, what) in _TOLD.items():
        parts = [values for key, values in maps.items() if key.partition(".")[0] == name]
        if not parts:
            continue
        if dim is not None:
            dataset = dataset.assign_coords({dim: COMPONENTS[dim]})
        stacked = np.stack(parts)[:, None] if dim else parts[0][None]
        dims = (dim, *pixels) if dim else pixels
        dataset[f"{name}_std"] = (dims, stacked, {"units": units, "long_name": _STATED.format(what)})
    shown = scene.shown.sum(axis=0)[None, ::every_px, ::every_px].astype(np.float32)
    told = {"units": "1", "long_name": "number of images that show the surface point of the pixel"}
    dataset["images_used"] = (pixels, shown, told)
    kept = ("scene_hash", "recording_hash")
    hashes = {name: scene.recording.attrs[name] for name in kept if name in scene.recording.attrs}
    dataset.attrs = {"scenetruth": "bound", **scene.intrinsics.to_attrs(), **hashes, **attrs}
    return dataset
