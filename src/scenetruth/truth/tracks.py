"""Tracks of surface points over time."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import Problem, RecordingError, SceneError
from scenetruth.scene.spec import Scene
from scenetruth.scene.world import build_world
from scenetruth.schema import check_dataset

__all__ = ["track_points"]


def track_points(
    scene: Scene, truth: xr.Dataset, times: Iterable[float], *, t: int = 0, folder: str | Path = ""
) -> NDArray[np.float64]:
    """Follow the surface points that pixels see at one frame to other times.

    ``object_id``, ``face_id`` and ``barycentric`` of a truth name the surface point of every pixel; it stays the same
    while the surface moves.

    Parameters
    ----------
    scene
        The scene that the truth was made from.
    truth
        The truth of the reference camera (or of one camera, selected from the truth of all).
    times
        Times in frames, any real numbers.
    t
        The frame whose pixels are followed.
    folder
        Folder to which relative paths of files in the scene refer.

    Returns
    -------
    numpy.ndarray
        World positions (X, Y, Z) in mm, shape (times, 3, y, x); NaN where a pixel shows no surface.

    Raises
    ------
    SceneError
        If the scene cannot be made.
    RecordingError
        If the truth does not have the agreed form or what tracks need, or there are no such times or frame.

    See Also
    --------
    make_truth : The truth whose pixels are followed.

    Examples
    --------
    >>> import scenetruth as st
    >>> item = {"mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}, "name": "wall"}
    >>> item |= {"pose": {"position_mm": [0, 0, 100]}}
    >>> item |= {"motion": [{"kind": "velocity", "velocity_mm_per_frame": [0, 0, 2]}]}
    >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 60}, "objects": [item]}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 3}, "render": {"backend": "raycast"}}
    >>> scene = st.scene_from_plain(plain)
    >>> _, truth = st.simulate(scene)
    >>> track_points(scene, truth, [0, 1.5])[:, 2, 15, 20].round(9).tolist()
    [100.0, 103.0]
    """
    if not isinstance(scene, Scene):
        raise SceneError([Problem("", "must be a Scene, as of load_scene", type(scene).__name__)])
    check_dataset(truth, "truth")
    problems = [
        Problem(name, "is missing; tracks need it")
        for name in ("object_id", "face_id", "barycentric")
        if name not in truth
    ]
    if isinstance(t, bool) or not isinstance(t, int | np.integer) or t not in truth["t"].values:
        problems.append(Problem("t", f"must be one of the frames of the truth, {truth['t'].values.tolist()}", t))
    try:
        moments = np.array([float(time) for time in times])
    except (TypeError, ValueError, OverflowError):
        moments = np.full(1, np.nan)
    if not np.isfinite(moments).all():
        problems.append(Problem("times", "must be finite numbers", times))
    if problems:
        raise RecordingError(problems, source="truth")
    world = build_world(scene, Path(folder))
    image = truth.sel(t=t)
    body = image["object_id"].values
    if body.ndim != 2:
        image = image.sel(s=0)
        body = image["object_id"].values
    here = body >= 0
    face = world.faces[world.face_offsets[body[here]] + image["face_id"].values[here]]
    b1, b2 = (image["barycentric"].values[k][here][:, None] for k in range(2))
    tracks = np.full((len(moments), 3, *body.shape), np.nan)
    for track, time in zip(tracks, moments, strict=True):
        vertices = world.at(float(time)).vertices_mm
        first, second, third = (vertices[face[:, k]] for k in range(3))
        track[:, here] = (first + b1 * (second - first) + b2 * (third - first)).T
    return tracks
