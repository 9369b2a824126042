"""One simulation of a rig: images, estimate and score, as a piece of work that leaves its figures in a file."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenetruth.comparison.point import quiet
from scenetruth.dataset.sample import Made
from scenetruth.design.optimise.parts import Objective
from scenetruth.design.optimise.statistics import STATISTICS
from scenetruth.estimators import estimate
from scenetruth.placing import is_full_disk, write_aside
from scenetruth.plain import parse_json
from scenetruth.provenance import scene_hash
from scenetruth.scene import Scene, scene_from_plain
from scenetruth.schema import digest
from scenetruth.scoring import QUANTITIES, score
from scenetruth.simulation import simulate

__all__ = ["Confirmation", "Figures", "figure_in", "simulate_one", "simulated"]

Figures = dict[str, dict[str, float]]
"""Statistics of scores by objective's title: ``rms``, ``median_abs``, ``p95_abs``, ``bias``, ``density``."""

_STATISTICS = ("rms", "median_abs", "p95_abs", "bias", "density")


_ALL = dict.fromkeys(_STATISTICS, math.nan)
"""Nothing was told: nothing is lacking."""


def figure_in(figures: Figures | None, title: str, statistic: str) -> float:
    """Return the figure of an objective's simulation; NaN where there is none.

    Parameters
    ----------
    figures
        Of a simulation; None if it is not made.
    title
        The objective.
    statistic
        Key of `STATISTICS`.
    """
    kind = STATISTICS[statistic]
    return kind.factor * (figures or {}).get(title, {}).get(kind.scored, math.nan)


@dataclass(frozen=True)
class Confirmation:
    """All that a worker needs to simulate any rig with any seed.

    Parameters
    ----------
    folder
        Where figures go.
    plains
        Scenes of the rigs.
    seeds
        Seeds of each.
    objectives
        What is measured.
    versions
        What figures depend on besides.
    """

    folder: str
    plains: tuple[Mapping[str, Any], ...]
    seeds: tuple[int, ...]
    objectives: tuple[Objective, ...]
    versions: tuple[tuple[str, str], ...]

    def __len__(self) -> int:
        """Return how many simulations there are."""
        return len(self.plains) * len(self.seeds)

    def scene(self, number: int) -> Scene:
        """Return the scene of a simulation."""
        rig, seed = divmod(number, len(self.seeds))
        return scene_from_plain({**self.plains[rig], "seed": self.seeds[seed]})

    def key(self, number: int) -> str:
        """Return a hash of all that its figures depend on."""
        scene = self.scene(number)
        depends: dict[str, Any] = {
            "scene": scene_hash(scene),
            "score": scene.score.model_dump(mode="json"),
            "method": scene.estimate.model_dump(mode="json"),
            "objectives": [(one.quantity, one.region, one.title) for one in self.objectives],
            "versions": self.versions,
        }
        return digest(json.loads(json.dumps(depends)))

    def figures(self, number: int) -> Figures | None:
        """Return the figures of a simulation; None if it is not made, or lacks a statistic that is wanted."""
        key = self.key(number)
        try:
            plain = parse_json((Path(self.folder) / f"{key}.json").read_bytes())
        except (OSError, ValueError):
            return None
        if not isinstance(plain, dict) or plain.get("key") != key:
            return None
        figures: Figures = plain["figures"]
        lacking = [
            one for one in self.objectives if STATISTICS[one.statistic].scored not in figures.get(one.title, _ALL)
        ]
        return None if lacking else figures


def simulated(scene: Scene, objectives: tuple[Objective, ...]) -> Figures:
    """Simulate a scene, estimate with its method, and score.

    Parameters
    ----------
    scene
        The scene.
    objectives
        What is measured; what nothing is told of is left out.
    """
    with quiet():
        recording, truth = simulate(scene, truth_content="complete" if _is_further(objectives) else "standard")
        maps = estimate(recording, scene.estimate.method, scene.estimate.settings.model_dump())
        found = score(maps, truth, **scene.score.model_dump())
    figures: Figures = {}
    # Scores name single objects only where there are several: the interior is that of the only one.
    alone = len(scene.parts) == 1
    for one in objectives:
        region = "interior" if alone and one.region.startswith("object_") else one.region
        told = found.regions.get(region, {}).get(one.quantity, {})
        values = {name: float(value) for name in _STATISTICS if (value := told.get(name)) is not None}
        if "rms" in values:
            figures[one.title] = values
    return figures


def _is_further(objectives: tuple[Objective, ...]) -> bool:
    """Whether something is measured that the standard truth does not tell."""
    variables = {QUANTITIES[one.quantity].variable for one in objectives}
    return not variables <= _STANDARD


_STANDARD = frozenset(("depth", "disparity", "velocity", "flow", "normal", "growth_rate", ""))
"""Variables of the standard truth; windowed growth follows from them and has none."""


def simulate_one(job: Confirmation, number: int) -> Made:
    """Make one simulation, for whoever works through many: what goes wrong is returned."""
    start = time.perf_counter()
    try:
        found = simulated(job.scene(number), job.objectives)
        key = job.key(number)
        path = Path(job.folder) / f"{key}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_aside(path, overwrite=True) as aside:
            aside.write_text(json.dumps({"key": key, "figures": found}, allow_nan=False), encoding="utf-8")
    except Exception as error:  # whatever it is, the others go on
        rig, seed = divmod(number, len(job.seeds))
        message = f"rig {rig + 1} of those that are simulated, seed {job.seeds[seed]}: {type(error).__name__}: {error}"
        return Made(number, failure={"message": message}, disk_full=is_full_disk(error))
    return Made(number, {"simulation": number}, seconds=time.perf_counter() - start)
