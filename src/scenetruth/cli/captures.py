"""The commands under `capture`: real images from a folder."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from scenetruth.cli import design_options, options
from scenetruth.cli.messages import echo, print_message, print_wrote

__all__ = ["register"]

_EXIT_MISTAKES = 1

CapturePath = Annotated[
    Path,
    typer.Argument(metavar="FOLDER", help="Folder of images with a capture.yaml, or such a file.", show_default=False),
]

ImageFolder = Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of images.", show_default=False)]

BaselineMm = Annotated[
    float | None,
    options.option(
        "--baseline-mm", metavar="MM", help="Displacement of the camera between neighbouring positions, in mm."
    ),
]

Correct = Annotated[
    bool, typer.Option("--correct/--no-correct", help="Correction with the dark frames and flat fields of the capture.")
]

Undistort = Annotated[bool, options.flag("--undistort", help="Resampling to images without lens distortion.")]


StartFocalLengthPx = Annotated[
    float | None,
    options.option("--focal-length-px", metavar="PX", help="Start value of the focal length in px."),
]

ImportedFile = Annotated[
    Path | None,
    options.option(
        "--import",
        metavar="FILE",
        help="Calibration file, or camera file of OpenCV, Kalibr, COLMAP, MATLAB, MatchID or DICe: the start values; "
        "without board images, the camera.",
    ),
]

StatedStd = Annotated[
    list[str] | None,
    options.repeatable(
        "--std",
        "NAME=VALUE",
        "Standard deviation of an intrinsic parameter of the imported camera (f, c_x, c_y, k1, ...); 0.1 % of f and "
        "5 px of c_x and c_y if not given.",
    ),
]

FreeDistortion = Annotated[
    str | None,
    options.option(
        "--distortion",
        metavar="NAMES",
        help="Estimated coefficients of the distortion, such as k1,k2,p1,p2,k3; if not given, k1,k2,p1,p2 and those "
        "that the residuals ask for.",
    ),
]


RunMethod = Annotated[
    str,
    typer.Option(
        "--method", metavar="METHOD", help="Method of estimation, with settings as in refined[window_sigma_px: 4]."
    ),
]

RunCheck = Annotated[
    bool, typer.Option("--check/--no-check", help="End the run if the check of the images finds mistakes.")
]

Calibration = Annotated[
    Path | None,
    options.option("--calibration", metavar="FILE", help="Calibration of camera and stage."),
]


class ImageGeometry(StrEnum):
    """Images of a recording with a calibration."""

    rectified = "rectified"
    recorded = "recorded"


Geometry = Annotated[
    ImageGeometry,
    typer.Option("--geometry", help="With a calibration: images of an ideal rig, or recorded images with its lens."),
]


class BoardType(StrEnum):
    """Types of calibration boards."""

    charuco = "charuco"
    checkerboard = "checkerboard"
    dots = "dots"
    asymmetric_dots = "asymmetric_dots"


Board = Annotated[
    BoardType | None,
    options.option(
        "--board-type",
        help="Type of the calibration board; charuco if not given. Its size follows from the field of view.",
    ),
]

Poses = Annotated[int | None, options.option("--poses", metavar="N", help="Poses of the board; 8 if not given.")]

Dark = Annotated[int | None, options.option("--dark", metavar="N", help="Images without light; 8 if not given.")]

Flat = Annotated[
    int | None, options.option("--flat", metavar="N", help="Images of a uniformly bright surface; 16 if not given.")
]

Strip = Annotated[bool, options.flag("--strip", help="Fiducial strip in all images of the objects.")]

CaptureParameters = Annotated[
    list[str] | None,
    options.repeatable(
        "--parameter",
        "NAME=VALUE",
        "Parameter of the simulated capture, with a value in YAML: board, poses, scale_std, warp_mm, step_std, "
        "exposures, static, strip_scale_std, distance_mm, noise_seed, truth_maps.",
    ),
]

RunFolder = Annotated[
    Path, typer.Argument(metavar="RUN", help="Run directory with recording and estimate.", show_default=False)
]

Method = Annotated[
    str | None,
    options.option("--method", metavar="NAME", help="Method whose estimate is used, if the run has several."),
]

SurfaceMesh = Annotated[
    Path | None,
    options.option(
        "--surface",
        metavar="FILE",
        help="Mesh of the surface in mm, in the frame of the recording, instead of the depth.",
    ),
]

Draws = Annotated[
    int, options.option("--draws", metavar="N", help="Simulations, which differ in the noise; more lower the scatter.")
]

SceneOnly = Annotated[bool, options.flag("--scene-only", help="Scene of the twin only, without simulation.")]

app = typer.Typer(name="capture", help="Read, check, calibrate and simulate real images.", no_args_is_help=True)


def register(parent: typer.Typer) -> None:
    """Add the commands to the command line."""
    options.add_command(app, init)
    options.add_command(app, check)
    options.add_command(app, calibrate)
    options.add_command(app, import_, "import")
    options.add_command(app, run)
    options.add_command(app, simulate)
    options.add_command(app, twin)
    parent.add_typer(app)


def init(
    folder: ImageFolder,
    focal_length_px: design_options.FocalLengthPx = None,
    baseline_mm: BaselineMm = None,
) -> None:
    """Write a commented capture.yaml for a folder of images, from their names."""
    from scenetruth.capture import write_capture_file

    file = write_capture_file(folder, focal_length_px=focal_length_px, baseline_mm=baseline_mm)
    for line in file.read_text(encoding="utf-8").splitlines():
        text, _, comment = line.partition("#")
        if text.strip().startswith(("images:", "board:", "dark:", "flat:", "static:", "mask:")) and comment:
            echo(f"{text.strip()}  {comment.strip()}")
    print_wrote(file)
    print_message(f"next: fill in {file}, then scenetruth capture check {folder}")


def check(capture: CapturePath, *, as_json: options.Json = False) -> None:
    """Check the images of a capture for mistakes that they show by themselves."""
    from scenetruth.capture import check_capture
    from scenetruth.cli.console import reporting

    with reporting() as reporter:
        report = check_capture(capture, progress=reporter)
    if as_json:
        typer.echo(json.dumps(report.to_dict(), indent=2))
    else:
        for finding in report.findings:
            echo(str(finding))
        if report.noise is not None:
            for line in report.noise.describe():
                echo(f"noise: {line}")
        count = len(report.mistakes("error"))
        missing = f", {len(report.missing):,} missing" if report.missing else ""
        echo(f"{report.image_count:,} images{missing}; " + (f"{count} mistakes" if count else "no mistakes"))
    if not report.usable:
        raise typer.Exit(_EXIT_MISTAKES)


def calibrate(
    capture: CapturePath,
    output: options.Output,
    *,
    focal_length_px: StartFocalLengthPx = None,
    import_file: ImportedFile = None,
    std: StatedStd = None,
    distortion: FreeDistortion = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Calibrate camera and stage from the board images of a capture."""
    from scenetruth.capture import calibrate_capture
    from scenetruth.cli.console import reporting

    start = _read_start(focal_length_px, import_file, std, distortion)
    with reporting() as reporter:
        found = calibrate_capture(
            capture,
            output=output,
            overwrite=overwrite,
            progress=reporter,
            **start,
        )
    for line in found.summary().splitlines():
        echo(line)
    print_wrote(Path(output) / "calibration.yaml")
    print_message(f"next: scenetruth capture import {capture} --calibration {Path(output) / 'calibration.yaml'} -o RUN")


