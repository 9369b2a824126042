"""The report: one HTML page with numbers, figures, viewer, definitions and provenance of an estimate."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from typing import Any

import xarray as xr

from scenetruth.errors import Problem, ScoreError
from scenetruth.glossary import define_terms
from scenetruth.html import template_environment
from scenetruth.number_format import (
    flatten,
    format_count,
    format_number,
    format_percent_value,
    humanise,
)
from scenetruth.plain_data import argument_problems
from scenetruth.progress import Progress
from scenetruth.results import Result
from scenetruth.schema import check_same_run, read_intrinsics, read_object_names, read_scene
from scenetruth.scoring.figures import FigureInfo, plot_all
from scenetruth.scoring.report.map_summaries import describe_maps, format_value
from scenetruth.scoring.report.report_content import (
    build_score_content,
    describe_invalidity,
    describe_noise,
    interior_share,
    list_empty_objects,
    state_result,
    summarise_estimate,
    summarise_score,
)
from scenetruth.scoring.report.setting_rows import describe_settings
from scenetruth.scoring.report.surface_rows import describe_surfaces
from scenetruth.scoring.report.viewer import Viewer, build_viewer, json_for_script, packed_plotly, viewer_script
from scenetruth.scoring.score_result import Score
from scenetruth.scoring.scorer import score as evaluate
from scenetruth.threads import in_order

__all__ = ["inline_picture", "matches_fingerprint", "write_report", "write_report_with"]

_SCREEN_SCALE = 0.6
"""CSS pixels per pixel of a figure."""
_HEAD = 2000
"""Number of characters at the beginning of a page that contain the fingerprint."""
_SHOWN_ELSEWHERE = ("warnings", "score_settings", "estimate_settings")
_PROVENANCE = {
    "frames": "scored frames t",
    "margin_px": "margin of the interior [px]",
    "working_point_px": "disparity to which images are shifted, median [px]",
}


def write_report(
    estimate: xr.Dataset,
    truth: xr.Dataset | None = None,
    recording: xr.Dataset | None = None,
    *,
    score: Score | None = None,
    output: str | Path,
    figures: Collection[str] | None = None,
    figure_formats: Sequence[str] = ("png",),
    allow_mismatch: bool = False,
    good_practice: Result | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write a report of an estimate: one HTML page with its statistics, figures and maps.

    The page is interactive: linked maps with the values at the pointer, profiles, and a 3D view of the surface. It
    works offline and can be printed. With a truth, statistics, maps and figures show the errors. Without a truth, as
    for real images, the page states this and reports medians and densities of the estimate.

    Parameters
    ----------
    estimate
        The estimate.
    truth
        The ground truth, if available.
    recording
        The recording of the estimate; its images are shown.
    score
        The score; default: computed here. ``warnings`` (a list of texts) of its metadata are shown at the top, the
        remaining metadata in a table.
    output
        Output directory of ``report.html`` and ``figures/*.png``; created if missing.
    figures
        Names of the figures to draw (`scenetruth.scoring.FIGURES`); default: all.
    figure_formats
        Formats of the figures: ``"png"``, which the page requires, and ``"pdf"``.
    allow_mismatch
        Whether the data sets and the score may belong to different recordings.
    good_practice
        The fields that a report of image correlation states, from `report_good_practice`; default: no table of them.
    progress
        Called as ``progress("report", done, total)``, in figures.

    Returns
    -------
    pathlib.Path
        The page, which contains its figures and requires no other file.

    Raises
    ------
    ScoreError
        If recording, estimate and truth do not match, or a score is given without a truth; lists every problem.
    MismatchError
        If the data sets belong to different recordings.

    See Also
    --------
    score : Error statistics only.
    run_scene : All stages up to the report, in a run directory.

    Examples
    --------
    Images and a depth map from another source, without truth:

    >>> from tempfile import TemporaryDirectory
    >>> import numpy as np
    >>> from scenetruth.schema import read_intrinsics, label, make_recording
    >>> images = np.random.default_rng(1).random((3, 1, 12, 16))
    >>> recording = make_recording(images, focal_length_px=100.0, baseline_mm=5.0)
    >>> disparity = np.full((1, 12, 16), 1.0)
    >>> estimate = label("estimate", {"disparity": disparity}, read_intrinsics(recording), t=[0])
    >>> with TemporaryDirectory() as folder:
    ...     page = write_report(estimate, recording=recording, output=folder)
    ...     print(page.name, sorted(path.name for path in (page.parent / "figures").iterdir()))
    report.html ['disparity.png', 'image.png']
    """
    if recording is None:
        raise ScoreError([Problem("recording", "is missing; the figures show its images")])
    return write_report_with(
        estimate,
        truth,
        recording,
        score=score,
        output=output,
        figures=figures,
        figure_formats=figure_formats,
        allow_mismatch=allow_mismatch,
        good_practice=good_practice,
        progress=progress,
    )


