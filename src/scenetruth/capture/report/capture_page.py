"""The page of a capture: results, sources of the error, suggestions, calibration and noise."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.capture.calibration import RigCalibration, RigSolution
from scenetruth.capture.calibration.rig_model import INTRINSICS
from scenetruth.capture.capture_check import CaptureReport
from scenetruth.capture.folder_reading import CaptureFolder
from scenetruth.capture.report.calibration_figures import CalibrationData, draw_calibration
from scenetruth.capture.report.error_budget import DepthBudget, depth_budget
from scenetruth.capture.report.noise_figures import draw_depth_std, draw_noise, noise_words, split_std
from scenetruth.capture.report.suggestions import PoseEffect, Suggestion, assess_poses, cover, suggest
from scenetruth.glossary import define_terms
from scenetruth.html import HtmlTable, make_table, template_environment
from scenetruth.number_format import (
    format_length,
    format_measured,
    format_number,
    format_signed_percent,
    format_two_digits,
)
from scenetruth.progress import Progress
from scenetruth.scoring.error_pairs import read_std
from scenetruth.scoring.figures import FigureInfo
from scenetruth.scoring.report.map_summaries import describe_maps
from scenetruth.scoring.report.report_content import describe_noise
from scenetruth.scoring.report.score_report import inline_picture

__all__ = ["CaptureResults", "write_capture_page"]

_SHOWN_FIGURES = ("image", "depth", "surface", "velocity_z", "growth_rate")
_SURFACE_PERCENT = (1.0, 99.0)
_GAUGE, _MOST_COMBINATIONS = 1e-2, 8
_UNITS = {"f": "px", "c_x": "px", "c_y": "px", "axis_y": "rad", "axis_z": "rad"}
_MEANINGS = {
    "f": "focal length", "c_x": "principal point", "c_y": "principal point", "axis_y": "axis of the stage",
    "axis_z": "axis of the stage", "step_scale": "relative error of the step length",
}  # fmt: skip
_STEPS = 5


@dataclass(frozen=True, eq=False)
class CaptureResults:
    """Everything that the page of a capture shows.

    ``folder``, ``check``: Files of the capture, and findings of their check.
    ``calibration``, ``solution``: Calibration from images of a board, and its fit; None without them.
    ``estimate``, ``method``: Estimate, and the name of its method; None if there is none.
    ``report``: Page of the estimate, relative to that of the capture, and the directory of its figures.
    """

    folder: CaptureFolder
    check: CaptureReport
    calibration: RigCalibration | None = None
    solution: RigSolution | None = None
    estimate: xr.Dataset | None = None
    method: str = ""
    report: str = ""
    figures: Path | None = None


def write_capture_page(results: CaptureResults, pictures: Path, progress: Progress | None = None) -> str:
    """Return the page of a capture, and draw its figures into an existing directory."""

    def reached(done: int) -> None:
        if progress is not None:
            progress("page", done, _STEPS)

    reached(0)
    depth, surface = _depths(results)
    found: dict[str, Any] = {"calibration_figures": [], "suggestions": None, "coverage": [], "tolerances": []}
    sentences = _estimate_sentences(results)
    if results.calibration is not None and results.solution is not None:
        calibration, solution = results.calibration, results.solution
        fit, priors = solution.fit, solution.priors
        budget = depth_budget(calibration, depth, fit)
        poses = assess_poses(fit, priors, calibration, budget)
        reached(1)
        sentences = sentences + budget.words()
        suggestions = _suggestion_table(suggest(fit, priors, calibration, budget, poses), budget)
        found["suggestions"] = suggestions if suggestions.lines else None
        reached(2)
        data = CalibrationData(calibration, solution, budget, poses, surface)
        found |= {
            "calibration_figures": _inlined(draw_calibration(data, pictures), pictures),
            "parameters": _parameter_table(calibration),
            "poses": _pose_table(poses, budget),
            "coverage": cover(fit).words(surface),
            "tolerances": _tolerance_lines(calibration),
        }
    reached(3)
    noise_figures = _inlined(draw_noise(results.folder, results.check.noise, pictures), pictures)
    reached(4)
    text = (
        template_environment("scenetruth.capture.report")
        .get_template("capture.html.j2")
        .render(
            name=results.folder.capture.description,
            origin=_origin(results),
            notices=list(_notices(results)),
            sentences=sentences,
            report=results.report,
            method=results.method,
            estimate_figures=_estimate_figures(results, pictures),
            noise=noise_words(results.folder, results.check.noise),
            noise_figures=noise_figures,
            findings=[str(finding) for finding in results.check.findings],
            mistakes=any(finding.severity != "note" for finding in results.check.findings),
            **found,
        )
    )
    reached(_STEPS)
    return define_terms(text)


def _depths(results: CaptureResults) -> tuple[float, tuple[float, float] | None]:
    """Return the distance for which errors are stated, and the depth range of the surface, in mm."""
    if results.estimate is not None and "depth" in results.estimate:
        frame = results.estimate.isel(t=results.estimate.sizes["t"] // 2)
        values = frame["depth"].values[_valid(frame)]
        if values.size:
            low, high = np.percentile(values, _SURFACE_PERCENT)
            return float(np.median(values)), (float(low), float(high))
    if results.folder.capture.distance_mm is not None:
        return results.folder.capture.distance_mm, None
    if results.solution is not None:
        return float(np.mean(cover(results.solution.fit).depth_mm)), None
    return 1.0, None


def _valid(frame: xr.Dataset) -> NDArray[np.bool_]:
    """Return the pixels with a depth that is no fallback."""
    known = np.isfinite(frame["depth"].values)
    return np.asarray(known & frame["valid"].values if "valid" in frame else known)


def _estimate_sentences(results: CaptureResults) -> list[str]:
    """Return what the estimate states, in sentences."""
    estimate = results.estimate
    if estimate is None or "depth" not in estimate:
        return []
    frame = estimate.isel(t=estimate.sizes["t"] // 2)
    valid = _valid(frame)
    if not valid.any():
        return ["No pixel has a valid depth: see the check of the images below."]
    parts = [
        f"{format_two_digits(float(np.nanmedian(values[valid])))} mm {text}"
        for text, values in split_std(frame).items()
    ]
    noise = describe_noise(describe_maps(estimate))
    text = " ± median standard deviation of a pixel" if noise["stated"] else ""
    first = f"Medians of all valid pixels{text}: {noise['medians']}."
    if noise["hidden"]:
        first += f" {noise['hidden']}"
    sentences = [f"{first} {100 * valid.mean():.0f}\N{NO-BREAK SPACE}% of the pixels have a valid depth."]
    if len(parts) > 1:
        sentences.append(
            f"Standard deviation of the depth in the maps, frame t = {int(frame['t'])}, median: {' and '.join(parts)}. "
            "Both add as squares."
        )
    return sentences


def _notices(results: CaptureResults) -> Iterable[str]:
    if results.calibration is None:
        yield (
            "No images of a board: the camera is that of the capture file or of an imported file, and errors of the "
            "stage are estimated from the images of the measurement only. A wrong focal length or step length changes "
            "all depths in proportion, and is not noticed."
        )
    elif results.calibration.warnings:
        yield from results.calibration.warnings
    missing = results.check.missing
    if missing:
        yield f"{len(missing)} images are missing: {', '.join(missing[:5])}{' ...' if len(missing) > 5 else ''}"


def _origin(results: CaptureResults) -> str:
    images, camera = results.folder.images, results.folder.capture.camera
    boards = len(results.folder.board)
    text = (
        f"{len(images.positions)} positions × {len(images.frames)} frames of {camera.width} × {camera.height} px, "
        f"{camera.bit_depth} bits"
    )
    return f"{text}; {boards} images of the board" if boards else text


def _inlined(figures: Sequence[FigureInfo], folder: Path) -> list[tuple[FigureInfo, str, int]]:
    return [(figure, *inline_picture(folder / figure.file)) for figure in figures]


_TITLES = {
    "image": ("Reference image", "Image of the reference camera."),
    "depth": ("Depth", "Depth of the reference camera."),
    "surface": ("Surface", "Estimated surface in 3D."),
    "velocity_z": ("Velocity along Z", "Motion towards the camera is negative."),
    "growth_rate": ("Growth rate", "Relative growth of surface area."),
}


def _estimate_figures(results: CaptureResults, pictures: Path) -> list[tuple[FigureInfo, str, int]]:
    """Return figures of the report of the estimate, and its standard deviations."""
    own = [] if results.estimate is None else _inlined(draw_depth_std(results.estimate, pictures), pictures)
    if results.figures is None or not results.figures.is_dir():
        return own
    titles = dict(_TITLES)
    # Growth is a small difference of large numbers: without its standard uncertainty, it may be noise.
    growth_std = None if results.estimate is None else _median_growth_std(results.estimate)
    if growth_std is None:
        titles.pop("growth_rate")
    else:
        name, words = titles["growth_rate"]
        stated = f"{words} Median standard uncertainty of a pixel: {format_two_digits(growth_std)} %/h."
        titles["growth_rate"] = (name, stated)
    found = [
        FigureInfo(f"{name}.png", *titles[name])
        for name in _SHOWN_FIGURES
        if name in titles and (results.figures / f"{name}.png").exists()
    ]
    return _inlined(found, results.figures) + own


def _median_growth_std(estimate: xr.Dataset) -> float | None:
    """Return the median standard deviation of growth in %/h; None if none is stated."""
    std = (
        read_std(estimate.isel(t=[estimate.sizes["t"] // 2]), "growth_rate") if "growth_rate_std" in estimate else None
    )
    return None if std is None or not np.isfinite(std).any() else float(np.nanmedian(std))


def _suggestion_table(found: Sequence[Suggestion], budget: DepthBudget) -> HtmlTable:
    before = budget.total.mean_std
    rows = [
        (one.text, format_number(one.after_mm, 2), _change(one.after_mm / before - 1))
        for one in found
        if abs(one.after_mm / before - 1) >= _LEAST_CHANGE
    ]
    caption = f"Standard deviation of the mean depth at {budget.depth_mm:.0f} mm, now {format_number(before, 2)} mm"
    return make_table("suggestions", caption, ("change", "then [mm]", "difference"), rows)


_LEAST_CHANGE = 0.005


def _change(share: float) -> str:
    """Return a relative change in whole per cent."""
    return format_signed_percent(round(share, 2))


_MOST_DIGITS = 12


def _parameter_table(calibration: RigCalibration) -> HtmlTable:
    shown = (*INTRINSICS, "axis_y", "axis_z", "step_scale", *(f"{name}.scale" for name in calibration.targets))
    rows = []
    for name in shown:
        std = calibration.std(name)
        if std == 0 and calibration.value(name) == 0:
            continue
        prior = calibration.prior_std[calibration.names.index(name)]
        stated = format_length(float(prior), 2) if np.isfinite(prior) else "none"
        meaning = _MEANINGS.get(name, "relative error of the size" if name.endswith(".scale") else "lens distortion")
        value = format_measured(calibration.value(name), std, _MOST_DIGITS)
        rows.append((name, meaning, _UNITS.get(name, "–"), value, format_number(std, 2), stated))
    caption = "Parameters, with standard deviations after the calibration, and stated before it (tolerance)"
    return make_table("parameters", caption, ("parameter", "meaning", "unit", "value", "std", "tolerance"), rows)


def _pose_table(poses: Sequence[PoseEffect], budget: DepthBudget) -> HtmlTable:
    rows = [
        (
            str(pose.pose), f"{pose.tilt_deg:.0f}", pose.farther or "–", f"{pose.depth_mm:.0f}", str(pose.images),
            str(pose.points), format_number(pose.rms_px, 2), format_number(pose.without_mm, 2),
        )
        for pose in poses
    ]  # fmt: skip
    total = format_number(budget.total.mean_std, 2)
    caption = f"Poses of the board; last column: standard deviation of the mean depth without it, {total} mm with all"
    columns = (
        "pose", "tilt [°]", "farther", "distance [mm]", "images", "points", "residual [px]", "without it [mm]",
    )  # fmt: skip
    return make_table("poses", caption, columns, rows)


def _in_words(combination: str) -> str:
    """Return a combination of parameters with words for positions and visits of the stage.

    >>> _in_words("0.39 position[3].x - 0.26 visit[13].y")
    '0.39 (position 3 along X) − 0.26 (visit 13 along Y)'
    """
    return re.sub(
        r"(position|visit)\[(\d+)\]\.([xyz])",
        lambda found: f"({found[1]} {found[2]} along {found[3].upper()})",
        combination,
    ).replace(" - ", " − ")


def _tolerance_lines(calibration: RigCalibration) -> list[str]:
    weak = [one for one in calibration.combinations if not one.from_images and one.ratio > _GAUGE]
    return [
        f"{_in_words(one.words)} (information of the images: {format_two_digits(one.ratio)} of that of the tolerances)"
        for one in weak
    ][:_MOST_COMBINATIONS]
