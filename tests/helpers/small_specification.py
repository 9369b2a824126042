"""A design specification that takes seconds: a wall before three or four positions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from scenetruth.design.optimisation import ConstraintValue, DesignSpace, Evaluation, Objective, Parameter

__all__ = ["Formula", "constraint", "objective", "scene", "spec", "square"]


def scene() -> dict[str, Any]:
    """Return a small scene that refined methods can estimate."""
    wall: dict[str, Any] = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}}
    wall["pose"] = {"position_mm": [0, 0, 500]}
    wall["texture"] = {"kind": "noise", "wavelength_mm": [4, 16]}
    wall["motion"] = [{"kind": "velocity", "velocity_mm_per_frame": [0.1, 0.0, 0.2]}]
    plain: dict[str, Any] = {"camera": {"width": 64, "height": 48, "focal_length_px": 500}, "objects": [wall]}
    plain |= {"stage": {"positions": 3, "baseline_mm": 4}, "frames": {"count": 3}, "sensor": {"noise_std": 0.01}}
    return plain | {"render": {"backend": "raycast", "supersampling": 2}, "score": {"interior_margin_px": 0}}


def spec(**changes: Any) -> dict[str, Any]:
    """Return a design specification that needs some dozens of predictions, and no simulation."""
    plain: dict[str, Any] = {
        "title": "A wall",
        "scene": scene(),
        "method": "structure_tensor",
        "variables": {
            "stage.baseline_mm": {"from": 1, "to": 12, "log": True},
            "stage.positions": {"from": 2, "to": 5},
            "optics.psf": {"values": [None, {"kind": "gaussian", "sigma_px": 1.5}]},
        },
        "constraints": [{"kind": "stage_travel", "max": 16}],
        "objectives": [{"quantity": "depth"}],
        "search": {"predictions": 40, "morris_trajectories": 2, "sobol": 0},
        "confirmation": {"rigs": 0},
    }
    return plain | changes


def objective(title: str = "depth", wanted: float | None = None) -> Objective:
    """Return an objective."""
    return Objective("depth", "all", "mm", title, wanted)


def constraint(margin: float, title: str = "travel") -> ConstraintValue:
    """Return a constraint that leaves a share of its limit."""
    return ConstraintValue("travel", title, 1 - margin, 1.0, "mm", margin >= 0, margin)


def square(parameters: int) -> DesignSpace:
    """Return a space whose values are the numbers of its unit cube."""
    return DesignSpace(tuple(Parameter(f"x{number}") for number in range(parameters)))


class Formula:
    """A ledger whose predictions are formulas of the values."""

    def __init__(self, space: DesignSpace, formula: Any) -> None:
        self.space, self.formula = space, formula
        self.known: dict[tuple[Any, ...], Evaluation] = {}

    def __len__(self) -> int:
        return len(self.known)

    @property
    def evaluations(self) -> list[Evaluation]:
        return list(self.known.values())

    def ask(self, points: Sequence[Sequence[float]], phase: str) -> list[Evaluation]:
        found = []
        for point in points:
            values = self.space.values(point)
            key = tuple(values.values())
            if key not in self.known:
                predicted, margins = self.formula(values)
                limits = tuple(constraint(margin, f"bound {number}") for number, margin in enumerate(margins))
                self.known[key] = Evaluation(values, predicted, {}, limits)
            found.append(self.known[key])
        return found
