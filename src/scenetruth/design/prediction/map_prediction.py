"""Prediction as maps, in seconds: Cramér-Rao bound from one rendered image and the ground truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.bound.unknowns import MotionChoice
from scenetruth.design.prediction.method_models import MethodSetup, all_method_models, prepare_method
from scenetruth.design.prediction.prediction_result import Prediction
from scenetruth.design.prediction.reference_render import ReferenceRender, render_reference
from scenetruth.design.prediction.region_statistics import NAMES, compute_quantities, compute_values, select_regions
from scenetruth.scene import Scene
from scenetruth.schema import COMPONENTS

__all__ = ["predict_maps"]

Array = NDArray[np.float64]

_NO_INFORMATION_PX = 1e3
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
    scene: Scene, method: str, window_sigma_px: float | None, motion: MotionChoice | None, envelope: Prediction
) -> Prediction:
    """Predict the precision of a scene from a noise-free image; see `predict`."""
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
    )


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
