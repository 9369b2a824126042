"""Output files of a design: tables, scene files, ``design.json`` and the HTML report."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from scenetruth.design.optimisation.design_records import (
    Objective,
    compute_rig_interval,
    decide_rig_target,
    describe_decision,
)
from scenetruth.design.optimisation.design_result import (
    RESULT_FILE,
    SCREENING_FILE,
    SUFFICIENT_DENSITY,
    DesignResult,
    describe_rank_consistency,
    write_screening_table,
)
from scenetruth.design.optimisation.interpretation import LIGHT, TEXTURE
from scenetruth.design.optimisation.report.design_charts import build_front_charts, build_sensitivity_charts
from scenetruth.design.optimisation.report.design_tables import (
    build_constraint_table,
    build_discrepancy_table,
    build_front_table,
    build_parameter_table,
    build_rank_consistency_table,
    build_rule_table,
    build_sensitivity_table,
    find_tightest,
    get_catalogue_titles,
)
from scenetruth.design.optimisation.report.scene_file import (
    PREVIEW_FILE,
    build_preview,
    build_preview_file,
    build_scene_file,
    describe_cost,
    format_yaml,
)
from scenetruth.design.optimisation.report.side_view import assign_colours, describe_side_view, draw_side_views
from scenetruth.design.optimisation.report.side_view_geometry import compute_side_view
from scenetruth.design.optimisation.standard_lens import describe_standard_lens
from scenetruth.design.parameter_words import title_parameter
from scenetruth.html import render_page
from scenetruth.number_format import (
    format_interval,
    format_length,
    format_measured,
    format_number,
    format_percent,
    format_signed_percent,
)
from scenetruth.output import write_atomically
from scenetruth.results import to_plain_data
from scenetruth.scene import Scene

__all__ = [
    "ObjectiveResult",
    "derive_blur_limit",
    "describe_sensitivities",
    "list_warnings",
    "summarise_objectives",
    "write_design_files",
    "write_design_page",
]


_LINKED_FILES = (
    ("budget/index.html", "Uncertainty budget of the recommended rig"),
    ("pattern/pattern.pdf", "Pattern for printing at true scale"),
    ("pattern/pattern.svg", "The pattern as SVG"),
    ("recommended/report.html", "Report of a simulation of the recommended rig"),
    ("sweep/index.html", "Sweep around the recommended rig"),
)


def find_links(folder: str | Path) -> list[tuple[str, str]]:
    """Return addresses and titles of existing related files."""
    return [(name, words) for name, words in _LINKED_FILES if (Path(folder) / name).is_file()]


_MOST_LISTED = 3


@dataclass(frozen=True)
class ObjectiveResult:
    """Result of an objective for the recommended rig: value, interval, statistic, comparison with the target."""

    title: str
    figure: str
    unit: str
    between: str  # ends of the prediction interval with the unit; empty without one
    source: str
    verdict: str


def summarise_objectives(design: DesignResult) -> list[ObjectiveResult]:
    """Return the result of each objective for the recommended rig."""
    found = []
    for objective in design.objectives:
        predicted = design.recommended.predicted[objective.title]
        simulated = design.recommended.simulated.get(objective.title)
        if simulated is None:
            source, between = f"predicted {objective.statistic_title}; not simulated", ""
            figure, half = predicted, None
        else:
            between = format_interval(simulated.pi_low, simulated.pi_high)
            line = f"95 %: {between}; " if between else ""
            several = "recording" if simulated.seeds == 1 else "recordings"
            rms = compute_rig_interval(design.recommended, objective.title, "rmse")
            beside = (
                f"; RMSE {format_measured(rms.value, 0.5 * (rms.pi_high - rms.pi_low))}"
                if objective.statistic != "rmse" and rms.seeds
                else ""
            )
            line += f"predicted {format_number(predicted, 2)}{beside}"
            source = f"{objective.statistic_title} in {simulated.seeds} simulated {several} ({line})"
            figure, half = simulated.value, 0.5 * (simulated.pi_high - simulated.pi_low)
        verdict = _verdict(design, objective)
        between = between and f"{between} {objective.unit}"
        found.append(ObjectiveResult(objective.title, _figure(figure, half), objective.unit, between, source, verdict))
    return found


def _figure(value: float, half: float | None) -> str:
    """Return a result; predictions are accurate to two digits."""
    return format_number(value, 2) if half is None else format_measured(value, half)


def _verdict(design: DesignResult, objective: Objective) -> str:
    wanted, title = objective.wanted, objective.title
    if wanted is None:
        return ""
    aim = f"Target: {format_length(wanted)} {objective.unit}"
    decision = decide_rig_target(design.recommended, objective)
    if decision is None:
        met = "meets" if design.recommended.predicted[title] <= wanted else "does not meet"
        return f"{aim}. Undecided: the prediction {met} it, and the rig was not simulated."
    rms = compute_rig_interval(design.recommended, title, "rmse")
    outliers = objective.statistic != "rmse" and decision.answer == "yes" and rms.value > wanted
    words = describe_decision(decision, objective.unit)
    return f"{aim}. {words}." + (" The RMSE, which includes outliers, is above the target." if outliers else "")


def list_equal_rigs(design: DesignResult) -> list[int]:
    """Return the simulated rigs that the first objective does not distinguish from the recommended rig."""
    title, number = design.objectives[0].title, design.recommended.number
    pairs = [(one.better, one.worse) for one in design.orders if one.objective == title and one.verdict == "undecided"]
    return [worse if better == number else better for better, worse in pairs if number in (better, worse)]


_DISTORTION = "the distortion residual after calibration is not included"
_WITH_RIG = (f"{TEXTURE} ", f"{LIGHT} ")


def list_warnings(design: DesignResult) -> list[tuple[str, str]]:
    """Return the warnings of the report with the identifiers of the related sections."""
    values = []
    broken = [one for one in design.recommended.constraints if not one.holds]
    if broken:
        names = ", ".join(one.title for one in broken)
        values.append((f"The recommended rig violates constraints: {names}.", "constraints"))
    residual = next((one for one in design.assumptions if one.startswith(_DISTORTION)), None)
    if residual is not None:
        values.append((f"{residual[:1].upper()}{residual[1:]}.", "assumptions"))
    if not design.recommended.is_confirmed:
        values.append(("The recommended rig was not simulated: its values are predictions.", "agreement"))
    for objective in design.objectives:
        figure = design.recommended.predicted[objective.title]
        if objective.title in design.recommended.simulated:
            figure = design.recommended.simulated[objective.title].value
        decision = decide_rig_target(design.recommended, objective)
        missed = decision.answer == "no" if decision is not None else not figure <= (objective.wanted or math.inf)
        if objective.wanted is not None and (missed or (decision is not None and decision.answer == "undecided")):
            aim = f"{format_number(figure)} {objective.unit}, target {format_length(objective.wanted)} {objective.unit}"
            says = "does not meet the target" if missed else "is not yet shown to meet the target"
            values.append((f"The recommended rig {says}. {objective.title}: {aim}.", "alternatives"))
        values += _far_off(design, objective, figure)
        if design.recommended.density(objective.title) < SUFFICIENT_DENSITY:
            share = f"{100 * design.recommended.density(objective.title):.0f} %"
            words = f"{objective.title}: only {share} of the pixels are valid; the statistics refer to these."
            values.append((words, "agreement"))
    notable = [one for one in design.discrepancies if one.notable]
    if notable:
        count = f"{len(notable)} of {len(design.discrepancies)}"
        own = sum(one.rig == design.recommended.number for one in notable)
        which = f", {own} of them for the recommended rig" if own else ""
        values.append((f"Prediction and simulation differ notably in {count} values{which}.", "agreement"))
    return values


def _far_off(design: DesignResult, objective: Objective, figure: float) -> list[tuple[str, str]]:
    """Return a warning if the objective's statistic meets the target, but the RMSE does not because of outliers."""
    rms = compute_rig_interval(design.recommended, objective.title, "rmse")
    wanted = objective.wanted
    if objective.statistic == "rmse" or wanted is None or not figure <= wanted or not rms.value > wanted:
        return []
    value = f"{format_number(figure)} {objective.unit}"
    words = f"{objective.title}: the errors have outliers. The {objective.statistic_title} is {value},"
    return [(f"{words} but the RMSE {format_number(rms.value)} {objective.unit}.", "alternatives")]


