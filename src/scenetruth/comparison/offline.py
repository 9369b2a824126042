"""The recordings of a suite, written out for programs that run elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from scenetruth.comparison.case import all_cases
from scenetruth.comparison.compare import chosen_cases
from scenetruth.comparison.jobs import points_of
from scenetruth.comparison.point import noisy, quiet
from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.external import recording_key, write_recording
from scenetruth.progress import Progress
from scenetruth.scene import scene_from_plain
from scenetruth.simulation import simulate

__all__ = ["write_recordings"]


def write_recordings(
    folder: str | Path,
    suite: str = "core",
    *,
    cases: Sequence[str] | None = None,
    values: Sequence[float | str] | None = None,
    images: Literal["png", "tiff", "npy"] = "png",
    progress: Progress | None = None,
) -> list[Path]:
    """Write all recordings of a suite, each into a folder that is named by its key.

    What a program finds of them goes into folders of the same names, which
    `scenetruth.estimators.external.ResultsFolder` reads. Recordings that are there are not written again.

    Parameters
    ----------
    folder
        Where they go.
    suite, cases, values
        Which, as of `compare`.
    images
        How images are written; see `scenetruth.estimators.external.write_recording`.
    progress
        Called with (what, done, total).

    Returns
    -------
    list of pathlib.Path
        The folders of the recordings.

    Raises
    ------
    RecipeError
        If there is no such suite or case.
    """
    if Path(folder).is_file():
        raise EstimateError([Problem("recordings", "must be a folder", folder)])
    points = points_of(chosen_cases(suite, cases, values), suite, values)
    written = []
    for done, point in enumerate(points):
        if progress is not None:
            progress("recordings", done, len(points))
        case = all_cases()[point.case]
        noise_std = case.noise_std(point.values[0])
        with quiet():
            ideal = simulate(scene_from_plain(case.scene(point.values[0])))[0]
        for seed in range(point.seeds if noise_std else 1):
            recording = noisy(ideal, noise_std, case.kind, seed)
            place = Path(folder) / recording_key(recording)
            if not place.exists():
                place.parent.mkdir(parents=True, exist_ok=True)
                write_recording(recording, place, images)
            written.append(place)
    if progress is not None:
        progress("recordings", len(points), len(points))
    return written
