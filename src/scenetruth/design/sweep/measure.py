"""One simulation of a sweep: images, estimates of all methods, their scores, and the bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.comparison.contestants import Contestant
from scenetruth.comparison.point import quiet
from scenetruth.design.sweep.kept import Kept, errors_of, every_px
from scenetruth.design.sweep.least import Window, bound_names, least_std, sizes_of_normal, window_of
from scenetruth.errors import EstimateError
from scenetruth.estimators import prepare
from scenetruth.resources import Limits
from scenetruth.scene import Scene
from scenetruth.scoring import QUANTITIES, REGIONS, Score, score
from scenetruth.scoring.growth import growth_pairs, knows_growth
from scenetruth.scoring.parts import aligned_parts
from scenetruth.scoring.reading import Pairs, tells
from scenetruth.scoring.regions import further_regions, main_regions, seen_throughout
from scenetruth.settings import ScoreSettings
from scenetruth.simulation import simulate
from scenetruth.truth import make_truth

__all__ = ["FIGURES", "Measured", "contestants_of_scene", "measure"]

FIGURES: Mapping[str, str] = {"rms": "rms", "bias": "bias", "median": "median_abs", "density": "density"}
"""Statistics of a sweep, by what scores call them."""

Mask = NDArray[np.bool_]
Figures = dict[str, dict[str, dict[str, float]]]
"""Region to quantity to statistic to value."""


@dataclass
class Measured:
    """What came of a simulation.

    Parameters
    ----------
    figures
        By method.
    bounds
        By the name of the bound; empty unless it was asked for.
    failures
        Why methods have given nothing, by label.
    notes
        Why there is no bound.
    settled
        Labels of those whose failures need not be tried again: installed methods that refuse the recording.
    grows
        Whether anything grows, so that errors of growth can be compared with growth.
    kept
        Errors at some pixels; None unless they were asked for.
    """

    figures: dict[str, Figures] = field(default_factory=dict)
    bounds: dict[str, Figures] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    settled: list[str] = field(default_factory=list)
    grows: bool = False
    kept: Kept | None = None


def contestants_of_scene(scene: Scene) -> list[Contestant]:
    """Return a scene's own method."""
    settings = scene.estimate.settings.model_dump(mode="json")
    return [Contestant(scene.estimate.method, scene.estimate.method, settings)]


def measure(
    scene: Scene,
    contestants: Sequence[Contestant],
    *,
    bounded: bool,
    keeps: bool,
    limits: Limits | None = None,
) -> Measured:
    """Make the images of a scene, let all methods estimate from them, and score what they find.

    Parameters
    ----------
    scene
        The scene.
    contestants
        The methods; the scene's own if there are none.
    bounded
        Whether the bound is told too.
    keeps
        Whether errors at some pixels are kept.
    limits
        Bounds of what the scene may ask for.
    """
    methods = list(contestants) or contestants_of_scene(scene)
    measured, seen = Measured(), list[_Seen]()
    with quiet():
        with_ideal, truth = simulate(scene, ideal=bounded, limits=limits)
        recording = with_ideal.drop_vars("ideal", errors="ignore")
        step_px = every_px(recording)
        for one in methods:
            work = None
            try:
                work = prepare(recording, one.method, dict(one.settings))
                maps = work.estimate()
            except (EstimateError, KeyError) as error:
                measured.failures[one.label] = " ".join(str(error).split())
                if work is None and one.is_installed:
                    measured.settled.append(one.label)
                continue
            if _is_further(maps, truth):
                truth = make_truth(scene, truth_content="complete", limits=limits)
            found = score(maps, truth, **scene.score.model_dump())
            measured.figures[one.label] = _figures(found)
            measured.grows |= found.grows
            if keeps or bounded:
                seen.append(_seen(one, maps, truth, scene.score, step_px))
        if keeps:
            measured.kept = Kept(
                {(each.contestant.label, name): mask for each in seen for name, mask in each.regions.items()},
                {(each.contestant.label, name): errors for each in seen for name, errors in each.errors.items()},
            )
        if bounded:
            names = bound_names(methods)
            stds = {window: least_std(truth, with_ideal, window, step_px) for window in {each.window for each in seen}}
            for each in seen:
                told, why = stds[each.window]
                measured.bounds[names[each.contestant.label]] = each.least(told)
                if why and f"no bound: {why}" not in measured.notes:
                    measured.notes.append(f"no bound: {why}")
    return measured


