"""The commands `design predict`, `design budget` and `design sweep`, which evaluate a given design."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from scenetruth.cli import design_options, options
from scenetruth.cli.messages import print_wrote
from scenetruth.number_format import (
    UNDEFINED,
    format_interval,
    format_measured,
    format_number,
    format_two_digits,
    format_unit,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from scenetruth.design.prediction import Prediction
    from scenetruth.design.sweeps import Sweep
    from scenetruth.design.uncertainty import Budget
    from scenetruth.estimators import MethodSpec
    from scenetruth.scene import Scene

__all__ = ["budget", "precision_rows", "predict", "print_included", "sweep"]


_INCLUDED = "image noise, texture, light, optics, and the window and motion model of the method"
_NOT_INCLUDED = "errors of stage and calibration, and bias by curvature and edges (see `scenetruth design budget`)"


def budget(
    scene: options.SceneFile,
    output: options.OptionalOutput = None,
    *,
    overrides: options.Overrides = None,
    band: options.Band = None,
    method: options.Method = None,
    settings: options.Settings = None,
    calibration: design_options.Calibration = design_options.CalibrationPreset.typical,
    focal_length_percent: design_options.FocalLengthPercent = None,
    principal_point_px: design_options.PrincipalPointPx = None,
    baseline_percent: design_options.BaselinePercent = None,
    seeds: options.Seeds = "4",
    simulated_share: design_options.SimulatedShare = 0.9,
    region: options.Region = "interior",
    limits: options.Limits = None,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
) -> None:
    """Compute the uncertainty budget of a scene: sources, contributions, mitigations."""
    from scenetruth.cli.console import reporting
    from scenetruth.design.uncertainty import budget as make_budget
    from scenetruth.design.uncertainty.source import resolve_calibration
    from scenetruth.errors import Problem, RecipeError
    from scenetruth.resources import limits_from, load_checked_scene

    values = {
        "focal_length_percent": focal_length_percent,
        "principal_point_px": principal_point_px,
        "baseline_percent": baseline_percent,
    }
    given = {name: value for name, value in values.items() if value is not None}
    known = resolve_calibration({**resolve_calibration(calibration.value).model_dump(), **given})
    loaded = options.choose_band(load_checked_scene(scene, overrides=overrides or ()), band)
    chosen = options.read_settings(settings)
    with reporting() as reporter:
        found = make_budget(
            loaded,
            output=output,
            method=_select_method(loaded, method, chosen) if chosen else method,
            calibration=known,
            seeds=design_options.read_seeds(seeds) or 4,
            simulated_share=simulated_share,
            region=region,
            limits=limits_from(limits or ()),
            workers=workers,
            scheduler=scheduler,
            progress=reporter,
        )
    if region not in found.regions:
        problem = Problem("--region", f"must be one of {', '.join(found.regions)}", region)
        raise RecipeError([problem], source="an uncertainty budget")
    _print_budget(found, region)
    if output is not None:
        names = ("index.html", "waterfall.png", "budget.csv")
        print_wrote(output / name for name in names)
    if found.failures:
        raise typer.Exit(1)


def _select_method(scene: Scene, method: str | None, settings: Mapping[str, Any]) -> MethodSpec:
    from scenetruth.estimators import MethodSpec

    if method is not None and method != scene.estimate.method:
        return MethodSpec(method, settings)
    return MethodSpec(scene.estimate.method, {**scene.estimate.settings.model_dump(), **settings})


def _print_budget(found: Budget, region: str) -> None:
    from rich.table import Table

    from scenetruth.cli.console import make_console
    from scenetruth.design.uncertainty.budget_report import SHOWN_QUANTITIES, format_contribution
    from scenetruth.errors import visible
    from scenetruth.scoring.quantities import get_title

    for quantity in (one for one in SHOWN_QUANTITIES if found.contributions(one, region)):
        total = found.combined(quantity, region)
        heading = f"{get_title(quantity)}, {format_unit(total.unit)}, {region}"
        table = Table(title=visible(heading, lines=False), title_justify="left")
        table.add_column("source")
        table.add_column("magnitude", overflow="fold")
        for name in ("contribution", "predicted", "simulated"):
            table.add_column(name, justify="right")
        for one in found.contributions(quantity, region):
            values = (one.value, one.predicted, one.simulated)
            cells = (one.title, one.size, *(format_contribution(value, total.root_sum_square) for value in values))
            table.add_row(*(visible(cell, lines=False) for cell in cells))
        table.add_row("root sum of squares", "", format_two_digits(total.root_sum_square), "", "")
        table.add_row("all sources", "", "", "", format_two_digits(total.simulated))
        make_console().print(table)
    for line in (*found.summary(region).splitlines(), *found.failures):
        typer.echo(visible(line))


def predict(
    scene: options.SceneFile,
    *,
    overrides: options.Overrides = None,
    band: options.Band = None,
    model: design_options.Model = design_options.PredictionModel.analytic,
    method: options.Method = None,
    settings: options.Settings = None,
    region: options.Region = "interior",
    output: options.OptionalOutput = None,
    overwrite: options.Overwrite = False,
    limits: options.Limits = None,
) -> None:
    """Predict the standard uncertainty of depth, slope, motion and growth, without simulation."""
    from scenetruth.cli.console import reporting
    from scenetruth.design.prediction import predict as predicted
    from scenetruth.design.prediction import recommend
    from scenetruth.design.prediction.method_models import all_method_models
    from scenetruth.design.prediction.prediction_result import write_prediction
    from scenetruth.errors import Problem, SceneError
    from scenetruth.resources import limits_from, load_checked_scene

    window = _prediction_settings(settings)
    loaded = options.choose_band(load_checked_scene(scene, overrides=overrides or ()), band)
    allowed = limits_from(limits or ())
    own = loaded.estimate.method if loaded.estimate.method in all_method_models() else "refined"
    with reporting():
        found = predicted(
            loaded,
            model=model.value,
            method=method or own,
            limits=allowed,
            **window,
        )
    if region not in found.regions:
        problem = Problem("--region", f"must be one of {', '.join(found.regions)}", region)
        raise SceneError([problem], source=scene)
    _print_prediction(found, region)
    for line in recommend(loaded, found):
        typer.echo(f"warning: {line}")
    if output is not None:
        print_wrote(output / name for name in write_prediction(found, output, overwrite=overwrite))


_MOTIONS = ("translation", "rigid", "growing", "affine", "auto")


def _prediction_settings(given: list[str] | None) -> dict[str, Any]:
    from scenetruth.errors import EstimateError, Problem

    settings = options.read_settings(given)
    allowed = ("window_sigma_px", "motion")
    problems = [
        Problem(f"--setting {name}", f"does not affect a prediction; use {' or '.join(allowed)}", value)
        for name, value in settings.items()
        if name not in allowed
    ]
    window, motion = settings.get("window_sigma_px", 1.0), settings.get("motion", "rigid")
    if isinstance(window, bool) or not isinstance(window, int | float):
        problems.append(Problem("--setting window_sigma_px", "must be a number of px", window))
    if motion not in _MOTIONS:
        problems.append(Problem("--setting motion", f"must be one of {', '.join(_MOTIONS)}", motion))
    if problems:
        raise EstimateError(problems)
    return settings


def precision_rows(prediction: Prediction, region: str) -> list[tuple[str, str, str, str]]:
    """Return quantity, precision, RMS of the true motion or growth, and their ratio."""
    from scenetruth.design.prediction.prediction_result import TITLES

    rows = []
    for quantity, figure in prediction.precisions[region].items():
        if quantity in _LEFT_OUT:
            continue
        signal, ratio = figure.signal_value, figure.signal_to_noise
        there = "" if signal is None else format_number(signal)
        times = "" if ratio is None or not signal else format_number(ratio)
        unit = "" if figure.value_unit == "1" else f" {figure.value_unit}"
        precision = f"{format_number(figure.value)}{unit}" if figure.valid_fraction else "invalid"
        rows.append((TITLES[quantity], precision, there, times))
    return rows


_LEFT_OUT = ("disparity", "velocity_epe", "normal")


def _print_prediction(prediction: Prediction, region: str) -> None:
    from rich.table import Table

    from scenetruth.cli.console import make_console
    from scenetruth.errors import visible

    causes = prediction.causes
    of = "minimum standard deviation" if prediction.method == "refined" else "standard deviation"
    table = Table(title=visible(f"{region}: {of} per pixel, {prediction.method}", lines=False), title_justify="left")
    table.add_column("quantity")
    for heading in ("precision", "true RMS", "ratio"):
        table.add_column(heading, justify="right")
    for row in precision_rows(prediction, region):
        table.add_row(*map(visible, row))
    make_console().print(table)
    rows = {
        "grey-value noise": f"{100 * causes.noise_std:.3g} % of full scale, and "
        f"{format_two_digits(100 * causes.pattern_std)} % fixed-pattern noise",
        "texture": f"contrast {100 * causes.contrast:.3g} % of full scale, gradient "
        f"{100 * causes.gradient_x:.3g} and {100 * causes.gradient_y:.3g} % per px along x and y, wavelength about "
        f"{causes.wavelength_px:.3g} px",
        "lens, pixels, motion": f"transfer {100 * causes.transfer:.3g} % of the contrast; during exposure, "
        + (
            f"points move by up to {format_two_digits(causes.blur_px)} px (95th percentile)"
            if causes.blur_px > 0
            else "nothing moves"
        ),
        "rig": f"{causes.positions} positions, {causes.frames} frames at a time, {causes.disparity_px:.3g} px per step "
        f"at {causes.depth_mm:.4g} mm",
        "window": f"standard deviation {causes.window_sigma_px:g} px; motion {causes.motion}",
    }
    table = Table(title="inputs, medians over all visible pixels", title_justify="left", show_header=False)
    for name, text in rows.items():
        table.add_row(name, text)
    make_console().print(table)
    print_included("median over the region")
    for note in prediction.notes:
        typer.echo(f"note: {visible(note)}")


def print_included(of: str) -> None:
    """Print the sources of error that a predicted precision includes; ``of``: statistic and region."""
    typer.echo(f"precision: {of}; includes {_INCLUDED}; not included: {_NOT_INCLUDED}")


def sweep(
    scenes: options.SceneFiles,
    vary: design_options.Vary = None,
    *,
    output: options.Output,
    methods: options.LabelledMethods = None,
    settings: options.Settings = None,
    seeds: options.Seeds = "3",
    sobol_points: design_options.SobolPoints = 0,
    overrides: options.Overrides = None,
    region: options.Region = "interior",
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
    limits: options.Limits = None,
) -> None:
    """Simulate, estimate and score scenes over the levels of one or more factors."""
    from scenetruth.cli.console import reporting
    from scenetruth.design.sweeps import sweep as make_sweep
    from scenetruth.design.sweeps.factors import split_assignments
    from scenetruth.design.sweeps.sweep_plan import build_plan
    from scenetruth.errors import ArgumentError, CollectedErrors
    from scenetruth.resources.limits import limits_from

    varied, problems = split_assignments(vary or ())
    counted = design_options.parse_seeds(seeds, problems)
    changes, errors = list(overrides or ()), CollectedErrors()
    chosen: list[MethodSpec] = []
    with errors.collect():
        if problems:
            raise ArgumentError(problems, source="a sweep")
    with errors.collect():
        most = limits_from(limits or ())
    with errors.collect():
        if not methods:
            options.read_settings(settings)
            changes += [f"estimate.{setting}" for setting in settings or ()]
        chosen = options.with_settings(methods or (), settings)
    if errors and varied:
        with errors.collect():
            build_plan(scenes, varied, counted or 1, sobol_points, overrides=changes, own_methods=not methods)
    errors.raise_all()
    with reporting() as reporter:
        found = make_sweep(
            scenes,
            varied,
            methods=chosen or None,
            output=output,
            seeds=counted,
            sobol_points=sobol_points,
            overrides=changes,
            workers=workers,
            scheduler=scheduler,
            limits=most,
            progress=reporter,
        )
    _print_best(found, region)
    print_wrote(output / name for name in ("index.html", "results.csv", "plots"))
    if found.failures:
        raise typer.Exit(1)


def _print_best(found: Sweep, region: str) -> None:
    from rich.table import Table

    from scenetruth.cli.console import make_console
    from scenetruth.design.sweeps.plot_model import choose_main_region, describe_place, list_plotted_quantities
    from scenetruth.design.sweeps.sweep_report import find_only_method, names_methods
    from scenetruth.errors import ArgumentError, Problem, visible
    from scenetruth.scoring.quantities import get_title

    regions = {row.region for row in found.rows}
    if region not in regions and region == "interior":
        region = choose_main_region(found)
    elif region not in regions:
        raise ArgumentError(
            [Problem("--region", f"must be one of {', '.join(sorted(regions))}", region)], source="a sweep"
        )
    lines: list[list[str]] = []
    for quantity in list_plotted_quantities(found):
        try:
            best = found.best(quantity, region=region)
        except KeyError:
            continue
        at = describe_place(best)
        scene = f"{best.scene}: " if len(found.scenes) > 1 else ""
        interval = format_interval(best.ci_low, best.ci_high) or UNDEFINED
        value = format_measured(best.value, 0.5 * (best.ci_high - best.ci_low))
        lines.append([get_title(quantity), value, interval, format_unit(best.unit), scene + at, best.method])
    only = find_only_method([line[-1] for line in lines])
    shown = names_methods(found) and not only
    title = f"smallest RMSE of each quantity, region {region}"
    title += f", all of the method {only}" if names_methods(found) and only else ""
    table = Table(title=visible(title, lines=False), title_justify="left")
    for heading in ("quantity", "RMSE", "95 %", "unit", "at", *(["method"] if shown else [])):
        table.add_column(heading, overflow="fold")
    for cells in lines:
        table.add_row(*(visible(cell, lines=False) for cell in (cells if shown else cells[:-1])))
    make_console().print(table)
    for line in (*found.notes, *found.failures):
        typer.echo(visible(line, lines=False), err=True)
