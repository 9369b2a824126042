"""The commands under `dataset`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from scenetruth.cli import options
from scenetruth.cli.messages import echo, print_wrote

if TYPE_CHECKING:
    from scenetruth.dataset.sampler import Sampler

__all__ = ["register"]

_EXIT_SOME_FAILED = 1

app = typer.Typer(name="dataset", help="Generate and evaluate data sets of many scenes.", no_args_is_help=True)


def register(parent: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (check, preview, run, sample, status, estimate, catalogue, card, webdataset):
        options.add_command(app, command)
    parent.add_typer(app)


def check(recipe: options.RecipeFile, overrides: options.Overrides = None, limits: options.Limits = None) -> None:
    """Validate a recipe, test 100 draws, and predict the resources of the data set."""
    from scenetruth.cli.dataset_report import print_recipe
    from scenetruth.compilation import thread_count
    from scenetruth.dataset.generation import check_recipe
    from scenetruth.resources.limits import limits_from

    sampler = _load(recipe, overrides)
    with _naming(recipe):
        report = check_recipe(sampler.recipe, limits=limits_from(limits or ()), workers=thread_count())
    print_recipe(sampler, report.draws, report.resources)


def preview(
    recipe: options.RecipeFile,
    output: options.Output,
    *,
    overrides: options.Overrides = None,
    samples: options.Samples = None,
    overwrite: options.Overwrite = False,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
) -> None:
    """Preview the samples of a recipe without rendering them."""
    from scenetruth.cli.console import reporting
    from scenetruth.dataset.pages.preview_page import preview_dataset

    sampler = _load(recipe, overrides)
    with _naming(recipe), reporting() as reporter:
        page = preview_dataset(
            sampler.recipe,
            output=output,
            samples=samples,
            overwrite=overwrite,
            workers=workers,
            scheduler=scheduler,
            progress=reporter,
        )
    print_wrote(page)


def run(
    recipe: options.RecipeFile,
    output: options.Output,
    *,
    overrides: options.Overrides = None,
    workers: options.Workers = 1,
    threads: options.Threads = 1,
    scheduler: options.Scheduler = None,
    partition: options.PartOf = "1/1",
    retries: options.Retries = 1,
    max_tasks_per_worker: options.MaxTasksPerWorker = 500,
    extend: options.Extend = False,
    limits: options.Limits = None,
) -> None:
    """Generate a data set. If interrupted, run the same command again to resume."""
    from scenetruth.cli.console import reporting
    from scenetruth.dataset.generation import run_dataset
    from scenetruth.dataset.samples import Partition
    from scenetruth.resources.limits import limits_from

    sampler = _load(recipe, overrides)
    with _naming(recipe), reporting() as reporter:
        outcome = run_dataset(
            sampler.recipe,
            output=output,
            workers=workers,
            threads=threads,
            scheduler=scheduler,
            partition=Partition.read(partition),
            retries=retries,
            max_tasks_per_worker=max_tasks_per_worker,
            extend=extend,
            limits=limits_from(limits or ()),
            progress=reporter,
        )
    print_wrote(output, f"{outcome.made:,} samples; {outcome.present:,} existing samples were reused")
    if outcome.made:
        _warn_of_card(output)
    if outcome.failed:
        reasons = outcome.folder.failed
        echo(f"{len(outcome.failed):,} samples failed; see {reasons}; run the same command to retry them", err=True)
        raise typer.Exit(_EXIT_SOME_FAILED)


def sample(
    recipe: options.RecipeFile,
    number: options.SampleNumber,
    output: options.Output,
    *,
    overrides: options.Overrides = None,
    seed: options.SceneSeed = None,
) -> None:
    """Generate a single sample of a recipe, identical to that of the data set."""
    from scenetruth.dataset.fingerprint import compute_fingerprint
    from scenetruth.dataset.samples import make_sample
    from scenetruth.errors import Problem, RecipeError

    sampler = _load(recipe, [*(overrides or ()), *(() if seed is None else (f"seed={seed}",))])
    if number >= len(sampler):
        message = f"there are {len(sampler):,} samples, numbered from 0"
        raise RecipeError([Problem("NUMBER", message, number)], source=recipe)
    with _naming(recipe):
        row = make_sample(sampler, compute_fingerprint(sampler), number, output)
    print_wrote(output, f"recording {row['recording_hash']}")


def status(dataset: options.DatasetPath, *, as_json: options.Json = False) -> None:
    """Print how many samples of a data set exist and which failed."""
    from scenetruth.dataset.generation import read_status

    found = read_status(dataset)
    if as_json:
        failed = {str(number): message for number, message in found.failed.items()}
        typer.echo(json.dumps({"samples": found.count, "finished": found.done, "failed": failed}, indent=2))
        return
    echo(f"{found.done:,} of {found.count:,} samples exist, {len(found.failed):,} failed")
    for number, message in list(found.failed.items())[:_MAX_LISTED]:
        echo(f"  sample {number}: {' '.join(message.split())}")
    if len(found.failed) > _MAX_LISTED:
        echo(f"  and {len(found.failed) - _MAX_LISTED:,} more, in {dataset}/failed")


_MAX_LISTED = 20


def estimate(
    dataset: options.DatasetPath,
    method: options.Method = None,
    settings: options.Settings = None,
    *,
    workers: options.Workers = 1,
    threads: options.Threads = 1,
    scheduler: options.Scheduler = None,
    retries: options.Retries = 0,
) -> None:
    """Estimate and score every sample of a data set; the scores are columns of the catalogue."""
    from scenetruth.cli.console import reporting
    from scenetruth.dataset.dataset_estimation import estimate_dataset

    chosen = options.read_settings(settings)
    with reporting() as reporter:
        found = estimate_dataset(
            dataset,
            method,
            settings=chosen,
            workers=workers,
            threads=threads,
            scheduler=scheduler,
            retries=retries,
            progress=reporter,
        )
    print_wrote(dataset, f"{found.made:,} scores; {found.present:,} existing scores were reused")
    if found.failed:
        echo(f"{len(found.failed):,} samples failed", err=True)
        raise typer.Exit(_EXIT_SOME_FAILED)


def catalogue(dataset: options.DatasetPath) -> None:
    """Rebuild the catalogue of a data set from its samples."""
    from scenetruth.cli.console import reporting
    from scenetruth.dataset.verification import rebuild_catalogue

    with reporting() as reporter:
        count = rebuild_catalogue(dataset, progress=reporter)
    print_wrote(dataset, f"catalogue of {count:,} samples")
    _warn_of_card(dataset)


def card(
    dataset: options.DatasetPath,
    *,
    date: options.CardDate = "",
    version: options.CardVersion = "1.0.0",
    url: options.CardUrl = "",
    overwrite: options.Overwrite = False,
) -> None:
    """Write the data-set card: card.html, card.md and croissant.json."""
    from scenetruth.cli.console import reporting
    from scenetruth.dataset.pages.card import write_card

    with reporting() as reporter:
        page = write_card(dataset, version=version, date=date, url=url, overwrite=overwrite, progress=reporter)
    print_wrote(page)


def webdataset(
    dataset: options.DatasetPath,
    *,
    output: options.Output,
    maps: options.TruthMaps = None,
    samples_per_shard: options.SamplesPerShard = 100,
) -> None:
    """Write images and maps of all samples as tar files of WebDataset, for learning code."""
    from scenetruth.cli.console import reporting
    from scenetruth.dataset.reading import open_dataset
    from scenetruth.dataset.training_data import MAPS, write_webdataset

    with reporting() as reporter:
        files = write_webdataset(
            open_dataset(dataset),
            output,
            maps=maps or MAPS,
            samples_per_shard=samples_per_shard,
            progress=reporter,
        )
    print_wrote(output, f"{len(files):,} tar files")


def _warn_of_card(dataset: Path) -> None:
    from scenetruth.dataset.layout import DatasetFolder

    if DatasetFolder(dataset).card.exists():
        command = f"scenetruth dataset card {dataset} --overwrite"
        echo(f"warning: the data-set card is out of date; run `{command}`", err=True)


def _load(recipe: Path, overrides: Sequence[str] | None = None) -> Sampler:
    from scenetruth.dataset.layout import DatasetFolder
    from scenetruth.dataset.recipe_loader import load_recipe

    file = DatasetFolder(recipe).recipe if recipe.is_dir() else recipe
    return load_recipe(file, overrides=overrides or ()).sampler()


@contextmanager
def _naming(recipe: Path) -> Iterator[None]:
    from scenetruth.errors import RecipeError, SceneError

    try:
        yield
    except (RecipeError, SceneError) as error:
        raise RecipeError(error.problems, source=error.source or recipe) from error
