"""The commands `design optimise` and `design pattern`, which propose a design, and the group of all design commands."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scenetruth.cli import options
from scenetruth.cli.design_analysis import budget, predict, sweep
from scenetruth.cli.options import GOALS, SCENES, file_completer, resolve_file

if TYPE_CHECKING:
    from scenetruth.design.optimisation import DesignResult
    from scenetruth.design.patterns import PatternAssessment, PatternRig

__all__ = ["optimise", "pattern", "register"]


def optimise(
    goal: Annotated[
        Path,
        typer.Argument(
            metavar="GOAL",
            help="Goal file (YAML), or a name of `scenetruth scenes`.",
            show_default=False,
            callback=lambda given: resolve_file(GOALS, given),
            autocompletion=file_completer(GOALS),
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder of the answer; goes on where it was.", show_default=False),
    ] = None,
    *,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
) -> None:
    """Find the rig that measures best within constraints, by thousands of predictions; simulate the best."""
    from scenetruth.cli.console import reporting
    from scenetruth.design.optimisation import load_design_spec
    from scenetruth.design.optimisation import optimise as find_rig
    from scenetruth.design.optimisation.design_records import DesignSpecError
    from scenetruth.design.optimisation.report.scene_file import PREVIEW_FILE
    from scenetruth.errors import Problem

    if output is None:
        raise DesignSpecError([Problem("--output", "is missing: the folder where the answer goes")])
    wanted = load_design_spec(goal)
    with reporting() as reporter:
        found = find_rig(
            wanted,
            output=output,
            workers=workers,
            scheduler=scheduler,
            progress=reporter,
        )
    _print_front(found)
    _print_lines(*found.words())
    names = ("index.html", "recommended.yaml", PREVIEW_FILE, "front.csv", "screened.csv", "design.json")
    _print_lines(
        f"a part of what it sees, before it is rendered whole: scenetruth run {output / PREVIEW_FILE} -o preview"
    )
    _print_lines(f"written: {', '.join(str(output / name) for name in names)}")


def _print_lines(*lines: str) -> None:
    from scenetruth.errors import visible

    for line in lines:
        typer.echo(visible(line, lines=False))


def _print_front(found: DesignResult) -> None:
    from rich.table import Table

    from scenetruth.cli.console import make_console
    from scenetruth.design.optimisation.design_result import format_parameter
    from scenetruth.errors import visible

    table = Table(title=f"{visible(found.title, lines=False)}: the best rigs", title_justify="left")
    names = list(found.recommended.parameters)
    headings = ["rig", *names]
    for objective in found.objectives:
        headings += [f"{objective.title}, {objective.unit}", "simulated", "95 %"]
    for heading in headings:
        table.add_column(visible(heading, lines=False), overflow="fold")
    for rig in found.rigs:
        mark = " *" if rig.number == found.recommended.number else ""
        cells = [f"{rig.number}{mark}", *(format_parameter(rig.parameters[name]) for name in names)]
        for objective in found.objectives:
            told = rig.simulated.get(objective.title)
            cells.append(f"{rig.predicted[objective.title]:.3g}")
            cells += ["–", "–"] if told is None else [f"{told.number:.3g}", f"{told.low:.3g} to {told.high:.3g}"]
        table.add_row(*(visible(cell, lines=False) for cell in cells))
    make_console().print(table)


class PatternType(StrEnum):
    """Kinds of patterns."""

    speckle = "speckle"
    noise = "noise"
    grey_noise = "grey_noise"


class Encoding(StrEnum):
    """What grey values of a photograph mean."""

    srgb = "srgb"
    linear = "linear"


def pattern(
    scene: Annotated[
        Path | None,
        typer.Argument(
            metavar="SCENE",
            help="Scene file (YAML) that tells the rig, or a name of `scenetruth scenes`.",
            show_default=False,
            callback=lambda given: None if given is None else resolve_file(SCENES, given),
            autocompletion=file_completer(SCENES),
        ),
    ] = None,
    *,
    output: options.Output,
    overrides: options.Overrides = None,
    focal_length_px: Annotated[
        float | None, typer.Option("--focal-length-px", help="Of a rig without a scene.", show_default=False)
    ] = None,
    distance_mm: Annotated[
        float | None,
        typer.Option(
            "--distance-mm", help="Of the surface; the scene's median depth if not given.", show_default=False
        ),
    ] = None,
    light: Annotated[float, typer.Option("--light", help="Radiance of a perfectly white surface.")] = 1.0,
    kind: Annotated[
        PatternType, typer.Option("--kind", help="Random dots, noise in ink and paper, or noise in shades of grey.")
    ] = PatternType.speckle,
    size_mm: Annotated[
        str | None,
        typer.Option(
            "--size-mm", metavar="WxH", help="Of the sheet; 1.1 fields of view if not given.", show_default=False
        ),
    ] = None,
    dot_px: Annotated[
        float | None,
        typer.Option("--dot-px", help="Diameter of dots on the sensor; 4 if not given.", show_default=False),
    ] = None,
    dot_mm: Annotated[
        float | None, typer.Option("--dot-mm", help="The same on the surface.", show_default=False)
    ] = None,
    coverage: Annotated[
        float | None, typer.Option("--coverage", help="Share under ink; 0.5 if not given.", show_default=False)
    ] = None,
    spacing: Annotated[
        float | None,
        typer.Option(
            "--spacing",
            help="Least distance of dots' centres in diameters: 1 (if not given) for no overlap, 0 for anywhere.",
            show_default=False,
        ),
    ] = None,
    wavelength_px: Annotated[
        str | None,
        typer.Option(
            "--wavelength-px",
            metavar="SHORT,LONG",
            help="Band of noise on the sensor; 5,20 if not given.",
            show_default=False,
        ),
    ] = None,
    wavelength_mm: Annotated[
        str | None,
        typer.Option("--wavelength-mm", metavar="SHORT,LONG", help="The same on the surface.", show_default=False),
    ] = None,
    contrast: Annotated[
        float | None,
        typer.Option("--contrast", help="Of shades of grey: standard deviation over their range.", show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Of what is irregular.")] = 0,
    page: Annotated[str, typer.Option("--page", help="A5 to A0, letter, or WIDTHxHEIGHT in mm.")] = "A4",
    margin_mm: Annotated[float, typer.Option("--margin-mm", help="What the printer leaves white.")] = 10.0,
    against: Annotated[
        list[Path] | None,
        typer.Option(
            "--against",
            metavar="IMAGE",
            help="Photograph of a pattern to compare with; may be repeated.",
            show_default=False,
        ),
    ] = None,
    mm_per_px: Annotated[
        float | None,
        typer.Option(
            "--mm-per-px",
            help="Size of the photographs' pixels on the surface; if not given, the rig's own camera took them.",
            show_default=False,
        ),
    ] = None,
    encoding: Annotated[Encoding, typer.Option("--encoding", help="Of the photographs.")] = Encoding.srgb,
    window_sigma_px: Annotated[float, typer.Option("--window-sigma-px", help="Window of the estimator.")] = 6.0,
    overwrite: options.Overwrite = False,
) -> None:
    """Make a pattern to print at true scale for a rig, and tell what it is worth, beside photographs of others."""
    from scenetruth.design.patterns import assess_pattern, generate_pattern
    from scenetruth.design.patterns.assessment import (
        assessments_to_dataframe,
        describe_assessments,
        describe_pattern,
        plot_assessments,
    )
    from scenetruth.design.patterns.page_layout import lay_out_pages
    from scenetruth.design.patterns.pattern_model import PatternError
    from scenetruth.design.patterns.printing import export_pattern, format_scene_lines
    from scenetruth.errors import Problem
    from scenetruth.output import check_output, claim_folder, write_atomically

    problems: list[Problem] = []
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
        problems.append(Problem("--set", "changes a scene, and there is none: give SCENE", overrides))
    if mm_per_px is not None and not against:
        problems.append(Problem("--mm-per-px", "is that of a photograph: give --against", mm_per_px))
    if problems:
        raise PatternError(problems)
    claim = claim_folder("pattern.json", "pattern.pdf", "pattern.png", "scene_lines.yaml", "worth.csv", "worth.png")
    check_output(output, overwrite=overwrite, claim=claim)
    rig = _rig(scene, overrides, focal_length_px, distance_mm, light)
    given = {name: value for name, value in settings.items() if value is not None}
    made = generate_pattern(rig, kind.value, size_mm=size, seed=seed, **given)
    lay_out_pages(made, page, margin_mm)
    worths = [assess_pattern(made, window_sigma_px=window_sigma_px)]
    taken: dict[str, Any] = {"mm_per_px": mm_per_px, "encoding": encoding.value, "window_sigma_px": window_sigma_px}
    worths += [assess_pattern(file, rig, **taken) for file in against or ()]
    with write_atomically(output, overwrite=overwrite, claim=claim) as folder:
        folder.mkdir()
        files = export_pattern(made, folder, page=page, margin_mm=margin_mm)
        assessments_to_dataframe(worths).to_csv(folder / "worth.csv", index=False)
        plot_assessments(folder / "worth.png", worths)
    for line in [*describe_pattern(made), *describe_assessments(worths)]:
        _print_line(line)
    _print_assessments(worths)
    if kind is PatternType.speckle:
        _print_sizes(rig, coverage or 0.5)
    _print_line("in a scene file:")
    typer.echo(format_scene_lines(made, str((output / "pattern.png").resolve())).rstrip())
    names = [file.name for file in files] + ["worth.csv", "worth.png"]
    shown = names if len(names) < 12 else [*names[:3], "...", *names[-6:]]
    _print_line(f"written: {', '.join(str(output / name) if name != '...' else name for name in shown)}")


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
        problems.append(Problem(name, f"must be two numbers with {between!r} between", text))
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
    "gradient_x": ("gradient along x, rms", "% per px", 100.0),
    "gradient_y": ("gradient along y, rms", "% per px", 100.0),
    "theory_gradient": ("the same from theory", "% per px", 100.0),
    "wavelength_px": ("wavelength of equal worth", "px", 1.0),
    "size_px": ("speckle size (autocorrelation)", "px", 1.0),
    "aliased_share": ("too fine for the pixels", "% of variance", 100.0),
    "noise_std": ("noise", "% of full scale", 100.0),
    "disparity_px": ("disparity, at best", "px/step", 1.0),
    "depth_mm": ("depth, at best", "mm", 1.0),
    "flow_px": ("flow, at best", "px/frame", 1.0),
    "velocity_lateral_mm": ("U_X, at best", "mm/frame", 1.0),
    "velocity_depth_mm": ("U_Z, at best", "mm/frame", 1.0),
}


def _print_assessments(worths: Sequence[PatternAssessment]) -> None:
    from rich.table import Table

    from scenetruth.cli.console import make_console
    from scenetruth.errors import visible

    table = Table(title="what the rig sees, and standard deviations at best", title_justify="left")
    table.add_column("quantity")
    table.add_column("unit")
    for worth in worths:
        table.add_column(visible(worth.label, lines=False), justify="right", overflow="fold")
    figures = [worth.figures() for worth in worths]
    for name, (told, unit, factor) in _ROWS.items():
        values = [each[name] for each in figures]
        if any(value is not None for value in values):
            table.add_row(told, unit, *("–" if value is None else f"{factor * value:.3g}" for value in values))
    make_console().print(table)


def _print_sizes(rig: PatternRig, coverage: float) -> None:
    from rich.table import Table

    from scenetruth.cli.console import make_console
    from scenetruth.design.patterns.assessment import compute_size_table

    table = Table(title="dots of other sizes, anywhere (theory)", title_justify="left")
    for heading in ("px", "mm", "noise over that of 4 px", "too fine, % of variance"):
        table.add_column(heading, justify="right")
    for px, mm, noise, aliased in compute_size_table(rig, coverage):
        table.add_row(f"{px:g}", f"{mm:.3f}", f"{noise:.2f}", f"{100 * aliased:.1f}")
    make_console().print(table)


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    group = typer.Typer(
        help="Design an experiment: what precision is possible, what limits it, and which rig does better.",
        no_args_is_help=True,
    )
    for command in (budget, optimise, pattern, predict, sweep):
        group.command()(command)
    app.add_typer(group, name="design")
