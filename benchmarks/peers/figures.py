"""Makes the figures of the peers again: ``python -m benchmarks.peers.figures [NAME...]``, beside those known before.

Errors are told at the peer's own points, of the reference camera, on the object, 20 px and more from silhouettes and
edges: of flow the length of the error, of disparity (between neighbours, 5 mm) and depth (20 mm) the difference. Peers
are told which pixels the object covers, less 5 px. Of the star: the longest period of which less than 90 % is left over
four frames, 0.4 px, and the root of the mean square of the flow along y of the sheet at rest. Growth of area is told in
% per hour.

``NAME`` is a part of names of figures: ``pyvale``, ``cube``. What is there in FOLDER is not measured again. The
environments are those of `benchmarks.peers.setup`.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from benchmarks.beside import scene_of
from benchmarks.jobs import heading, line
from benchmarks.peers.catalogue import PEERS, command_of
from benchmarks.peers.pairs import Pair, made
from benchmarks.peers.programs.folder import whole_shift
from benchmarks.peers.setup import FOLDER
from benchmarks.peers.wanted import JOBS, WANTED, Job
from benchmarks.star import INTERIOR_PX, crossings, periods_px
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.estimators.opencv_common import FlowSettings, eight_bit_images, flow_between
from scenetruth.output import write_atomically

Map = NDArray[np.float64]
TIMEOUT_S = 900.0
REST = "star_at_rest"
SMOOTH_PX = 5
# From a share per frame to percent per hour, over the s that a frame takes.
PERCENT_HOURS = 360_000


def measured(job: Job, folder: Path) -> dict[str, dict[str, float]]:
    """Return figures by quantity and statistic, and how long it took.

    Parameters
    ----------
    job
        The work.
    folder
        Where environments and scenes are.
    """
    pair = made(job.scene, job.pair, folder)
    started = time.perf_counter()
    maps = _maps(job, pair, folder, points=job.scene != "star")
    seconds = {"": {"seconds": time.perf_counter() - started}}
    if job.scene == "star":
        rest = made(REST, job.pair, folder)
        return seconds | {"flow_y": _resolution(maps, pair, _maps(job, rest, folder, points=True), rest)}
    return seconds | _errors(maps, pair)


def _maps(job: Job, pair: Pair, folder: Path, *, points: bool) -> Mapping[str, Map]:
    """Return what a peer, OpenCV or a method finds in the reference frame."""
    if job.peer == "opencv":
        return _by_opencv(pair, FlowSettings(**_settings(job)))
    if job.peer not in PEERS:
        found = st.estimate(pair.recording, job.peer, _settings(job)).sel(t=0)
        told = found["status"].values == 2
        names = [name for name in ("disparity", "depth", "flow", "velocity", "growth_rate") if name in found]
        return {name: np.where(told, found[name].values, np.nan) for name in names}
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


def _settings(job: Job) -> dict[str, Any]:
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


def kept(name: str, folder: Path) -> dict[str, Any] | None:
    """Return the figures of some work that are there, if they are of this very work."""
    file = _file(name, folder)
    if not file.exists():
        return None
    there = json.loads(file.read_text(encoding="utf-8"))
    return there["found"] if there["job"] == json.loads(json.dumps(asdict(JOBS[name]))) else None


def _file(name: str, folder: Path) -> Path:
    return folder / "figures" / f"{name.replace(': ', '_').replace(' ', '_')}.json"


def main() -> None:
    """Measure what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="only figures whose names contain one of these")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="environments, scenes, figures (outputs/peers)")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    chosen = [name for name in JOBS if not given.names or any(part in name for part in given.names)]
    found, failed = {}, False
    for name in chosen:
        there = kept(name, given.folder)
        if there is None:
            try:
                there = measured(JOBS[name], given.folder)
            except (RuntimeError, OSError, subprocess.TimeoutExpired) as error:
                failed = True
                print(f"{name}: nothing found: {error}", file=sys.stderr, flush=True)
                continue
            _file(name, given.folder).parent.mkdir(parents=True, exist_ok=True)
            with write_atomically(_file(name, given.folder), overwrite=True) as aside:
                aside.write_text(json.dumps({"job": asdict(JOBS[name]), "found": there}, indent=1), encoding="utf-8")
            print(f"{name}: {there['']['seconds']:.1f} s", file=sys.stderr, flush=True)
        found[name] = there
    print(heading(("figure", "quantity", "statistic", "known before", "seen", "seen / known", "points")))
    for row in WANTED:
        if row.job in found:
            figures = found[row.job][row.quantity]
            seen = figures[row.statistic]
            ratio = "" if row.number is None else f"{seen / row.number:.2f}"
            before = "" if row.number is None else f"{row.number:g}"
            cells = (row.job, row.quantity, row.statistic, before, f"{seen:.3g}", ratio, f"{figures['points']:.0f}")
            print(line(cells), flush=True)
    if failed:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
