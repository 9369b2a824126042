"""The base class of all cases, and their records."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any, ClassVar, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.discovery import classes_in
from scenetruth.errors import ArgumentError, Problem

__all__ = [
    "ALL",
    "BOUND",
    "COMMON_VALID",
    "METHOD_VALID",
    "NOISE_STD",
    "SUITES",
    "BenchmarkRecord",
    "Case",
    "CaseEstimates",
    "Mask",
    "all_cases",
    "mask_interior",
    "select_cases",
]


METHOD_VALID = "method_valid"
"""Valid pixels of the method."""
COMMON_VALID = "common_valid"
"""Pixels that are valid for all methods of the comparison."""
ALL = "all"
"""All pixels of the region, including invalid pixels."""
BOUND = "bound"
"""Method label of records that hold the Cramér-Rao bound."""


@dataclass(frozen=True)
class BenchmarkRecord:
    """One value of a statistic, in ``unit``; NaN where undefined.

    ``level``: Level of the factor, in the unit of the case. ``method``: Label of the method, or `BOUND`.
    ``quantity``: A key of `scenetruth.scoring.QUANTITIES`; empty for time and memory.
    ``pixels``: The pixel set: `METHOD_VALID`, `COMMON_VALID` or `ALL`.
    ``ci_low``, ``ci_high``: Its 95 % confidence interval; NaN if not computed.
    ``threshold``: Abscissa of a curve: fraction of the most certain pixels, or number of standard deviations.
    """

    case: str
    level: float
    method: str
    quantity: str
    pixels: str
    statistic: str
    value: float
    ci_low: float = math.nan
    ci_high: float = math.nan
    threshold: float = math.nan
    unit: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON values, with None for NaN."""
        return {
            key: None if isinstance(value, float) and not math.isfinite(value) else value
            for key, value in asdict(self).items()
        }

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> BenchmarkRecord:
        """Return a record from the output of `to_dict`."""
        given: dict[str, Any] = {key: math.nan if value is None else value for key, value in plain.items()}
        return cls(**given)


SUITES = ("core", "full")
"""The suite for routine use, and the full one."""
NOISE_STD = 0.005
"""Default standard deviation of the image noise, in units of full scale 1; 1.3 steps of 8 bits."""

