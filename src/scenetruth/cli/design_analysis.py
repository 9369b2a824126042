"""The commands `design predict`, `design budget` and `design sweep`, which evaluate a given design."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scenetruth.cli import options
from scenetruth.cli.options import SCENES, file_completer, resolve_file

if TYPE_CHECKING:
    from scenetruth.design.prediction import Prediction
    from scenetruth.design.sweeps import Sweep
    from scenetruth.design.uncertainty import Budget

__all__ = ["budget", "precision_rows", "predict", "sweep"]


class CalibrationPreset(StrEnum):
    """How well the calibration is known."""

    typical = "typical"
    perfect = "perfect"


def budget(
    scene: options.SceneFile,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder of the budget; goes on where it was.", show_default=False),
    ] = None,
    *,
    overrides: options.Overrides = None,
    method: Annotated[
        str | None,
        typer.Option("--method", metavar="NAME", help="Method of estimation; the scene's if not given."),
    ] = None,
    calibration: Annotated[
        CalibrationPreset,
        typer.Option("--calibration", help="How well focal length, principal point and baseline are known."),
    ] = CalibrationPreset.typical,
    focal_length_percent: Annotated[
        float | None, typer.Option("--focal-length-percent", help="Standard deviation of the focal length, in %.")
    ] = None,
    principal_point_px: Annotated[
        float | None, typer.Option("--principal-point-px", help="Of the principal point, along x and y, in px.")
    ] = None,
    baseline_percent: Annotated[
        float | None, typer.Option("--baseline-percent", help="Of the scale of the stage's positions, in %.")
    ] = None,
    draws: Annotated[int, typer.Option("--draws", min=1, max=1000, help="Seeds that are simulated.")] = 4,
    confirm: Annotated[
        float,
        typer.Option("--confirm", min=0, max=1, help="Share of the sum of squares that is simulated; 1 for all."),
    ] = 0.9,
    region: Annotated[
        str, typer.Option("--region", help="Where figures are told for: interior, all, object_NAME.")
    ] = "interior",
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
) -> None:
    """Tell which error of depth, motion and growth comes from where, and what helps most."""
    from scenetruth.cli.console import reporting
    from scenetruth.design.uncertainty import budget as make_budget
    from scenetruth.design.uncertainty.source import resolve_calibration
    from scenetruth.errors import Problem, RecipeError
    from scenetruth.scene import load_scene

    told = {
        "focal_length_percent": focal_length_percent,
        "principal_point_px": principal_point_px,
        "baseline_percent": baseline_percent,
    }
    given = {name: value for name, value in told.items() if value is not None}
    known = resolve_calibration({**resolve_calibration(calibration.value).model_dump(), **given})
    loaded = load_scene(scene, overrides=overrides or ())
    with reporting() as reporter:
        found = make_budget(
            loaded,
            output=output,
            method=method,
            calibration=known,
            seeds=draws,
            simulated_share=confirm,
            region=region,
            workers=workers,
            scheduler=scheduler,
            progress=reporter,
        )
    if region not in found.regions:
        problem = Problem("--region", f"must be one of {', '.join(found.regions)}", region)
        raise RecipeError([problem], source="an error budget")
    _print_budget(found, region)
    if output is not None:
        names = ("index.html", "waterfall.png", "budget.csv")
        typer.echo(f"written: {', '.join(str(output / name) for name in names)}")
    if found.failures:
        raise typer.Exit(1)


def _print_budget(found: Budget, region: str) -> None:
    from rich.table import Table

    from scenetruth.cli.console import make_console
    from scenetruth.design.uncertainty.budget_report import SHOWN_QUANTITIES
    from scenetruth.design.uncertainty.uncertainty_budget import number, unit_text
    from scenetruth.errors import visible
    from scenetruth.scoring.quantities import get_title

    for quantity in (one for one in SHOWN_QUANTITIES if found.of(one, region)):
        total = found.total(quantity, region)
        heading = f"{get_title(quantity)}, {unit_text(total.unit)}, {region}"
        table = Table(title=visible(heading, lines=False), title_justify="left")
        table.add_column("cause")
        table.add_column("size", overflow="fold")
        for name in ("part", "predicted", "simulated"):
            table.add_column(name, justify="right")
        for one in found.of(quantity, region):
            cells = (one.title, one.size, number(one.figure), number(one.predicted), number(one.simulated))
            table.add_row(*(visible(cell, lines=False) for cell in cells))
        table.add_row("root of the sum of squares", "", number(total.parts), "", "")
        table.add_row("everything on", "", "", "", number(total.simulated))
        make_console().print(table)
    for line in (*found.words(region), *found.failures):
        typer.echo(visible(line))


class PredictionModel(StrEnum):
    """How much is computed."""

    envelope = "analytic"
    bound = "maps"


class WindowMotion(StrEnum):
    """What is unknown of how velocity changes in a window."""

    translation = "translation"
    rigid = "rigid"
    growing = "growing"
    affine = "affine"


def predict(
    scene: options.SceneFile,
    *,
    overrides: options.Overrides = None,
    level: Annotated[
        PredictionModel,
        typer.Option("--level", help="From the texture's spectrum, or from a rendered image, with maps."),
    ] = PredictionModel.envelope,
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            metavar="NAME",
            help="Method whose noise is predicted: refined, structure_tensor. The scene's if not given.",
            show_default=False,
        ),
    ] = None,
    window_sigma_px: Annotated[
        float | None,
        typer.Option("--window-sigma-px", help="Of its window; the method's if not given.", show_default=False),
    ] = None,
    motion: Annotated[
        WindowMotion | None,
        typer.Option("--motion", help="What it does not know of motion; its own if not given.", show_default=False),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder to make for the table, and the maps.", show_default=False),
    ] = None,
    overwrite: options.Overwrite = False,
    limits: options.Limits = None,
) -> None:
    """Predict how precisely depth, slopes, motion and growth can be known: no noise is drawn."""
    from scenetruth.cli.console import reporting
    from scenetruth.design.prediction import predict as predicted
    from scenetruth.design.prediction import recommend
    from scenetruth.design.prediction.method_models import all_method_models
    from scenetruth.resources.limits import limits_from
    from scenetruth.scene import load_scene

    loaded, allowed = load_scene(scene, overrides=overrides or ()), limits_from(limits or ())
    own = loaded.estimate.method if loaded.estimate.method in all_method_models() else "refined"
    with reporting():
        found = predicted(
            loaded,
            model=level.value,
            method=method or own,
            window_sigma_px=window_sigma_px,
            motion=None if motion is None else motion.value,
            limits=allowed,
        )
    _print_prediction(found)
    for line in recommend(loaded, found):
        typer.echo(f"warning: {line}")
    if output is not None:
        from scenetruth.design.prediction.prediction_result import write_prediction

        names = write_prediction(found, output, overwrite=overwrite)
        typer.echo(f"written: {', '.join(str(output / name) for name in names)}")


def precision_rows(prediction: Prediction, region: str) -> list[tuple[str, str, str, str]]:
    """Return quantity, precision, what there is to be measured, and how many standard deviations that is."""
    from scenetruth.design.prediction.prediction_result import TITLES

    rows = []
    for quantity, figure in prediction.figures[region].items():
        if quantity in _LEFT_OUT:
            continue
        signal, ratio = figure.signal_value, figure.signal_to_noise
        there = "" if signal is None else f"{signal:.3g}"
        times = "" if ratio is None or not signal else f"{ratio:.3g}"
        unit = "" if figure.value_unit == "1" else f" {figure.value_unit}"
        precision = f"{figure.value:.3g}{unit}" if figure.known_share else "not known"
        rows.append((TITLES[quantity], precision, there, times))
    return rows


_LEFT_OUT = ("disparity", "velocity_endpoint", "normal")


def _print_prediction(prediction: Prediction) -> None:
    from rich.table import Table

    from scenetruth.cli.console import make_console
    from scenetruth.errors import visible

    causes = prediction.causes
    of = "least standard deviation" if prediction.method == "refined" else "standard deviation"
    for region in prediction.regions:
        if region == "interior" and len(prediction.regions) == _WITH_ONE_OBJECT:
            continue
        table = Table(
            title=visible(f"{region}: {of} per pixel, {prediction.method}", lines=False), title_justify="left"
        )
        table.add_column("quantity")
        for heading in ("precision", "there is", "ratio"):
            table.add_column(heading, justify="right")
        for row in precision_rows(prediction, region):
            table.add_row(*map(visible, row))
        make_console().print(table)
    rows = {
        "noise of a grey value": f"{100 * causes.noise_std:.3g} % of full scale, and "
        f"{100 * causes.pattern_std:.2g} % that stay with the pixels",
        "texture": f"contrast {100 * causes.contrast:.3g} % of full scale, gradient "
        f"{100 * causes.gradient_x:.3g} and {100 * causes.gradient_y:.3g} % per px along x and y, waves of about "
        f"{causes.wavelength_px:.3g} px",
        "lens, pixels, motion": f"leave {100 * causes.transfer:.3g} % of its contrast; while an image is taken, "
        + (
            f"what moves moves by up to {causes.blur_px:.2g} px (95 % of it)" if causes.blur_px > 0 else "nothing moves"
        ),
        "rig": f"{causes.positions} positions, {causes.frames} frames at a time, {causes.disparity_px:.3g} px per step "
        f"at {causes.depth_mm:.4g} mm",
        "window": f"standard deviation {causes.window_sigma_px:g} px; motion {causes.motion}",
    }
    table = Table(title="what goes into it, medians over all that is seen", title_justify="left", show_header=False)
    for name, text in rows.items():
        table.add_row(name, text)
    make_console().print(table)
    for note in prediction.notes:
        typer.echo(f"note: {visible(note)}")


_WITH_ONE_OBJECT = 3


def sweep(
    scenes: Annotated[
        list[Path],
        typer.Argument(
            metavar="SCENE...",
            help="Scene files (YAML), or names of `scenetruth scenes`.",
            show_default=False,
            callback=lambda given: [resolve_file(SCENES, one) for one in given],
            autocompletion=file_completer(SCENES),
        ),
    ],
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="PATH=VALUES",
            help="A field and its values: 1,2,5; 1..10:4, four of them; 1..10:4log; 1..10 and 1..10:log with --sobol. "
            "May be repeated: all combinations are made.",
            show_default=False,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder of the sweep; goes on where it was.", show_default=False),
    ] = None,
    *,
    methods: Annotated[
        list[str] | None,
        typer.Option(
            "--method",
            metavar="NAME",
            help="Methods: NAME, MODULE:FUNCTION, NAME\\[setting: value, ...], LABEL=NAME\\[...]; may be repeated. "
            "Each scene's own if not given.",
            show_default=False,
        ),
    ] = None,
    seeds: Annotated[
        str, typer.Option("--seeds", metavar="NUMBER", help="How many seeds each point has; or a list, as 1,2,3.")
    ] = "3",
    sobol: Annotated[
        int, typer.Option("--sobol", min=0, metavar="NUMBER", help="Points that fill the ranges without a number.")
    ] = 0,
    overrides: options.Overrides = None,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
    limits: options.Limits = None,
) -> None:
    """Simulate, estimate and score scenes over whatever varies; with plots, error bars and the bound of noise."""
    from scenetruth.cli.console import reporting
    from scenetruth.design.sweeps import sweep as make_sweep
    from scenetruth.design.sweeps.factors import split_assignments
    from scenetruth.design.sweeps.sweep_plan import SweepError
    from scenetruth.errors import Problem
    from scenetruth.estimators.method_specs import parse_methods
    from scenetruth.resources.limits import limits_from

    varied, problems = split_assignments(vary or ())
    if output is None:
        problems.append(Problem("--output", "is missing: the folder where results go"))
    counted: int | list[int] = 0
    try:
        numbers = [int(one) for one in seeds.split(",")]
        counted = numbers if "," in seeds else numbers[0]
    except ValueError:
        problems.append(Problem("--seeds", "must be a number of seeds, or a list of them as 1,2,3", seeds))
    if problems or output is None:
        raise SweepError(problems)
    with reporting() as reporter:
        found = make_sweep(
            scenes,
            varied,
            methods=parse_methods(methods) if methods else None,
            output=output,
            seeds=counted,
            sobol_points=sobol,
            overrides=overrides or (),
            workers=workers,
            scheduler=scheduler,
            limits=limits_from(limits or ()),
            progress=reporter,
        )
    _print_best(found)
    typer.echo(f"written: {', '.join(str(output / name) for name in ('index.html', 'results.parquet', 'results.csv'))}")
    typer.echo(f"pictures: {output / 'plots'}")
    if found.failures:
        raise typer.Exit(1)


def _print_best(found: Sweep) -> None:
    from rich.table import Table

    from scenetruth.cli.console import make_console
    from scenetruth.design.sweeps.factors import format_level
    from scenetruth.design.sweeps.plot_model import choose_main_region, list_plotted_quantities
    from scenetruth.errors import visible
    from scenetruth.scoring.quantities import get_title

    region = choose_main_region(found)
    table = Table(title=f"least rms error of each quantity, region {region}", title_justify="left")
    for heading in ("quantity", "rms", "95 %", "unit", "at", "method"):
        table.add_column(heading, overflow="fold")
    for quantity in list_plotted_quantities(found):
        try:
            best = found.best(quantity, region=region)
        except KeyError:
            continue
        at = ", ".join(f"{path} = {format_level(value)}" for path, value in best.values.items())
        scene = f"{best.scene}: " if len(found.scenes) > 1 else ""
        interval = f"{best.low:.3g} to {best.high:.3g}" if best.low == best.low else "–"
        cells = (get_title(quantity), f"{best.number:.3g}", interval, best.unit, scene + at, best.method)
        table.add_row(*(visible(cell, lines=False) for cell in cells))
    make_console().print(table)
    for line in (*found.notes, *found.failures):
        typer.echo(visible(line, lines=False), err=True)
