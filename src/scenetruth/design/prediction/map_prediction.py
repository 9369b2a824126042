"""Prediction as maps, in seconds: Cramér-Rao bound from one rendered image and the ground truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.bound.unknowns import MotionChoice
from scenetruth.design.prediction.analytic_prediction import AS_MATT, NO_SHADOWS, PointErrors
from scenetruth.design.prediction.method_models import MethodSetup, all_method_models, prepare_method
from scenetruth.design.prediction.prediction_result import Prediction
from scenetruth.design.prediction.reference_render import ReferenceRender, render_reference
from scenetruth.design.prediction.region_statistics import NAMES, compute_quantities, compute_values, select_regions
from scenetruth.scene import Scene
from scenetruth.schema import COMPONENTS

__all__ = ["predict_maps"]

Array = NDArray[np.float64]

_NO_INFORMATION_PX = 1e3
_NEAR_POINTS = 4  # points of which the variances by highlights at a pixel are a mean
_DIMS = {
    "slope": "slope_component",
    "flow": "image_component",
    "velocity": "component",
    "principal_growth_rates": "principal",
}
_UNITS = {
    "disparity": "px/step",
    "depth": "mm",
    "slope": "1",
    "flow": "px/frame",
    "velocity": "mm/frame",
    "growth_rate": "1/frame",
    "principal_growth_rates": "1/frame",
}


def predict_maps(
    scene: Scene,
    method: str,
    window_sigma_px: float | None,
    motion: MotionChoice | None,
    envelope: Prediction,
    highlights: PointErrors | None = None,
) -> Prediction:
    """Predict the precision of a scene from a noise-free image; see `predict`.

    ``highlights``: Variances by highlights at points, which are added.
    """
    setup = prepare_method(scene, method, window_sigma_px, motion)
    frames = setup.scene.frames.model_copy(update={"count": len(np.unique(setup.views.t))})
    # With a rolling shutter, rows would have to be rendered separately.
    shutter = setup.scene.shutter.model_copy(update={"readout_time_s": 0.0})
    setup = replace(setup, scene=setup.scene.model_copy(update={"frames": frames, "shutter": shutter}))
    made = render_reference(setup.scene, complete=setup.motion == "affine")
    with np.errstate(all="ignore"):
        std = all_method_models()[method].from_images(setup, made)
    std = _without_rounding(std)
    truth = made.truth.sel(t=0)
    body = np.where(np.isfinite(truth["depth"].values), truth["object_id"].values, -1).astype(np.int64)
    if highlights is not None:
        std = _with_highlights(std, highlights, made.names, body, scene.camera.principal_point)
    interior = truth["boundary_distance"].values >= scene.score.interior_margin_px
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = -truth["normal"].values[:2] / truth["normal"].values[2]
    regions = select_regions(made.names, body, interior)
    named = {
        quantity: values * envelope.pattern_cost.get(quantity, 1.0)
        for quantity, values in compute_quantities(std, slopes).items()
    }
    figures = compute_values(named, _signals(truth, setup), regions, np.ones(body.shape), envelope.frame_interval_s)
    causes = {region: envelope.by_region.get(region, envelope.causes) for region in regions}
    return replace(
        envelope,
        model="maps",
        regions=tuple(regions),
        precisions=figures,
        by_region=causes,
        maps=_maps(std, truth, envelope, made),
        notes=tuple(_notes_of_images(envelope.notes)),
    )


def _notes_of_images(notes: Sequence[str]) -> Iterator[str]:
    """Yield the effects that a rendered image and its truth do not include either."""
    for note in notes:
        if note == NO_SHADOWS:
            yield "errors by shadows that move over surfaces are not included"
        elif not note.startswith(AS_MATT):
            yield note


def _with_highlights(
    std: dict[str, Array],
    highlights: PointErrors,
    names: Sequence[str],
    body: NDArray[np.int64],
    centre: tuple[float, float],
) -> dict[str, Array]:
    """Return maps with the variances by highlights of the nearest points on the same object."""
    from scipy.spatial import cKDTree

    found = {name: values**2 for name, values in std.items()}
    for number, name in enumerate(highlights.names):
        rows, columns = np.nonzero(body == list(names).index(name))
        own = np.flatnonzero(highlights.body == number)
        if not len(own) or not len(rows):
            continue
        points = np.column_stack([highlights.x[own] + centre[0], highlights.y[own] + centre[1]])
        distance, near = cKDTree(points).query(np.column_stack([columns, rows]), k=min(_NEAR_POINTS, len(own)))
        distance, near = distance.reshape(len(rows), -1), near.reshape(len(rows), -1)
        for quantity, values in found.items():
            given = highlights.variances.get(quantity)
            if given is None:
                continue
            variance = given[own][near]
            weights = np.where(np.isfinite(variance), 1.0 / np.maximum(distance, 1.0), 0.0)
            total = np.maximum(weights.sum(axis=1), 1e-300)
            values[rows, columns] += (weights * np.nan_to_num(variance, posinf=0.0)).sum(axis=1) / total
    return {name: np.sqrt(values) for name, values in found.items()}


def _without_rounding(std: dict[str, Array]) -> dict[str, Array]:
    """Return maps without pixels whose only information is rounding: positions uncertain by many pixels."""
    for name in ("disparity", "flow.0"):
        if name in std:
            unknown = std[name] > _NO_INFORMATION_PX
            return {each: np.where(unknown, np.nan, values) for each, values in std.items()}
    return std


def _signals(truth: xr.Dataset, setup: MethodSetup) -> dict[str, Array]:
    if not setup.sees_motion:
        return {}
    found = {f"flow_{axis}": truth["flow"].values[k] for k, axis in enumerate("xy")}
    found |= {f"velocity_{axis}": truth["velocity"].values[k] for k, axis in enumerate("xyz")}
    found["velocity_epe"] = np.linalg.norm(truth["velocity"].values, axis=0)
    if "principal_growth_rates" in truth:
        rates = truth["principal_growth_rates"].values
        found |= dict(zip(("growth_principal_1", "growth_principal_2"), rates, strict=True))
    return {**found, "growth_rate": truth["growth_rate"].values}


def _maps(std: dict[str, Array], truth: xr.Dataset, envelope: Prediction, made: ReferenceRender) -> xr.Dataset:
    """Return the maps with names, coordinates and units."""
    found = xr.Dataset(coords={dim: (dim, truth[dim].values) for dim in ("y", "x")})
    for name, unit in _UNITS.items():
        parts = {key: values for key, values in std.items() if key.partition(".")[0] == name}
        if not parts:
            continue
        attrs = {"units": unit, "long_name": f"predicted standard deviation of {name.replace('_', ' ')}"}
        if name in _DIMS:
            dim = _DIMS[name]
            found = found.assign_coords({dim: list(COMPONENTS[dim])})
            stacked = np.stack([envelope.pattern_cost.get(NAMES[key], 1.0) * values for key, values in parts.items()])
            found[f"{name}_std"] = ((dim, "y", "x"), stacked, attrs)
        else:
            found[f"{name}_std"] = (("y", "x"), parts[name] * envelope.pattern_cost.get(name, 1.0), attrs)
    noise = np.hypot(made.noise_map, made.pattern_map)
    attrs = {"units": "1", "long_name": "noise of a grey value, relative to full scale"}
    found["noise_std"] = (("y", "x"), noise, attrs)
    return found
