"""Programs and methods on the same four images of full size: the cube, a leaf, and the star.

Errors are evaluated at the program's own points, of the reference camera, on the object, 20 px and more from
silhouettes and edges: of flow the endpoint error, of disparity (between neighbours, 5 mm) and depth (20 mm) the
difference. Programs are given the pixels that the object covers, less 5 px. Of the star: the longest period of which
less than 90 % is left over four frames, 0.4 px, and the root of the mean square of the flow along y of the sheet at
rest. Growth of area is in % per hour.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from numpy.typing import NDArray

import scenetruth as st
from benchmarks.beside import scene_of
from benchmarks.peers.catalogue import PEERS, command_of
from benchmarks.peers.pairs import Pair, made
from benchmarks.peers.programs.folder import whole_shift
from benchmarks.results.jobs import estimators_hash
from benchmarks.star import INTERIOR_PX, crossings, periods_px
from scenetruth.estimators.opencv_common import FlowSettings, eight_bit_images, flow_between
from scenetruth.output import write_atomically

__all__ = ["COLUMNS", "JOBS", "FourImages", "four_images_table", "measure_four_images", "stored_four_images"]

COLUMNS = (
    *("job", "method", "scene", "options", "quantity", "rmse", "median_abs_error", "bias", "points"),
    *("cutoff_period_first", "cutoff_period_last", "noise_std"),
)
"""Columns of the table."""

Map = NDArray[np.float64]
TIMEOUT_S = 900.0
REST = "star_at_rest"
SMOOTH_PX = 5
# From a share per frame to percent per hour, over the s that a frame takes.
PERCENT_HOURS = 360_000


@dataclass(frozen=True)
class FourImages:
    """One run of one program, or, for the star, two.

    Parameters
    ----------
    peer
        A program, ``opencv``, or a method of scenetruth.
    scene, pair
        Which images, by the labels of `benchmarks.peers.pairs`.
    options
        Options of the program; of a method, its settings as NAME=VALUE.
    """

    peer: str
    scene: str
    pair: str
    options: tuple[str, ...] = ()


_SUBSET = ("--subset", "25")
JOBS: dict[str, FourImages] = {
    "pyvale: cube": FourImages("pyvale", "cube", "near"),
    "pyvale_stereo: cube": FourImages("pyvale_stereo", "cube", "far"),
    "al_dic_3d: cube": FourImages("al_dic_3d", "cube", "far"),
    "sun_dic: cube": FourImages("sun_dic", "cube", "near"),
    "pyxel: cube": FourImages("pyxel", "cube", "near", ("--rectangle",)),
    "mudic: cube": FourImages("mudic", "cube", "near"),
    "farneback: cube": FourImages("opencv", "cube", "near", ("flow=farneback",)),
    "dis: cube": FourImages("opencv", "cube", "near", ("flow=dis",)),
    "pyvale_stereo 75 px: leaf": FourImages("pyvale_stereo", "leaf", "far", ("--growth", "15")),
    "pyvale_stereo 45 px: leaf": FourImages("pyvale_stereo", "leaf", "far", ("--growth", "9")),
    "al_dic_3d 33 px: leaf": FourImages("al_dic_3d", "leaf", "far", ("--growth", "5")),
    "pyvale affine: star": FourImages("pyvale", "star", "one", _SUBSET),
    "pyvale quadratic: star": FourImages("pyvale", "star", "one", (*_SUBSET, "--shape", "QUAD")),
    "sun_dic: star": FourImages("sun_dic", "star", "one", _SUBSET),
    "farneback: star": FourImages("opencv", "star", "one", ("flow=farneback",)),
    "dis: star": FourImages("opencv", "star", "one", ("flow=dis",)),
    "structure_tensor: cube": FourImages("structure_tensor", "cube", "far"),
    "refined: cube": FourImages("refined", "cube", "far", ("window_sigma_px=8",)),
    "refined default: cube": FourImages("refined", "cube", "far"),
    "plane_sweep: cube": FourImages("plane_sweep", "cube", "far"),
    "structure_tensor: leaf": FourImages("structure_tensor", "leaf", "far"),
    "refined: leaf": FourImages("refined", "leaf", "far", ("window_sigma_px=8",)),
    "refined: leaf_anisotropic": FourImages("refined", "leaf_anisotropic", "far", ("window_sigma_px=8",)),
}
"""All work, by name; methods of scenetruth use the four images of stereo correlation."""


def measured(job: FourImages, folder: Path) -> dict[str, dict[str, float]]:
    """Return figures by quantity and statistic.

    Parameters
    ----------
    job
        The work.
    folder
        Where environments and scenes are.
    """
    pair = made(job.scene, job.pair, folder)
    maps = _maps(job, pair, folder, points=job.scene != "star")
    if job.scene == "star":
        rest = made(REST, job.pair, folder)
        return {"flow_y": _resolution(maps, pair, _maps(job, rest, folder, points=True), rest)}
    return _errors(maps, pair)


def _maps(job: FourImages, pair: Pair, folder: Path, *, points: bool) -> Mapping[str, Map]:
    """Return what a peer, OpenCV or a method finds in the reference frame."""
    if job.peer == "opencv":
        return _by_opencv(pair, FlowSettings(**_settings(job)))
    if job.peer not in PEERS:
        found = st.estimate(pair.recording, job.peer, _settings(job)).sel(t=0)
        valid = found["status"].values == 2
        names = [name for name in ("disparity", "depth", "flow", "velocity", "growth_rate") if name in found]
        return {name: np.where(valid, found[name].values, np.nan) for name in names}
    with tempfile.TemporaryDirectory(prefix="peer-") as output:
        options = (*job.options, "--region", str(pair.region.absolute()), *(["--points"] if points else []))
        words = shlex.split(command_of(folder, job.peer, options))
        places = {"{recording}": str(pair.folder.absolute()), "{output}": output}
        ended = subprocess.run(
            [places.get(word, word) for word in words],
            cwd=output,
            env={**os.environ, "OMP_WAIT_POLICY": "PASSIVE"},
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
        )
        if ended.returncode:
            raise RuntimeError(f"{shlex.join(words)}\n{ended.stderr[-1000:]}")
        return {file.name.partition("_t")[0]: np.load(file) for file in Path(output).rglob("*_t+0.npy")}


def _settings(job: FourImages) -> dict[str, Any]:
    return {name: yaml.safe_load(value) for name, _, value in (option.partition("=") for option in job.options)}


def _by_opencv(pair: Pair, settings: FlowSettings) -> dict[str, Map]:
    """Return flow to the next frame, and disparity as the flow to the other camera, started with the whole shift."""
    images = eight_bit_images(pair.recording)
    first = images(0, 0)[0]
    maps = {"flow": flow_between(first, images(0, 1)[0], settings)}
    if pair.recording.sizes["s"] > 1:
        other = images(1, 0)[0]
        region = np.load(pair.region)
        start, _ = whole_shift(first.astype(float), other.astype(float), region, (first.shape[1] // 2, 2))
        moved = np.ascontiguousarray(np.roll(other, -start, axis=1))
        maps["disparity"] = -start - flow_between(first, moved, settings)[0]
    return maps


def _errors(maps: Mapping[str, Map], pair: Pair) -> dict[str, dict[str, float]]:
    found = {}
    for name, values in maps.items():
        off = values - _true(name, pair)
        parts = {"flow": np.hypot(*off)} if name == "flow" else {name: off}
        if name == "growth_rate":
            parts = {name: off * PERCENT_HOURS / float(pair.recording.attrs["frame_interval_s"])}
        if name == "velocity":
            parts = {f"velocity_{axis}": one for axis, one in zip("xyz", off, strict=True)}
        for part, errors in parts.items():
            kept = errors[pair.inside & np.isfinite(errors)].astype(np.float64)
            found[part] = {
                "rmse": float(np.sqrt(np.mean(kept**2))),
                "median_abs_error": float(np.median(np.abs(kept))),
                "bias": float(kept.mean()),
                "points": float(kept.size),
            }
    return found


def _true(name: str, pair: Pair) -> Map:
    """Return the truth; of disparity per distance of the pair's two cameras."""
    values = np.asarray(pair.truth[name].values, dtype=np.float64)
    steps = pair.recording.attrs["baseline_mm"] / pair.truth.attrs["baseline_mm"]
    return values * steps if name == "disparity" else values


