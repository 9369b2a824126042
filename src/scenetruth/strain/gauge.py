"""Settings of strain windows, and the length over which they measure: the virtual strain gauge."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import Field, ValidationError, field_validator

from scenetruth.errors import Problem, ScoreError
from scenetruth.validated_model import FrozenModel, NonNegative
from scenetruth.validation_problems import list_problems

__all__ = ["MEASURES", "StrainGauge", "StrainMeasure", "StrainSettings", "strain_settings"]

StrainMeasure = Literal["green_lagrange", "hencky", "engineering", "rate"]
"""The tensor that is computed; ``rate`` is the rate of deformation, all others compare two configurations."""

MEASURES: Mapping[StrainMeasure, str] = {
    "green_lagrange": "Green-Lagrange strain, (C - 1) / 2",
    "hencky": "Hencky strain, ln(C) / 2",
    "engineering": "engineering strain, the symmetric part of the displacement gradient",
    "rate": "rate of deformation, the symmetric part of the velocity gradient",
}
"""Titles of the measures; C is the right Cauchy-Green tensor of the surface."""

_MAX_POINTS = 1001


class StrainSettings(FrozenModel):
    """Settings of a strain computation.

    See Also
    --------
    compute_strain, score_strain : Use them.

    Examples
    --------
    >>> StrainSettings(measure="hencky", window=15, step=3).window
    15
    """

    measure: StrainMeasure = "green_lagrange"
    """``green_lagrange``, ``hencky``, ``engineering`` (valid for small rotations only) or ``rate`` (per frame)."""
    window: Annotated[int, Field(ge=3, le=_MAX_POINTS)] = 11
    """Points along each side of the strain window; an odd number."""
    step: Annotated[int, Field(ge=1, le=_MAX_POINTS)] = 4
    """Distance between the points of the window, and of the result, in pixels of the maps."""
    order: Literal[1, 2] = 1
    """Order of the polynomial. Both orders have the same derivative in a complete window; they differ at borders."""
    weights: Literal["uniform", "gaussian"] = "uniform"
    """``gaussian``: weights decrease to ``edge_weight`` at the middle of the sides of the window."""
    edge_weight: Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)] = 0.1
    """Gaussian weight at the middle of the sides, relative to that of the centre."""
    subset_px: NonNegative | None = None
    """Size of the subset of the displacements, px; default: from the settings of the estimate, see `StrainGauge`."""
    correlation_sigma_px: NonNegative | None = None
    """Standard deviation σ of the Gaussian window with which the errors of the displacements are correlated,
    exp(-r²/4σ²), px; 0 for independent errors; default: ``window_sigma_px`` of the estimate's settings."""
    min_coverage: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Minimum share of the weights of a window on valid points of the same surface."""
    max_slope_deg: Annotated[float, Field(gt=0, lt=90)] = 80.0
    """Maximum slope of a continuous surface, degrees; larger depth steps separate two surfaces."""

    @field_validator("window")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            msg = "must be an odd number"
            raise ValueError(msg)
        return value

    def axis_weights(self) -> NDArray[np.float64]:
        """Return the weights along each axis, with the sum 1, shape (window,)."""
        offset = np.linspace(-1.0, 1.0, self.window)
        weights = np.ones(self.window) if self.weights == "uniform" else self.edge_weight ** (offset**2)
        return np.asarray(weights / weights.sum())

    @property
    def units(self) -> str:
        """Unit of the strain."""
        return "1/frame" if self.measure == "rate" else "1"


def strain_settings(settings: StrainSettings | Mapping[str, Any] | None) -> StrainSettings:
    """Return validated settings; a ScoreError lists every problem."""
    if isinstance(settings, StrainSettings):
        return settings
    if settings is not None and not isinstance(settings, Mapping):
        raise ScoreError([Problem("settings", "must be StrainSettings or a mapping of its fields", settings)])
    try:
        return StrainSettings(**(settings or {}))
    except ValidationError as error:
        raise ScoreError(list_problems(error, settings, model=StrainSettings), source="settings") from error


@dataclass(frozen=True)
class StrainGauge:
    """The virtual strain gauge: the size of the area of the image that affects one strain value.

    Its length is (window - 1) step + subset (International Digital Image Correlation Society, A Good Practices Guide
    for Digital Image Correlation, 2018, section 5.4).

    ``window``: Points along each side of the strain window.
    ``step_px``: Distance of the points in px of the full image.
    ``subset_px``: Size of the subset; 0 for a truth, NaN if unknown. A Gaussian window of the standard deviation σ
      counts as a subset of 2 √π σ, the square with the same noise.
    ``mm_per_px``: Median image scale at the valid points; NaN if there are none.
    """

    window: int
    step_px: float
    subset_px: float
    mm_per_px: float = math.nan

    @property
    def length_px(self) -> float:
        """Length in px of the full image; without the subset if its size is unknown."""
        subset = 0.0 if math.isnan(self.subset_px) else self.subset_px
        return (self.window - 1) * self.step_px + subset

    @property
    def length_mm(self) -> float:
        """Length on a frontal surface in mm."""
        return self.length_px * self.mm_per_px

    def to_attrs(self) -> dict[str, float]:
        """Return the gauge as attributes of a data set; unknown values are omitted."""
        found = {
            "step_px": self.step_px,
            "subset_px": self.subset_px,
            "gauge_length_px": self.length_px,
            "mm_per_px": self.mm_per_px,
            "gauge_length_mm": self.length_mm,
        }
        return {name: float(value) for name, value in found.items() if math.isfinite(value)}


def read_subset_px(dataset: xr.Dataset) -> float:
    """Return the size of the subset that an estimate states, px; 0 for a truth, NaN if unknown."""
    if "mixed" in dataset:
        return 0.0
    settings = read_method_settings(dataset)
    sigma = _length(settings, "window_sigma_px")
    if math.isfinite(sigma):
        return 2 * math.sqrt(math.pi) * sigma
    return next((size for name in _SUBSETS if math.isfinite(size := _length(settings, name))), math.nan)


_SUBSETS = ("subset_px", "subset_size_px", "block_size_px", "window_px", "window_size_px")


def read_correlation_px(dataset: xr.Dataset) -> float:
    """Return the standard deviation of the Gaussian window of an estimate, px; NaN if unknown."""
    return _length(read_method_settings(dataset), "window_sigma_px")


def read_method_settings(dataset: xr.Dataset) -> dict[str, Any]:
    """Return the settings of the method of an estimate; empty if they are not stated."""
    try:
        found = json.loads(dataset.attrs.get("settings", "{}"))
    except (TypeError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _length(settings: Mapping[str, Any], name: str) -> float:
    """Return a positive length from settings; NaN if there is none."""
    value = settings.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value <= 0:
        return math.nan
    return float(value)
