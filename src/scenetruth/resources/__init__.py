"""What a scene asks for, what the work on it will take, what the machine has, and what is refused."""

from scenetruth.resources.bounds import Limits, limits_from
from scenetruth.resources.demand import Demand, Effort, Part, Recorded, demand_of
from scenetruth.resources.forecast import Forecast, StageForecast, foresee
from scenetruth.resources.machine import Machine, machine_at
from scenetruth.resources.refusal import bounded_parts, machine_problems, refuse_beyond_bounds, refuse_resources

__all__ = [
    "Demand",
    "Effort",
    "Forecast",
    "Limits",
    "Machine",
    "Part",
    "Recorded",
    "StageForecast",
    "bounded_parts",
    "demand_of",
    "foresee",
    "limits_from",
    "machine_at",
    "machine_problems",
    "refuse_beyond_bounds",
    "refuse_resources",
]
