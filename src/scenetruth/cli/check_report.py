"""Output of `scenetruth check`: contents of a scene, resources, predicted precision."""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.table import Table

from scenetruth.camera import Frames, Stage, StagePose
from scenetruth.cli.console import print_warning
from scenetruth.errors import MachineError, SceneError, visible
from scenetruth.number_format import format_duration
from scenetruth.resources import Forecast, Limits, Machine, ObjectWorkload, StageForecast
from scenetruth.scene import Scene
from scenetruth.scene.scene_report import SceneReport

if TYPE_CHECKING:
    from scenetruth.design.prediction import Prediction

__all__ = ["print_check"]

_MOST_NAMES, _MOST_OBJECTS = 5, 40
_UNKNOWN = "unknown"
_MOST_PRECISIONS, _GROWTH, _NO_GROWTH = 3, "Growth", 1e-7
_NOT_IN_CHECK = ("Slope", "Optical flow", _GROWTH)
_MOST_PRECISE = "refined"


def print_check(scene: Scene, file: Path, limits: Limits, *, as_json: bool = False) -> None:
    """Validate a scene, and print the size of its results and the required resources, as tables or as JSON."""
    from scenetruth.pipeline import estimate_run_cost, run_problems
    from scenetruth.resources import (
        inspect_machine,
        limited_objects,
        machine_problems,
        raising_all_problems,
    )
    from scenetruth.resources.limits import find_unit_errors
    from scenetruth.resources.quick_preview import make_quick_preview, without_interior
    from scenetruth.scene.scene_report import describe_scene

    try:
        parts = limited_objects(scene, limits)
        with raising_all_problems(scene):
            preview = make_quick_preview(scene, parts)
            report = describe_scene(scene, preview.world, preview.depth, preview.times)
    except SceneError as error:
        raise SceneError(error.problems, source=file) from error
    forecast, machine = estimate_run_cost(scene, parts), inspect_machine(Path())
    if not as_json:
        _print_table(scene, file, report, {part.item.name: part.size.faces for part in parts})
        _print_forecast(forecast, machine)
    problems = machine_problems(forecast, machine, limits)
    if problems:
        raise MachineError(problems)
    messages = [*find_unit_errors(scene), *report.warnings, *_print_precision(scene, parts, shown=not as_json)]
    if without := without_interior(preview, scene.score.interior_margin_px):
        messages.append(_interior_warning(without, scene.score.interior_margin_px))
    if preview.left_out:
        messages.append(f"objects: {_listed(preview.left_out)} not analysed, to limit the time; a run checks them")
    if preview.unpainted:
        names = _listed(preview.unpainted)
        messages.append(f"objects: the brightness of {names} not analysed, to limit the time; a run checks it")
    messages += [f"cannot be estimated: {problem}" for problem in run_problems(scene, [scene.estimate])]
    if as_json:
        print(json.dumps(_to_dict(file, report, forecast, messages), indent=2))
        return
    for message in messages:
        print_warning(message)
    print(
        "the scene is valid" if not messages else f"the scene is valid, with {len(messages)} warnings", file=sys.stdout
    )


def _print_precision(scene: Scene, parts: Sequence[ObjectWorkload], *, shown: bool) -> list[str]:
    from scenetruth.cli.design_analysis import precision_rows, print_included
    from scenetruth.design.prediction.method_models import all_method_models
    from scenetruth.design.prediction.predictor import predict_quickly, recommend

    own = scene.estimate.method
    try:
        found = predict_quickly(scene, parts, own if own in all_method_models() else _MOST_PRECISE)
        # For methods without growth, the attainable precision is shown.
        growing = found if found.method == _MOST_PRECISE else predict_quickly(scene, parts, _MOST_PRECISE)
    except SceneError as error:
        # A scene without noise, or without a surface that can be analysed quickly, may still be valid.
        if shown:
            print(f"precision is not predicted: {'; '.join(map(str, error.problems))}", file=sys.stdout)
        return []
    table = Table(title=f"predicted precision per pixel, {found.method}", title_justify="left")
    for heading in ("", "precision", "true RMS", "ratio"):
        table.add_column(heading, justify="left" if not heading else "right")
    for region in _most_moving(found):
        name = region.removeprefix("object_")
        rows = [row for row in precision_rows(found, region) if not row[0].startswith(_NOT_IN_CHECK)]
        if _grows(growing, region):
            grown = [row for row in precision_rows(growing, region) if row[0].startswith(_GROWTH)]
            rows += [(f"{row[0]}, {growing.method}", *row[1:]) for row in grown]
        for title, precision, there, ratio in rows:
            table.add_row(*map(visible, (f"'{name}': {title}", precision, there, ratio)))
    if table.row_count and shown:
        _console().print(table)
        print_included("median over each object, with textures by formula")
    for note in found.notes if shown else ():
        print(f"note: {visible(note)}", file=sys.stdout)
    messages = recommend(scene, found, parts, painting=False)
    if growing is not found:
        messages += recommend(scene, growing, parts, painting=False, growth_alone=True)
    return messages


