"""The commands of ``scenetruth``."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scenetruth import __version__

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from rich.console import Console

    from scenetruth.cli.console import Reporter
    from scenetruth.experiment.fidelity.run import Fidelity
    from scenetruth.scene import Scene
    from scenetruth.scoring import Score
    from scenetruth.settings import EstimateSettings, ScoreSettings

__all__ = ["app", "run_app"]

app = typer.Typer(
    name="scenetruth",
    help="Rendered scenes with exact ground truth for measuring depth and 3D motion from a camera on a linear stage.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


class ImageForm(StrEnum):
    """File formats of images."""

    png = "png"
    tiff = "tiff"


class TruthViews(StrEnum):
    """Cameras that a truth is made for."""

    reference = "reference"
    all = "all"


class TruthPoses(StrEnum):
    """Poses and times that a truth is made for."""

    real = "real"
    nominal = "nominal"


class TruthContent(StrEnum):
    """Maps that a truth holds."""

    standard = "standard"
    complete = "complete"


class Platform(StrEnum):
    """OpenGL platforms of pyrender."""

    auto = "auto"
    osmesa = "osmesa"
    egl = "egl"


class Divergence(StrEnum):
    """Forms of the divergence term."""

    paper = "paper"
    consistent = "consistent"


experiments = typer.Typer(help="Answer a question about the method by many virtual measurements.", no_args_is_help=True)
app.add_typer(experiments, name="experiment")

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (YAML).", show_default=False)]
Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder with the stores of a run.", show_default=False)]
Output = Annotated[Path, typer.Option("--output", "-o", help="Folder to make.", show_default=False)]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="PATH=VALUE", help="Override a field of the scene; may be repeated.", show_default=False
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace results that exist.")]
Images = Annotated[
    ImageForm | None,
    typer.Option("--images", help="Write the images as 16-bit PNG or float TIFF too.", show_default=False),
]
Truth = Annotated[TruthViews, typer.Option("--truth", help="Truth of the reference camera or of all cameras.")]
Poses = Annotated[
    TruthPoses,
    typer.Option("--truth-poses", help="Truth from where the camera stood, or from where it should have stood."),
]
Content = Annotated[
    TruthContent,
    typer.Option("--truth-content", help="What estimates are scored against, or everything known of the surface."),
]
Ideal = Annotated[bool, typer.Option("--ideal", help="Keep the linear images before the sensor too.")]


def run_app() -> None:
    """Run the command line."""
    from scenetruth.cli.console import guard

    guard(lambda: app())


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"scenetruth {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


@app.command()
def run(
    scene: SceneFile,
    output: Output,
    overrides: Overrides = None,
    overwrite: Overwrite = False,
    images: Images = None,
    truth: Truth = TruthViews.reference,
    truth_poses: Poses = TruthPoses.real,
    truth_content: Content = TruthContent.standard,
    ideal: Ideal = False,
) -> None:
    """Render a scene, estimate, score and report, in one go."""
    from scenetruth.cli.console import reporting
    from scenetruth.estimators.structure_tensor.rig import requirements
    from scenetruth.storage import write_aside

    spec = _load(scene, overrides)
    camera = spec.camera
    problems = requirements(spec.estimate, spec.stage.positions, spec.frames.count, camera.width, camera.height)
    if spec.stage.rows > 1:
        from scenetruth.errors import Problem

        message = "a grid cannot be estimated as a whole: `scenetruth render` it, then estimate recording.sel(s_y=0)"
        problems.append(Problem("stage.rows", message, spec.stage.rows))
    if problems:
        from scenetruth.errors import SceneError

        raise SceneError(problems, source=scene)
    with write_aside(output, overwrite=overwrite) as folder, reporting() as report:
        recording, exact = _render(spec, folder, images, (truth, truth_poses, truth_content), report, ideal=ideal)
        estimated = _estimate(recording, spec.estimate, folder, report, overwrite=False)
        scored = _score(estimated, exact, recording, spec.score, folder, report)
        _report(recording, estimated, exact, scored, folder, report)
        del recording, exact, estimated
    _print_score(scored)
    typer.echo(f"written: {output}")


@app.command()
def render(
    scene: SceneFile,
    output: Output,
    overrides: Overrides = None,
    overwrite: Overwrite = False,
    images: Images = None,
    truth: Truth = TruthViews.reference,
    truth_poses: Poses = TruthPoses.real,
    truth_content: Content = TruthContent.standard,
    ideal: Ideal = False,
) -> None:
    """Render a scene: a recording and its truth."""
    from scenetruth.cli.console import reporting
    from scenetruth.storage import write_aside

    spec = _load(scene, overrides)
    with write_aside(output, overwrite=overwrite) as folder, reporting() as report:
        _render(spec, folder, images, (truth, truth_poses, truth_content), report, ideal=ideal)
    typer.echo(f"written: {output / 'recording.zarr'}, {output / 'truth.zarr'}")


@app.command()
def estimate(folder: Folder, overrides: Overrides = None, overwrite: Overwrite = False) -> None:
    """Estimate depth and motion from FOLDER/recording.zarr."""
    from scenetruth.cli.console import reporting
    from scenetruth.storage import load

    target = folder / "estimate.zarr"
    _refuse_existing([target], overwrite)
    recording = load(folder / "recording.zarr", "recording")
    settings = _settings_in(recording, "estimate", overrides)
    from scenetruth.estimators import estimate_settings

    with reporting() as report:
        _estimate(recording, estimate_settings(**settings), folder, report, overwrite=overwrite)
    typer.echo(f"written: {target}")
    stale = [name for name in ("score.json", "score.csv", "report.html", "figures") if (folder / name).exists()]
    if stale:
        remedy = "repeat `scenetruth score` and `scenetruth report` with --overwrite"
        typer.echo(f"warning: {', '.join(stale)} in {folder} belong to the former estimate; {remedy}", err=True)


@app.command()
def score(folder: Folder, overrides: Overrides = None, overwrite: Overwrite = False) -> None:
    """Score FOLDER/estimate.zarr against FOLDER/truth.zarr."""
    from scenetruth.cli.console import reporting
    from scenetruth.storage import load

    targets = [folder / "score.json", folder / "score.csv"]
    _refuse_existing(targets, overwrite)
    estimated, exact = load(folder / "estimate.zarr", "estimate"), load(folder / "truth.zarr", "truth")
    recording = load(folder / "recording.zarr", "recording")
    from scenetruth.scoring import score_settings

    settings = score_settings(**_settings_in(recording, "score", overrides))
    with reporting() as report:
        scored = _score(estimated, exact, recording, settings, folder, report, overwrite=overwrite)
    _print_score(scored)
    typer.echo(f"written: {', '.join(map(str, targets))}")


@app.command()
def report(folder: Folder, overwrite: Overwrite = False) -> None:
    """Draw the pictures and the report of FOLDER."""
    from scenetruth.cli.console import reporting
    from scenetruth.errors import StoreError
    from scenetruth.scoring import Score
    from scenetruth.storage import load

    _refuse_existing([folder / "report.html", folder / "figures"], overwrite)
    file = folder / "score.json"
    try:
        scored = Score.from_json(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise StoreError(file, "cannot be read; make it with `scenetruth score`") from error
    recording, exact = load(folder / "recording.zarr", "recording"), load(folder / "truth.zarr", "truth")
    estimated = load(folder / "estimate.zarr", "estimate")
    with reporting() as reporter:
        _report(recording, estimated, exact, scored, folder, reporter, overwrite=overwrite)
    typer.echo(f"written: {folder / 'report.html'}")


@app.command()
def check(scene: SceneFile, overrides: Overrides = None) -> None:
    """Validate a scene and print what will be made from it."""
    from scenetruth.cli.check import print_check

    print_check(_load(scene, overrides), scene)


@app.command()
def schema() -> None:
    """Print the JSON Schema of scene files."""
    from scenetruth.scene import Scene

    typer.echo(json.dumps(Scene.model_json_schema(), indent=2))


@experiments.command()
def figure2(
    output: Output,
    divergence: Annotated[Divergence, typer.Option(help="Setting of the estimator.")] = Divergence.paper,
    runs: Annotated[
        int | None, typer.Option(min=1, help="Measurements for each point; 8 without, 60 with noise if not given.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Draw the paper's figure 2: errors of U_X, U_Z and Z over their size."""
    from scenetruth.cli.console import reporting
    from scenetruth.experiment import run_figure2
    from scenetruth.storage import write_aside

    with write_aside(output, overwrite=overwrite) as folder, reporting() as report:
        run_figure2(folder, divergence=divergence.value, runs=runs, progress=report)
    typer.echo(f"written: {output / 'figure2.csv'}, {output / 'figure2.png'}")


