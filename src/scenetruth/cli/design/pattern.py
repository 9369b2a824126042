"""The command that makes patterns to print: design pattern."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scenetruth.cli import options
from scenetruth.cli.completion import files_on
from scenetruth.cli.shipped import SCENES, find

if TYPE_CHECKING:
    from scenetruth.design.pattern import Rig, Worth

__all__ = ["pattern"]


class PatternKind(StrEnum):
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
            callback=lambda given: None if given is None else find(SCENES, given),
            autocompletion=files_on(SCENES),
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
        PatternKind, typer.Option("--kind", help="Random dots, noise in ink and paper, or noise in shades of grey.")
    ] = PatternKind.speckle,
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
    from scenetruth.design.pattern import make_pattern, pattern_worth
    from scenetruth.design.pattern.drawing import draw_worths
    from scenetruth.design.pattern.errors import PatternError
    from scenetruth.design.pattern.printing import pages_of, scene_lines, write_pattern
    from scenetruth.design.pattern.words import pattern_words, worth_words
    from scenetruth.design.pattern.worth import worths_to_frame
    from scenetruth.errors import Problem
    from scenetruth.placing import check_output, claim_folder, write_aside

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
    made = make_pattern(rig, kind.value, size_mm=size, seed=seed, **given)
    pages_of(made, page, margin_mm)
    worths = [pattern_worth(made, window_sigma_px=window_sigma_px)]
    taken: dict[str, Any] = {"mm_per_px": mm_per_px, "encoding": encoding.value, "window_sigma_px": window_sigma_px}
    worths += [pattern_worth(file, rig, **taken) for file in against or ()]
    with write_aside(output, overwrite=overwrite, claim=claim) as folder:
        folder.mkdir()
        files = write_pattern(made, folder, page=page, margin_mm=margin_mm)
        worths_to_frame(worths).to_csv(folder / "worth.csv", index=False)
        draw_worths(folder / "worth.png", worths)
    for line in [*pattern_words(made), *worth_words(worths)]:
        _say(line)
    _print_worths(worths)
    if kind is PatternKind.speckle:
        _print_sizes(rig, coverage or 0.5)
    _say("in a scene file:")
    typer.echo(scene_lines(made, str((output / "pattern.png").resolve())).rstrip())
    names = [file.name for file in files] + ["worth.csv", "worth.png"]
    shown = names if len(names) < 12 else [*names[:3], "...", *names[-6:]]
    _say(f"written: {', '.join(str(output / name) if name != '...' else name for name in shown)}")


def _say(text: str) -> None:
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
) -> Rig:
    from scenetruth.design.pattern import rig_of
    from scenetruth.scene import load_scene

    changes = {} if focal_length_px is None else {"focal_length_px": focal_length_px}
    scene = None if file is None else load_scene(file, overrides or ())
    return rig_of(scene, distance_mm=distance_mm, light=light, **changes)


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


def _print_worths(worths: Sequence[Worth]) -> None:
    from rich.table import Table

    from scenetruth.cli.tables import console
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
    console().print(table)


def _print_sizes(rig: Rig, coverage: float) -> None:
    from rich.table import Table

    from scenetruth.cli.tables import console
    from scenetruth.design.pattern.words import size_rows

    table = Table(title="dots of other sizes, anywhere (theory)", title_justify="left")
    for heading in ("px", "mm", "noise over that of 4 px", "too fine, % of variance"):
        table.add_column(heading, justify="right")
    for px, mm, noise, aliased in size_rows(rig, coverage):
        table.add_row(f"{px:g}", f"{mm:.3f}", f"{noise:.2f}", f"{100 * aliased:.1f}")
    console().print(table)