def _most_moving(found: Prediction) -> list[str]:
    """Return the regions of the moving objects with the largest motion, or the first regions if none moves."""
    regions = [region for region in found.regions if region.startswith("object_")]
    quantity = next((name for name in ("velocity_epe", "flow_x") if name in found.quantities), None)
    if quantity is not None:
        regions.sort(key=lambda region: found.precision(quantity, region).signal or 0.0, reverse=True)
    return regions[:_MOST_PRECISIONS]


def _grows(found: Prediction, region: str) -> bool:
    if "growth_rate" not in found.quantities or region not in found.regions:
        return False
    return (found.precision("growth_rate", region).signal or 0.0) > _NO_GROWTH


def _to_dict(file: Path, report: SceneReport, forecast: Forecast, warnings: Sequence[str]) -> dict[str, object]:
    return {
        "scene": str(file),
        "valid": True,
        "warnings": list(warnings),
        "images": report.image_count,
        "recording_bytes": report.recording_bytes,
        "truth_bytes": report.truth_bytes,
        "run_time_s": forecast.seconds,
        "reference_run_time_s": forecast.reference_seconds,
        "stages": {
            name: {
                "memory_bytes": stage.memory_bytes,
                "disk_bytes": stage.disk_bytes,
                "disk_at_most_bytes": stage.disk_at_most_bytes,
                "run_time_s": stage.seconds,
            }
            for name, stage in forecast.stages.items()
        },
    }


def _interior_warning(names: Sequence[str], margin_px: float) -> str:
    return (
        f"objects: {_listed(names)} with hardly any interior pixels: nearly all their pixels are less than "
        f"{margin_px:g} px from an edge, so that scores of the interior are not representative; use a nearer camera, a "
        "longer focal length or a smaller score.interior_margin_px"
    )


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(f"'{name}'" for name in names[:_MOST_NAMES])
    return shown if len(names) <= _MOST_NAMES else f"{shown} and {len(names) - _MOST_NAMES} more"


def _print_table(scene: Scene, file: Path, report: SceneReport, faces: Mapping[str, int]) -> None:
    camera, stage, frames = scene.camera, scene.stage, scene.frames
    table = Table(title=visible(scene.description or str(file)), show_header=False, title_justify="left")
    rows = {
        "images": f"{report.image_count} of {camera.width} x {camera.height} px "
        f"({_positions(stage)}; {frames.count} frames)",
        **_stage_rows(stage, frames),
        "focal length": f"{camera.focal_px:g} px",
        **_lens_rows(scene, report),
        **_light_rows(scene),
        "recording": _megabytes(report.recording_bytes),
        "truth": _megabytes(report.truth_bytes),
    }
    if report.objects:
        rows |= {
            "mean disparity": f"about {report.mean_disparity_px:.3g} px per step",
            "working point": f"{report.working_point_px} px per step",
            "residual disparity": "about {:+.2f} to {:+.2f} px per step".format(*report.residual_disparity_px),
        }
    for item in report.objects[:_MOST_OBJECTS]:
        text = "about {} faces, depth {:.5g} to {:.5g} mm, disparity {:.3g} to {:.3g} px per step".format(
            faces[item.name], *item.depth_mm, *item.disparity_px
        )
        if item.wavelength_px is not None:
            text += ", texture wavelengths {:.2f} to {:.2f} px".format(*item.wavelength_px)
        rows[f"object '{item.name}'"] = "\n".join([text, *item.content])
    if len(report.objects) > _MOST_OBJECTS:
        rows[f"and {len(report.objects) - _MOST_OBJECTS} more"] = ""
    for name, text in rows.items():
        table.add_row(visible(name), visible(text))
    _console().print(table)