def write_report_with(
    estimate: xr.Dataset,
    truth: xr.Dataset | None,
    recording: xr.Dataset,
    *,
    score: Score | None = None,
    output: str | Path,
    figures: Collection[str] | None = None,
    figure_formats: Sequence[str] = ("png",),
    allow_mismatch: bool = False,
    good_practice: Result | None = None,
    progress: Progress | None = None,
    made_of: str = "",
    elsewhere: Callable[[str], Future[FigureInfo | None]] | None = None,
) -> Path:
    """Write a report as `write_report` does; used by the pipeline, which draws in two processes."""
    given = {"recording": recording, "estimate": estimate, **({} if truth is None else {"truth": truth})}
    wrong = [
        Problem(name, "must be an xarray.Dataset", type(part).__name__)
        for name, part in given.items()
        if not isinstance(part, xr.Dataset)
    ]
    if score is not None and not isinstance(score, Score):
        wrong.append(Problem("score", "must be a Score", type(score).__name__))
    practice, unsuitable = _practice_rows(good_practice)
    wrong += unsuitable
    wrong += argument_problems(progress)
    if wrong:
        raise ScoreError(wrong)
    if not allow_mismatch:
        parts = {"recording": recording.attrs, "estimate": estimate.attrs}
        parts |= {} if truth is None else {"truth": truth.attrs}
        check_same_run(parts | ({} if score is None else {"score": dict(score.metadata)}))
    if truth is not None and score is None:
        score = evaluate(estimate, truth, recording, allow_mismatch=True)
    target = Path(output)
    viewer: Viewer

    def build() -> None:
        nonlocal viewer
        viewer = build_viewer(recording, estimate, truth, score)

    drawn = plot_all(
        recording,
        estimate,
        truth,
        score,
        target / "figures",
        progress,
        names=figures,
        elsewhere=elsewhere,
        meanwhile=build,
        also=tuple(one for one in figure_formats if one != "png"),
    )
    page = target / "report.html"
    rendered = _render(recording, estimate, truth, score, drawn, target / "figures", made_of, viewer, practice)
    page.write_text(rendered, encoding="utf-8")
    return page


def matches_fingerprint(page: Path, made_of: str) -> bool:
    """Return whether a page was written by `write_report` with the fingerprint ``made_of``."""
    try:
        with page.open(encoding="utf-8", errors="replace") as file:
            return f'content="{made_of}"' in file.read(_HEAD)
    except OSError:
        return False


def _render(
    recording: xr.Dataset,
    estimate: xr.Dataset,
    truth: xr.Dataset | None,
    score: Score | None,
    figures: list[FigureInfo],
    folder: Path,
    made_of: str,
    viewer: Viewer,
    practice: Sequence[Mapping[str, Any]],
) -> str:
    environment = template_environment("scenetruth.scoring.report")
    environment.filters |= {
        "number": format_number,
        "measured": format_value,
        "percent": format_percent_value,
        "count": format_count,
    }
    scene = read_scene(recording)
    metadata = recording.attrs if score is None else score.metadata
    method = str(estimate.attrs.get("method", ""))
    if score is None:
        content = _content_without_truth(estimate)
    else:
        content = _content_with_truth(score, viewer, method)
        names = [] if truth is None or "object_id" not in truth else read_object_names(truth)
        content["empty_objects"] = [f"“{name}”" for name in list_empty_objects(names, score.regions)]
        content["invalid"] = "" if truth is None else describe_invalidity(estimate, truth)
    template = "without_truth.html.j2" if score is None else "with_truth.html.j2"
    page = environment.get_template(template).render(
        made_of=made_of,
        name=(scene or {}).get("description"),
        notices=list(_notices(metadata)),
        figures=[*in_order(lambda figure: (figure, *inline_picture(folder / figure.file)), figures, at_once=2)],
        practice=practice,
        settings_table=describe_settings(method, _settings_of(estimate, score)),
        metadata=list(_metadata_rows(recording, estimate, score)),
        scene=None if scene is None else json.dumps(scene, indent=2, ensure_ascii=False),
        viewer_data=json_for_script(viewer.plain),
        viewer_notes=viewer.notes,
        viewer_script=viewer_script(),
        plotly_data=packed_plotly(),
        **content,
    )
    return define_terms(page)


