"""The scenes of the figures: rendered once, written as peers read them, with region and truth beside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

import scenetruth as st
from benchmarks.beside import scene_of
from benchmarks.refined import IDEAL, INTERIOR_PX, LATE
from benchmarks.same_images import pair_of
from benchmarks.star import AT_REST
from scenetruth.estimators.external import write_recording
from scenetruth.output import write_atomically

__all__ = ["PAIRS", "SCENES", "Pair", "made"]

ONE_CAMERA = ("stage.positions=1", "frames.count=9")
SCENES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "cube": ("cube", ()),
    "cube_ideal": ("cube", IDEAL),
    "leaf": ("leaf", (LATE, "objects.0.deformation.0.along_share=null")),
    "leaf_anisotropic": ("leaf", (LATE,)),
    "star": ("star", ONE_CAMERA),
    "star_at_rest": ("star", (*ONE_CAMERA, *AT_REST)),
}
"""Scenes by label: name and changes. The leaf grows alike in all directions unless it is called anisotropic."""
PAIRS: Mapping[str, tuple[int, int]] = {"near": (0, 1), "far": (-2, 2), "one": (0, 0)}
"""Left and right camera: neighbours 5 mm apart, the outermost 20 mm apart, one camera alone."""
COUNT = 3
"""Frames that are rendered; those before the first of the pair are not used."""
APART = {"star": 4}
"""How many frames apart the two of a pair are, by name of the scene, if not one: the star moves by 0.4 px in four."""
MARGIN_PX = 5
"""How far within its outline an object is looked at, as if somebody had drawn it."""


@dataclass(frozen=True)
class Pair:
    """Two frames of one or two cameras.

    Parameters
    ----------
    folder
        Images and camera.json.
    region
        File of the pixels to look at.
    recording
        The same as a recording, its reference the left camera.
    truth
        Truth of the left camera in the first frame.
    inside
        The pixels that are measured: of the object, 20 px and more from silhouettes and edges.
    apart
        How many frames the second is after the first.
    """

    folder: Path
    region: Path
    recording: xr.Dataset
    truth: xr.Dataset
    inside: NDArray[np.bool_]
    apart: int = 1


def made(label: str, pair: str, folder: Path) -> Pair:
    """Return a pair of a scene; scene and pair are made if they are not there.

    Parameters
    ----------
    label
        One of `SCENES`.
    pair
        One of `PAIRS`.
    folder
        Where they are kept.
    """
    name, changes = SCENES[label]
    place = folder / "scenes" / label
    if not place.exists():
        place.parent.mkdir(parents=True, exist_ok=True)
        rendered, truth = st.simulate(scene_of(name, [f"frames.count={COUNT}", *changes]), truth_views="all")
        with write_atomically(place) as aside:
            aside.mkdir()
            st.save_store(rendered, aside / "recording.zarr")
            st.save_store(truth, aside / "truth.zarr")
    recording: Any = st.load_store(place / "recording.zarr", kind="recording")
    truth = st.load_store(place / "truth.zarr", kind="truth")
    left, right = PAIRS[pair]
    apart = APART.get(name, 1)
    if left == right:
        # Times belong to the frames of the scene, of which some are omitted.
        recording = recording.drop_vars("planned_time_s", errors="ignore")
        recording = recording.sel(s=[left], t=[0, apart]).assign_coords(t=[0, 1])
        truth = truth.sel(s=left, t=[0])
    else:
        recording, truth = pair_of(recording, truth, left, right)
    truth = truth.isel(t=0)
    seen = np.isfinite(truth["depth"].values)
    seen &= truth["object_id"].values == 0
    inside = seen & (truth["boundary_distance"].values >= INTERIOR_PX)
    written = folder / "pairs" / f"{label}_{pair}"
    if not written.exists():
        written.parent.mkdir(parents=True, exist_ok=True)
        with write_atomically(written) as aside:
            aside.mkdir()
            write_recording(recording, aside / "recording")
            np.save(aside / "region.npy", binary_erosion(seen, iterations=MARGIN_PX, border_value=1))
    return Pair(written / "recording", written / "region.npy", recording, truth, inside, apart)
