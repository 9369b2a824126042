"""Tables that commands print."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from scenetruth.estimators import Estimator
    from scenetruth.scoring import Score

__all__ = ["console", "print_formats", "print_main_figures", "print_methods", "print_score", "print_shipped"]


def print_methods() -> None:
    """Print all methods that are installed: what they give, what they need, who brings them, what is wrong."""
    from rich.table import Table

    from scenetruth.errors import EstimateError, visible
    from scenetruth.estimators import find_method, method_entries

    table = Table(title="methods of estimation", title_justify="left")
    for heading in ("name", "gives", "needs", "from"):
        table.add_column(heading, overflow="fold")
    for entry in method_entries():
        try:
            if entry.problem:
                raise ValueError(entry.problem)
            method = find_method(entry.name)
        except (EstimateError, ValueError) as error:
            problems = getattr(error, "problems", ())
            told = "; ".join(problem.message for problem in problems) or str(error)
            table.add_row(*map(visible, (entry.name, "–", f"cannot be used: {told}", entry.origin)))
            continue
        gives = ", ".join(sorted(method.gives)) or "shows in its estimates"
        needs = "; ".join([str(method.needs), *_cannot_be_used(method)])
        table.add_row(*map(visible, (entry.name, gives, needs, entry.origin)))
    console().print(table)


def _cannot_be_used(method: Estimator) -> list[str]:
    """Return what a method lacks whatever the recording: it is asked of one that has all that it needs."""
    import numpy as np

    from scenetruth.schema import make_recording

    needs = method.needs
    try:
        images = np.zeros((max(needs.cameras, 3), max(needs.frames, 3), 64, 64), dtype=np.uint8)
        problems = method.requirements(make_recording(images, 100.0, 5.0), method.settings())
    except Exception:  # of settings that must be given, or a plug-in at fault, its estimates will tell
        return []
    return [f"cannot be used: {problem.message}" for problem in problems if problem.path == "method"]


def print_formats() -> None:
    """Print all formats of export: what they write, their options with defaults, which package they need."""
    from rich.table import Table

    from scenetruth.export import known_formats

    table = Table(title="formats of export", title_justify="left")
    for heading in ("name", "writes", "options", "needs"):
        table.add_column(heading, overflow="fold")
    for kind, model in known_formats().items():
        fields = [f"{name}={field.default}" for name, field in model.model_fields.items() if name != "kind"]
        table.add_row(kind, model.summary, ", ".join(fields) or "–", ", ".join(model.packages) or "–")
    console().print(table)


def print_shipped() -> None:
    """Print the scenes, recipes and goals that are shipped, how they are called, and where their files are."""
    import yaml
    from rich.table import Table

    from scenetruth.cli.shipped import GOALS, RECIPES, SCENES
    from scenetruth.errors import StoreError, visible
    from scenetruth.files.shipped import shipped_folder

    if shipped_folder() is None:
        raise StoreError("scenes", "are not there; install scenetruth again")
    for shelf in (SCENES, RECIPES, GOALS):
        table = Table(title=f"{shelf.noun}s: {shelf.call('NAME')}", title_justify="left")
        for heading in ("name", "description", "size"):
            table.add_column(heading, overflow="fold")
        for name, file in shelf.files().items():
            plain = yaml.load(file.read_text(encoding="utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader))
            described = " ".join(str(plain.get("description") or plain.get("title", "")).split())
            table.add_row(*map(visible, (name, described, _size_in(plain))))
        console().print(table)
    print(f"files to copy: {visible(str(shipped_folder()))}", "what a scene takes: scenetruth check NAME", sep="\n")


def _size_in(plain: Mapping[str, Any]) -> str:
    """Return what a scene, a recipe or a goal says of its size; empty if nothing."""
    if "camera" in plain:
        camera, stage = plain["camera"], plain["stage"]
        across = stage.get("positions") or len(stage.get("positions_mm") or [0])
        images = across * stage.get("rows", 1) * plain["frames"]["count"]
        return f"{images} images of {camera['width']} x {camera['height']} px"
    if "samples" in plain:
        # As `Recipe.count`, of every draw itself and all steps of its ladders.
        steps = 1 + sum(len(values) for values in (plain.get("paired") or {}).values())
        return f"{plain['samples'] * steps:,} scenes"
    return f"{len(plain['free'])} to choose" if "free" in plain else ""


def console() -> Console:
    """Return a console on standard output; brackets are no markup.

    Where it is no terminal, and ``COLUMNS`` says no width, it is wide enough for tables.
    """
    from rich.console import Console

    console = Console(markup=False, emoji=False, highlight=False)
    if console.is_terminal or "COLUMNS" in os.environ:
        return console
    return Console(width=120, markup=False, emoji=False, highlight=False)


def print_score(scored: Score, method: str = "") -> None:
    """Print the figures of merit of an estimate: the interior, then the rms errors of all regions."""
    from rich.table import Table

    from scenetruth.errors import visible
    from scenetruth.scoring import units_of
    from scenetruth.scoring.summary import shown_quantities

    headings = {
        "bias": "bias",
        "rms": "rms",
        "median_abs": "median",
        "p95_abs": "95 %",
        "relative_rms": "rms,\nrel.",
        "calibration": "err/\nstd",
        "within_2_std": "in 2\nstd",
        "density": "density",
    }
    title = visible(f"{method}, region interior" if method else "region interior")
    table = Table(title=title, title_justify="left")
    table.add_column("quantity", overflow="fold")
    table.add_column("unit")
    for name in headings.values():
        table.add_column(name, justify="right")
    for quantity in shown_quantities(scored.regions, grows=scored.grows):
        cells = [scored.regions["interior"][quantity].get(name) for name in headings]
        table.add_row(quantity, units_of(quantity), *("–" if value is None else f"{value:.3g}" for value in cells))
    console().print(table)
    _print_regions(scored)


_MAIN = (
    ("depth", "disparity"),
    ("velocity_x", "flow_x"),
    ("velocity_y", "flow_y"),
    ("velocity_z",),
    ("growth_rate_windowed", "growth_rate"),
)
"""Of each of these, the first that a score has is a main figure."""


_ALL_FIGURES = 72
"""So many letters of a line have room for all columns."""


def print_main_figures(scored: Score, method: str) -> None:
    """Print how large the errors of depth, motion and growth are in the interior; all else is in the page and files."""
    from rich.table import Table

    from scenetruth.errors import visible
    from scenetruth.scoring.quantities import title_of, units_of
    from scenetruth.scoring.summary import shown_quantities

    shown, interior = shown_quantities(scored.regions, grows=scored.grows), scored.regions["interior"]
    table = Table(title=visible(f"errors of {method}, region interior", lines=False), title_justify="left")
    table.add_column("quantity", min_width=13)
    # What finds no room is left out: no figure loses digits.
    headings = ("rms", "median", "unit", "rms, rel.", "density")[: 5 if console().width >= _ALL_FIGURES else 3]
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "unit" else "right", no_wrap=True)
    for name in (next((one for one in several if one in shown), None) for several in _MAIN):
        if name is None:
            continue
        rms, median, relative, density = (
            interior[name].get(key) for key in ("rms", "median_abs", "relative_rms", "density")
        )
        shares = ("–" if value is None else f"{100 * value:.3g} %" for value in (relative, density))
        values = ("–" if value is None else f"{value:.3g}" for value in (rms, median))
        table.add_row(title_of(name), *[*values, units_of(name), *shares][: len(headings)])
    console().print(table)


_GROWTH = ("growth_rate", "growth_rate_windowed")


def _print_regions(scored: Score) -> None:
    """Print the rms errors of some quantities in every region that has any pixel scored."""
    from rich.table import Table

    from scenetruth.errors import visible
    from scenetruth.scoring import units_of
    from scenetruth.scoring.summary import shown_quantities

    shown = shown_quantities(scored.regions, grows=scored.grows)
    names = [
        name
        for name in ("depth", "normal", "flow_x", "velocity_z", "velocity_endpoint", *_GROWTH)
        if name in shown
        # Flow stands for motion where there is nothing better.
        and (name != "flow_x" or "velocity_z" not in scored.regions["all"])
    ]
    table = Table(title="all regions, rms errors", title_justify="left")
    table.add_column("region", overflow="fold")
    for name in ("pixels", "density", *(f"{name}\n{units_of(name)}" for name in names)):
        table.add_column(name, justify="right")
    first = names[0] if names else next(iter(scored.regions["all"]))
    for region, quantities in scored.regions.items():
        count, density = (quantities[first][key] for key in ("count", "density"))
        if not count:
            continue
        cells = [density, *(quantities[name]["rms"] for name in names)]
        table.add_row(
            visible(region, lines=False), f"{count:,}", *("–" if value is None else f"{value:.3g}" for value in cells)
        )
    console().print(table)