def _read_start(
    focal_length_px: float | None, import_file: Path | None, std: list[str] | None, distortion: str | None
) -> dict[str, Any]:
    """Return the arguments of a calibration that describe its start."""
    from scenetruth.errors import ArgumentError, Problem

    values, problems = options.parse_assignments("--std", std)
    for name, value in values.items():
        if not isinstance(value, int | float) or isinstance(value, bool):
            problems.append(Problem(f"--std {name}", "must be a number", value))
    if focal_length_px is not None and import_file is not None:
        problems.append(Problem("--focal-length-px", "is part of the file of --import; specify one of them"))
    if values and import_file is None:
        problems.append(Problem("--std", "states the standard deviations of a camera of --import, which is missing"))
    if problems:
        raise ArgumentError(problems, source="a calibration")
    return {
        "guess": import_file if focal_length_px is None else focal_length_px,
        "std": values or None,
        "distortion": None if distortion is None else [one.strip() for one in distortion.split(",") if one.strip()],
    }


def import_(
    capture: CapturePath,
    output: options.Output,
    *,
    correct: Correct = True,
    undistort: Undistort = False,
    calibration: Calibration = None,
    geometry: Geometry = ImageGeometry.rectified,
    overwrite: options.Overwrite = False,
) -> None:
    """Read the images of a capture into a run directory, as a recording."""
    from scenetruth.capture import import_capture
    from scenetruth.cli.console import reporting
    from scenetruth.storage import RECORDING, store_name

    with reporting() as reporter:
        recording = import_capture(
            capture,
            output=output,
            overwrite=overwrite,
            correct=correct,
            undistort=undistort,
            calibration=calibration,
            geometry=geometry.value,
            progress=reporter,
        )
    sizes = recording["image"].sizes
    count = sizes["s"] * sizes["t"] * sizes.get("s_y", 1)
    store = Path(output) / store_name(RECORDING, zipped=False)
    print_wrote(store, f"{count:,} images of {sizes['x']} x {sizes['y']} px")
    print_message(f"next: scenetruth estimate {output} --method refined")