def describe_sensitivities(design: DesignResult) -> list[str]:
    """Return a line on the most influential parameters of each objective, for changes of ±10 %."""
    values = []
    for objective in design.objectives:
        own = [
            one
            for one in design.sensitivities
            if one.objective == objective.title and math.isfinite(one.ten_percent) and one.ten_percent != 0
        ]
        own = sorted(own, key=lambda one: -abs(one.ten_percent))[:_MOST_LISTED]
        if own:
            parts = [
                f"an increase of {_changed_words(one.parameter)} by 10 % changes it by "
                f"{format_signed_percent(one.ten_percent)} ({'better' if one.ten_percent < 0 else 'worse'}), "
                f"a decrease by {format_signed_percent(one.ten_percent_less)}"
                for one in own
            ]
            values.append(f"{objective.title}: {_listed(parts)}.")
    return values


def _changed_words(parameter: str) -> str:
    return f"the {title_parameter(parameter)}"


def _listed(parts: Sequence[str]) -> str:
    return "; ".join(parts)


PAGE = "index.html"
_BLUR_PX = 1.0  # default limit of the blur disc for the depth of field


def write_design_page(design: DesignResult, folder: str | Path) -> Path:
    """Write the HTML report of a design.

    Parameters
    ----------
    design
        The design.
    folder
        Output directory. An existing budget and pattern in it are linked.

    Returns
    -------
    pathlib.Path
        The report.

    Raises
    ------
    SceneError
        If the scene of the recommended rig is invalid.
    StoreError
        If the report cannot be written.

    See Also
    --------
    scenetruth.design.optimisation.optimise : Optimise a rig; writes the report with an output directory.
    scenetruth.DesignResult.load : Load a design from its output directory.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from scenetruth.design.optimisation import optimise
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}, "pose": {"position_mm": [0, 0, 500]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [4, 16]}}
    >>> scene = {"camera": {"width": 64, "height": 48, "focal_length_px": 500}, "objects": [wall]}
    >>> scene |= {"stage": {"positions": 3, "baseline_mm": 4}, "frames": {"count": 3}, "sensor": {"noise_std": 0.01}}
    >>> spec = {"title": "A wall", "scene": scene, "variables": {"stage.baseline_mm": {"values": [4, 6, 8, 10]}}}
    >>> spec |= {"constraints": [{"kind": "stage_travel", "max": 16}], "objectives": [{"quantity": "depth"}]}
    >>> spec |= {"search": {"predictions": 16, "morris_trajectories": 0, "sobol": 0}, "confirmation": {"rigs": 0}}
    >>> design = optimise(spec)
    >>> with TemporaryDirectory() as folder:
    ...     page = write_design_page(design, folder)
    ...     page.name, design.title in page.read_text(encoding="utf-8")
    ('index.html', True)
    """
    view = compute_side_view(
        design.recommended.scene, derive_blur_limit(design.specification), design.objectives[0].region
    )
    on_front, on_parameters = build_front_charts(design), build_sensitivity_charts(design)
    charts = {chart.name: {"data": chart.data, "layout": chart.layout} for chart in (*on_front, *on_parameters)}
    tightest = find_tightest(design.recommended)
    text = render_page(
        "scenetruth.design.optimisation.report",
        "design.html.j2",
        charts,
        design=design,
        rig=design.recommended,
        reached=summarise_objectives(design),
        titles=get_catalogue_titles(design),
        feasible=int(design.screened["holds"].sum()),
        warnings=list_warnings(design),
        tightest=tightest,
        left=format_percent(tightest.margin) if tightest is not None else "",
        equals=list_equal_rigs(design),
        view=view,
        drawings=draw_side_views(view),
        drawn=describe_side_view(view),
        outlines=list(zip(view.outlines, assign_colours(view), strict=True)),
        bought=list(describe_standard_lens(design.standard_lens, design.objectives, design.recommended)),
        required=[f"{line[:1].upper()}{line[1:]}" for line in design.assumptions if line.startswith(_WITH_RIG)],
        assumptions=[line for line in design.assumptions if not line.startswith(_WITH_RIG)],
        parameters=build_parameter_table(design),
        file=build_scene_file(design.recommended, "recommended.yaml"),
        cost=describe_cost(Scene.from_dict(design.recommended.scene)),
        preview=build_preview_file(design),
        preview_changes=build_preview(design).changes,
        front=build_front_table(design),
        front_charts=on_front,
        constraints=build_constraint_table(design.recommended),
        sensitivity_charts=on_parameters,
        sensitivities=build_sensitivity_table(design),
        sensitivity_words=describe_sensitivities(design),
        rules=build_rule_table(design),
        discrepancies=build_discrepancy_table(design),
        orders=build_rank_consistency_table(design),
        order_words=list(describe_rank_consistency(design.objectives, design.orders)),
        specification=format_yaml(design.specification),
        links=find_links(folder),
        number=format_number,
        length=format_length,
    )
    path = Path(folder) / PAGE
    with write_atomically(path, overwrite=True) as partial:
        partial.write_text(text, encoding="utf-8")
    return path


