"""Uncertainty budget of depth, motion and growth: contributions of all sources, and mitigations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.design.uncertainty.budget_builder import budget
from scenetruth.design.uncertainty.contributions import CombinedUncertainty, Contribution
from scenetruth.design.uncertainty.observation_model import (
    ImageDisturbance,
    ObservationModel,
    build_observation_model,
    displace_camera,
    disturb_poses,
    shift_in_time,
)
from scenetruth.design.uncertainty.propagation import Propagation, select_propagation
from scenetruth.design.uncertainty.simulation_runs import BudgetTask, SimulationRun, simulate_run
from scenetruth.design.uncertainty.source import (
    Calibration,
    Mitigation,
    active_sources,
    all_sources,
    contrast_sources,
    resolve_calibration,
    restrict_sources,
)
from scenetruth.design.uncertainty.uncertainty_budget import Budget
from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.design.uncertainty.budget_report import compute_bars, make_waterfalls, write_page, write_waterfall
    from scenetruth.design.uncertainty.sources.stage import make_stage_schedule

__all__ = [
    "Budget", "BudgetTask", "Calibration", "CombinedUncertainty", "Contribution", "ImageDisturbance", "Mitigation",
    "ObservationModel", "Propagation", "SimulationRun", "active_sources", "all_sources", "budget",
    "build_observation_model", "compute_bars", "contrast_sources", "displace_camera", "disturb_poses",
    "make_stage_schedule", "make_waterfalls", "resolve_calibration", "restrict_sources", "select_propagation",
    "shift_in_time", "simulate_run", "write_page", "write_waterfall",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "budget_report": "compute_bars make_waterfalls write_page write_waterfall",
        "sources.stage": "make_stage_schedule",
    },
)
