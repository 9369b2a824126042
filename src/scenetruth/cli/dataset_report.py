"""Output of `scenetruth dataset check`."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from scenetruth.cli.console import print_warning
from scenetruth.dataset.pages.page_text import describe_distribution
from scenetruth.dataset.recipe_validation import DrawReport
from scenetruth.dataset.sampler import Sampler
from scenetruth.errors import RecipeError, visible
from scenetruth.number_format import format_duration
from scenetruth.resources import Forecast

__all__ = ["print_recipe"]

_MOST_FIELDS = 40


def print_recipe(sampler: Sampler, trial: DrawReport, forecast: Forecast) -> None:
    """Print the contents of a data set and the required resources."""
    recipe = sampler.recipe
    table = Table(title=visible(recipe.description or recipe.name), show_header=False, title_justify="left")
    for heading in ("what", "value"):
        # Long paths are truncated at the start, because their ends differ.
        table.add_column(heading, overflow="fold")
    table.add_row("samples", f"{recipe.count:,}" + (f" ({recipe.samples:,} draws)" if recipe.steps > 1 else ""))
    table.add_row("base", visible(", ".join(str(base) for base in sampler.bases)))
    for item in sampler.varied[:_MOST_FIELDS]:
        table.add_row(visible(item.key), visible(describe_distribution(item.distribution)))
    if len(sampler.varied) > _MOST_FIELDS:
        table.add_row(f"and {len(sampler.varied) - _MOST_FIELDS} more", "")
    for path, steps in recipe.paired_factors.items():
        table.add_row(visible(f"paired factor {path}"), visible(", ".join(map(str, steps))))
    table.add_row("draws", visible(str(trial)))
    console = Console(highlight=False, markup=False, emoji=False)
    console.print(table)
    taken = Table(title="foreseen", title_justify="left")
    for heading in ("", "memory", "disk", "at most", "processor time"):
        taken.add_column(heading, justify="left" if not heading else "right", overflow="fold")
    for what, count in (("one sample", 1), ("all", recipe.count)):
        taken.add_row(
            what,
            _size(forecast.memory_bytes),
            _size(count * forecast.disk_bytes),
            _size(count * forecast.disk_wanted_bytes),
            format_duration(count * forecast.seconds),
        )
    console.print(taken)
    if trial.problems:
        raise RecipeError(trial.problems)
    if not recipe.licence:
        print_warning("licence: is missing; a data set without a licence may not be used")


def _size(count: float) -> str:
    for size, unit in ((1e12, "TB"), (1e9, "GB")):
        if count >= size:
            return f"{count / size:,.1f} {unit}"
    return f"{count / 1e6:,.1f} MB"
