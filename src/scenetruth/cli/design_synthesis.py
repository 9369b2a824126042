"""The commands `design optimise` and `design pattern`, which propose a design, and the group of all design commands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import typer

from scenetruth.cli import design_options, options
from scenetruth.cli.design_analysis import budget, predict, sweep
from scenetruth.cli.messages import print_wrote
from scenetruth.number_format import format_interval, format_number, format_unit

if TYPE_CHECKING:
    from scenetruth.capture import BoardKind
    from scenetruth.design.optimisation import DesignResult
    from scenetruth.design.patterns import PatternAssessment, PatternRig

__all__ = ["optimise", "register"]


def optimise(
    specification: options.DesignFile,
    *,
    output: options.Output,
    overrides: options.Overrides = None,
    seeds: options.ConfirmationSeeds = None,
    limits: options.Limits = None,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
) -> None:
    """Optimise a camera rig by predicted uncertainty, and simulate the best candidates."""
    from scenetruth.cli.console import print_warning, reporting
    from scenetruth.design.optimisation import optimise as find_rig
    from scenetruth.design.optimisation.report.scene_file import PREVIEW_FILE, describe_cost, find_cost_problems
    from scenetruth.resources.limits import limits_from
    from scenetruth.scene import Scene

    with reporting() as reporter:
        found = find_rig(
            specification,
            overrides=overrides or (),
            seeds=seeds,
            limits=limits_from(limits or ()),
            output=output,
            workers=workers,
            scheduler=scheduler,
            progress=reporter,
        )
    _print_front(found)
    _print_lines(*found.summary().splitlines())
    names = ("index.html", "recommended.yaml", PREVIEW_FILE, "pareto_front.csv", "evaluations.csv", "design.json")
    scene = Scene.from_dict(dict(found.recommended.scene))
    _print_lines(
        f"a run of all images of recommended.yaml {describe_cost(scene)}",
        f"time at the speed of this machine: scenetruth check {output / 'recommended.yaml'}",
    )
    for problem in find_cost_problems(scene):
        print_warning(f"recommended.yaml: a run of all images is rejected on this machine: {problem}")
    _print_lines(f"preview of a part of its images: scenetruth run {output / PREVIEW_FILE} -o preview")
    print_wrote(output / name for name in names)


_INCLUDED = (
    "predicted: image noise as in `scenetruth design predict`, and stage errors and motion during a scan in quadrature",
    "simulated: all errors against the ground truth, also bias by curvature and edges, and misaligned images",
)


def _print_lines(*lines: str) -> None:
    from scenetruth.errors import visible

    for line in lines:
        typer.echo(visible(line, lines=False))


def _print_front(found: DesignResult) -> None:
    from rich.table import Table

    from scenetruth.cli.console import make_console
    from scenetruth.design.optimisation.design_result import format_parameter
    from scenetruth.design.parameter_words import parameter_unit, title_parameters
    from scenetruth.errors import visible

    table = Table(title=f"{visible(found.title, lines=False)}: the best rigs", title_justify="left")
    table.add_column("rig", overflow="fold")
    for rig in found.rigs:
        table.add_column(f"{rig.number}{' *' if rig.number == found.recommended.number else ''}", justify="right")
    titles = title_parameters(list(found.recommended.parameters))
    for name, title in titles.items():
        unit = parameter_unit(name)
        cells = [format_parameter(rig.parameters[name]) for rig in found.rigs]
        table.add_row(*(visible(cell, lines=False) for cell in (f"{title}, {unit}" if unit else title, *cells)))
    for objective in found.objectives:
        entries = [rig.simulated.get(objective.title) for rig in found.rigs]
        title = f"{objective.title}, {format_unit(objective.unit)}"
        rows = [
            (title, *(format_number(rig.predicted[objective.title]) for rig in found.rigs)),
            ("  simulated", *("–" if one is None else format_number(one.value) for one in entries)),
            ("  95 %", *("–" if one is None else format_interval(one.pi_low, one.pi_high) for one in entries)),
        ]
        for row in rows:
            table.add_row(*(visible(cell, lines=False) for cell in row))
    make_console().print(table)
    _print_lines(*_INCLUDED)


def pattern(
    scene: options.OptionalSceneFile = None,
    *,
    output: options.Output,
    overrides: options.Overrides = None,
    focal_length_px: design_options.FocalLengthPx = None,
    distance_mm: design_options.SurfaceDistanceMm = None,
    light: design_options.Light = 1.0,
    type: design_options.PatternTypeOption = design_options.PatternType.speckle,
    size_mm: design_options.SizeMm = None,
    dot_px: design_options.DotPx = None,
    dot_mm: design_options.DotMm = None,
    coverage: design_options.Coverage = None,
    spacing: design_options.Spacing = None,
    wavelength_px: design_options.WavelengthPx = None,
    wavelength_mm: design_options.WavelengthMm = None,
    contrast: design_options.Contrast = None,
    board: design_options.BoardLengths = None,
    seed: options.Seed = 0,
    page: design_options.Page = "A4",
    margin_mm: design_options.MarginMm = 10.0,
    reference_images: design_options.ReferenceImages = None,
    mm_per_px: design_options.MmPerPx = None,
    encoding: design_options.PhotographEncoding = design_options.Encoding.srgb,
    window_sigma_px: design_options.WindowSigmaPx = 6.0,
    overwrite: options.Overwrite = False,
) -> None:
    """Generate a pattern or a calibration board to print at true scale, and assess it."""
    from scenetruth.design.patterns import assess_pattern, generate_pattern
    from scenetruth.design.patterns.assessment import (
        assessments_to_dataframe,
        describe_assessments,
        describe_pattern,
        plot_assessments,
    )
    from scenetruth.design.patterns.page_layout import lay_out_pages
    from scenetruth.design.patterns.printing import export_pattern, format_scene_lines
    from scenetruth.errors import ArgumentError, Problem
    from scenetruth.output import check_output, claim_folder, write_atomically

    lengths, problems = options.parse_assignments("--board", board)
    settings: dict[str, Any] = {
        "dot_px": dot_px,
        "dot_mm": dot_mm,
        "coverage": coverage,
        "spacing": spacing,
        "contrast": contrast,
        "wavelength_px": _numbers(problems, "wavelength_px", wavelength_px, ","),
        "wavelength_mm": _numbers(problems, "wavelength_mm", wavelength_mm, ","),
    }
    size = _numbers(problems, "size_mm", size_mm, "x")
    if overrides and scene is None:
        problems.append(Problem("--set", "changes a scene; specify SCENE", overrides))
    if mm_per_px is not None and not reference_images:
        problems.append(Problem("--mm-per-px", "applies to a photograph; specify --reference-image", mm_per_px))
    is_board = type in design_options.BOARD_TYPES
    if board and not is_board:
        problems.append(Problem("--board", f"applies to calibration boards, not to --type {type.value}", board))
    if is_board:
        others = {**settings, "size_mm": size, "reference_image": reference_images}
        problems += [
            Problem(f"--{name.replace('_', '-')}", f"does not apply to calibration boards (--type {type.value})", value)
            for name, value in others.items()
            if value is not None
        ]
    if problems:
        raise ArgumentError(problems, source="a pattern")
    if is_board:
        rig = _rig(scene, overrides, focal_length_px, distance_mm, light)
        _write_board(rig, cast("BoardKind", type.value), lengths, output, page, margin_mm, overwrite=overwrite)
        return
    claim = claim_folder(
        "pattern.json", "pattern.pdf", "pattern.png", "scene_lines.yaml", "assessment.csv", "assessment.png"
    )
    check_output(output, overwrite=overwrite, claim=claim)
    rig = _rig(scene, overrides, focal_length_px, distance_mm, light)
    given = {name: value for name, value in settings.items() if value is not None}
    made = generate_pattern(rig, type.value, size_mm=size, seed=seed, **given)
    lay_out_pages(made, page, margin_mm)
    worths = [assess_pattern(made, window_sigma_px=window_sigma_px)]
    taken: dict[str, Any] = {"mm_per_px": mm_per_px, "encoding": encoding.value, "window_sigma_px": window_sigma_px}
    worths += [assess_pattern(file, rig, **taken) for file in reference_images or ()]
    with write_atomically(output, overwrite=overwrite, claim=claim) as folder:
        folder.mkdir()
        files = export_pattern(made, folder, page=page, margin_mm=margin_mm)
        assessments_to_dataframe(worths).to_csv(folder / "assessment.csv", index=False)
        plot_assessments(folder / "assessment.png", worths)
    for line in [*describe_pattern(made), *describe_assessments(worths)]:
        _print_line(line)
    _print_assessments(worths)
    if type is design_options.PatternType.speckle:
        _print_sizes(rig, coverage or 0.5)
    _print_line("in a scene file:")
    typer.echo(format_scene_lines(made, str((output / "pattern.png").resolve())).rstrip())
    names = [file.name for file in files] + ["assessment.csv", "assessment.png"]
    shown = names if len(names) < 12 else [*names[:3], "...", *names[-6:]]
    print_wrote(output / name if name != "..." else name for name in shown)


def _write_board(
    rig: PatternRig,
    type: BoardKind,
    lengths: dict[str, Any],
    output: Path,
    page: str,
    margin_mm: float,
    *,
    overwrite: bool,
) -> None:
    """Write a calibration board, and print its section of a capture file."""
    from scenetruth.design.patterns import export_board, generate_board
    from scenetruth.design.patterns.board_patterns import BOARD_FILES, BOARD_SIGN, format_board
    from scenetruth.output import check_output, claim_folder, write_atomically

    claim = claim_folder(BOARD_SIGN, *BOARD_FILES)
    check_output(output, overwrite=overwrite, claim=claim)
    made = generate_board(rig, type, **lengths)
    with write_atomically(output, overwrite=overwrite, claim=claim) as folder:
        folder.mkdir()
        files = export_board(made, folder, page=page, margin_mm=margin_mm)
    _print_line(f"{type} of {made.size_mm[0]:g} x {made.size_mm[1]:g} mm: {made.description}")
    _print_line("in a capture file:")
    typer.echo(format_board(made).rstrip())
    print_wrote(output / file.name for file in files)


def _print_line(text: str) -> None:
    from scenetruth.errors import visible

    typer.echo(visible(text, lines=False))


def _numbers(problems: list[Any], name: str, text: str | None, between: str) -> tuple[float, float] | None:
    from scenetruth.errors import Problem

    if text is None:
        return None
    try:
        first, second = (float(part) for part in text.casefold().split(between))
    except ValueError:
        problems.append(Problem(name, f"must be two numbers with {between!r} between them", text))
        return None
    return first, second


def _rig(
    file: Path | None,
    overrides: list[str] | None,
    focal_length_px: float | None,
    distance_mm: float | None,
    light: float,
) -> PatternRig:
    from scenetruth.design.patterns import PatternRig
    from scenetruth.scene import load_scene

    changes = {} if focal_length_px is None else {"focal_length_px": focal_length_px}
    scene = None if file is None else load_scene(file, overrides=overrides or ())
    return PatternRig.from_scene(scene, distance_mm=distance_mm, light=light, **changes)


_ROWS = {
    "contrast": ("contrast (standard deviation)", "% of full scale", 100.0),
    "gradient_x": ("gradient along x, RMS", "% per px", 100.0),
    "gradient_y": ("gradient along y, RMS", "% per px", 100.0),
    "theory_gradient": ("gradient, theory", "% per px", 100.0),
    "wavelength_px": ("equivalent wavelength", "px", 1.0),
    "size_px": ("speckle size (autocorrelation)", "px", 1.0),
    "aliased_share": ("aliased power", "% of variance", 100.0),
    "noise_std": ("noise", "% of full scale", 100.0),
    "disparity_px": ("disparity, bound", "px/step", 1.0),
    "depth_mm": ("depth, bound", "mm", 1.0),
    "flow_px": ("flow, bound", "px/frame", 1.0),
    "velocity_lateral_mm": ("U_X, bound", "mm/frame", 1.0),
    "velocity_depth_mm": ("U_Z, bound", "mm/frame", 1.0),
}


def _print_assessments(worths: Sequence[PatternAssessment]) -> None:
    from rich.table import Table

    from scenetruth.cli.console import make_console
    from scenetruth.errors import visible

    table = Table(title="imaged pattern, and lower bounds of standard deviations", title_justify="left")
    table.add_column("quantity")
    table.add_column("unit")
    for worth in worths:
        table.add_column(visible(worth.label, lines=False), justify="right", overflow="fold")
    figures = [worth.statistics() for worth in worths]
    for name, (entries, unit, factor) in _ROWS.items():
        values = [each[name] for each in figures]
        if any(value is not None for value in values):
            table.add_row(entries, unit, *("–" if value is None else f"{factor * value:.3g}" for value in values))
    make_console().print(table)


def _print_sizes(rig: PatternRig, coverage: float) -> None:
    from rich.table import Table

    from scenetruth.cli.console import make_console
    from scenetruth.design.patterns.assessment import compute_size_table

    table = Table(title="other dot sizes, random positions (theory)", title_justify="left")
    for heading in ("px", "mm", "noise relative to 4 px", "aliased, % of variance"):
        table.add_column(heading, justify="right")
    for px, mm, noise, aliased in compute_size_table(rig, coverage):
        table.add_row(f"{px:g}", f"{mm:.3f}", f"{noise:.2f}", f"{100 * aliased:.1f}")
    make_console().print(table)


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    group = typer.Typer(
        help="Predict, budget and optimise the uncertainty of an experiment.",
        no_args_is_help=True,
    )
    for command in (predict, budget, sweep, optimise, pattern):
        options.add_command(group, command)
    app.add_typer(group, name="design")
