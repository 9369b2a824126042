"""The command `capture simulate`."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any

from scenetruth.cli import options
from scenetruth.cli.messages import print_message, print_wrote

__all__ = ["simulate"]


class BoardType(StrEnum):
    """Types of calibration boards."""

    charuco = "charuco"
    checkerboard = "checkerboard"
    dots = "dots"
    asymmetric_dots = "asymmetric_dots"


Board = Annotated[
    BoardType | None,
    options.option(
        "--board", help="Type of the calibration board; charuco if not given. Its size follows from the field of view."
    ),
]

Poses = Annotated[int | None, options.option("--poses", metavar="N", help="Poses of the board; 8 if not given.")]

Dark = Annotated[int | None, options.option("--dark", metavar="N", help="Images without light; 8 if not given.")]

Flat = Annotated[
    int | None, options.option("--flat", metavar="N", help="Images of a uniformly bright surface; 16 if not given.")
]

Strip = Annotated[bool, options.flag("--strip", help="Fiducial strip in all images of the objects.")]

CaptureSettings = Annotated[
    list[str] | None,
    options.repeatable(
        "--setting",
        "NAME=VALUE",
        "Setting of the simulated capture, with a value in YAML: board, poses, scale_std, warp_mm, step_std, "
        "static, strip_scale_std, distance_mm.",
    ),
]


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
    settings: CaptureSettings = None,
) -> None:
    """Simulate a capture folder: boards, dark and flat images, images of the objects, and the truth apart."""
    from scenetruth.capture import simulate_capture
    from scenetruth.cli.console import reporting
    from scenetruth.errors import ArgumentError, Problem
    from scenetruth.resources.limits import limits_from

    values, problems = options.parse_assignments("--setting", settings)
    named: dict[str, Any] = {
        "board": None if board is None else board.value,
        "poses": poses,
        "dark": dark,
        "flat": flat,
        "strip": strip or None,
    }
    given = {name: value for name, value in named.items() if value is not None}
    problems += [
        Problem(f"--{name}", f"is also given by --setting {name}; specify one of them", value)
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
