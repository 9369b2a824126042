"""The command that predicts the precision of a scene: design predict."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scenetruth.cli import options

if TYPE_CHECKING:
    from scenetruth.design.predict import Prediction

__all__ = ["precision_rows", "predict"]


class Level(StrEnum):
    """How much is computed."""

    envelope = "envelope"
    bound = "bound"


class Motion(StrEnum):
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
        Level, typer.Option("--level", help="From the texture's spectrum, or from a rendered image, with maps.")
    ] = Level.envelope,
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
        Motion | None,
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
    from scenetruth.design.predict import advise
    from scenetruth.design.predict import predict as predicted
    from scenetruth.design.predict.methods.base import modelled
    from scenetruth.resources.bounds import limits_from
    from scenetruth.scene import load_scene

    loaded, allowed = load_scene(scene, overrides or ()), limits_from(limits or ())
    own = loaded.estimate.method if loaded.estimate.method in modelled() else "refined"
    with reporting():
        found = predicted(
            loaded,
            level=level.value,
            method=method or own,
            window_sigma_px=window_sigma_px,
            motion=None if motion is None else motion.value,
            limits=allowed,
        )
    _print(found)
    for line in advise(loaded, found):
        typer.echo(f"warning: {line}")
    if output is not None:
        from scenetruth.design.predict.writing import write

        names = write(found, output, overwrite=overwrite)
        typer.echo(f"written: {', '.join(str(output / name) for name in names)}")


def precision_rows(prediction: Prediction, region: str) -> list[tuple[str, str, str, str]]:
    """Return quantity, precision, what there is to be measured, and how many standard deviations that is."""
    from scenetruth.design.predict.quantities import TITLES

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


def _print(prediction: Prediction) -> None:
    from rich.table import Table

    from scenetruth.cli.tables import console
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
        console().print(table)
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
    console().print(table)
    for note in prediction.notes:
        typer.echo(f"note: {visible(note)}")


_WITH_ONE_OBJECT = 3