_LEVEL_UNITS = ("%", "%/h", "1/m", "degrees", "minutes", "mm", "of full scale", "px", "px per frame", "px per step")
"""Units of factors."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class CaseEstimates:
    """The estimates by label at one level of a case, for one noise realisation and t = 0 only, (t, y, x).

    ``truth``: The truth of the reference camera at the same frame, with ``seen_throughout``.
    """

    estimates: Mapping[str, xr.Dataset]
    truth: xr.Dataset
    recording: xr.Dataset
    value: float


class Case:
    """A case, discovered in the modules of `cases`; subclasses set attributes without default and define `scene`."""

    kind: ClassVar[str]
    """Its key: lower-case letters and underscores."""
    title: ClassVar[str]
    """Its title."""
    question: ClassVar[str]
    """The question that it answers, one sentence."""
    varied: ClassVar[str]
    """The factor with its unit: the label of the axis."""
    core: ClassVar[tuple[float, ...]] = ()
    """Levels in the suite ``core``; without any, the case belongs to the suite ``full`` only."""
    full: ClassVar[tuple[float, ...]] = ()
    """Levels in the suite ``full``; default: those of ``core``."""
    quantities: ClassVar[tuple[str, ...]] = ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z", "flow_x")
    """The evaluated quantities: keys of `scenetruth.scoring.QUANTITIES`."""
    logarithmic: ClassVar[bool] = False
    """Whether the axis is logarithmic."""
    seeds: ClassVar[Mapping[str, int]] = {"core": 1, "full": 3}
    """Number of noise realisations of each level, by suite."""
    margin_px: ClassVar[float] = 16.0
    """Minimum distance of evaluated pixels from the image border, where points are missing from some images."""
    edge_px: ClassVar[float] = 12.0
    """Minimum distance from silhouettes and creases."""
    bounded: ClassVar[bool] = False
    """Whether the Cramér-Rao bound is computed."""
    one_scene: ClassVar[bool] = False
    """Whether all levels share one scene and are distinguished by `region_at`."""
    truth_content: ClassVar[Literal["standard", "complete_with_light"]] = "standard"
    """Maps of the truth of `region_at`."""
    headline: ClassVar[tuple[str, str]] = ("disparity", "rmse")
    """Quantity and statistic of the case in a summary."""

    def values(self, suite: str) -> tuple[float, ...]:
        """Return the levels in a suite."""
        return self.core if suite == "core" else self.full or self.core

    def labels(self) -> Mapping[float, str]:
        """Return the names of levels that are not numbers, such as scenes; empty if all are numbers."""
        return {}

    def get_label(self, value: float) -> str:
        """Return the name of a level in tables, on axes, on the command line, and in file names."""
        return self.labels().get(value, f"{value:g}")

    def describe_level(self, value: float) -> str:
        """Return factor and level in words, with the unit.

        >>> print(all_cases()["slope"].describe_level(60.0), all_cases()["gallery"].describe_level(0.0), sep="; ")
        angle to the image plane 60°; scene: cube
        """
        if self.labels():
            return f"{self.varied}: {self.get_label(value)}"
        name, comma, unit = self.varied.rpartition(", ")
        if not comma or unit not in _LEVEL_UNITS:
            return f"{self.varied} {self.get_label(value)}"
        separator = "" if unit == "degrees" else "\N{NO-BREAK SPACE}"
        return f"{name} {self.get_label(value)}{separator}{'°' if unit == 'degrees' else unit}"

    def parse_level(self, given: float | str) -> float:
        """Return the level for a number or a name."""
        named = {label: value for value, label in self.labels().items()}
        if given in named:
            return named[str(given)]
        try:
            value = float(given)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or (named and value not in named.values()):
            must = f"must be one of {', '.join(named)}" if named else "must be a number"
            raise ArgumentError([Problem(f"values of {self.kind}", must, given)])
        return value

    def lacks(self) -> str:
        """Return the missing requirement of the case with its remedy; empty if the case can be run."""
        return ""

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the scene as plain values; its sensor is ideal if `noise_std` is to be added."""
        raise NotImplementedError

    def noise_std(self, value: float) -> float:
        """Return the standard deviation of the added image noise, in units of full scale 1."""
        return NOISE_STD

    def region_at(self, truth: xr.Dataset, value: float) -> Mask:
        """Return the evaluated pixels of the reference frame, shape (y, x).

        The default excludes discontinuities, the image border, and pixels without a surface. Besides its own maps,
        ``truth`` has ``seen_throughout``: whether the point is visible in all images.
        """
        away = truth["boundary_distance"].values >= self.edge_px
        return np.asarray(np.isfinite(truth["depth"].values) & away & mask_interior(truth, self.margin_px))

    def further_rows(self, found: CaseEstimates) -> Iterable[BenchmarkRecord]:
        """Return additional records of this case at one level."""
        return ()

    def conclusions(self, rows: Sequence[BenchmarkRecord]) -> Iterable[BenchmarkRecord]:
        """Return records derived from all levels, such as a cut-off period."""
        return ()


def mask_interior(truth: xr.Dataset, margin_px: float) -> Mask:
    """Return the pixels at least ``margin_px`` from the image border."""
    height, width = truth.sizes["y"], truth.sizes["x"]
    y, x = np.mgrid[:height, :width]
    return np.asarray(np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y)) >= margin_px)


@cache
def all_cases() -> Mapping[str, Case]:
    """Return all cases by key, in the order of packages and modules."""
    modules = (f"scenetruth.benchmark.cases.{name}" for name in ("imaging", "surfaces", "light", "scenes"))
    return {cls.kind: cls() for cls in classes_in(Case, *modules) if hasattr(cls, "kind")}


def select_cases(names: Iterable[str] | None) -> list[Case]:
    """Return cases by key; all by default."""
    known = all_cases()
    if names is None:
        return list(known.values())
    problems = [
        Problem("cases", f"no such case; available: {', '.join(known)}", name) for name in names if name not in known
    ]
    if problems:
        raise ArgumentError(problems)
    return [known[name] for name in names]