def _content_with_truth(score: Score, viewer: Viewer, method: str) -> dict[str, Any]:
    """Return the template values of a score, without maps, figures and provenance."""
    sentences = summarise_score(score, viewer)
    result = state_result(sentences, method, interior_share(score))
    return {**build_score_content(score), "sentences": sentences, "result": result}


def _content_without_truth(estimate: xr.Dataset) -> dict[str, Any]:
    """Return the template values of an estimate without truth, without maps, figures and provenance."""
    found = describe_maps(estimate)
    sentences = summarise_estimate(found)
    # The table has the others.
    cards = [one for one in found.values() if one.title in {each.title for each in sentences}]
    values = {"rows": list(found.values()), "cards": cards, "sentences": sentences, "noise": describe_noise(found)}
    return {**values, "surfaces": describe_surfaces(estimate)}


_PRACTICE_COLUMNS = ("group", "field", "value", "unit", "source")


def _practice_rows(good_practice: Result | None) -> tuple[list[dict[str, Any]], list[Problem]]:
    """Return the fields of good practice by group, or the problem with them."""
    if good_practice is None:
        return [], []
    wanted = "must be a GoodPracticeReport"
    if not isinstance(good_practice, Result):
        return [], [Problem("good_practice", wanted, type(good_practice).__name__)]
    table = good_practice.to_dataframe()
    if tuple(table.columns) != _PRACTICE_COLUMNS:
        return [], [Problem("good_practice", wanted, type(good_practice).__name__)]
    rows = [dict(zip(_PRACTICE_COLUMNS, row, strict=True)) for row in table.itertuples(index=False)]
    return [*_merged(rows)], []


def _merged(rows: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the fields, and those without data next to each other for the same reason as one row of a group."""
    for (_, value, unit, source), run in groupby(
        rows, lambda row: (row["group"], row["value"], row["unit"], row["source"])
    ):
        same = [*run]
        if len(same) > 1 and not unit and not any(character.isdigit() for character in value):
            names = [str(row["field"]) for row in same]
            field = ", ".join([names[0], *(f"{name[0].lower()}{name[1:]}" for name in names[1:])])
            yield {**same[0], "field": field, "value": value, "source": source}
        else:
            yield from same


def _notices(metadata: Mapping[str, Any]) -> Iterator[str]:
    warnings = metadata.get("warnings") or []
    yield from ([warnings] if isinstance(warnings, str) else map(str, warnings))


def _settings_of(estimate: xr.Dataset, score: Score | None) -> dict[str, Any]:
    """Return the settings of the method, which the metadata of the score, else the estimate, state."""
    stated = (score.metadata if score else {}).get("estimate_settings") or estimate.attrs.get("settings") or {}
    with suppress(ValueError):
        stated = json.loads(stated) if isinstance(stated, str) else stated
    return dict(stated) if isinstance(stated, Mapping) else {}


def _metadata_rows(recording: xr.Dataset, estimate: xr.Dataset, score: Score | None) -> Iterator[tuple[str, str]]:
    sizes = recording["image"].sizes
    yield (
        "recording",
        f"{sizes.get('s_y', 1) * sizes.get('s', 1)} cameras × {sizes['t']} frames of {sizes['x']} × {sizes['y']} px, "
        f"{recording['image'].dtype}",
    )
    for key, value in read_intrinsics(estimate).to_attrs().items():
        yield humanise(key), flatten(value)
    # The metadata of a score may lack the recording; the attributes of the data sets are then used.
    of_recording = ("scene_hash", "seed", "render_backend", "render_fallback_reason")
    known = {key: recording.attrs[key] for key in of_recording if key in recording.attrs}
    known |= {key: estimate.attrs[key] for key in ("method",) if key in estimate.attrs}
    for key, value in {**known, **(score.metadata if score else {})}.items():
        # Frames are those of the first row, if there is only the reference frame.
        empty = value is None or value in ("", [0])
        if key not in _SHOWN_ELSEWHERE and not empty:
            yield _PROVENANCE.get(key, humanise(key)), flatten(value)


def inline_picture(file: Path) -> tuple[str, int]:
    """Return a figure as a data URL with 256 colours, and the width at which all figures have the same text size."""
    from PIL import Image

    with Image.open(file) as picture:
        few = picture.convert("RGB").quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        content = io.BytesIO()
        few.save(content, "PNG", compress_level=6)
        width = picture.width
    return "data:image/png;base64," + base64.b64encode(content.getvalue()).decode("ascii"), round(width * _SCREEN_SCALE)