@experiments.command()
def emva(
    output: Output,
    preset: Annotated[
        list[str] | None,
        typer.Option("--preset", metavar="NAME", help="A sensor preset; may be repeated; all if not given."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Measure sensor presets as EMVA 1288 does: gain, noise, fixed patterns, saturation, linearity."""
    from scenetruth.cli.console import reporting
    from scenetruth.experiment import run_emva
    from scenetruth.storage import write_aside

    with write_aside(output, overwrite=overwrite) as folder, reporting() as report:
        results = run_emva(folder, preset or (), progress=report)
    for one in results:
        typer.echo(f"{one.sensor:16} {one.quantity:22} {one.told:10.5g} {one.measured:10.5g} {100 * one.error:+8.3f} %")
    typer.echo(f"written: {output / 'emva.csv'}, {output / 'emva_levels.csv'} and a picture of each sensor")


@experiments.command()
def fidelity(
    output: Output,
    platform: Annotated[Platform, typer.Option(help="OpenGL platform of pyrender.")] = Platform.auto,
    overwrite: Overwrite = False,
) -> None:
    """Measure how true the renderers are to the exact pixel integral, at sub-pixel shifts."""
    from scenetruth.cli.console import reporting
    from scenetruth.experiment import run_fidelity
    from scenetruth.storage import write_aside

    with write_aside(output, overwrite=overwrite) as folder, reporting() as report:
        results, reason = run_fidelity(folder, platform=platform.value, progress=report)
    _print_fidelity(results)
    if reason:
        typer.echo(f"left out: {reason}")
    names = ("fidelity.csv", "fidelity.json", "fidelity.png", "fidelity_maps.png")
    typer.echo("written: " + ", ".join(str(output / name) for name in names))


def _load(scene: Path, overrides: list[str] | None) -> Scene:
    from scenetruth.scene import load_scene

    return load_scene(scene, overrides or ())


def _refuse_existing(targets: list[Path], overwrite: bool) -> None:
    from scenetruth.errors import OutputExistsError

    for target in targets:
        if target.exists() and not overwrite:
            raise OutputExistsError(target, "exists already; say --overwrite to replace it")


def _settings_in(recording: xr.Dataset, section: str, overrides: list[str] | None) -> dict[str, Any]:
    """Return a section of the recorded scene with overrides; everything else of the scene is past changing."""
    from scenetruth.errors import Problem, SceneError
    from scenetruth.scene.load import apply_overrides, scene_from_plain
    from scenetruth.schema import scene_of

    fixed = [text for text in overrides or () if not text.startswith(f"{section}.")]
    if fixed:
        message = f"only fields of '{section}' can be changed after rendering"
        raise SceneError([Problem("--set", message, text) for text in fixed])
    plain = scene_of(recording)
    if plain is None:
        alone: dict[str, Any] = {section: {}}
        apply_overrides(alone, overrides or ())
        return dict(alone[section])
    apply_overrides(plain, overrides or ())
    return dict(scene_from_plain(plain).to_plain()[section])


def _render(
    spec: Scene,
    folder: Path,
    images: ImageForm | None,
    truth: tuple[TruthViews, TruthPoses, TruthContent],
    report: Reporter,
    *,
    ideal: bool,
) -> tuple[xr.Dataset, xr.Dataset]:
    import yaml

    from scenetruth.simulation import simulate
    from scenetruth.storage import save, write_images

    with report.timed("simulate"):
        views, poses, content = truth
        recording, exact = simulate(
            spec,
            truth_views=views.value,
            truth_poses=poses.value,
            truth_content=content.value,
            ideal=ideal,
            progress=report,
        )
    backend, reason = recording.attrs["render_backend"], recording.attrs["render_fallback_reason"]
    report.say(f"rendered with {backend}" + (f": {reason}" if reason else ""))
    with report.timed("save"):
        folder.mkdir(parents=True)
        (folder / "scene.yaml").write_text(
            yaml.safe_dump(spec.to_plain(), sort_keys=False, allow_unicode=True), encoding="utf-8"
        )
        save(recording, folder / "recording.zarr")
        save(exact, folder / "truth.zarr")
        if images is not None:
            write_images(recording, folder / "images", images.value)
    return recording, exact


def _estimate(
    recording: xr.Dataset, settings: EstimateSettings, folder: Path, report: Reporter, *, overwrite: bool
) -> xr.Dataset:
    from scenetruth.estimators import estimate as estimate_maps
    from scenetruth.storage import save

    with report.timed("estimate"):
        estimated = estimate_maps(recording, progress=report, **settings.model_dump())
    save(estimated, folder / "estimate.zarr", overwrite=overwrite)
    return estimated


def _score(
    estimated: xr.Dataset,
    exact: xr.Dataset,
    recording: xr.Dataset,
    settings: ScoreSettings,
    folder: Path,
    report: Reporter,
    *,
    overwrite: bool = False,
) -> Score:
    from scenetruth.scoring import score as score_estimate
    from scenetruth.storage import write_aside

    attrs = recording.attrs
    metadata = {
        "versions": json.loads(attrs.get("versions", "{}")),
        "scene_hash": attrs.get("scene_hash"),
        "seed": attrs.get("seed"),
        "render_backend": attrs.get("render_backend"),
        "render_fallback_reason": attrs.get("render_fallback_reason"),
        "working_point_px": estimated.attrs.get("working_point_px"),
        "estimate_settings": json.loads(estimated.attrs.get("settings", "{}")),
        "timings_s": dict(report.timings_s),
    }
    scored = score_estimate(estimated, exact, recording, metadata=metadata, **settings.model_dump())
    for name, text in (("score.json", scored.to_json()), ("score.csv", scored.to_csv())):
        with write_aside(folder / name, overwrite=overwrite) as aside:
            aside.write_text(text, encoding="utf-8")
    return scored


def _report(
    recording: xr.Dataset,
    estimated: xr.Dataset,
    exact: xr.Dataset,
    scored: Score,
    folder: Path,
    report: Reporter,
    *,
    overwrite: bool = False,
) -> None:
    from tempfile import TemporaryDirectory

    from scenetruth.scoring import write_report
    from scenetruth.storage import write_aside

    with TemporaryDirectory(prefix=".report-", dir=folder) as made:
        write_report(recording, estimated, exact, scored, Path(made), progress=report)
        for name in ("figures", "report.html"):
            with write_aside(folder / name, overwrite=overwrite) as place:
                Path(made, name).rename(place)


def _print_fidelity(results: Sequence[Fidelity]) -> None:
    from rich.table import Table

    table = Table(title="rendered against exact images, subsets of 25 x 25 px", title_justify="left")
    for heading in ("wavelengths", "backend"):
        table.add_column(heading)
    for heading in ("samples", "shift rms, px", "max, px", "bound, px", "grey rms / std", "ms per image"):
        table.add_column(heading, justify="right")
    for result in results:
        bound = result.bound_px
        verdict = "–" if bound is None else f"{bound:.0e}, {'kept' if result.within_bounds else 'missed'}"
        table.add_row(
            f"from {result.shortest_wavelength_px:g} px",
            result.backend,
            f"{result.supersampling} x {result.supersampling}",
            f"{result.rms_px:.1e}",
            f"{result.max_px:.1e}",
            verdict,
            f"{result.rms_grey:.1e}",
            f"{1000 * result.seconds_per_image:.0f}",
        )
    _console().print(table)


def _console() -> Console:
    from rich.console import Console

    console = Console()
    return console if console.is_terminal else Console(width=120)


def _print_score(scored: Score) -> None:
    from rich.table import Table

    from scenetruth.scoring import units_of
    from scenetruth.scoring.quantities import GROWTH_QUANTITIES

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
    table = Table(title="region interior", title_justify="left")
    table.add_column("quantity", overflow="fold")
    table.add_column("unit")
    for name in headings.values():
        table.add_column(name, justify="right")
    for quantity, values in scored.regions["interior"].items():
        if quantity == "outliers" or (quantity in GROWTH_QUANTITIES and not scored.grows):
            continue
        cells = [values.get(name) for name in headings]
        table.add_row(quantity, units_of(quantity), *("–" if value is None else f"{value:.3g}" for value in cells))
    _console().print(table)
    _print_regions(scored)


def _print_regions(scored: Score) -> None:
    """Print the rms errors of some quantities in every region that has any pixel scored."""
    from rich.table import Table

    from scenetruth.scoring import units_of
    from scenetruth.scoring.quantities import GROWTH_QUANTITIES

    names = [
        name
        for name in ("depth", "velocity_z", "velocity_endpoint", "growth_rate", "growth_rate_windowed")
        if name in scored.regions["all"] and (name not in GROWTH_QUANTITIES or scored.grows)
    ]
    table = Table(title="all regions, rms errors", title_justify="left")
    table.add_column("region", overflow="fold")
    for name in ("pixels", "density", *(f"{name}\n{units_of(name)}" for name in names)):
        table.add_column(name, justify="right")
    for region, quantities in scored.regions.items():
        depth = quantities["depth"]
        if not depth["count"]:
            continue
        cells = [depth["density"], *(quantities[name]["rms"] for name in names)]
        table.add_row(region, f"{depth['count']:,}", *("–" if value is None else f"{value:.3g}" for value in cells))
    _console().print(table)
