"""Workload and cost of a scene, resources of the machine, and the limits on both."""

from scenetruth.resources.cost_estimate import Forecast, StageForecast, estimate_cost
from scenetruth.resources.enforcement import (
    build_checked_scene,
    limited_objects,
    load_checked_scene,
    machine_problems,
    raising_all_problems,
    read_checked_scene,
    refuse_beyond_limits,
    refuse_resources,
)
from scenetruth.resources.limits import Limits, limits_from
from scenetruth.resources.system import Machine, inspect_machine
from scenetruth.resources.workload import MethodWorkload, ObjectWorkload, RecordingWorkload, Workload, compute_workload

__all__ = [
    "Forecast", "Limits", "Machine", "MethodWorkload", "ObjectWorkload", "RecordingWorkload", "StageForecast",
    "Workload", "build_checked_scene", "compute_workload", "estimate_cost", "inspect_machine", "limited_objects",
    "limits_from", "load_checked_scene", "machine_problems", "raising_all_problems", "read_checked_scene",
    "refuse_beyond_limits", "refuse_resources",
]  # fmt: skip
