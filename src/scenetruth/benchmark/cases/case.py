"""The base of all cases, and the records they yield."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any, ClassVar

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
"""Pixels that the method itself tells."""
COMMON_VALID = "common_valid"
"""Pixels that all methods of the comparison tell."""
ALL = "all"
"""All pixels of the region; what is missing counts as missing."""
BOUND = "bound"
"""Stands for a method where a row holds the Cramér-Rao bound."""


@dataclass(frozen=True)
class BenchmarkRecord:
    """One figure.

    ``case``: Which case of the suite.
    ``level``: What was varied, in the unit of the case.
    ``method``: Label of the method, or `BOUND`.
    ``quantity``: What was measured: a key of `scenetruth.scoring.QUANTITIES`; empty for time and memory.
    ``pixels``: Over which pixels: `METHOD_VALID`, `COMMON_VALID` or `ALL`.
    ``statistic``: What of their errors.
    ``value``: The figure, in the quantity's unit; NaN where there is none.
    ``ci_low``, ``ci_high``: Its 95 % confidence interval; NaN if it was not found out.
    ``threshold``: What a curve is drawn over besides: the share of pixels that is kept, or the number of standard
      deviations.
    ``unit``: Unit of the figure.
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
        """Return plain values; None for NaN, which JSON cannot spell."""
        return {
            key: None if isinstance(value, float) and not math.isfinite(value) else value
            for key, value in asdict(self).items()
        }

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> BenchmarkRecord:
        """Return a row from what `to_dict` made."""
        given: dict[str, Any] = {key: math.nan if value is None else value for key, value in plain.items()}
        return cls(**given)


SUITES = ("core", "full")
"""The suite for every day, and the whole one."""
NOISE_STD = 0.005
"""Noise of the images unless the case varies it: standard deviation, of full scale 1; 1.3 steps of 8 bits."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class CaseEstimates:
    """What methods have found at one value of a case, with one noise.

    ``estimates``: Estimates by label, of the reference frame alone: t = 0, dimensions (t, y, x).
    ``truth``: The truth of the reference camera at the same frame, and ``visible_throughout``.
    ``recording``: The images that they were made from.
    ``value``: What was varied.
    """

    estimates: Mapping[str, xr.Dataset]
    truth: xr.Dataset
    recording: xr.Dataset
    value: float


class Case:
    """A case of the suite; one module in a room of `cases` each, which is found by itself.

    Derive from it, set what is below, and write `scene`; the rest has defaults that suit most cases.
    """

    kind: ClassVar[str]
    """Its name: lower-case letters and underscores."""
    title: ClassVar[str]
    """What it is, in a few words."""
    question: ClassVar[str]
    """What it answers, in a sentence."""
    varied: ClassVar[str]
    """What is varied, with its unit: the label of the axis."""
    core: ClassVar[tuple[float, ...]] = ()
    """Values in the suite ``core``; a case without any is in the suite ``full`` alone."""
    full: ClassVar[tuple[float, ...]] = ()
    """Values in the suite ``full``; those of ``core`` if empty."""
    quantities: ClassVar[tuple[str, ...]] = ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z", "flow_x")
    """What is measured: keys of `scenetruth.scoring.QUANTITIES`."""
    logarithmic: ClassVar[bool] = False
    """Whether the axis is drawn so."""
    seeds: ClassVar[Mapping[str, int]] = {"core": 1, "full": 3}
    """How many noises each value gets, by suite."""
    margin_px: ClassVar[float] = 16.0
    """Least distance of what is measured from the image's border, which not all images show."""
    edge_px: ClassVar[float] = 12.0
    """Least distance from silhouettes and creases."""
    bounded: ClassVar[bool] = False
    """Whether the Cramér-Rao bound is told beside it."""
    one_scene: ClassVar[bool] = False
    """Whether all values are of one scene, and `region_at` tells them apart."""
    headline: ClassVar[tuple[str, str]] = ("disparity", "rmse")
    """Quantity and statistic that stand for the case in a summary."""

    def values(self, suite: str) -> tuple[float, ...]:
        """Return what is varied in a suite."""
        return self.core if suite == "core" else self.full or self.core

    def labels(self) -> Mapping[float, str]:
        """Return what values are called that are no amounts, as scenes by their names; empty if all are amounts."""
        return {}

    def label_of(self, value: float) -> str:
        """Return what a value is called: in tables, on axes, on the command line, and by its file."""
        return self.labels().get(value, f"{value:g}")

    def value_of(self, given: float | str) -> float:
        """Return the value that is given as a number, or by what it is called."""
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
        """Return what the case needs and this installation has not, with the remedy; empty if it can be measured."""
        return ""

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the scene, as plain values; its sensor is ideal if `noise_std` is to be added."""
        raise NotImplementedError

    def noise_std(self, value: float) -> float:
        """Return the standard deviation of the noise that is added to the images, of full scale 1."""
        return NOISE_STD

    def region_at(self, truth: xr.Dataset, value: float) -> Mask:
        """Return which pixels of the reference frame are measured, shape (y, x).

        Those away from edges and from the image's border; where nothing is seen, there is nothing to measure. ``truth``
        has, besides its own maps, ``visible_throughout``: whether all images show the point.
        """
        away = truth["boundary_distance"].values >= self.edge_px
        return np.asarray(np.isfinite(truth["depth"].values) & away & mask_interior(truth, self.margin_px))

    def further_rows(self, found: CaseEstimates) -> Iterable[BenchmarkRecord]:
        """Return figures of this case's own at one value."""
        return ()

    def conclusions(self, rows: Sequence[BenchmarkRecord]) -> Iterable[BenchmarkRecord]:
        """Return figures that follow from the rows of all values, as a period at which too much is lost."""
        return ()


def mask_interior(truth: xr.Dataset, margin_px: float) -> Mask:
    """Return which pixels lie so far from the border of the image."""
    height, width = truth.sizes["y"], truth.sizes["x"]
    y, x = np.mgrid[:height, :width]
    return np.asarray(np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y)) >= margin_px)


@cache
def all_cases() -> Mapping[str, Case]:
    """Return all cases by kind, in the order of rooms and modules."""
    modules = (f"scenetruth.benchmark.cases.{name}" for name in ("imaging", "surfaces", "scenes"))
    return {cls.kind: cls() for cls in classes_in(Case, *modules) if hasattr(cls, "kind")}


def select_cases(names: Iterable[str] | None) -> list[Case]:
    """Return cases by kind; all if no names are given."""
    known = all_cases()
    if names is None:
        return list(known.values())
    problems = [
        Problem("cases", f"there is no such case; known: {', '.join(known)}", name)
        for name in names
        if name not in known
    ]
    if problems:
        raise ArgumentError(problems)
    return [known[name] for name in names]
