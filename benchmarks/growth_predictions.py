"""Predicted over measured scatter where growth is anisotropic: a table of docs/results/predictions.md.

Run it from the top of the repository: ``python -m benchmarks.growth_predictions --kept FILE``; 240 x 180 pixels, 5
cameras, 9 frames, estimated with several noises. Medians over the pixels of the growing object whose windows lie in all
images; the last column is the RMS of the prediction over that of all errors, which include bias. Options of all
benchmarks: `benchmarks.jobs`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import scenetruth as st
from benchmarks.jobs import arguments, ends, heading, line
from benchmarks.trust_growth import SCENES, sheet
from scenetruth.benchmark.design_point import add_noise
from scenetruth.design import predict
from scenetruth.schema.variables import MOTION_AFFINE, MOTION_PLAIN

NOISES = 4
EDGE_PX, BORDER_PX = 12.0, (13, 24)  # least distances from silhouettes, and from the image border along y and x
QUANTITIES: Mapping[str, tuple[str, int | None]] = {
    "disparity": ("disparity", None),
    "depth": ("depth", None),
    "U_X": ("velocity", 0),
    "U_Y": ("velocity", 1),
    "U_Z": ("velocity", 2),
    "growth": ("growth_rate", None),
}
COLUMNS = ("scene", "affine model, %", *QUANTITIES, "growth: error")
Array = NDArray[np.float64]


def inclined(axis: tuple[float, float, float], angle_deg: float) -> dict[str, Any]:
    """Return a sheet with 70 % of its growth along X, inclined about an axis."""
    plain = sheet(0.3, 0.7)
    plain["objects"][0]["pose"]["rotations"] = [{"axis": list(axis), "angle_deg": angle_deg}]
    return plain


CASES: Mapping[str, dict[str, Any]] = {
    "sheet 0.7": SCENES["sheet 0.7"],
    "saddle 0.9": SCENES["saddle 0.9"],
    "sheet 0.7, inclined at 45° to the direction of growth": inclined((1.0, 1.0, 0.0), 12.0),
    "leaf 0.7": SCENES["leaf 0.7"],
    "leaf 0.6, 0.1": SCENES["leaf 0.6, 0.1"],
}


def ratios(scene: dict[str, Any], noises: int) -> list[float]:
    """Return the share of pixels with the affine model in %, and the ratios of each quantity."""
    from scipy.stats import chi2

    ideal, whole = st.simulate(scene | {"sensor": "ideal"})
    truth, std = whole.sel(t=0), predict(scene, model="maps", method="refined").maps
    assert std is not None
    noise_std = float(scene["sensor"]["noise_std"])
    found = [st.estimate(add_noise(ideal, noise_std, "growth", k), "refined").sel(t=0) for k in range(noises)]
    inside = (truth["boundary_distance"].values >= EDGE_PX) & (truth["object_id"].values == 0)
    rows, columns = BORDER_PX
    border = np.ones_like(inside)
    border[rows:-rows, columns:-columns] = False
    valid = inside & ~border & np.all([each["status"].values == 2 for each in found], axis=0)
    models = np.array([each["motion_model"].values[valid] for each in found])
    cells = [100.0 * float(np.mean((models >= MOTION_AFFINE) & (models > MOTION_PLAIN)))]
    half = float(chi2.median(noises - 1) / (noises - 1))
    for name, component in QUANTITIES.values():

        def part(dataset: Any, variable: str, component: int | None = component) -> Array:
            values = dataset[variable].values
            return np.asarray(values if component is None else values[component], dtype=np.float64)

        values, predicted = np.array([part(each, name) for each in found]), part(std, f"{name}_std")
        kept = valid & np.isfinite(values).all(axis=0) & np.isfinite(predicted)
        scatter = np.sqrt(np.median(values.var(axis=0, ddof=1)[kept]) / half)
        cells.append(float(np.median(predicted[kept]) / scatter))
    error = (values - part(truth, name))[:, kept]
    return [*cells, float(np.sqrt(np.mean(predicted[kept] ** 2) / np.mean(error**2)))]


def main() -> None:
    """Print the table, scene by scene."""
    parser = arguments(__doc__)
    parser.add_argument("--noises", type=int, default=NOISES, help="recordings of each scene")
    given = parser.parse_args()
    print(heading(COLUMNS), flush=True)
    for name, cells in ends(ratios, {name: (scene, given.noises) for name, scene in CASES.items()}, given):
        print(line([name, f"{cells[0]:.0f}", *(f"{each:.2f}" for each in cells[1:])]), flush=True)


if __name__ == "__main__":
    main()
