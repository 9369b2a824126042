"""What ``scenetruth check`` prints."""

from __future__ import annotations

import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from scenetruth.camera import Frames, Stage
from scenetruth.errors import SceneError
from scenetruth.scene import Scene

__all__ = ["print_check"]


def print_check(scene: Scene, file: Path) -> None:
    """Validate a scene down to its meshes and textures, and print what will be made from it."""
    from scenetruth.camera import Viewpoint
    from scenetruth.estimate.rig import requirements
    from scenetruth.raycast import Topology
    from scenetruth.scene.check import describe_scene
    from scenetruth.scene.world import build_world
    from scenetruth.truth import GeometryPass, truth_maps

    try:
        world = build_world(scene)
        vertices = world.at(0).vertices_mm
        if (vertices[:, 2] > 0).any():
            geometry = GeometryPass(world, Topology.of(vertices, world.faces), 0.0)
            depth = truth_maps(geometry, scene.camera, Viewpoint.on_axis(0.0), scene.stage.baseline_mm)["depth"]
        else:
            depth = vertices[:0, 2]
        report = describe_scene(scene, world, depth)
    except SceneError as error:
        raise SceneError(error.problems, source=file) from error
    camera, stage, frames = scene.camera, scene.stage, scene.frames
    table = Table(title=scene.description or str(file), show_header=False, title_justify="left")
    rows = {
        "images": f"{report.image_count} of {camera.width} x {camera.height} px "
        f"({_positions(stage)}; {frames.count} frames)",
        **_stage_rows(stage, frames),
        "focal length": f"{camera.focal_px:g} px",
        "recording": _megabytes(report.recording_bytes),
        "truth": _megabytes(report.truth_bytes),
        "mean disparity": f"{report.mean_disparity_px:.3f} px per step",
        "working point": f"{report.working_point_px} px per step",
        "residual disparity": "{:+.3f} to {:+.3f} px per step".format(*report.residual_disparity_px),
    }
    for item in report.objects:
        text = "{} faces, depth {:.6g} to {:.6g} mm, disparity {:.3f} to {:.3f} px per step".format(
            item.faces, *item.depth_mm, *item.disparity_px
        )
        if item.wavelength_px is not None:
            text += ", texture wavelengths {:.2f} to {:.2f} px".format(*item.wavelength_px)
        rows[f"object '{item.name}'"] = text
    for name, text in rows.items():
        table.add_row(name, text)
    Console(highlight=False).print(table)
    problems = requirements(scene.estimate, stage.positions, frames.count, camera.width, camera.height)
    messages = [*report.warnings, *(f"cannot be estimated: {problem}" for problem in problems)]
    for message in messages:
        Console(stderr=True, highlight=False, markup=False, soft_wrap=True).print(f"warning: {message}", style="yellow")
    print(
        "the scene is valid" if not messages else f"the scene is valid, with {len(messages)} warnings", file=sys.stdout
    )


def _positions(stage: Stage) -> str:
    if stage.positions_mm is None:
        text = f"{stage.positions} positions, {stage.baseline_mm:g} mm apart"
    else:
        text = f"{stage.positions} positions at {', '.join(f'{x:g}' for x in stage.positions_mm)} mm"
    return text if stage.rows == 1 else f"{stage.rows} rows, {stage.row_spacing_mm:g} mm apart, of {text}"


def _stage_rows(stage: Stage, frames: Frames) -> dict[str, str]:
    """Say what distinguishes the stage from one that is perfect and takes no time."""
    rows, errors = {}, stage.errors
    if stage.time_per_position_s > 0:
        rows["scan"] = (
            f"{stage.scan}, {stage.time_per_position_s:g} s per position; a frame needs {stage.scan_interval_s:g} s "
            f"of its {frames.frame_interval_s:g} s"
        )
    if errors is not None:
        name = f"{errors.preset}: " if errors.preset else ""
        rows["stage errors"] = (
            f"{name}repeatability {errors.repeatability_um:g} µm, backlash {errors.backlash_um:g} µm, "
            f"straightness {errors.straightness_um:g} µm, pitch {errors.pitch_urad:g}, yaw {errors.yaw_urad:g}, "
            f"roll {errors.roll_urad:g} µrad"
        )
    return rows


def _megabytes(count: int) -> str:
    return f"{count / 1e6:.1f} MB"
