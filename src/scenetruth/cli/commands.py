"""Commands outside a group: those that read a scene or a run directory, and those about the installation."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from scenetruth.cli import options
from scenetruth.cli.messages import Verbosity, echo, print_note, print_wrote, verbosity

if TYPE_CHECKING:
    from pydantic import BaseModel

    from scenetruth.cli.console import ProgressReporter
    from scenetruth.estimators import MethodLike, MethodSpec
    from scenetruth.pipeline import FigureWorker, PipelineRunner, RunResult

__all__ = ["register_export", "register_info", "register_runs"]


def register_runs(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (run, render, estimate, score, report, verify):
        options.add_command(app, command)


def run(
    scene: options.SceneFile,
    output: options.Output,
    *,
    overrides: options.Overrides = None,
    band: options.Band = None,
    seed: options.SceneSeed = None,
    limits: options.Limits = None,
    methods: options.Methods = None,
    settings: options.Settings = None,
    overwrite: options.Overwrite = False,
    allow_mismatch: options.AllowMismatch = False,
    save_images: options.SaveImages = None,
    save_radiance: options.SaveRadiance = False,
    truth_views: options.TruthViews = options.TruthViewsChoice.reference,
    truth_poses: options.TruthPoses = options.TruthPosesChoice.actual,
    truth_content: options.TruthContent = options.TruthContentChoice.standard,
    report: options.Report = True,
    figures: options.Figures = None,
    figure_formats: options.FigureFormats = options.FigureFormat.png,
) -> None:
    """Render a scene, estimate, score and report."""
    results = _run(
        scene,
        _with_seed(overrides, seed),
        output,
        limits,
        band=band,
        stages=("render", "estimate", "score", "report")[: 4 if report else 3],
        methods=methods or (),
        settings=settings or (),
        truth=(truth_views.value, truth_poses.value, truth_content.value),
        save_radiance=save_radiance,
        save_images=save_images,
        overwrite=overwrite,
        allow_mismatch=allow_mismatch,
        figures=figures or None,
        figure_formats=("png", *_beside_png(figure_formats)),
        helpers=options.helpers() if report else 0,
    )
    _print_results(results)
    print_wrote(output)
    _raise_failures(results)


def render(
    scene: options.SceneFile,
    output: options.Output,
    *,
    overrides: options.Overrides = None,
    band: options.Band = None,
    seed: options.SceneSeed = None,
    limits: options.Limits = None,
    overwrite: options.Overwrite = False,
    save_images: options.SaveImages = None,
    save_radiance: options.SaveRadiance = False,
    truth_views: options.TruthViews = options.TruthViewsChoice.reference,
    truth_poses: options.TruthPoses = options.TruthPosesChoice.actual,
    truth_content: options.TruthContent = options.TruthContentChoice.standard,
) -> None:
    """Render the recording and the ground truth of a scene."""
    results = _run(
        scene,
        _with_seed(overrides, seed),
        output,
        limits,
        band=band,
        stages=("render",),
        truth=(truth_views.value, truth_poses.value, truth_content.value),
        save_radiance=save_radiance,
        save_images=save_images,
        overwrite=overwrite,
    )
    print_wrote((results.folder.recording, results.folder.truth))


def _with_seed(overrides: list[str] | None, seed: int | None) -> list[str]:
    return [*(overrides or ()), *(() if seed is None else (f"seed={seed}",))]


def estimate(
    run: options.RunPath,
    settings: options.Settings = None,
    methods: options.Methods = None,
    overwrite: options.Overwrite = False,
    limits: options.Limits = None,
    *,
    command: options.Command = None,
    command_name: options.CommandName = "command",
    command_images: options.CommandImages = options.ExchangeFormat.png,
    command_timeout_s: options.CommandTimeoutS = 600.0,
    command_memory_mb: options.CommandMemoryMb = None,
    command_uses_mask: options.CommandUsesMask = False,
    command_keep: options.CommandKeep = None,
) -> None:
    """Estimate depth and motion from the recording of a run directory."""
    from scenetruth.cli.console import reporting

    options.read_settings(settings)
    with ExitStack() as open_:
        names: list[str | None] = [*(methods or ())]
        if command is not None:
            from scenetruth.estimators import Needs, offered
            from scenetruth.estimators.external import CommandMethod

            made = CommandMethod(
                command,
                command_name,
                images=command_images.value,
                timeout_s=command_timeout_s,
                memory_mb=command_memory_mb,
                keep_in=command_keep,
                needs=Needs(exclusion_mask=command_uses_mask),
            )
            open_.enter_context(offered(made))
            names.append(command_name)
        names = names or [None]
        reporter = open_.enter_context(reporting())
        runner = open_.enter_context(_runner(run, overwrite, False, limits, reporter))
        choices = [runner.choice(each, _estimate_fields(settings)) for each in names]
        for choice in choices:
            with runner.keeping_failures(choice.method):
                runner.estimate(choice)
    for choice in choices:
        files = runner.folder.paths(choice.method)
        if choice.method in runner.failures:
            continue
        print_wrote(files.estimate)
        stale = [path.name for path in files.after_estimate if path.exists()]
        if stale:
            fix = "run `scenetruth score` and `scenetruth report` with --overwrite"
            echo(
                f"warning: {run}: {', '.join(stale)} are out of date and belong to the previous estimate; {fix}",
                err=True,
            )
    _raise_failures(runner.results())


def _estimate_fields(settings: Sequence[str] | None) -> list[str]:
    return [f"estimate.{setting}" for setting in settings or ()]


def score(
    run: options.RunPath,
    overrides: options.Overrides = None,
    methods: options.EstimatedMethods = None,
    region: options.Region = "interior",
    overwrite: options.Overwrite = False,
    allow_mismatch: options.AllowMismatch = False,
    limits: options.Limits = None,
    *,
    as_json: options.Json = False,
) -> None:
    """Score every estimate of a run directory against the ground truth."""
    from scenetruth.cli.console import reporting

    with reporting() as reporter, _runner(run, overwrite, allow_mismatch, limits, reporter) as runner:
        names = methods or runner.folder.estimated()
        settings = runner.score_settings(overrides or ())
        for method in names:
            with runner.keeping_failures(method):
                runner.score(method, settings)
    results = runner.results()
    if as_json:
        typer.echo(
            json.dumps({name: json.loads(scored.to_json()) for name, scored in results.scores.items()}, indent=2)
        )
    else:
        _print_scores(results, region)
        for method in results.scores:
            files = runner.folder.paths(method)
            print_wrote((files.score_json, files.score_csv))
    _raise_failures(results)


def report(
    run: options.RunPath,
    methods: options.EstimatedMethods = None,
    figures: options.Figures = None,
    figure_formats: options.FigureFormats = options.FigureFormat.png,
    overwrite: options.Overwrite = False,
    allow_mismatch: options.AllowMismatch = False,
    limits: options.Limits = None,
) -> None:
    """Write figures and a report of every estimate of a run directory."""
    from scenetruth.cli.console import reporting
    from scenetruth.pipeline import open_figure_worker

    with (
        reporting() as reporter,
        open_figure_worker(options.helpers()) as helper,
        _runner(run, overwrite, allow_mismatch, limits, reporter, helper) as runner,
    ):
        names = methods or runner.folder.estimated()
        for method in names:
            with runner.keeping_failures(method):
                runner.report(method, figures or None, _beside_png(figure_formats))
    for method in names:
        if method not in runner.failures:
            print_wrote(runner.folder.paths(method).report)
    _raise_failures(runner.results())


def verify(
    path: options.ResultPath,
    *,
    regenerate: options.Regenerate = 0,
    seed: options.Seed = 0,
    as_json: options.Json = False,
) -> None:
    """Check every file of a run, a store or a data set against its checksum."""
    from scenetruth.cli.console import reporting
    from scenetruth.errors import StoreError

    if not _is_dataset(path):
        from scenetruth.pipeline import verify_run

        if regenerate:
            raise StoreError(path, "is not a data set; --regenerate applies to data sets only")
        with reporting() as reporter:
            results = [(str(each.path), each.problem) for each in verify_run(path, progress=reporter)]
    else:
        from scenetruth.dataset.verification import verify_dataset

        with reporting() as reporter:
            failures = verify_dataset(path, regenerate=regenerate, seed=seed, progress=reporter)
        results = [(each.name, each.problem) for each in failures] or [(str(path), "")]
    if as_json:
        typer.echo(json.dumps([{"path": name, "problem": problem} for name, problem in results], indent=2))
    else:
        for name, problem in results[:_MOST_LISTED]:
            echo(f"{name}: {problem}" if problem else f"verified: {name}", err=bool(problem))
    failed = {name for name, problem in results if problem}
    if failed:
        more = f", {_MOST_LISTED} are listed" if len(results) > _MOST_LISTED and not as_json else ""
        raise StoreError(path, f"verification failed for {len(failed):,} of its results{more}; generate them again")


_MOST_LISTED = 20


def _is_dataset(path: Path) -> bool:
    return (path / "dataset.json").exists()


def _beside_png(form: options.FigureFormat) -> tuple[str, ...]:
    return () if form is options.FigureFormat.png else (form.value,)


def _run(
    file: Path,
    overrides: list[str] | None,
    output: Path,
    limits: list[str] | None,
    *,
    save_images: options.ImageFormat | None,
    methods: Sequence[str] = (),
    settings: Sequence[str] = (),
    band: str | None = None,
    helpers: int = 0,
    **wanted: Any,
) -> RunResult:
    """Load a scene, and run its stages; further arguments are passed to `run_pipeline`."""
    from scenetruth.cli.console import reporting
    from scenetruth.errors import EstimateError, Problem, SceneError
    from scenetruth.pipeline import open_figure_worker

    options.read_settings(settings)
    if settings and len(methods) > 1:
        raise EstimateError([Problem("--setting", "is ambiguous with several methods; use --method once", settings)])
    form: Literal["png", "tiff"] | None = None if save_images is None else save_images.value
    with reporting() as reporter, open_figure_worker(helpers) as helper:
        # The first import of the libraries takes seconds: both processes import them simultaneously.
        from scenetruth.pipeline import run_pipeline
        from scenetruth.resources import limits_from, load_checked_scene
        from scenetruth.scene.scene_loader import read_scene

        changes = [*(overrides or ()), *_estimate_fields(settings)]
        chosen: list[MethodLike] = list(dict.fromkeys(methods))
        # A field of the section `estimate` is a setting of the specified method.
        if len(methods) == 1 and ":" in methods[0]:
            fields = [change for change in changes if change.startswith("estimate.")]
            changes = [change for change in changes if change not in fields]
            chosen = [_with_settings(methods[0], fields)]
        elif len(methods) == 1 and ((own := read_scene(file).scene) is None or methods[0] != own.estimate.method):
            changes.insert(0, f"estimate={{method: {json.dumps(methods[0])}}}")
        allowed = limits_from(limits or ())
        loaded = options.choose_band(load_checked_scene(file, overrides=changes, limits=allowed), band)
        try:
            return run_pipeline(
                loaded,
                output,
                methods=chosen,
                limits=allowed,
                save_images=form,
                helpers=helper or 0,
                progress=reporter,
                **wanted,
            )
        except SceneError as error:
            raise SceneError(error.problems, source=file) from error


def _with_settings(method: str, fields: Sequence[str]) -> MethodSpec:
    """Return user code, which a scene cannot name, with its settings."""
    from scenetruth.estimators import MethodSpec
    from scenetruth.scene.scene_loader import apply_overrides

    alone: dict[str, Any] = {"estimate": {"method": method}}
    apply_overrides(alone, fields)
    settings = alone["estimate"]
    return MethodSpec(settings.pop("method"), settings)


def _runner(
    folder: Path,
    overwrite: bool,
    allow_mismatch: bool,
    limits: list[str] | None,
    reporter: ProgressReporter,
    helper: FigureWorker | None = None,
) -> PipelineRunner:
    from scenetruth.pipeline import PipelineRunner, RunDirectory
    from scenetruth.resources.limits import limits_from

    allowed = limits_from(limits or ())
    return PipelineRunner(RunDirectory(folder), overwrite, not allow_mismatch, reporter, helper, allowed)


def _print_scores(results: RunResult, region: str) -> None:
    from scenetruth.cli.console import print_score

    for method, scored in results.scores.items():
        print_score(scored, method if len(results.scores) > 1 else "", region)


def _print_results(results: RunResult) -> None:
    from scenetruth.cli.console import make_console, print_main_figures
    from scenetruth.cli.terminal_preview import print_picture

    for method, scored in results.scores.items():
        print_picture(results.folder, method, make_console())
        print_main_figures(scored, method)
        page = results.folder.paths(method).report
        if page.is_file():
            echo(f"page: {page.absolute().as_uri()}")


def _raise_failures(results: RunResult) -> None:
    """Raise a single failure unchanged, and several failures as one error."""
    from scenetruth.errors import ScenetruthError

    failures = list(results.failures.values())
    if len(failures) == 1:
        raise failures[0]
    if failures:
        raise ScenetruthError("\n".join(f"{method}: {error}" for method, error in results.failures.items()))


_EXIT_UNFIT = 2


def register_info(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    options.add_command(app, check)
    options.add_command(app, list_, "list")
    for command in (schema, precompile, doctor):
        options.add_command(app, command)


def check(
    scene: options.SceneFile,
    overrides: options.Overrides = None,
    limits: options.Limits = None,
    *,
    as_json: options.Json = False,
) -> None:
    """Validate a scene, and predict the size of its results and the resources they need."""
    from scenetruth.cli.check_report import print_check
    from scenetruth.resources import limits_from, load_checked_scene

    allowed = limits_from(limits or ())
    loaded = load_checked_scene(scene, overrides=overrides or (), limits=allowed)
    print_check(loaded, scene, allowed, as_json=as_json)


def list_(kind: options.Listed, *, as_json: options.Json = False) -> None:
    """List bundled files, methods, export formats or benchmark cases."""
    from scenetruth.cli import listings

    rows = listings.collect(kind.value)
    if as_json:
        typer.echo(json.dumps(rows, indent=2))
    else:
        listings.print_rows(kind.value, rows)


def schema(kind: options.SchemaOf = options.SchemaKind.scene) -> None:
    """Print the JSON Schema of scenes, recipes, design specifications or captures."""
    model: type[BaseModel]
    if kind is options.SchemaKind.scene:
        from scenetruth.scene import Scene as model
    elif kind is options.SchemaKind.recipe:
        from scenetruth.dataset.recipe_loader import Recipe as model
    elif kind is options.SchemaKind.design:
        from scenetruth.design.optimisation import DesignSpec as model
    else:
        from scenetruth.capture import Capture as model
    typer.echo(json.dumps(model.model_json_schema(), indent=2))


def precompile() -> None:
    """Precompile the numerical kernels (1 to 2 min, once per machine)."""
    from scenetruth import pipeline
    from scenetruth.cli.console import reporting

    with reporting() as report, pipeline.open_figure_worker(options.helpers()) as helper:
        pipeline.precompile(report, helper)
    if verbosity() is not Verbosity.quiet:
        typer.echo("compilation finished")


def doctor(*, as_json: options.Json = False) -> None:
    """Check the installation and list every problem with its fix."""
    from scenetruth.cli import diagnostics

    checks = diagnostics.run_checks()
    if as_json:
        typer.echo(diagnostics.checks_to_json(checks))
    else:
        diagnostics.print_checks(checks)
    if not diagnostics.is_fit(checks):
        raise typer.Exit(_EXIT_UNFIT)


def register_export(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    options.add_command(app, export)
    options.add_command(app, strain)


def export(
    path: options.ExportSource,
    format: options.Format,
    output: options.Output,
    *,
    left: options.Left = None,
    flow: options.Flow = None,
    format_options: options.FormatOptions = None,
    method: options.ExportedMethod = None,
    row: options.Row = None,
    overwrite: options.Overwrite = False,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
) -> None:
    """Export a run, or every sample of a data set, in another format."""
    from scenetruth.pipeline import export_run

    chosen = _read_format_options(format_options, {"left": left, "flow": flow})
    wanted: dict[str, Any] = {"method": method, "row": row, "overwrite": overwrite, **chosen}
    if _is_dataset(path):
        _export_samples(path, output, format, workers=workers, scheduler=scheduler, **wanted)
        return
    done = export_run(path, output, format, **wanted)
    for note in done.notes:
        print_note(note)
    print_wrote(output, f"{len(done.files)} files")


def strain(
    run: options.RunPath,
    output: options.Output,
    *,
    method: options.StrainMethod = None,
    measure: options.StrainMeasure = options.StrainChoice.green_lagrange,
    window: options.StrainWindow = 11,
    step: options.StrainStep = 4,
    order: options.StrainOrder = 1,
    weights: options.StrainWeights = options.StrainWeight.uniform,
    subset_px: options.SubsetPx = None,
    since: options.SinceFrame = None,
    overwrite: options.Overwrite = False,
    allow_mismatch: options.AllowMismatch = False,
    as_json: options.Json = False,
) -> None:
    """Compute the strain of an estimate with its gauge, its score and the fields of a report."""
    from scenetruth.cli.console import print_warning
    from scenetruth.pipeline import run_strain
    from scenetruth.strain import StrainSettings, describe_missing_strain, strain_settings

    wanted = {"measure": measure.value, "window": window, "step": step, "order": order, "weights": weights.value}
    settings: StrainSettings = strain_settings({**wanted, "subset_px": subset_px})
    done = run_strain(
        run, output, method=method, settings=settings, since=since, overwrite=overwrite, allow_mismatch=allow_mismatch
    )
    if as_json:
        scored = None if done.score is None else done.score.to_dict()
        typer.echo(json.dumps({"score": scored, "good_practice": done.practice.to_dict()}, indent=2))
        return
    attrs = done.strain.attrs
    length = f"{attrs['gauge_length_px']:.4g} px" + (
        f", {attrs['gauge_length_mm']:.3g} mm" if "gauge_length_mm" in attrs else ""
    )
    open_subset = "" if "subset_px" in attrs else " without the subset, which the estimate does not state (--subset-px)"
    echo(f"{done.method or 'truth'}: virtual strain gauge {length}{open_subset}")
    missing = describe_missing_strain(done.strain["invalid_reason"].values, settings)
    if missing:
        print_warning(missing)
    elif done.score is not None:
        echo(done.score.summary())
    echo(done.practice.summary().splitlines()[0])
    print_wrote(output)


def _export_samples(dataset: Path, output: Path, format: str, **wanted: Any) -> None:
    from scenetruth.cli.console import reporting
    from scenetruth.dataset.dataset_export import export_dataset

    with reporting() as reporter:
        result = export_dataset(dataset, output, format, progress=reporter, **wanted)
    print_wrote(output, f"{result.done:,} samples; {result.present:,} existing samples were reused")
    if result.failed:
        raise typer.Exit(1)


_OF_EXPORT = ("format", "method", "row", "overwrite", "folder", "out", "kind", "output", "path", "workers")


def _read_format_options(given: Sequence[str] | None, named: dict[str, Any]) -> dict[str, Any]:
    """Return the options of the format: those of --option, and those with a name on the command line."""
    from scenetruth.errors import ExportError, Problem

    values, problems = options.parse_assignments("--option", given)
    problems += [
        Problem("--option", f"{name} is not an option of a format; see `scenetruth export --help`", values[name])
        for name in values
        if name in _OF_EXPORT
    ]
    for name, value in named.items():
        if value is not None and name in values:
            problems.append(Problem("--option", f"{name} is given twice", values[name]))
        elif value is not None:
            values[name] = value
    if problems:
        raise ExportError(problems)
    return values
