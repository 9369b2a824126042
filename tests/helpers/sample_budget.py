"""A budget as if measured."""

from __future__ import annotations

import math

from scenetruth.design.uncertainty import Budget, CombinedUncertainty, Contribution, Mitigation

__all__ = ["budget_of_a_cube"]


def budget_of_a_cube(noise: str = "sensor noise", scale: float = 1.0) -> Budget:
    """Return a budget of depth, most of which is the stage's yaw; all figures are multiplied by the scale."""

    def part(
        cause: str, title: str, figure: float, simulated: float = math.nan, seen: float = math.nan
    ) -> Contribution:
        told = ("100 µrad", "depth", "interior", "mm")
        predicted, drawn = (4.2, 1.39) if cause == "stage_yaw" else (figure, math.nan)
        figures = (scale * predicted, scale * drawn, scale * simulated)
        return Contribution(cause, title, *told, *figures, seen, scale * figure)

    parts = [
        part("noise", noise, 0.05),
        part("stage_yaw", "stage yaw", 1.4, 1.4, 0.5),
        part("slope", "slanted surfaces", 0.16),
        part("timing", "scan timing", 0.001),
        part("lens_residual", "lens distortion", 0.002),
        part("curvature", "curved surfaces", math.nan),
    ]
    whole = math.sqrt(sum(one.value**2 for one in parts if math.isfinite(one.value)))
    total = CombinedUncertainty("depth", "interior", "mm", whole, whole, scale * 1.5, scale * 0.16, 660.0, 0.9)
    remedies = {"stage_yaw": Mitigation("an air bearing", {"stage_yaw": 0.025})}
    return Budget("A cube", "structure_tensor", parts, [total], 3, remedies)