def _resolution(moving: Mapping[str, Map], pair: Pair, still: Mapping[str, Map], rest: Pair) -> dict[str, float]:
    # Along the two rows in the middle, summed over a few columns.
    rows = slice(pair.inside.shape[0] // 2 - 1, pair.inside.shape[0] // 2 + 1)
    found = moving["flow"][1][rows].astype(np.float64) / pair.apart
    truth = pair.truth["flow"].isel(image_component=1).values[rows]
    known = np.isfinite(found)
    summed = [
        np.convolve(np.where(known, one, 0.0).sum(axis=0), np.ones(SMOOTH_PX), "same")
        for one in (found * truth, truth**2)
    ]
    with np.errstate(invalid="ignore", divide="ignore"):
        first, last = crossings(periods_px(scene_of("star", ())), summed[0] / summed[1])
    inner = np.zeros_like(rest.inside)
    inner[INTERIOR_PX:-INTERIOR_PX, INTERIOR_PX:-INTERIOR_PX] = True
    off = still["flow"][1][rest.inside & inner]
    off = off[np.isfinite(off)].astype(np.float64)
    noise = float(np.sqrt(np.mean(off**2)))
    return {"cutoff_period_first": first, "cutoff_period_last": last, "noise_std": noise, "points": float(off.size)}


def measure_four_images(folder: Path, peers: Path) -> Iterator[tuple[str, float]]:
    """Measure what is missing; yield name and processor time in s of each job as it ends.

    Parameters
    ----------
    folder
        Folder of the results.
    peers
        Folder of the environments.
    """
    for name, job in JOBS.items():
        if stored_four_images(folder, name) is not None:
            continue
        started = _processor_s()
        try:
            found = measured(job, peers)
        except (RuntimeError, OSError, subprocess.TimeoutExpired) as error:
            print(f"{name}: no result: {error}", file=sys.stderr, flush=True)
            continue
        file = _file(folder, name)
        file.parent.mkdir(parents=True, exist_ok=True)
        plain = {"job": _identity(job), "found": found, "processor_s": _processor_s() - started}
        with write_atomically(file, overwrite=True) as partial:
            partial.write_text(json.dumps(plain, indent=1), encoding="utf-8")
        yield name, _processor_s() - started


def stored_four_images(folder: Path, name: str) -> dict[str, dict[str, float]] | None:
    """Return the results of a job by quantity and statistic, if they are of this very job.

    Parameters
    ----------
    folder
        Folder of the results.
    name
        Name of the job.
    """
    file = _file(folder, name)
    if not file.exists():
        return None
    there = json.loads(file.read_text(encoding="utf-8"))
    found: dict[str, dict[str, float]] = there["found"]
    return found if there["job"] == json.loads(json.dumps(_identity(JOBS[name]))) else None


def four_images_table(folder: Path) -> pd.DataFrame:
    """Return all results: a line for each job and quantity.

    Parameters
    ----------
    folder
        Folder of the results.
    """
    lines = []
    for name, job in JOBS.items():
        found = stored_four_images(folder, name) or {}
        for quantity, values in found.items():
            line = {"job": name, "method": job.peer, "scene": job.scene, "options": " ".join(job.options)}
            lines.append(line | {"quantity": quantity, **values})
    return pd.DataFrame(lines, columns=list(COLUMNS))


def _identity(job: FourImages) -> dict[str, Any]:
    """Return all on which the result of a run depends: of a built-in method also its code."""
    own = job.peer != "opencv" and job.peer not in PEERS
    return asdict(job) | ({"code": estimators_hash()} if own else {})


def _file(folder: Path, name: str) -> Path:
    return folder / "four_images" / f"{name.replace(': ', '_').replace(' ', '_')}.json"


def _processor_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
