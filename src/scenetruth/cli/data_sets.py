"""The commands under `dataset`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scenetruth.cli import options
from scenetruth.cli.options import RECIPES, file_completer, method_names, resolve_file

if TYPE_CHECKING:
    from scenetruth.dataset.sampler import Sampler

__all__ = ["register"]

_EXIT_SOME_FAILED = 1

RecipeFile = Annotated[
    Path,
    typer.Argument(
        metavar="RECIPE",
        help="Recipe of a data set (YAML), or a name of `scenetruth scenes`.",
        show_default=False,
        callback=lambda given: resolve_file(RECIPES, given),
        autocompletion=file_completer(RECIPES),
    ),
]
DatasetPath = Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of a data set.", show_default=False)]
Threads = Annotated[int, typer.Option("--threads", min=1, max=1024, help="Threads of each process.")]
PartOf = Annotated[
    str, typer.Option("--part", metavar="N/PARTS", help="Part to make, where several machines share the folder.")
]
Retries = Annotated[
    int, typer.Option("--retries", min=0, max=100, help="How often a sample that failed is tried again.")
]
Recycle = Annotated[
    int, typer.Option("--recycle", min=1, help="Samples after which a process of this machine is started anew.")
]
Extend = Annotated[bool, typer.Option("--extend", help="Let a data set get more samples than it had.")]

app = typer.Typer(
    name="dataset", help="Make data sets of many scenes from a recipe, and look after them.", no_args_is_help=True
)


def register(parent: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (check, preview, run, sample, status, verify, estimate, schema, card):
        app.command()(command)
    parent.add_typer(app)


def check(recipe: RecipeFile, limits: options.Limits = None) -> None:
    """Validate a recipe, try some draws, and print what the data set will take."""
    from scenetruth.cli.dataset_report import print_recipe
    from scenetruth.compilation import thread_count
    from scenetruth.dataset.generation import estimate_sample_cost
    from scenetruth.dataset.recipe_validation import refuse_recipe, try_draws
    from scenetruth.resources.limits import limits_from

    sampler = _load(recipe)
    with _naming(recipe):
        refuse_recipe(sampler)
        trial = try_draws(sampler, _TRIAL_DRAWS, workers=thread_count())
        forecast = estimate_sample_cost(sampler, None, limits_from(limits or ()), Path())
    print_recipe(sampler, trial, forecast)


_TRIAL_DRAWS = 100


def preview(
    recipe: RecipeFile,
    output: options.Output,
    *,
    draws: Annotated[
        int | None,
        typer.Option(
            "--draws",
            min=1,
            max=100_000,
            help="How many samples are drawn; 500 if not given, or 48 where the geometry of each is looked at.",
            show_default=False,
        ),
    ] = None,
    overwrite: options.Overwrite = False,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
) -> None:
    """Show what a recipe draws, before anything is made: values, rejected draws, thumbnails."""
    from scenetruth.cli.console import reporting
    from scenetruth.dataset.pages.preview_page import write_preview

    sampler = _load(recipe)
    with _naming(recipe), reporting() as reporter:
        page = write_preview(
            sampler,
            output,
            draws=draws,
            overwrite=overwrite,
            workers=workers,
            scheduler=scheduler,
            progress=reporter,
        )
    _echo(f"written: {page}")


def run(
    recipe: RecipeFile,
    output: options.Output,
    *,
    workers: options.Workers = 1,
    threads: Threads = 1,
    scheduler: options.Scheduler = None,
    part: PartOf = "1/1",
    retries: Retries = 1,
    recycle: Recycle = 500,
    extend: Extend = False,
    limits: options.Limits = None,
) -> None:
    """Make a data set, or what is missing of it; it can be interrupted, and run again."""
    from scenetruth.cli.console import reporting
    from scenetruth.dataset.generation import run_dataset
    from scenetruth.dataset.samples import Partition
    from scenetruth.resources.limits import limits_from

    sampler = _load(recipe)
    with _naming(recipe), reporting() as reporter:
        outcome = run_dataset(
            sampler.recipe,
            output=output,
            workers=workers,
            threads=threads,
            scheduler=scheduler,
            partition=Partition.read(part),
            retries=retries,
            max_tasks_per_worker=recycle,
            extend=extend,
            limits=limits_from(limits or ()),
            progress=reporter,
        )
    _echo(f"written: {output}: {outcome.made:,} samples made, {outcome.present:,} were there")
    if outcome.made and outcome.folder.card.exists():
        _echo(f"its card tells of it as it was before: scenetruth dataset card {output} --overwrite", err=True)
    if outcome.failed:
        _echo(
            f"{len(outcome.failed):,} samples failed; see {outcome.folder.failed}, and run again to try them", err=True
        )
        raise typer.Exit(_EXIT_SOME_FAILED)


def sample(
    recipe: RecipeFile,
    number: Annotated[int, typer.Argument(metavar="NUMBER", min=0, help="Number of the sample.", show_default=False)],
    output: options.Output,
) -> None:
    """Make a single sample of a recipe, the same as in its data set."""
    from scenetruth.dataset.fingerprint import compute_fingerprint
    from scenetruth.dataset.samples import make_sample
    from scenetruth.errors import Problem, RecipeError

    sampler = _load(recipe)
    if number >= len(sampler):
        message = f"there are {len(sampler):,} samples, numbered from 0"
        raise RecipeError([Problem("NUMBER", message, number)], source=recipe)
    with _naming(recipe):
        row = make_sample(sampler, compute_fingerprint(sampler), number, output)
    _echo(f"written: {output} (recording {row['recording_hash']})")


def status(folder: DatasetPath) -> None:
    """Tell how far a data set is."""
    from scenetruth.dataset.generation import read_status

    found = read_status(folder)
    _echo(f"{found.done:,} of {found.count:,} samples are there, {len(found.failed):,} failed")
    for number, message in list(found.failed.items())[:_MAX_LISTED]:
        _echo(f"  sample {number}: {' '.join(message.split())}")
    if len(found.failed) > _MAX_LISTED:
        _echo(f"  and {len(found.failed) - _MAX_LISTED:,} more, in {folder}/failed")


_MAX_LISTED = 20


def verify(
    folder: DatasetPath,
    again: Annotated[
        int, typer.Option("--again", min=0, help="How many samples, drawn at random, are made again.")
    ] = 3,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of that draw.")] = 0,
) -> None:
    """Hash every file of a data set, and make a few samples again, to the same bytes."""
    from scenetruth.cli.console import reporting
    from scenetruth.dataset.generation import verify_dataset
    from scenetruth.errors import StoreError

    with reporting() as reporter:
        found = verify_dataset(folder, again=again, seed=seed, progress=reporter)
    for damage in found[:_MAX_LISTED]:
        _echo(f"sample {damage.number}: {damage.problem}", err=True)
    if found:
        more = f", of which {_MAX_LISTED} are told" if len(found) > _MAX_LISTED else ""
        raise StoreError(folder, f"{len(found):,} things are wrong{more}")
    _echo(f"{folder}: whole")


def estimate(
    folder: DatasetPath,
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            metavar="NAME",
            help="A method of estimation; the scene's if not given.",
            autocompletion=method_names,
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="A setting of the method; may be repeated.", show_default=False
        ),
    ] = None,
    *,
    workers: options.Workers = 1,
    threads: Threads = 1,
    scheduler: options.Scheduler = None,
    retries: Retries = 0,
) -> None:
    """Estimate and score every sample by a method; scores land in the catalogue."""
    from scenetruth.cli.console import reporting
    from scenetruth.dataset.dataset_estimation import estimate_dataset
    from scenetruth.scene.scene_loader import apply_overrides

    chosen: dict[str, object] = {}
    apply_overrides(chosen, settings or ())
    with reporting() as reporter:
        found = estimate_dataset(
            folder,
            method,
            settings=chosen,
            workers=workers,
            threads=threads,
            scheduler=scheduler,
            retries=retries,
            progress=reporter,
        )
    _echo(f"{found.done:,} samples estimated and scored, {found.present:,} were before")
    if found.failed:
        _echo(f"{len(found.failed):,} samples failed", err=True)
        raise typer.Exit(_EXIT_SOME_FAILED)


def schema() -> None:
    """Print the JSON Schema of recipes."""
    import json

    from scenetruth.dataset.recipe_loader import Recipe

    typer.echo(json.dumps(Recipe.model_json_schema(), indent=2))


def card(
    folder: DatasetPath,
    *,
    published: Annotated[
        str, typer.Option("--published", metavar="DATE", help="Day of its publication, as 2026-11-23.")
    ] = "",
    version: Annotated[str, typer.Option("--version", metavar="VERSION", help="Version of the data set.")] = "1.0.0",
    url: Annotated[str, typer.Option("--url", metavar="URL", help="Where it is to be found.")] = "",
    overwrite: options.Overwrite = False,
) -> None:
    """Describe a data set: card.html and card.md for people, croissant.json for machines."""
    from scenetruth.cli.console import reporting
    from scenetruth.dataset.pages.card import write_card
    from scenetruth.dataset.pages.croissant import Publication

    with reporting() as reporter:
        page = write_card(folder, Publication(version, published, url), overwrite=overwrite, progress=reporter)
    _echo(f"written: {page}")


def _load(recipe: Path) -> Sampler:
    """Load a recipe; the folder of a data set stands for the one in it."""
    from scenetruth.dataset.layout import DatasetFolder
    from scenetruth.dataset.recipe_loader import load_recipe

    return load_recipe(DatasetFolder(recipe).recipe if recipe.is_dir() else recipe).sampler()


@contextmanager
def _naming(recipe: Path) -> Iterator[None]:
    """Name the recipe's file in errors of what is inside it."""
    from scenetruth.errors import RecipeError, SceneError

    try:
        yield
    except (RecipeError, SceneError) as error:
        raise RecipeError(error.problems, source=error.source or recipe) from error


def _echo(text: str, *, err: bool = False) -> None:
    from scenetruth.errors import visible

    typer.echo(visible(text), err=err)
