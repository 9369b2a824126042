"""What keeps a bound from being computed: impossible settings, and data sets that do not tell enough."""

from __future__ import annotations

from collections.abc import Mapping
from typing import get_args

import numpy as np
import xarray as xr

from scenetruth.bound.model import Brightness, Motion, Surface
from scenetruth.bound.windows import Window
from scenetruth.errors import Problem
from scenetruth.schema import pixel_grid_of

__all__ = ["data_problems", "setting_problems"]

_NEEDED = ("depth", "velocity", "normal", "mixed")


def setting_problems(
    words: Mapping[str, str], noise_std: float | None, window_sigma_px: float, every_px: int
) -> list[Problem]:
    """Return what is wrong with the settings of `cramer_rao`.

    Parameters
    ----------
    words
        Its settings that are one of some words, by name.
    noise_std, window_sigma_px, every_px
        The others.
    """
    choices = {"surface": Surface, "motion": Motion, "window": Window, "brightness": Brightness}
    problems = [
        Problem(name, f"must be one of {', '.join(get_args(choices[name]))}", word)
        for name, word in words.items()
        if word not in get_args(choices[name])
    ]
    for name, value in (("noise_std", noise_std), ("window_sigma_px", window_sigma_px)):
        if value is not None and not (isinstance(value, int | float | np.number) and 0 < value < np.inf):
            problems.append(Problem(name, "must be a positive number", value))
    if not isinstance(every_px, int | np.integer) or every_px < 1:
        problems.append(Problem("every_px", "must be a whole number of at least 1", every_px))
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
    elif pixel_grid_of(recording).step_px != 1.0:
        problems.append(Problem("recording.x", "must be neighbouring pixels: gradients are those of the images"))
    if "distortion" in recording.attrs:
        problems.append(Problem("recording", "is of a lens with distortion; the bound is that of a pinhole camera"))
    if brightness == "per_image" and recording.sizes.get("channel", 1) > 1:
        problems.append(Problem("brightness", "per_image is for grey images, and these have colours"))
    return problems
