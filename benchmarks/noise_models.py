"""``noise: estimated`` of `refined` beside ``uniform``: bias, RMSE, z-scores, valid pixels and time, scene by scene.

Run it from the top of the repository: ``python -m benchmarks.noise_models [NAME ...] [--held-out] [--kept FILE]
[--cache DIR]``; the bundled scenes (`benchmarks.trust_shipped`) and those of `benchmarks.trust_noise`. Values are those
of the interior. Every third scene is held out (``--held-out``). Times are processor times, taken by turns.
"""

from __future__ import annotations

import functools
import json
import time
from typing import Any

import numpy as np

from benchmarks import trust
from benchmarks.jobs import ends, heading, line, number
from benchmarks.trust import Plain, assess, list_scenes, parse_arguments

__all__ = ["compare"]

MODELS = ("uniform", "estimated")
FAMILIES = ("shipped", "noise")
COLUMNS = ("scene", "quantity", "valid, %", "bias", "RMSE", "rms z", "beyond 6, %", "time ratio")
SUMMARY = ("quantity", "scenes", "ratio of RMSE, median (range)", "ratio of rms z, median (range)")


def compare(scene: Plain, settings: Plain, cache: str | None) -> dict[str, Any]:
    """Return the statistics of both models on a scene, and the processor time of each in s."""
    warm_up(json.dumps(settings))
    trust.simulated(scene, cache)
    found: dict[str, Any] = {}
    for model in MODELS:
        begun = time.process_time()
        found[model] = assess(scene, {**settings, "noise": model}, cache)
        found[f"{model} s"] = time.process_time() - begun
    return found


@functools.cache
def warm_up(settings: str) -> None:
    """Compile the code of both models, once per process."""
    for model in MODELS:
        assess(trust.rig([trust.plane(trust.noise(4, 20))]), {**json.loads(settings), "noise": model}, None)


def main() -> None:
    """Print a line for each scene and quantity, ``uniform / estimated``, and ratios of both over all scenes."""
    given, settings = parse_arguments(__doc__)
    scenes = [each for each in list_scenes(held_out=given.held_out) if each[0].split()[0] in FAMILIES]
    print(heading(COLUMNS), flush=True)
    every: list[dict[str, Any]] = []
    for name, found in ends(compare, {name: (scene, settings, given.cache) for name, scene in scenes}, given):
        every.append(found)
        both = [found[model] for model in MODELS]
        ratio = number(found["estimated s"] / found["uniform s"])
        for quantity in both[0]:
            cells = (
                " / ".join(number(scale * each[quantity][key]) for each in both)
                for key, scale in (("density", 100), ("bias", 1), ("error", 1), ("rms", 1), ("beyond", 100))
            )
            print(line([name, quantity, *cells, ratio]), flush=True)
    print()
    print(heading(SUMMARY))
    for quantity in sorted({quantity for found in every for quantity in found["uniform"]}):
        pairs = [(found["uniform"][quantity], found["estimated"][quantity]) for found in every]
        pairs = [pair for pair in pairs if all(each["density"] > 0 for each in pair)]
        print(line([quantity, len(pairs), *(spread(pairs, key) for key in ("error", "rms"))]))


def spread(pairs: list[tuple[dict[str, float], dict[str, float]]], key: str) -> str:
    """Return median and range of the ratio of ``estimated`` to ``uniform``."""
    ratios = [estimated[key] / uniform[key] for uniform, estimated in pairs]
    return f"{np.median(ratios):.3f} ({min(ratios):.3f} to {max(ratios):.3f})"


if __name__ == "__main__":
    main()
