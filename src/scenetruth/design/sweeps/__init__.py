"""Sweeps: complete simulations over lists, ranges or Sobol points of factors, with the same seeds at every point."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scenetruth.design.sweeps.aggregation import (
    Interval,
    compute_mean,
    compute_positive_mean,
    compute_root_mean_square,
    compute_scatter,
)
from scenetruth.design.sweeps.factors import Factor, format_level, parse_factors, split_assignments
from scenetruth.design.sweeps.point_simulation import bound_window_from_method, compute_normal_statistics
from scenetruth.design.sweeps.sweep_plan import build_plan
from scenetruth.design.sweeps.sweep_result import STATISTICS, Sweep, SweepRecord
from scenetruth.design.sweeps.sweep_runner import sweep
from scenetruth.lazy_exports import export_lazily

if TYPE_CHECKING:
    from scenetruth.design.sweeps.plot_model import build_panels, list_plotted_quantities
    from scenetruth.design.sweeps.static_plots import write_static_plots
    from scenetruth.design.sweeps.sweep_report import build_chart, find_only_method, write_sweep_report

__all__ = [
    "STATISTICS", "Factor", "Interval", "Sweep", "SweepRecord", "bound_window_from_method", "build_chart",
    "build_panels", "build_plan", "compute_mean", "compute_normal_statistics", "compute_positive_mean",
    "compute_root_mean_square", "compute_scatter", "find_only_method", "format_level", "list_plotted_quantities",
    "parse_factors", "split_assignments", "sweep", "write_static_plots", "write_sweep_report",
]  # fmt: skip

__getattr__, __dir__ = export_lazily(
    __name__,
    {
        "plot_model": "build_panels list_plotted_quantities",
        "static_plots": "write_static_plots",
        "sweep_report": "build_chart find_only_method write_sweep_report",
    },
)