def _print_forecast(forecast: Forecast, machine: Machine) -> None:
    table = Table(title="foreseen", title_justify="left")
    for heading in ("", "memory", "disk", "at most", "processor time"):
        table.add_column(heading, justify="left" if not heading else "right")
    rows: list[tuple[str, StageForecast | Forecast]] = [*forecast.stages.items(), ("all stages", forecast)]
    for name, stage in rows:
        table.add_row(
            name,
            _size(stage.memory_bytes),
            _size(stage.disk_bytes),
            _size(stage.disk_at_most_bytes),
            format_duration(stage.seconds),
        )
    free = [_UNKNOWN if value is None else _size(value) for value in (machine.memory_bytes, machine.disk_bytes)]
    table.add_row("this machine has", *free, "", f"{machine.processors} processors")
    _console().print(table)
    print(
        f"processor time: at the speed of this machine; {format_duration(forecast.reference_seconds)} at reference "
        "speed, as in scene files and pages of designs",
        file=sys.stdout,
    )


def _console() -> Console:
    return Console(highlight=False, markup=False, emoji=False)


def _size(count: float) -> str:
    return _megabytes(int(count)) if count < 1e9 else f"{count / 1e9:.1f} GB"


def _positions(stage: Stage) -> str:
    if stage.positions_mm is None:
        text = f"{stage.positions} positions, {stage.baseline_mm:g} mm apart"
    else:
        text = f"{stage.positions} positions at {', '.join(f'{x:g}' for x in stage.positions_mm)} mm"
    return text if stage.rows == 1 else f"{stage.rows} rows, {stage.row_spacing_mm:g} mm apart, of {text}"


def _stage_rows(stage: Stage, frames: Frames) -> dict[str, str]:
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
    if stage.axis_tilt_urad is not None:
        rows["stage axis"] = "tilted by {:g} µrad along Y and {:g} µrad along Z".format(*stage.axis_tilt_urad)
    if stage.poses is not None:
        rows["stage poses"] = _listed_poses(stage.poses)
    return rows


def _listed_poses(poses: Sequence[StagePose]) -> str:
    """Return the RMS values of listed poses, and their visits."""
    off = np.array([pose.offset_um for pose in poses])
    turns = 1e6 * np.array([pose.rotation_rad for pose in poses])
    rms = np.sqrt(np.mean(np.hstack([off, turns]) ** 2, axis=0))
    visited = sum(pose.visits is not None for pose in poses)
    visits = f"; visits of {visited} listed" if visited else ""
    return (
        "{} listed, RMS of x {:.3g}, y {:.3g}, z {:.3g} µm, pitch {:.3g}, yaw {:.3g}, roll {:.3g} µrad".format(
            len(poses), *rms
        )
        + visits
    )


def _lens_rows(scene: Scene, report: SceneReport) -> dict[str, str]:
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
        rows["defocus"] = f"discs of up to {blur.max():.2f} px; means of {optics.defocus.samples} sharp images"
    if optics.vignetting is not None:
        rows["vignetting"] = f"{100 * (1 - optics.vignetting.factor(camera)[-1, -1]):.1f} % in the lower right corner"
    if shutter.exposure_time_s > 0 or shutter.readout_time_s > 0:
        rows["shutter"] = f"open for {shutter.exposure_time_s:g} s" + (
            f", last row {shutter.readout_time_s:g} s after the first" if shutter.readout_time_s > 0 else ""
        )
    return rows


def _light_rows(scene: Scene) -> dict[str, str]:
    rows = {"bands": ", ".join(scene.camera.bands)} if scene.camera.bands else {}
    lamps = Counter(lamp.kind for lamp in scene.lighting.lights)
    if lamps:
        rows["lamps"] = ", ".join(f"{count} {kind}" for kind, count in lamps.items())
    backend = scene.render.backend
    if backend == "auto" and scene.needs_rays:
        rows["rendering"] = f"ray casting, because OpenGL cannot render {scene.needs_rays}"
    elif backend != "raycast" and scene.lighting.lit:
        available = " if available" if backend == "auto" else ""
        rows["rendering"] = f"textures by OpenGL{available}; light, shadows and gloss by ray casting"
    return rows


def _megabytes(count: int) -> str:
    return f"{count / 1e6:.1f} MB"
