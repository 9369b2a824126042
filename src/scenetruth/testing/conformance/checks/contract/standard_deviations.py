"""Standard deviations are positive and finite wherever they are told."""

from __future__ import annotations

import numpy as np

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.deviation import Deviation, NotApplicable

__all__ = ["NEEDS", "check"]

NEEDS = Need()


def check(bench: Bench) -> None:
    """Look at all variables of the plain estimate that are called so."""
    found = bench.plain
    names = [str(name) for name in found.data_vars if str(name).endswith("_std")]
    if not names:
        msg = "the method tells no standard deviations"
        raise NotApplicable(msg)
    wrong = []
    for name in names:
        values = found[name].values
        bad = int((np.isinf(values) | (values <= 0)).sum())
        wrong += [f"{name} is 0, negative or infinite in {bad} places"] if bad else []
        what = name.removesuffix("_std")
        if what in found and found[what].dims == found[name].dims:
            alone = int((np.isfinite(values) & ~np.isfinite(found[what].values)).sum())
            wrong += [f"{name} is told in {alone} places where {what} is not known"] if alone else []
    if wrong:
        raise Deviation(
            "the plain recording was estimated",
            "standard deviations above 0, or NaN",
            "; ".join(wrong),
            "write NaN where no standard deviation is known",
        )