def run(
    capture: CapturePath,
    output: options.Output,
    *,
    method: RunMethod = "refined",
    focal_length_px: StartFocalLengthPx = None,
    import_file: ImportedFile = None,
    std: StatedStd = None,
    distortion: FreeDistortion = None,
    check: RunCheck = True,
    limits: options.Limits = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Check, calibrate, import and estimate a capture, and write its report."""
    from scenetruth.capture import run_capture
    from scenetruth.cli.console import reporting
    from scenetruth.estimators.method_specs import parse_method
    from scenetruth.resources.limits import limits_from

    start = _read_start(focal_length_px, import_file, std, distortion)
    with reporting() as reporter:
        done = run_capture(
            capture,
            output,
            method=parse_method(method),
            check=check,
            limits=limits_from(limits or ()),
            overwrite=overwrite,
            progress=reporter,
            **start,
        )
    for finding in done.check.findings:
        echo(str(finding))
    if done.calibration is not None:
        for line in done.calibration.summary().splitlines():
            echo(line)
    print_wrote([done.page, done.folder.paths(done.folder.own_method).report])


def simulate(
    scene: options.SceneFile,
    output: options.Output,
    *,
    overrides: options.Overrides = None,
    seed: options.SceneSeed = None,
    limits: options.Limits = None,
    board: Board = None,
    poses: Poses = None,
    dark: Dark = None,
    flat: Flat = None,
    strip: Strip = False,
    parameters: CaptureParameters = None,
) -> None:
    """Simulate a capture folder: images of boards and objects, dark and flat images, truth."""
    from scenetruth.capture import simulate_capture
    from scenetruth.cli.console import reporting
    from scenetruth.errors import ArgumentError, Problem
    from scenetruth.resources.limits import limits_from

    values, problems = options.parse_assignments("--parameter", parameters)
    named: dict[str, Any] = {
        "board": None if board is None else board.value,
        "poses": poses,
        "dark": dark,
        "flat": flat,
        "strip": strip or None,
    }
    given = {name: value for name, value in named.items() if value is not None}
    problems += [
        Problem(
            "--board-type" if name == "board" else f"--{name}",
            f"is also given by --parameter {name}; specify one of them",
            value,
        )
        for name, value in given.items()
        if name in values
    ]
    if problems:
        raise ArgumentError(problems, source="a simulated capture")
    changed = [*(overrides or ()), *(() if seed is None else (f"seed={seed}",))]
    with reporting() as reporter:
        folder = simulate_capture(
            scene, output, overrides=changed, limits=limits_from(limits or ()), progress=reporter, **values, **given
        )
    print_wrote([folder / "capture.yaml", folder / "truth" / "parameters.yaml"])
    print_message("The folder truth contains the true parameters, points and maps; no other file depends on it.")


def twin(
    capture: CapturePath,
    run: RunFolder,
    output: options.Output,
    *,
    calibration: Calibration = None,
    method: Method = None,
    surface: SurfaceMesh = None,
    draws: Draws = 1,
    scene_only: SceneOnly = False,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Predict the errors of a measurement by a simulated twin of rig, surface and texture."""
    from scenetruth.capture import make_twin, run_twin
    from scenetruth.cli.console import reporting
    from scenetruth.errors import ArgumentError, Problem

    if overwrite and not scene_only:
        message = "is for --scene-only; the same command resumes, and another twin needs another directory"
        raise ArgumentError([Problem("--overwrite", message, True)], source="a twin")
    if scene_only:
        with reporting() as reporter:
            made = make_twin(
                capture,
                run,
                output,
                calibration=calibration,
                method=method,
                mesh=surface,
                overwrite=overwrite,
                progress=reporter,
            )
        for note in (f"noise from {made.sensor.origin}", *made.notes):
            echo(f"note: {note}")
        print_wrote(made.folder / "scene.yaml", f"{len(made.motions)} surfaces")
        return
    with reporting() as reporter:
        found = run_twin(
            capture,
            run,
            output,
            calibration=calibration,
            method=method,
            mesh=surface,
            draws=draws,
            progress=reporter,
        )
    if as_json:
        typer.echo(json.dumps(found.prediction.to_dict(), indent=2))
    else:
        for line in found.prediction.summary().splitlines():
            echo(line)
    print_wrote([found.scene, found.folder / "prediction.csv", found.folder / "prediction.png"])
