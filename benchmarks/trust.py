"""How far the stated standard deviations of a method can be trusted: errors in units of them, scene by scene.

Run it from the top of the repository: ``python -m benchmarks.trust [NAME ...] [--held-out] [--kept FILE] [--cache
DIR]``; small scenes of 240 x 180 pixels, 5 cameras, 9 frames. Every third scene of a family is held out
(``--held-out``): it is looked at only to confirm what was chosen on the others. Families are in the modules
``trust_*`` beside this one.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import pickle
import pkgutil
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import benchmarks
import scenetruth as st
from benchmarks.jobs import arguments, ends, heading, line, number
from scenetruth.scoring.regions import main_regions

__all__ = ["Plain", "assess", "family", "list_scenes", "parse_arguments", "plane", "rig", "simulated"]

Plain = dict[str, Any]
DEPTH_MM, FOCAL_PX, BASELINE_MM = 600.0, 2400.0, 5.0
PIXEL_MM = DEPTH_MM / FOCAL_PX
QUANTITIES = ("disparity", "depth", "velocity_x", "velocity_y", "velocity_z", "growth_rate")
COLUMNS = ("scene", "quantity", "valid, %", "rms z", "median |z| / 0.67", "beyond 6, %", "within 2, %", "rms error")
FAR, NEAR = 6.0, 2.0
SUMMARY = ("scenes", "number", "valid, %", "beyond 6, %", "worst scene, %", "RMS z-score")


def rig(objects: list[Plain], **changes: Any) -> Plain:
    """Return a scene with the usual camera, stage, frames and sensor; nested changes are merged."""
    scene: Plain = {
        "camera": {"width": 240, "height": 180, "focal_length_px": FOCAL_PX},
        "stage": {"positions": 5, "baseline_mm": BASELINE_MM},
        "frames": {"count": 9, "frame_interval_s": 60},
        "objects": objects,
        "sensor": {"bit_depth": 12, "noise_std": 0.005},
        "seed": 11,
    }
    for name, value in changes.items():
        scene[name] = {**scene[name], **value} if isinstance(value, dict) and name in scene else value
    return scene


def plane(texture: Plain, **more: Any) -> Plain:
    """Return a sheet that fills the view and moves by about a pixel per frame, with a texture in mm."""
    default: Plain = {
        "name": "sheet",
        "mesh": {"kind": "plane", "size_mm": [110, 90]},
        "texture": texture,
        "pose": {"position_mm": [0, 0, DEPTH_MM], "rotations": [{"axis": [0, 1, 0], "angle_deg": 10}]},
        "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.2, 0.1, 0.3]}],
    }
    return {**default, **more}


def noise(shortest_px: float, longest_px: float, contrast: float = 0.25) -> Plain:
    """Return a noise texture by its wavelengths in pixels."""
    waves = [shortest_px * PIXEL_MM, longest_px * PIXEL_MM]
    return {"kind": "noise", "wavelength_mm": waves, "mean": 0.5, "rms_contrast": contrast}


def family(name: str) -> Mapping[str, Plain]:
    """Return the scenes of a module ``trust_*``, by name."""
    return dict(importlib.import_module(f"benchmarks.{name}").SCENES)


def list_scenes(*, held_out: bool) -> Iterator[tuple[str, Plain]]:
    """Give the scenes of all families, those that are held out or the others."""
    for module in sorted(each.name for each in pkgutil.iter_modules(benchmarks.__path__)):
        if module.startswith("trust_"):
            for number_, (name, scene) in enumerate(family(module).items()):
                if (number_ % 3 == 2) == held_out:
                    yield f"{module.removeprefix('trust_')} {name}", scene


def simulated(scene: Plain, cache: str | None) -> tuple[xr.Dataset, xr.Dataset]:
    """Return recording and truth of a scene, from a folder of earlier ones if it is there."""
    source = json.dumps(scene, sort_keys=True)
    file = None if cache is None else Path(cache) / f"{hashlib.sha256(source.encode()).hexdigest()[:24]}.pickle"
    if file is not None and file.exists():
        return pickle.loads(file.read_bytes())
    recording, truth = st.simulate(scene)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.with_suffix(".part").write_bytes(pickle.dumps((recording.load(), truth.load())))
        file.with_suffix(".part").rename(file)
    return recording, truth


def assess(scene: Plain, settings: Plain, cache: str | None) -> dict[str, dict[str, float]]:
    """Return what errors in the interior are in units of the stated standard deviations, by quantity."""
    recording, truth = simulated(scene, cache)
    estimate = st.estimate(recording, "refined", **settings)
    truth = truth.sel(t=estimate["t"])
    interior = np.asarray(main_regions(truth, 12.0)["interior"])
    found: dict[str, dict[str, float]] = {}
    for quantity in QUANTITIES:
        name, _, part = quantity.partition("_")
        if name == "velocity":
            values, exact, std = (
                each.sel(component=part.upper()).values
                for each in (estimate["velocity"], truth["velocity"], estimate["velocity_std"])
            )
        elif f"{quantity}_std" in estimate and quantity in truth:
            values, exact, std = estimate[quantity].values, truth[quantity].values, estimate[f"{quantity}_std"].values
        else:
            continue
        among = interior & np.isfinite(exact)
        valid = among & (estimate["status"].values == 2) & np.isfinite(values)
        error = (values - exact)[valid].astype(np.float64)
        z = np.abs(error) / np.maximum(std[valid], 1e-300)
        z = np.where(np.isfinite(z), z, np.inf)
        some = bool(z.size)
        found[quantity] = {
            "density": float(valid.sum() / max(among.sum(), 1)),
            "rms": float(np.sqrt(np.mean(np.minimum(z, 1e3) ** 2))) if some else float("nan"),
            "robust": float(np.median(z) / 0.6745) if some else float("nan"),
            "beyond": float(np.mean(z > FAR)) if some else 0.0,
            "within": float(np.mean(z < NEAR)) if some else float("nan"),
            "error": float(np.sqrt(np.mean(error**2))) if some else float("nan"),
            "bias": float(np.mean(error)) if some else float("nan"),
        }
    return found


def parse_arguments(description: str | None) -> tuple[argparse.Namespace, Plain]:
    """Return the arguments of a benchmark of stated standard deviations, and the settings of the method."""
    parser = arguments(description)
    parser.add_argument("--held-out", action="store_true", help="the scenes that are held out instead of the others")
    parser.add_argument("--cache", help="folder of simulated scenes")
    parser.add_argument("--setting", action="append", default=[], metavar="NAME=VALUE", help="of the method, as JSON")
    given = parser.parse_args()
    return given, {name: json.loads(value) for name, _, value in (each.partition("=") for each in given.setting)}


def main() -> None:
    """Print a table with a line for each scene and quantity."""
    given, settings = parse_arguments(__doc__)
    jobs = {name: (scene, settings, given.cache) for name, scene in list_scenes(held_out=given.held_out)}
    print(heading(COLUMNS), flush=True)
    every: dict[str, Plain] = {}
    for name, found in ends(assess, jobs, given):
        every[name] = found
        for quantity, of in found.items():
            cells = [number(100 * of["density"]), number(of["rms"]), number(of["robust"])]
            cells += [number(100 * of["beyond"]), number(100 * of["within"]), number(of["error"])]
            print(line([name, quantity, *cells]), flush=True)
    print()
    print(heading(SUMMARY))
    for label, scenes in grouped(every):
        print(line([label, str(len(scenes)), *summarise(scenes)]))


def grouped(found: Mapping[str, Plain]) -> Iterator[tuple[str, list[Plain]]]:
    """Give the results of the groups of scenes of all families."""
    for module in sorted({name.split()[0] for name in found}):
        own = {name.partition(" ")[2]: of for name, of in found.items() if name.split()[0] == module}
        for label, pattern in importlib.import_module(f"benchmarks.trust_{module}").GROUPS.items():
            scenes = [of for name, of in own.items() if re.search(pattern, name)]
            if scenes:
                yield label, scenes


def summarise(scenes: Sequence[Plain]) -> list[str]:
    """Return valid share, shares beyond 6 of all valid pixels and of the worst scene, and the range of RMS z-scores."""
    density = [max(of["density"] for of in scene.values()) for scene in scenes]
    pooled, worst, scores = [], [], []
    for quantity in QUANTITIES:
        some = [scene[quantity] for scene in scenes if quantity in scene and scene[quantity]["density"] > 0]
        if some:
            total = sum(of["density"] for of in some)
            pooled.append(sum(of["density"] * of["beyond"] for of in some) / total)
            worst.append(max(of["beyond"] for of in some))
            scores += [of["rms"] for of in some]
    valid = f"{number(100 * min(density))} to {number(100 * max(density))}"
    if not pooled:
        return [valid, "–", "–", "–"]
    spread = f"{number(min(scores))} to {number(max(scores))}"
    return [valid, number(100 * max(pooled)), number(100 * max(worst)), spread]


if __name__ == "__main__":
    main()
