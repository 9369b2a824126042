"""One scene of a case, made and measured: images, noises, estimates of all methods, figures."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.comparison.case import Case, Found, all_cases
from scenetruth.comparison.contestants import Contestant
from scenetruth.comparison.maps import Maps, maps_of
from scenetruth.comparison.measures.figures import figure_rows
from scenetruth.comparison.memory import PeakMemory
from scenetruth.comparison.rows import BOUND, OWN, Row
from scenetruth.errors import EstimateError, EstimateWarning, SceneWarning, ScoreError
from scenetruth.estimators import prepare
from scenetruth.randomness import generator_for
from scenetruth.scene import scene_from_plain
from scenetruth.scoring import find_slips, units_of
from scenetruth.scoring.regions import seen_throughout
from scenetruth.simulation import simulate

__all__ = ["Measured", "Point", "measure", "noisy", "quiet"]

BOUND_SIGMA_PX = 6.0
"""Window of the Cramér-Rao bound that is told: that of the methods by default."""


@dataclass(frozen=True)
class Point:
    """A scene of a case, and what is measured of it.

    Parameters
    ----------
    case
        Kind of the case.
    values
        What was varied: one value, or all of a case whose values are of one scene.
    seeds
        How many noises.
    """

    case: str
    values: tuple[float, ...]
    seeds: int

    @property
    def name(self) -> str:
        """What its file is called."""
        return "all" if len(self.values) > 1 else all_cases()[self.case].label_of(self.values[0])


@dataclass
class Measured:
    """What came of a point.

    Parameters
    ----------
    rows
        The figures.
    failures
        Why methods have given nothing, by label.
    settled
        Labels of those whose failures need not be tried again: installed methods that refuse the recording.
    slips
        Likely slips of convention in what methods of others and of one's own gave, by label.
    maps
        What is pictured; None where nothing is measured in pixels, or figures were read from a file.
    """

    rows: list[Row] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)
    settled: list[str] = field(default_factory=list)
    slips: dict[str, list[str]] = field(default_factory=dict)
    maps: Maps | None = None


def measure(case: Case, point: Point, contestants: Sequence[Contestant]) -> Measured:
    """Make a scene, let all methods estimate from the same images, and measure what they find.

    Parameters
    ----------
    case
        The case of the point.
    point
        The point.
    contestants
        The methods.
    """
    measured = Measured()
    first = point.values[0]
    noise_std = case.noise_std(first)
    with quiet():
        ideal, whole = simulate(scene_from_plain(case.scene(first)))
        truth = whole.sel(t=[0])
        truth = truth.assign(seen_throughout=(("y", "x"), seen_throughout(whole)))
        found = []
        for seed in range(point.seeds if noise_std else 1):
            recording = noisy(ideal, noise_std, case.kind, seed)
            estimates = {}
            for one in contestants:
                took, held, work = time.perf_counter(), PeakMemory(), None
                try:
                    with held:
                        work = prepare(recording, one.method, dict(one.settings))
                        maps = work.estimate().sel(t=[0])
                except (EstimateError, KeyError) as error:
                    measured.failures[one.label] = str(error)
                    if work is None and one.is_installed:
                        measured.settled.append(one.label)
                    continue
                took = time.perf_counter() - took
                estimates[one.label] = maps
                if seed == 0 and not one.is_own:
                    with suppress(ScoreError):
                        measured.slips[one.label] = [slip.message for slip in find_slips(maps, truth)]
                for name, number, unit in (("seconds", took, "s"), ("peak_memory", held.megabytes, "MB")):
                    measured.rows.append(Row(case.kind, first, one.label, "", OWN, name, number, at=seed, unit=unit))
            found.append(Found(estimates, truth, recording, first))
        measured.maps = maps_of(case, found[0])
        for value in point.values:
            measured.rows += figure_rows(case, value, found)
            here = Found(found[0].estimates, truth, found[0].recording, value)
            measured.rows += case.further_rows(here)
            if case.bounded and noise_std:
                measured.rows += _bound_rows(case, value, whole, ideal, noise_std)
    return measured


def noisy(ideal: xr.Dataset, noise_std: float, *keys: Any) -> xr.Dataset:
    """Return a recording with white Gaussian noise in its images.

    Parameters
    ----------
    ideal
        The recording without noise.
    noise_std
        Standard deviation, in its grey values.
    *keys
        What tells this noise from others.
    """
    if not noise_std:
        return ideal
    image = ideal["image"]
    noise = generator_for(0, "noise", *keys).normal(0.0, noise_std, image.shape)
    found = ideal.assign(image=(image.dims, (image.values + noise).astype(np.float32), image.attrs))
    # It is another recording now.
    found.attrs.pop("recording_hash", None)
    return found


def _bound_rows(case: Case, value: float, truth: xr.Dataset, ideal: xr.Dataset, noise_std: float) -> Iterator[Row]:
    from scenetruth.bound import cramer_rao

    # No method is told that sheets do not grow, or that the light is steady.
    bound = cramer_rao(
        truth,
        ideal,
        noise_std=noise_std,
        window_sigma_px=BOUND_SIGMA_PX,
        motion="growing",
        brightness="per_image",
    ).sel(t=0)
    region = case.region_at(truth.sel(t=0).assign(seen_throughout=(("y", "x"), seen_throughout(truth))), value)
    for quantity in case.quantities:
        name, _, axis = quantity.partition("_")
        if f"{name}_std" not in bound:
            continue
        maps = bound[f"{name}_std"].values
        std = (maps["xyz".index(axis)] if axis else maps)[region]
        std = std[np.isfinite(std)]
        number = float(np.sqrt(np.mean(np.square(std)))) if std.size else math.nan
        yield Row(case.kind, value, BOUND, quantity, OWN, "noise", number, unit=units_of(quantity))


@contextmanager
def quiet() -> Iterator[None]:
    """Leave out what the suite's scenes are warned of: they are meant to be difficult."""
    with warnings.catch_warnings():
        for category in (EstimateWarning, SceneWarning, RuntimeWarning):
            warnings.simplefilter("ignore", category)
        yield