def _is_further(maps: xr.Dataset, truth: xr.Dataset) -> bool:
    """Whether an estimate tells something that is scored, and of which a truth says nothing."""
    return any(entry.variable in maps and not tells(truth, name) for name, entry in QUANTITIES.items())


@dataclass(frozen=True)
class _Seen:
    """What a method has found at some pixels, regions and errors of the shape (t, y, x)."""

    contestant: Contestant
    regions: Mapping[str, Mask]
    errors: Mapping[str, NDArray[np.float32]]
    reference: int | None
    """Place of the frame t = 0; None if it is not estimated."""
    grows: bool
    """Whether it tells growth itself, in its own window."""

    @property
    def window(self) -> Window:
        return window_of(self.contestant)

    def least(self, std: Mapping[str, NDArray[np.float64]]) -> Figures:
        """Return the least errors at the pixels that it tells."""
        found: Figures = {}
        for region, mask in self.regions.items():
            for quantity, errors in self.errors.items():
                # Growth that follows from depth and velocity has a larger window.
                if self.reference is None or quantity not in std or (quantity == "growth_rate" and not self.grows):
                    continue
                told = mask[self.reference] & np.isfinite(errors[self.reference])
                sizes = sizes_of_normal(std[quantity][told])
                if sizes:
                    found.setdefault(region, {})[quantity] = sizes
        return found


def _seen(contestant: Contestant, maps: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings, step_px: int) -> _Seen:
    regions = {name: mask[..., ::step_px, ::step_px] for name, mask in _regions(maps, truth, settings).items()}
    frames = maps["t"].values.tolist()
    reference = frames.index(0) if 0 in frames else None
    return _Seen(contestant, regions, _errors(maps, truth, settings, step_px), reference, "growth_rate" in maps)


def _is_told(region: str) -> bool:
    return region in REGIONS or region.startswith("object_")


def _figures(found: Score) -> Figures:
    return {
        region: {
            quantity: {
                name: float(value) for name, key in FIGURES.items() if (value := statistics.get(key)) is not None
            }
            for quantity, statistics in quantities.items()
            if any(key in statistics for key in FIGURES.values())
        }
        for region, quantities in found.regions.items()
        if _is_told(region)
    }


def _regions(maps: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings) -> dict[str, Mask]:
    """Return where regions lie, as scores have them, at the frames of an estimate: shape (t, y, x)."""
    reference = truth.sel({dim: 0 for dim in ("s_y", "s") if dim in truth["depth"].dims})
    here = reference.sel(t=maps["t"].values)
    masks = main_regions(here, settings.interior_margin_px)
    masks |= further_regions(here, masks["interior"], settings, throughout=seen_throughout(truth))
    return {name: mask for name, mask in masks.items() if _is_told(name)}


def _errors(
    maps: xr.Dataset, truth: xr.Dataset, settings: ScoreSettings, step_px: int
) -> dict[str, NDArray[np.float32]]:
    """Return errors in every so many rows and columns by quantity, shape (t, y, x)."""
    parts: list[dict[str, NDArray[np.float32]]] = []
    for found, exact in aligned_parts(maps, truth):
        grown = growth_pairs(found, exact, settings) if knows_growth(found, exact) else None
        parts.append(errors_of(Pairs(found, exact, grown), step_px))
    common = [name for name in parts[0] if all(name in part for part in parts)]
    return {name: np.concatenate([part[name] for part in parts]) for name in common}