def derive_blur_limit(spec: Mapping[str, Any]) -> float:
    """Return the largest acceptable blur disc of a specification in px; 1 px by default."""
    limits = []
    for one in spec.get("constraints") or ():
        if one.get("kind") == "depth_of_field":
            limits.append(float(one.get("blur_px") or _BLUR_PX))
        elif one.get("kind") == "defocus_blur" and one.get("max"):
            limits.append(float(one["max"]))
    return min(limits, default=_BLUR_PX)


FRONT_FILE, RIG_FILE = "pareto_front.csv", "recommended.yaml"


def write_design_files(design: DesignResult, folder: Path) -> None:
    """Write a design: ``recommended.yaml`` and its preview, tables, ``design.json``, ``index.html``."""
    head = f"# {design.title}: the recommended rig. Run: scenetruth run {RIG_FILE} -o results\n"
    cost = describe_cost(Scene.from_dict(design.recommended.scene))
    head += f"# A run of all images {cost}\n"
    head += f"# (scenetruth check {RIG_FILE} states the time at the speed of this machine); preview: {PREVIEW_FILE}\n"
    text = head + yaml.safe_dump(to_plain_data(design.recommended.scene), sort_keys=False, allow_unicode=True)
    _write_text(folder / RIG_FILE, text)
    light = build_preview(design)
    head = f"# {design.title}: preview of the recommended rig. Run: scenetruth run {PREVIEW_FILE} -o preview\n"
    head += f"# Differences from {RIG_FILE}: {'; '.join(light.changes) or 'none'}\n"
    _write_text(
        folder / PREVIEW_FILE, head + yaml.safe_dump(to_plain_data(light.plain), sort_keys=False, allow_unicode=True)
    )
    with write_atomically(folder / FRONT_FILE, overwrite=True) as partial:
        design.to_dataframe().to_csv(partial, index=False)
    with write_atomically(folder / SCREENING_FILE, overwrite=True) as partial:
        write_screening_table(design.screened, partial)
    _write_text(
        folder / RESULT_FILE, json.dumps(design.to_dict(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    )

    write_design_page(design, folder)


def _write_text(path: Path, text: str) -> None:
    with write_atomically(path, overwrite=True) as partial:
        partial.write_text(text, encoding="utf-8")
