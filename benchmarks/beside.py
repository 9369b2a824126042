"""The two methods that are compared, and what one makes of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.method_settings import StructureTensorSettings
from scenetruth.scoring.regions import further_regions, main_regions, visible_throughout
from scenetruth.settings import ScoreSettings

__all__ = ["METHODS", "SCENES", "beyond", "estimated", "scene_of"]

SCENES = Path(__file__).parents[1] / "scenes"
METHODS = ("structure_tensor", "refined")
# Errors of more than so many stated standard deviations are none that an error bar should let happen.
_FAR = 6.0


def scene_of(name: str, changes: Sequence[str]) -> st.Scene:
    """Return a scene of the library with changes."""
    return st.load_scene(SCENES / f"{name}.yaml", overrides=list(changes))


def estimated(recording: xr.Dataset, method: str, scene: st.Scene) -> xr.Dataset:
    """Return what a method makes of a scene, with the scene's settings where they are of this method.

    Parameters
    ----------
    recording
        Images of the scene.
    method
        One of `METHODS`.
    scene
        The scene.
    """
    settings = scene.estimate or StructureTensorSettings()
    chosen: dict[str, Any] = settings.model_dump() if settings.method == method else {"method": method}
    return st.estimate(recording, **chosen)


def beyond(found: xr.Dataset, truth: xr.Dataset) -> dict[str, tuple[float, float]]:
    """Return, by region of the score, the shares in % of known pixels whose depth and velocity are far off.

    Parameters
    ----------
    found
        Estimate with standard deviations.
    truth
        The whole truth of the reference camera.
    """
    throughout, exact = visible_throughout(truth), truth.sel(t=found["t"].values)
    masks = main_regions(exact, ScoreSettings().interior_margin_px)
    masks |= further_regions(exact, masks["interior"], ScoreSettings(), throughout=throughout)
    known = found["status"].values == 2
    with np.errstate(invalid="ignore"):
        depth = _far(found, exact, "depth")
        speed = _far(found, exact, "velocity").any(axis=0)
    return {
        name: (100 * float(depth[mask & known].mean()), 100 * float(speed[mask & known].mean()))
        for name, mask in masks.items()
        if (mask & known).any()
    }


def _far(found: xr.Dataset, truth: xr.Dataset, name: str) -> NDArray[np.bool_]:
    off = np.abs(found[name].values - truth[name].transpose(*found[name].dims).values)
    return np.asarray(off > _FAR * found[f"{name}_std"].values)
