"""Errors of all methods in highlights and at borders of shadows, and print tables in Markdown.

Run from the top of the repository: ``python -m benchmarks.light``. The benchmark cases of light, and the regions of a
rosette with and without gloss.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.ndimage import gaussian_filter

import scenetruth as st
from benchmarks.jobs import heading, line
from scenetruth.benchmark.cases import METHOD_VALID, all_cases
from scenetruth.benchmark.design_point import add_noise
from scenetruth.errors import EstimateWarning, SceneWarning
from scenetruth.estimators import MethodSpec
from scenetruth.scoring.error_pairs import EstimateTruthPairs
from scenetruth.scoring.regions import further_regions, main_regions
from scenetruth.settings import ScoreSettings

METHODS = (
    MethodSpec("structure_tensor"),
    MethodSpec("refined"),
    MethodSpec("plane_sweep"),
    MethodSpec("opencv_scene_flow", label="sgbm + farneback"),
    MethodSpec("opencv_scene_flow", {"stereo": "bm", "flow": "dis"}, label="bm + dis"),
)
CASES = ("gloss", "translucency", "penumbra")
QUANTITIES = ("disparity", "velocity_x", "velocity_z")
STATISTICS = ("bias", "rmse", "rms_z", "beyond_6_std", "density")
SCENE = {"frames.count": 5, "camera.width": 400, "camera.height": 300, "plants.0.texture.channel": "green"}
GLOSS = {"plants.0.material": {"refractive_index": 1.5, "roughness": 0.2}}
MARGIN_PX = 10.0
FAR = 6.0
NOISE_STD = 0.005


def compare_cases() -> None:
    """Print the statistics of the benchmark cases."""
    rows = st.compare(METHODS, suite="full", cases=CASES).to_dataframe()
    rows = rows[rows["pixels"] == METHOD_VALID]
    for case in CASES:
        for quantity in QUANTITIES:
            print(f"\n### {case}: {quantity}\n")
            own = rows[(rows["case"] == case) & (rows["quantity"] == quantity)]
            levels = list(dict.fromkeys(own["label"]))
            print(heading(["method", "statistic", *levels]))
            for method in dict.fromkeys(own["method"]):
                for statistic in STATISTICS:
                    found = own[(own["method"] == method) & (own["statistic"] == statistic)]
                    if len(found):
                        print(line([method, statistic, *(_value(found, level) for level in levels)]))


def _value(rows: pd.DataFrame, level: str) -> str:
    values = rows[rows["label"] == level]["value"].to_numpy()
    return f"{values[0]:.2g}" if len(values) and math.isfinite(values[0]) else ""


def compare_regions(methods: Sequence[str] = ("refined", "structure_tensor")) -> None:
    """Print the errors of a rosette at t = 0 by region."""
    print("\n### rosette: disparity by region\n")
    print(heading(["leaves", "method", "region", "RMSE", "RMS z-score", "beyond 6, %", "valid, %"]))
    chosen = ScoreSettings(interior_margin_px=MARGIN_PX)
    for name, changes in (("glossy", GLOSS), ("matt", {})):
        scene = st.load_scene("rosette", overrides={**SCENE, **changes})
        recording, truth = st.simulate(scene, truth_content="complete_with_light")
        exact = truth.sel(t=[0])
        masks = main_regions(exact, MARGIN_PX)
        masks |= further_regions(exact, masks["interior"], chosen)
        for method in methods:
            settings = {"tau": "auto"} if method == "structure_tensor" else {}
            pair = EstimateTruthPairs(st.estimate(recording, method, settings).sel(t=[0]), exact)["disparity"]
            error = pair.estimate - pair.truth
            valid = np.isfinite(error) & (True if pair.full is None else pair.full)
            for region in ("interior", "specular", "shadow_boundary"):
                kept = valid & masks[region]
                if kept.any() and pair.std is not None:
                    z = np.abs(error[kept] / pair.std[kept])
                    far, density = 100 * np.mean(z > FAR), 100 * kept.sum() / masks[region].sum()
                    values = np.sqrt(np.mean(error[kept] ** 2)), np.sqrt(np.mean(z**2)), far, density
                    print(line([name, method, region, *(f"{value:.2g}" for value in values)]))


def compare_filtered(methods: Sequence[str] = ("structure_tensor", "refined")) -> None:
    """Print the errors in a highlight with images as recorded, and without their smooth part."""
    print("\n### gloss 0.1: images without their smooth part\n")
    print(heading(["method", "Gaussian, px", "bias", "RMSE", "RMS z-score", "beyond 6, %", "valid, %"]))
    case = all_cases()["gloss"]
    ideal, truth = st.simulate(st.Scene.from_dict(case.scene(0.1)), truth_content=case.truth_content)
    exact = truth.sel(t=[0])
    region = case.region_at(truth.sel(t=0), 0.1)
    recording = add_noise(ideal, NOISE_STD, case.kind, 0)
    grey = recording["image"]
    for method in methods:
        settings = {"tau": "auto"} if method == "structure_tensor" else {}
        for sigma in (0.0, 2.0, 3.0):
            smooth = gaussian_filter(grey.values, (0, 0, sigma, sigma)) if sigma else 0.0
            estimate = st.estimate(recording.assign(image=grey - smooth), method, settings)
            pair = EstimateTruthPairs(estimate.sel(t=[0]), exact)["disparity"]
            error = (pair.estimate - pair.truth)[0]
            kept = region & np.isfinite(error) & (True if pair.full is None else pair.full[0])
            assert pair.std is not None
            found, z = error[kept], np.abs(error[kept] / pair.std[0][kept])
            values = found.mean(), np.sqrt(np.mean(found**2)), np.sqrt(np.mean(z**2)), 100 * np.mean(z > FAR)
            print(line([method, sigma, *(f"{value:.2g}" for value in (*values, 100 * kept.sum() / region.sum()))]))


if __name__ == "__main__":
    with warnings.catch_warnings():
        for category in (SceneWarning, EstimateWarning, RuntimeWarning):
            warnings.simplefilter("ignore", category)
        compare_cases()
        compare_filtered()
        compare_regions()
