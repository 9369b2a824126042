"""Optimisation of a rig: specification, catalogues, constraints, search, and confirmation by simulation."""

from scenetruth.design.optimisation.catalogues import load_catalogues
from scenetruth.design.optimisation.choice_descents import descend_from_choices
from scenetruth.design.optimisation.confirmation import (
    ConfirmationTask,
    check_pair_rank,
    check_rank_consistency,
    compare_with_prediction,
    find_indistinct,
    get_simulated_statistic,
    reduce_scene,
    simulate_candidate,
    simulate_candidates,
    simulate_objectives,
)
from scenetruth.design.optimisation.constraints import ConstraintSpec, evaluate_bound
from scenetruth.design.optimisation.design_records import (
    STATISTICS,
    ConstraintValue,
    Discrepancy,
    Objective,
    PredictionInterval,
    RigDesign,
    RuleOfThumb,
    Sensitivity,
    compute_predicted_statistic,
    compute_prediction_interval,
    compute_rig_interval,
    decide_target,
    describe_decision,
)
from scenetruth.design.optimisation.design_result import (
    DesignResult,
    compose_summary,
    describe_rank_consistency,
    format_parameter,
)
from scenetruth.design.optimisation.design_search import (
    allocate_evaluations,
    analyse_sensitivity,
    search_with_optuna,
)
from scenetruth.design.optimisation.evaluation_log import EvaluationLog
from scenetruth.design.optimisation.interpretation import (
    check_rules_of_thumb,
    compute_local_sensitivities,
    describe_limiting_factors,
    list_assumptions,
    rig_from_evaluation,
)
from scenetruth.design.optimisation.optimiser import optimise
from scenetruth.design.optimisation.pareto_front import (
    add_alternatives,
    find_pareto_front,
    select_distinguishable,
    select_recommended,
    thin_front,
)
from scenetruth.design.optimisation.problem_setup import OptimisationProblem, load_problem, prepare_problem
from scenetruth.design.optimisation.report.design_charts import (
    AxisSpec,
    build_axis,
    build_front_charts,
    build_sensitivity_charts,
)
from scenetruth.design.optimisation.report.design_report import (
    derive_blur_limit,
    describe_sensitivities,
    list_warnings,
    summarise_objectives,
    write_design_files,
    write_design_page,
)
from scenetruth.design.optimisation.report.design_tables import (
    build_constraint_table,
    build_discrepancy_table,
    build_front_table,
    build_parameter_table,
    build_rank_consistency_table,
    build_sensitivity_table,
)
from scenetruth.design.optimisation.report.scene_file import build_preview_file, build_scene_file
from scenetruth.design.optimisation.report.side_view import choose_round_length_mm, describe_side_view, draw_side_views
from scenetruth.design.optimisation.report.side_view_geometry import (
    SideView,
    compute_depth_of_field,
    compute_outline,
    compute_side_view,
)
from scenetruth.design.optimisation.rig_context import RigContext, compute_stage_shifts_px, compute_stage_uncertainty
from scenetruth.design.optimisation.rig_evaluation import (
    BaseRig,
    DesignSpace,
    Evaluation,
    EvaluationTask,
    Parameter,
    build_rig,
    compute_objective_contributions,
    evaluate_rig,
    rank_evaluations,
)
from scenetruth.design.optimisation.specification import (
    CONSTRAINT_MODULES,
    ConfirmationSpec,
    DesignSpec,
    IlluminationSpec,
    SearchSpec,
    load_design_spec,
)
from scenetruth.design.optimisation.standard_lens import (
    F_STOPS,
    StandardLens,
    choose_f_stop,
    choose_standard_lens,
    describe_standard_lens,
)

__all__ = [
    "CONSTRAINT_MODULES", "F_STOPS", "STATISTICS", "AxisSpec", "BaseRig", "ConfirmationSpec", "ConfirmationTask",
    "ConstraintSpec", "ConstraintValue", "DesignResult", "DesignSpace", "DesignSpec", "Discrepancy", "Evaluation",
    "EvaluationLog", "EvaluationTask", "IlluminationSpec", "Objective", "OptimisationProblem", "Parameter",
    "PredictionInterval", "RigContext", "RigDesign", "RuleOfThumb", "SearchSpec", "Sensitivity", "SideView",
    "StandardLens", "add_alternatives", "allocate_evaluations", "analyse_sensitivity", "build_axis",
    "build_constraint_table", "build_discrepancy_table", "build_front_charts", "build_front_table",
    "build_parameter_table", "build_preview_file", "build_rank_consistency_table", "build_rig", "build_scene_file",
    "build_sensitivity_charts", "build_sensitivity_table", "check_pair_rank", "check_rank_consistency",
    "check_rules_of_thumb", "choose_f_stop", "choose_round_length_mm", "choose_standard_lens",
    "compare_with_prediction", "compose_summary", "compute_depth_of_field", "compute_local_sensitivities",
    "compute_objective_contributions", "compute_outline", "compute_predicted_statistic",
    "compute_prediction_interval", "compute_rig_interval", "compute_side_view", "compute_stage_shifts_px",
    "compute_stage_uncertainty", "decide_target", "derive_blur_limit", "descend_from_choices", "describe_decision",
    "describe_limiting_factors", "describe_rank_consistency", "describe_sensitivities", "describe_side_view",
    "describe_standard_lens", "draw_side_views", "evaluate_bound", "evaluate_rig", "find_indistinct",
    "find_pareto_front",
    "format_parameter", "get_simulated_statistic", "list_assumptions", "list_warnings", "load_catalogues",
    "load_design_spec", "load_problem", "optimise", "prepare_problem", "rank_evaluations", "reduce_scene",
    "rig_from_evaluation",
    "search_with_optuna", "select_distinguishable", "select_recommended", "simulate_candidate",
    "simulate_candidates", "simulate_objectives", "summarise_objectives", "thin_front", "write_design_files",
    "write_design_page",
]  # fmt: skip
