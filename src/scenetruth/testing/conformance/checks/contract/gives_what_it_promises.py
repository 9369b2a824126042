"""The plain recording has an estimate, which holds what `gives` promises and knows it somewhere."""

from __future__ import annotations

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.deviation import Deviation

__all__ = ["NEEDS", "check"]

NEEDS = Need(plain=False)


def check(bench: Bench) -> None:
    """Estimate, and look for each quantity."""
    sizes = dict(bench.recording()["image"].sizes)
    found = bench.estimate(bench.recording())
    missing = [name for name in sorted(bench.method.gives) if name not in found]
    blank = [name for name in sorted(bench.method.gives) if name in found and not found[name].notnull().any()]
    if missing or blank:
        told = [f"no {', '.join(missing)}"] if missing else []
        told += [f"NaN everywhere in {', '.join(blank)}"] if blank else []
        raise Deviation(
            f"a textured plane was estimated, images {sizes}, noise-free",
            f"all of {', '.join(sorted(bench.method.gives))}, known somewhere",
            "; ".join(told),
            "return it, or take it from `gives`; a method that needs larger images or more of them is checked with "
            "size=, cameras=, frames=",
        )
