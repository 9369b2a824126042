"""A sweep over two factors, made by hand."""

from __future__ import annotations

from typing import Any

from scenetruth.design.sweeps import Sweep, SweepRecord

__all__ = ["BASELINE", "HOSTILE", "KIND", "NOISE", "over_two", "rows"]


HOSTILE = "</script><script>alert(1)</script>"


BASELINE, NOISE, KIND = "stage.baseline_mm", "sensor.noise_std", "objects.0.mesh.kind"


def rows(points: list[dict[str, Any]], methods: tuple[str, ...] = ("mine",)) -> list[SweepRecord]:
    found = []
    for number, values in enumerate(points, 1):
        for factor, method in enumerate(methods, 1):
            where = (values, "cube", method, None, "interior")
            error = factor * number
            found.append(SweepRecord(*where, "depth", "rmse", error, 0.8 * error, 1.2 * error, "mm"))
            found.append(SweepRecord(*where, "depth", "bias", -error, unit="mm"))
            found.append(SweepRecord(*where, "growth_rate", "rmse", error, unit="%/h"))
            found.append(SweepRecord(values, "cube", method, 1, "interior", "depth", "rmse", 77.0, unit="mm"))
            bound = "bound" if len(methods) == 1 else f"bound of {method}"
            found.append(SweepRecord(values, "cube", bound, None, "interior", "depth", "rmse", error / 2, unit="mm"))
    return found


def over_two() -> Sweep:
    points = [{BASELINE: b, NOISE: n} for b in (1, 2, 4) for n in (0.01, 0.02)]
    return Sweep([BASELINE, NOISE], ["cube"], ["mine"], rows(points), ["cube at 3: why"], [HOSTILE])
