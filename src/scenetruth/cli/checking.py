"""What ``scenetruth check`` prints."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from scenetruth.camera import Frames, Stage, Viewpoint
from scenetruth.cli.console import print_warning
from scenetruth.errors import SceneError, SceneWarning, visible
from scenetruth.scene import Scene
from scenetruth.scene.check import SceneReport

__all__ = ["print_check"]


def print_check(scene: Scene, file: Path) -> None:
    """Validate a scene down to its meshes and textures, and print what will be made from it."""
    from scenetruth.pipeline import run_problems
    from scenetruth.raycast import Topology
    from scenetruth.scene.check import check_scene, describe_scene
    from scenetruth.scene.world import build_world
    from scenetruth.truth import GeometryPass, interior_warnings, truth_maps

    try:
        world = build_world(scene)
        with warnings.catch_warnings():
            # The report tells them again.
            warnings.simplefilter("ignore", SceneWarning)
            check_scene(scene, world)
        geometry = GeometryPass(world, Topology.of(world.at(0).vertices_mm, world.faces, world.crease_deg), 0.0)
        maps = truth_maps(geometry, scene.camera, Viewpoint.on_axis(0.0), scene.stage.baseline_mm, "standard")
        margin = scene.score.interior_margin_px
        edges_only = interior_warnings(world, maps["object_id"], maps["boundary_distance"], margin)
        report = describe_scene(scene, world, maps["depth"])
    except SceneError as error:
        raise SceneError(error.problems, source=file) from error
    camera, stage, frames = scene.camera, scene.stage, scene.frames
    table = Table(title=visible(scene.description or str(file)), show_header=False, title_justify="left")
    rows = {
        "images": f"{report.image_count} of {camera.width} x {camera.height} px "
        f"({_positions(stage)}; {frames.count} frames)",
        **_stage_rows(stage, frames),
        "focal length": f"{camera.focal_px:g} px",
        **_lens_rows(scene, report),
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
        table.add_row(visible(name), visible(text))
    Console(highlight=False, markup=False, emoji=False).print(table)
    problems = run_problems(scene, [scene.estimate])
    messages = [*report.warnings, *edges_only, *(f"cannot be estimated: {problem}" for problem in problems)]
    for message in messages:
        print_warning(message)
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


def _lens_rows(scene: Scene, report: SceneReport) -> dict[str, str]:
    """Say what distinguishes lens and shutter from a pinhole that is open for no time."""
    rows, camera, optics, shutter = {}, scene.camera, scene.optics, scene.shutter
    if camera.distortion is not None:
        corner = np.array([[camera.width - 1, camera.height - 1]], dtype=np.float64)
        shift = camera.without_distortion().project(camera.ray_directions(corner)) - corner
        rows["distortion"] = f"{np.linalg.norm(shift):.2f} px in the lower right corner"
    if optics.psf is not None:
        size = optics.psf.sigma_px if optics.psf.kind == "gaussian" else optics.psf.radius_px
        what = "standard deviation" if optics.psf.kind == "gaussian" else "radius of the first dark ring"
        rows["point spread"] = f"{optics.psf.kind}, {what} {size:.2f} px"
    if optics.defocus is not None:
        depths = np.array([item.depth_mm for item in report.objects])
        blur = optics.defocus.blur_diameter_px(depths, camera.focal_px)
        rows["defocus"] = f"discs of up to {blur.max():.2f} px; images are means of {optics.defocus.samples} sharp ones"
    if optics.vignetting is not None:
        rows["vignetting"] = f"{100 * (1 - optics.vignetting.factor(camera)[-1, -1]):.1f} % in the lower right corner"
    if shutter.exposure_time_s > 0 or shutter.readout_time_s > 0:
        rows["shutter"] = f"open for {shutter.exposure_time_s:g} s" + (
            f", last row {shutter.readout_time_s:g} s after the first" if shutter.readout_time_s > 0 else ""
        )
    return rows


def _megabytes(count: int) -> str:
    return f"{count / 1e6:.1f} MB"
