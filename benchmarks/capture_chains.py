"""Full chains from simulated captures to error bars: share of the errors within their 95 % bars.

Run it from the top of the repository: ``python -m benchmarks.capture_chains [--seeds N] [--scenes NAME ...]``. Each
chain has a new rig: lens, axis, guide, step length, board and noise are drawn. It is calibrated from images of its
board, its images are rectified, and depth and motion are estimated with the errors of the calibration.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml
from numpy.typing import NDArray

import scenetruth as st
from benchmarks.capture_rectification import make_scene, true_maps
from scenetruth.camera import Camera
from scenetruth.capture import (
    add_calibration_errors,
    calibrate_capture,
    import_capture,
    region_mean,
    simulate_capture,
)
from scenetruth.schema import read_intrinsics
from scenetruth.scoring.common_statistics import CommonErrors, remove_common_errors
from scenetruth.scoring.error_pairs import percent_per_hour
from scenetruth.scoring.statistics import ErrorSamples

__all__ = ["main"]

Floats = NDArray[np.float64]

_BORDER_PX = 12
_BARS = 1.96
_QUANTITIES = (("depth", None), ("velocity", "Z"), ("growth_rate", None))


def chain_scene(name: str, seed: int) -> dict[str, Any]:
    """Return a scene with a rig that is drawn."""
    generator = np.random.default_rng([seed, 7])
    if name == "leaf":
        from scenetruth.scene import load_scene

        scene = load_scene(Path(__file__).parents[1] / "scenes" / "leaf.yaml").to_dict()
        scene["camera"] |= {"width": 320, "height": 240, "focal_length_px": 2200}
        scene["frames"]["count"] = 5
    else:
        scene = make_scene(name, seed)
    camera = scene["camera"]
    camera["focal_length_px"] *= 1 + 2e-3 * generator.standard_normal()
    camera["principal_point_px"] = (np.array([159.5, 119.5]) + 6 * generator.standard_normal(2)).tolist()
    # 1 px in the corners.
    corner = 200 / camera["focal_length_px"]
    camera["distortion"] = {
        "k1": float(0.005 / corner**2 * generator.uniform(-1, 1)),
        "p1": float(0.001 / corner * generator.uniform(-1, 1)),
        "p2": float(0.001 / corner * generator.uniform(-1, 1)),
    }
    scene["stage"] |= {
        "errors": {"preset": "screw_stage"}, "axis_tilt_urad": (4000 * generator.standard_normal(2)).tolist(),
    }  # fmt: skip
    scene["optics"] = {"psf": {"kind": "gaussian", "sigma_px": 0.6}}
    scene["sensor"] = {"kind": "emva1288", "preset": "industrial_cmos"}
    scene["render"] = {"backend": "raycast", "supersampling": 4}
    scene["seed"] = seed
    return scene


def _board(scene: dict[str, Any]) -> dict[str, Any]:
    """Return a board with squares of 40 px, large enough for windows between edge and marker in the small image."""
    distance = max(each["pose"]["position_mm"][2] for each in scene["objects"][:1])
    square = round(40 * distance / scene["camera"]["focal_length_px"], 1)
    return {
        "kind": "charuco", "squares": [8, 6], "square_mm": square, "marker_mm": round(0.74 * square, 2),
        "dictionary": "4X4_250",
    }  # fmt: skip


def run_chain(name: str, seed: int, scratch: Path) -> dict[str, Any]:
    """Return z of means and differences, and shares of pixels within their bars."""
    begin = time.process_time()
    scene = chain_scene(name, seed)
    folder = simulate_capture(
        scene, scratch / "lab", board=_board(scene), poses=8, dark=8, flat=8, static=0
    )  # fmt: skip
    simulated = time.process_time()
    rig = calibrate_capture(folder)
    recording = import_capture(folder, calibration=rig)
    estimate = add_calibration_errors(st.estimate(recording, "refined"), rig)
    found: dict[str, Any] = {
        "scene": name, "seed": seed, "simulation_s": simulated - begin, "chain_s": time.process_time() - simulated,
        "variance_factor": rig.variance_factor,
    }  # fmt: skip
    plain = yaml.safe_load((folder / "truth" / "parameters.yaml").read_text())["camera"]
    camera = Camera(
        width=rig.width, height=rig.height, focal_length_px=plain["focal_length_px"],
        principal_point_px=plain["principal_point_px"], distortion=plain["distortion"],
    )  # fmt: skip
    found["z_f"] = (rig.value("f") - camera.focal_px) / rig.std("f")
    true = true_maps(st.load_store(folder / "truth" / "truth.zarr"), camera, rig)
    now = estimate.sel(t=0)
    usable = now["valid"].values & (true["away"] > _BORDER_PX)
    for quantity, component in _QUANTITIES:
        if quantity not in estimate:
            continue
        number = None if component is None else "XYZ".index(component)
        each = (now[f"{quantity}{ending}"].values for ending in ("", "_std"))
        value, std = (np.asarray(values if number is None else values[number]) for values in each)
        truth = true[quantity] if number is None else true[quantity][number]
        among = usable & np.isfinite(value) & np.isfinite(std) & np.isfinite(truth)
        if among.sum() < 500:
            continue
        error = value - truth
        middle = np.median(np.nonzero(among)[1])
        left = among & (np.arange(among.shape[1]) < middle)
        mean = region_mean(estimate, quantity, among, component=component)
        apart = region_mean(estimate, quantity, left, minus=among & ~left, component=component)
        rest = _without_common_errors(estimate.sel(t=[0]), quantity, number, (error, truth, std), among[None])
        found[quantity] = {
            "pixels": int(among.sum()),
            "error": float(error[among].mean()),
            "std": mean.std,
            "common": mean.std_common,
            "z": float(error[among].mean() / mean.std),
            "z_difference": float((error[left].mean() - error[among & ~left].mean()) / apart.std),
            "within": float(np.mean(np.abs(error[among]) < _BARS * std[among])),
            "within_apart": float(np.mean(np.abs(rest) < _BARS)),
            "rms_z_apart": float(np.sqrt(np.mean(rest**2))),
        }
    return found


def _without_common_errors(
    estimate: xr.Dataset,
    quantity: str,
    number: int | None,
    maps: tuple[Floats, Floats, Floats],
    among: NDArray[np.bool_],
) -> Floats:
    """Return errors less the common ones, over the standard deviations of the pixels, at a lattice of pixels."""
    scale = percent_per_hour(read_intrinsics(estimate)) if quantity == "growth_rate" else 1.0
    error, truth, std = (scale * each[among[0]] for each in maps)
    name = quantity if number is None else f"{quantity}_{'xyz'[number]}"
    samples = CommonErrors(estimate).samples(name, ErrorSamples(among, among, error, truth, std))
    assert samples is not None  # all quantities have errors by the calibration
    return remove_common_errors(samples)


def summarise(results: list[dict[str, Any]]) -> None:
    """Print coverage over chains."""
    for quantity, _ in _QUANTITIES:
        for name in [*dict.fromkeys(each["scene"] for each in results), "all"]:
            own = [each[quantity] for each in results if name in (each["scene"], "all") and quantity in each]
            if not own:
                continue
            z, z2 = (np.array([each[key] for each in own]) for key in ("z", "z_difference"))
            shares = [100 * np.mean([each[key] for each in own]) for key in ("within_apart", "within")]
            print(f"{quantity:12} {name:6} {len(own):3d} chains: rms z of the mean {np.sqrt(np.mean(z**2)):.2f}"
                  f" ({np.sum(np.abs(z) < _BARS)} within), of halves {np.sqrt(np.mean(z2**2)):.2f}"
                  f" ({np.sum(np.abs(z2) < _BARS)} within), pixels within, common part apart {shares[0]:.1f} %"
                  f" (rms z {np.sqrt(np.mean([each['rms_z_apart']**2 for each in own])):.2f}),"
                  f" all {shares[1]:.1f} %, stated {np.mean([each['std'] for each in own]):.3g},"
                  f" rms error of the mean {np.sqrt(np.mean([each['error']**2 for each in own])):.3g}")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=7)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--scenes", nargs="+", default=["plane", "cube", "leaf"])
    parser.add_argument("--output", type=Path, help="file of all results, one JSON object a line")
    given = parser.parse_args()
    results = []
    for seed in range(given.first, given.first + given.seeds):
        for place, name in enumerate(given.scenes):
            # No two chains have the same draws.
            with tempfile.TemporaryDirectory() as scratch:
                found = run_chain(name, 100 * place + seed, Path(scratch))
            results.append(found)
            print(json.dumps(found), flush=True)
            if given.output is not None:
                with given.output.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps(found) + "\n")
    summarise(results)


if __name__ == "__main__":
    main()
