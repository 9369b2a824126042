"""The commands outside a group: those that read a scene or a run directory, and those about the installation."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from scenetruth.cli import options

if TYPE_CHECKING:
    from scenetruth.cli.console import ProgressReporter
    from scenetruth.estimators import MethodLike, MethodSpec
    from scenetruth.pipeline import FigureWorker, PipelineRunner, RunResult

__all__ = ["register_export", "register_info", "register_runs"]


def register_runs(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (run, render, estimate, score, report, verify):
        app.command()(command)


def run(
    scene: options.SceneFile,
    output: options.Output,
    *,
    overrides: options.Overrides = None,
    limits: options.Limits = None,
    methods: options.Methods = None,
    overwrite: options.Overwrite = False,
    images: options.Images = None,
    truth: options.Truth = options.TruthViews.reference,
    truth_poses: options.Poses = options.TruthPoses.real,
    truth_content: options.Content = options.TruthContent.standard,
    ideal: options.Ideal = False,
    report: options.Report = True,
    figures: options.Figures = None,
    figures_format: options.FiguresFormat = options.FigureForm.png,
) -> None:
    """Render a scene, estimate, score and report, in one go."""
    results = _run(
        scene,
        overrides,
        output,
        limits,
        stages=("render", "estimate", "score", "report")[: 4 if report else 3],
        methods=methods or (),
        truth=(truth.value, truth_poses.value, truth_content.value),
        save_radiance=ideal,
        save_images=images,
        overwrite=overwrite,
        figures=figures or None,
        figure_formats=("png", *_beside_png(figures_format)),
        helpers=options.helpers() if report else 0,
    )
    _print_results(results)
    _echo(f"written: {output}")
    _raise_failures(results)


def render(
    scene: options.SceneFile,
    output: options.Output,
    *,
    overrides: options.Overrides = None,
    limits: options.Limits = None,
    overwrite: options.Overwrite = False,
    images: options.Images = None,
    truth: options.Truth = options.TruthViews.reference,
    truth_poses: options.Poses = options.TruthPoses.real,
    truth_content: options.Content = options.TruthContent.standard,
    ideal: options.Ideal = False,
) -> None:
    """Render a scene: a recording and its truth."""
    results = _run(
        scene,
        overrides,
        output,
        limits,
        stages=("render",),
        truth=(truth.value, truth_poses.value, truth_content.value),
        save_radiance=ideal,
        save_images=images,
        overwrite=overwrite,
    )
    _echo(f"written: {results.folder.recording}, {results.folder.truth}")


def estimate(
    folder: options.Folder,
    overrides: options.Overrides = None,
    methods: options.Methods = None,
    overwrite: options.Overwrite = False,
    limits: options.Limits = None,
    *,
    command: options.Command = None,
    name: options.CommandName = "command",
    command_images: options.CommandImages = options.SharedForm.png,
    timeout_s: options.TimeoutS = 600.0,
    memory_mb: options.MemoryMb = None,
    reads_masks: options.ReadsMasks = False,
    keep_in: options.KeepIn = None,
) -> None:
    """Estimate depth and motion from FOLDER/recording.zarr."""
    from scenetruth.cli.console import reporting

    with ExitStack() as open_:
        names: list[str | None] = [*(methods or ())]
        if command is not None:
            from scenetruth.estimators import Needs, offered
            from scenetruth.estimators.external import CommandMethod

            made = CommandMethod(
                command,
                name,
                images=command_images.value,
                timeout_s=timeout_s,
                memory_mb=memory_mb,
                keep_in=keep_in,
                needs=Needs(exclusion_mask=reads_masks),
            )
            open_.enter_context(offered(made))
            names.append(name)
        names = names or [None]
        reporter = open_.enter_context(reporting())
        runner = open_.enter_context(_runner(folder, overwrite, False, limits, reporter))
        choices = [runner.choice(each, overrides or ()) for each in names]
        for choice in choices:
            with runner.keeping_failures(choice.method):
                runner.estimate(choice)
    for choice in choices:
        files = runner.folder.of(choice.method)
        if choice.method in runner.failures:
            continue
        _echo(f"written: {files.estimate}")
        stale = [path.name for path in files.after_estimate if path.exists()]
        if stale:
            remedy = "repeat `scenetruth score` and `scenetruth report` with --overwrite"
            _echo(f"warning: {', '.join(stale)} in {folder} belong to the former estimate; {remedy}", err=True)
    _raise_failures(runner.results())


def score(
    folder: options.Folder,
    overrides: options.Overrides = None,
    methods: options.Methods = None,
    overwrite: options.Overwrite = False,
    allow_mismatch: options.AllowMismatch = False,
    limits: options.Limits = None,
) -> None:
    """Score every estimate in FOLDER against FOLDER/truth.zarr."""
    from scenetruth.cli.console import reporting

    with reporting() as reporter, _runner(folder, overwrite, allow_mismatch, limits, reporter) as runner:
        names = methods or runner.folder.estimated()
        settings = runner.score_settings(overrides or ())
        for method in names:
            with runner.keeping_failures(method):
                runner.score(method, settings)
    results = runner.results()
    _print_scores(results)
    for method in results.scores:
        files = runner.folder.of(method)
        _echo(f"written: {files.score_json}, {files.score_csv}")
    _raise_failures(results)


def report(
    folder: options.Folder,
    methods: options.Methods = None,
    figures: options.Figures = None,
    figures_format: options.FiguresFormat = options.FigureForm.png,
    overwrite: options.Overwrite = False,
    allow_mismatch: options.AllowMismatch = False,
    limits: options.Limits = None,
) -> None:
    """Draw the pictures and the report of every estimate in FOLDER; without a truth, those that need none."""
    from scenetruth.cli.console import reporting
    from scenetruth.pipeline import open_figure_worker

    with (
        reporting() as reporter,
        open_figure_worker(options.helpers()) as helper,
        _runner(folder, overwrite, allow_mismatch, limits, reporter, helper) as runner,
    ):
        names = methods or runner.folder.estimated()
        for method in names:
            with runner.keeping_failures(method):
                runner.report(method, figures or None, _beside_png(figures_format))
    for method in names:
        if method not in runner.failures:
            _echo(f"written: {runner.folder.of(method).report}")
    _raise_failures(runner.results())


def verify(folder: options.Results) -> None:
    """Check that the results in FOLDER are as they were written, to the last byte of their data."""
    from scenetruth.cli.console import reporting
    from scenetruth.errors import StoreError
    from scenetruth.pipeline import verify_run

    with reporting() as reporter:
        verdicts = verify_run(folder, progress=reporter)
    for verdict in verdicts:
        _echo(f"{verdict.path}: {verdict.problem or 'whole'}", err=bool(verdict.problem))
    damaged = {verdict.path for verdict in verdicts if verdict.problem}
    if damaged:
        raise StoreError(folder, f"{len(damaged)} of its results cannot be trusted; make them again")


def _echo(text: str, *, err: bool = False) -> None:
    """Print a line; names of files may hold what a terminal obeys."""
    from scenetruth.errors import visible

    typer.echo(visible(text), err=err)


def _beside_png(form: options.FigureForm) -> tuple[str, ...]:
    return () if form is options.FigureForm.png else (form.value,)


def _run(
    file: Path,
    overrides: list[str] | None,
    output: Path,
    limits: list[str] | None,
    *,
    save_images: options.ImageForm | None,
    methods: Sequence[str] = (),
    helpers: int = 0,
    **wanted: Any,
) -> RunResult:
    """Load a scene, and take it through stages; what else is ``wanted`` is told to `run_pipeline`."""
    from scenetruth.cli.console import reporting
    from scenetruth.errors import SceneError
    from scenetruth.pipeline import open_figure_worker

    form: Literal["png", "tiff"] | None = None if save_images is None else save_images.value
    with reporting() as reporter, open_figure_worker(helpers) as helper:
        # Libraries take seconds to load when they are read from disk for the first time: both processes do so at once.
        from scenetruth.pipeline import run_pipeline
        from scenetruth.resources.limits import limits_from
        from scenetruth.scene import load_scene

        changes = list(overrides or ())
        chosen: list[MethodLike] = list(dict.fromkeys(methods))
        # --set estimate.FIELD means a field of the one method that is given.
        if len(methods) == 1 and ":" in methods[0]:
            fields = [change for change in changes if change.startswith("estimate.")]
            changes = [change for change in changes if change not in fields]
            chosen = [_with_settings(methods[0], fields)]
        elif len(methods) == 1 and methods[0] != load_scene(file).estimate.method:
            changes.insert(0, f"estimate={{method: {json.dumps(methods[0])}}}")
        loaded, allowed = load_scene(file, overrides=changes), limits_from(limits or ())
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
    """Return code, which no scene may name, with its settings."""
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


def _print_scores(results: RunResult) -> None:
    from scenetruth.cli.console import print_score

    for method, scored in results.scores.items():
        print_score(scored, method if len(results.scores) > 1 else "")


def _print_results(results: RunResult) -> None:
    """Print what a run has found, in short, with a picture where the terminal shows one, and name its pages."""
    from scenetruth.cli.console import make_console, print_main_figures
    from scenetruth.cli.terminal_preview import print_picture

    for method, scored in results.scores.items():
        print_picture(results.folder, method, make_console())
        print_main_figures(scored, method)
        page = results.folder.of(method).report
        if page.is_file():
            _echo(f"page: {page.absolute().as_uri()}")


def _raise_failures(results: RunResult) -> None:
    """Tell what went wrong; one failure as it is, several one after the other."""
    from scenetruth.errors import ScenetruthError

    failures = list(results.failures.values())
    if len(failures) == 1:
        raise failures[0]
    if failures:
        raise ScenetruthError("\n".join(f"{method}: {error}" for method, error in results.failures.items()))


_EXIT_UNFIT = 2


def register_info(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    for command in (check, scenes, schema, methods, warm_up, doctor):
        app.command()(command)


def check(scene: options.SceneFile, overrides: options.Overrides = None, limits: options.Limits = None) -> None:
    """Validate a scene and print what will be made from it."""
    from scenetruth.cli.check_report import print_check
    from scenetruth.resources.limits import limits_from
    from scenetruth.scene import load_scene

    print_check(load_scene(scene, overrides=overrides or ()), scene, limits_from(limits or ()))


def scenes() -> None:
    """List the scenes that are shipped, and recipes and goals: each is called by its name alone."""
    from scenetruth.cli.console import print_bundled

    print_bundled()


def schema() -> None:
    """Print the JSON Schema of scene files."""
    from scenetruth.scene import Scene

    typer.echo(json.dumps(Scene.model_json_schema(), indent=2))


def methods() -> None:
    """List the methods of estimation, ours and those of plug-ins, and what keeps one from being used here."""
    from scenetruth.cli.console import print_methods

    print_methods()


def warm_up() -> None:
    """Compile now what is compiled at first use: a minute or two once, seconds from then on."""
    from scenetruth import pipeline
    from scenetruth.cli.console import reporting

    with reporting() as report, pipeline.open_figure_worker(options.helpers()) as helper:
        pipeline.precompile(report, None if helper is None else helper.compile_method)
    typer.echo("everything is compiled")


def doctor(
    as_json: Annotated[
        bool, typer.Option("--json", help="As JSON, to be sent along with the report of a fault.")
    ] = False,
) -> None:
    """Say what works on this machine and what does not, each with a remedy; exit code 2 if scenes cannot be run."""
    from scenetruth.cli import diagnostics as room

    findings = room.run_checks()
    if as_json:
        typer.echo(room.checks_to_json(findings))
    else:
        room.print_checks(findings)
    if not room.is_fit(findings):
        raise typer.Exit(_EXIT_UNFIT)


def register_export(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(export)


def export(
    folder: Annotated[
        Path | None, typer.Argument(metavar="FOLDER", help="Folder of a run, or of a data set.", show_default=False)
    ] = None,
    format: Annotated[
        str | None,
        typer.Option("--format", metavar="NAME", help="A format; --list tells all.", show_default=False),
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Folder to make.", show_default=False)] = None,
    *,
    left: Annotated[
        int | None, typer.Option("--left", metavar="S", help="Left camera of a pair.", show_default=False)
    ] = None,
    flow: Annotated[
        str | None,
        typer.Option(
            "--flow",
            metavar="KIND",
            help="finite: where points are in the next image; instantaneous: dx/dt.",
            show_default=False,
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="An option of the format; may be repeated.", show_default=False
        ),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            "--method", metavar="NAME", help="Export this method's estimate, not the truth.", show_default=False
        ),
    ] = None,
    row: Annotated[int | None, typer.Option("--row", metavar="N", help="Row of a grid.", show_default=False)] = None,
    overwrite: options.Overwrite = False,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
    listed: Annotated[bool, typer.Option("--list", help="List the formats with their options, and end.")] = False,
) -> None:
    """Write the recording and truth (or an estimate) of a run, or of every sample of a data set, in another format."""
    from scenetruth.errors import ExportError, Problem, visible
    from scenetruth.pipeline import export_run

    if listed:
        from scenetruth.cli.console import print_formats

        print_formats()
        return
    missing = {"FOLDER": folder, "--format": format, "--output": output}
    problems = [
        Problem(name, "is missing; see `scenetruth export --help`") for name, value in missing.items() if not value
    ]
    chosen: dict[str, Any] = {name: value for name, value in (("left", left), ("flow", flow)) if value is not None}
    problems += _read_settings(settings or (), chosen)
    if problems or folder is None or format is None or output is None:
        raise ExportError(problems)
    if (folder / "dataset.json").exists():
        _export_samples(
            folder,
            output,
            format,
            workers=workers,
            scheduler=scheduler,
            method=method,
            row=row,
            overwrite=overwrite,
            **chosen,
        )
        return
    done = export_run(folder, output, format, method=method, row=row, overwrite=overwrite, **chosen)
    for note in done.notes:
        typer.echo(visible(f"note: {note}"), err=True)
    typer.echo(visible(f"written: {output} ({len(done.files)} files)"))


def _export_samples(folder: Path, output: Path, format: str, **wanted: Any) -> None:
    from scenetruth.cli.console import reporting
    from scenetruth.dataset.dataset_export import export_dataset

    with reporting() as reporter:
        found = export_dataset(folder, output, format, progress=reporter, **wanted)
    typer.echo(f"written: {output} ({found.done:,} samples, {found.present:,} were there)")
    if found.failed:
        raise typer.Exit(1)


def _read_settings(given: list[str] | tuple[str, ...], chosen: dict[str, Any]) -> list[Any]:
    """Put settings NAME=VALUE among what is chosen; return what is wrong with them."""
    import yaml

    from scenetruth.errors import Problem

    reserved = ("format", "method", "row", "overwrite", "folder", "out", "kind")
    problems = []
    for text in given:
        name, sign, value = text.partition("=")
        if not sign or not name.isidentifier():
            problems.append(Problem("--set", "must be NAME=VALUE", text))
        elif name in reserved:
            problems.append(Problem("--set", f"{name} is no option of a format; see `scenetruth export --help`", text))
        elif name in chosen:
            problems.append(Problem("--set", f"{name} is given twice", text))
        else:
            try:
                chosen[name] = yaml.safe_load(value)
            except yaml.YAMLError:
                problems.append(Problem("--set", "must have a value in YAML", text))
    return problems
