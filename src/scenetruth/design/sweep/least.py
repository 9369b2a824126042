"""The Cramér-Rao bound of a point, from its ideal images: what no method can go below."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast, get_args

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.bound.model import Brightness, Motion, Surface
from scenetruth.comparison.contestants import Contestant
from scenetruth.errors import RecordingError
from scenetruth.estimators import find_method, validate_settings
from scenetruth.schema import intrinsics_of
from scenetruth.scoring import QUANTITIES
from scenetruth.scoring.reading import percent_per_hour

__all__ = ["BOUND", "Window", "bound_names", "least_std", "sizes_of_normal", "window_of"]

BOUND = "bound"
"""Stands for a method where figures are the bound."""
_SIGMA_PX = 6.0
"""Window where a method has none: that of the others by default."""

Map = NDArray[np.float64]


@dataclass(frozen=True)
class Window:
    """What a bound is of: the window of a method, and what it does not know in it.

    Parameters
    ----------
    sigma_px
        Standard deviation of the Gaussian window, in px.
    surface, motion, brightness
        As of `scenetruth.bound.cramer_rao`.
    """

    sigma_px: float
    surface: Surface
    motion: Motion
    brightness: Brightness


def window_of(contestant: Contestant) -> Window:
    """Return the window of a method, and what it does not know there, as its settings tell.

    What settings leave to the images (``auto``) is unknown: slopes, rotation and growth. A method that has no such
    settings may take slopes, the velocity gradient and brightness for known: so that no method goes below its bound.
    """
    settings = validate_settings(find_method(contestant.method), contestant.settings)
    sigma = getattr(settings, "window_sigma_px", None)
    return Window(
        float(sigma) if isinstance(sigma, int | float) else _SIGMA_PX,
        cast(Surface, _told(settings, "surface", get_args(Surface), "constant", "plane")),
        cast(Motion, _told(settings, "motion", get_args(Motion), "translation", "growing")),
        "per_image" if getattr(settings, "brightness", None) == "per_image" else "fixed",
    )


def _told(settings: Any, name: str, words: Sequence[str], without: str, otherwise: str) -> str:
    """Return a setting that is one of some words, or what stands for it: without it, or where it is another word."""
    told = getattr(settings, name, None)
    return without if told is None else told if told in words else otherwise


def bound_names(contestants: Sequence[Contestant]) -> dict[str, str]:
    """Return what the bounds of methods are called, by label."""
    if len(contestants) == 1:
        return {contestants[0].label: BOUND}
    return {one.label: f"{BOUND} of {one.label}" for one in contestants}


def least_std(truth: xr.Dataset, recording: xr.Dataset, window: Window, step_px: int) -> tuple[dict[str, Map], str]:
    """Return the least standard deviations that noise allows, at the reference frame.

    Parameters
    ----------
    truth, recording
        Of the point; the recording has ``ideal``.
    window
        What the bound is of.
    step_px
        It is told in every so many rows and columns.

    Returns
    -------
    tuple
        Maps by quantity, shape (y, x), in its units, NaN where there is no bound; and why there are none, or an empty
        text.
    """
    from scenetruth.bound import cramer_rao

    grey = recording.sizes.get("channel", 1) == 1
    try:
        bound = cramer_rao(
            truth,
            recording,
            window_sigma_px=window.sigma_px,
            surface=window.surface,
            motion=window.motion,
            brightness=window.brightness if grey else "fixed",
            every_px=step_px,
        ).sel(t=0)
    except RecordingError as error:
        return {}, "; ".join(map(str, error.problems))
    found = {}
    for quantity, entry in QUANTITIES.items():
        name = f"{entry.variable}_std"
        if entry.error == "difference" and name in bound:
            values = bound[name].values if entry.component is None else bound[name].values[entry.component]
            found[quantity] = values * (percent_per_hour(intrinsics_of(recording)) if entry.units == "%/h" else 1.0)
    return found, ""


def sizes_of_normal(std: Map) -> dict[str, float]:
    """Return how large errors are that are normal with these standard deviations: ``rms`` and ``median``.

    Parameters
    ----------
    std
        Standard deviations, any shape; those that are not finite and positive do not count.

    Returns
    -------
    dict
        Root of the mean square, and median of the absolute value; empty without any standard deviation.

    Examples
    --------
    >>> {name: round(size, 4) for name, size in sizes_of_normal(np.array([1.0, 1.0, np.nan])).items()}
    {'rms': 1.0, 'median': 0.6745}
    """
    kept = std[np.isfinite(std) & (std > 0)]
    return {"rms": float(np.sqrt(np.mean(np.square(kept)))), "median": _median_of(kept)} if kept.size else {}


def _median_of(std: Map) -> float:
    """Return the median of the absolute values of normal errors with these standard deviations."""
    from scipy.optimize import brentq
    from scipy.special import erf, erfinv

    factor = math.sqrt(2) * float(erfinv(0.5))
    low, high = factor * float(std.min()), factor * float(std.max())
    if high <= low * (1 + 1e-12):
        return low
    return float(brentq(lambda size: float(np.mean(erf(size / (math.sqrt(2) * std)))) - 0.5, low, high, rtol=1e-9))
