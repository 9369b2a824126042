"""Measure how far predicted precision is from the scatter of estimates, over scenes drawn from a recipe.

Run it from the top of the repository: ``python -m benchmarks.predictions FOLDER [--scenes NUMBER ...]``. Each scene is
rendered once without noise; its own sensor then makes several recordings of it, with other noise and other fixed
patterns. Means and variances of their estimates are kept in the folder, a file per scene: a run that is cut short goes
on where it was. They are then held against both levels of `st.predict`, and a table and a plot are written there.

Of a few noises, the median of what is measured of a variance is less than the variance: it is divided by the median of
chi squared over its degrees of freedom. ``interior`` and ``object_NAME`` lie at least two standard deviations of the
window away from edges and from the image's border; ``border`` is what lies nearer to that. Regions count whose
estimates are known for half of their pixels, 100 at least. A region is unbiased in a quantity if what is left of the
mean error, median over pixels, is less than half of the scatter: the mean of so many noises scatters by the root of one
over their number, which is allowed for.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from benchmarks.jobs import heading, line
from scenetruth.benchmark.cases.case import mask_interior
from scenetruth.camera import LinearImage, build_sensor_chain
from scenetruth.design import predict
from scenetruth.random_streams import generator_for

Array = NDArray[np.float64]

SCENES = 30
NOISES: Mapping[str, int] = {"refined": 6, "structure_tensor": 16}
# Of the median over pixels of mean errors, in standard deviations.
MOST_BIAS = 0.5
FEWEST_PIXELS, LEAST_SHARE = 100, 0.5
QUANTITIES: Mapping[str, tuple[str, int | None]] = {
    "depth": ("depth", None),
    "disparity": ("disparity", None),
    "velocity_x": ("velocity", 0),
    "velocity_y": ("velocity", 1),
    "velocity_z": ("velocity", 2),
    "flow_x": ("flow", 0),
    "flow_y": ("flow", 1),
    "slope_x": ("slope", 0),
    "slope_y": ("slope", 1),
    "growth_rate": ("growth_rate", None),
}
COLUMNS = ("scene", "method", "region", "quantity", "measured", "bound", "envelope", "ratio", "ratio_envelope", "bias")


def recipe() -> dict[str, Any]:
    """Return the recipe: sheets, cubes, spheres and leaves, 0.4 to 0.6 mm per px, of any noise, texture and motion."""
    shapes: dict[str, tuple[dict[str, Any], float]] = {
        "sheet": ({"kind": "plane", "size_mm": [170, 140]}, 600),
        "cube": ({"kind": "box", "size_mm": [62, 62, 62]}, 640),
        "sphere": ({"kind": "sphere", "radius_mm": 70, "cap_deg": 60, "resolution_mm": 1.0}, 670),
        "leaf": (
            {"kind": "leaf", "length_mm": 95, "width_mm": 85, "bend_along_deg": -20, "fold_deg": 15},
            600,
        ),
    }
    bases = []
    for name, (mesh, depth) in shapes.items():
        thing = {
            "name": name,
            "mesh": mesh,
            "pose": {
                "position_mm": [-30 if name == "leaf" else 0, 0, depth],
                "rotations": [
                    {"axis": [0, 1, 0], "angle_deg": 45 if name == "cube" else 0},
                    {"axis": [1, 0, 0], "angle_deg": 0},
                ],
            },
            "texture": {"kind": "noise", "wavelength_mm": [2.5, 10]},
            "motion": [
                {"kind": "velocity", "velocity_mm_per_frame": [0, 0, 0]},
                {"kind": "rotation", "axis": [0, 0, 1], "rate_deg_per_frame": 0},
            ],
        }
        wall = {
            "name": "wall",
            "mesh": {"kind": "plane", "size_mm": [220, 180]},
            "pose": {"position_mm": [0, 0, 700]},
            "texture": {"kind": "noise", "wavelength_mm": [2.5, 10]},
        }
        camera = {"width": 160, "height": 120, "focal_length_px": 1200}
        plain = {"camera": camera, "stage": {"positions": 5, "baseline_mm": 5.0}, "frames": {"count": 5}}
        plain |= {"objects": [thing, wall], "render": {"backend": "raycast"}}
        bases.append(plain | {"sensor": {"noise_std": 0.01, "bit_depth": 8}})

    def uniform(low: float, high: float) -> dict[str, Any]:
        return {"kind": "uniform", "low": low, "high": high}

    tilt = "objects.0.pose.rotations"
    sensors = [
        {"noise_std": 0.004, "bit_depth": 10},
        {"noise_std": 0.008, "bit_depth": 8},
        {"noise_std": 0.015, "bit_depth": 8},
        {"kind": "emva1288", "preset": "scientific_cmos"},
        {"kind": "emva1288", "preset": "industrial_cmos"},
    ]
    return {
        "name": "predictions",
        "samples": SCENES,
        "seed": 16,
        "base": bases,
        "parameters": {"shortest_mm": uniform(2.2, 4.5), "longest": uniform(2.5, 5.0)},
        "distributions": {
            "objects.*.texture.wavelength_mm.0": "=shortest_mm",
            "objects.*.texture.wavelength_mm.1": "=shortest_mm * longest",
            "objects.*.texture.rms_contrast": uniform(0.08, 0.3),
            f"{tilt}.0.angle_deg": uniform(-30, 30),
            f"{tilt}.1.angle_deg": uniform(-30, 30),
            "objects.0.motion.0.velocity_mm_per_frame.0": uniform(-0.3, 0.3),
            "objects.0.motion.0.velocity_mm_per_frame.1": uniform(-0.3, 0.3),
            "objects.0.motion.0.velocity_mm_per_frame.2": uniform(-0.6, 0.6),
            "objects.0.motion.1.rate_deg_per_frame": uniform(-0.2, 0.2),
            "stage.baseline_mm": uniform(1.0, 8.0),
            "stage.positions": {"kind": "choice", "values": [3, 5, 7]},
            "optics.psf": {"kind": "choice", "values": [None, {"kind": "gaussian", "sigma_px": 0.6}]},
            "shutter.exposure_time_s": {"kind": "choice", "values": [0.0, 0.5]},
            "sensor": {"kind": "choice", "values": sensors},
        },
    }


def scene_of(number: int) -> dict[str, Any]:
    """Return the plain values of a scene: a cube shows an edge, and windows differ from scene to scene."""
    plain = dict(st.Recipe.from_dict(recipe()).sampler().draw(number).plain)
    if plain["objects"][0]["name"] == "cube":
        plain["objects"][0]["pose"]["rotations"][0]["angle_deg"] += 45
    plain["score"] = {**plain["score"], "interior_margin_px": 2 * window_of(number) + 1}
    return plain


def window_of(number: int) -> float:
    """Return the standard deviation of the window for a scene, in px."""
    return (3.0, 4.0, 6.0)[number % 3]


def recordings(ideal: xr.Dataset, sensor: Any, count: int) -> Iterator[xr.Dataset]:
    """Give recordings of the same linear images by a sensor, each with noise and patterns of its own."""
    chain, images = build_sensor_chain(sensor), ideal["image"]
    size = images.shape[-2:]
    for seed in range(count):
        opened = chain.open(size, partial(generator_for, 1000 + seed, "sensor"))
        taken = np.empty(images.shape, dtype=chain.dtype)
        for k, s in enumerate(images["s"].values.tolist()):
            for n, t in enumerate(images["t"].values.tolist()):
                taken[k, n] = opened.read(LinearImage(images.values[k, n], 0, s, t))
        found = ideal.assign(image=(images.dims, taken, images.attrs))
        found.attrs = {**ideal.attrs, "full_scale": float(chain.full_scale)}
        found.attrs.pop("recording_hash", None)
        yield found


def measured(number: int, folder: Path) -> Mapping[str, Array]:
    """Estimate a scene with several noises; return mean and variance of what is found, from a file if it is there.

    Returns
    -------
    dict
        ``METHOD/QUANTITY/mean``, ``/variance`` (n - 1 degrees of freedom), ``truth/QUANTITY``, ``object_id`` and
        ``boundary_distance``, each of shape (y, x).
    """
    file = folder / f"scene_{number:02d}.npz"
    if file.is_file():
        return dict(np.load(file))
    scene = st.Scene.from_dict(scene_of(number))
    ideal, whole = st.simulate(scene.model_copy(update={"sensor": "ideal"}), truth_content="complete")
    truth, sigma = whole.sel(t=0), window_of(number)
    kept = {name: truth[name].values for name in ("object_id", "boundary_distance")}
    kept |= {f"truth/{name}": _part(truth, *place) for name, place in QUANTITIES.items()}
    for method, count in NOISES.items():
        settings: dict[str, Any] = {"window_sigma_px": sigma}
        if method == "structure_tensor":
            settings |= {"window_taps_px": 4 * round(sigma) + 1, "tau": "auto"}
        estimates = [st.estimate(each, method, settings) for each in recordings(ideal, scene.sensor, count)]
        if any(0 not in one["t"].values for one in estimates):
            continue
        estimates = [one.sel(t=0) for one in estimates]
        # What is told without a standard deviation is where a fit would have started.
        fitted = np.array([np.isfinite(_part(one, "depth_std", None)) for one in estimates])
        for quantity, place in QUANTITIES.items():
            if any(place[0] not in one for one in estimates):
                continue
            values = np.where(fitted, np.array([_part(one, *place) for one in estimates]), np.nan)
            kept[f"{method}/{quantity}/mean"] = values.mean(axis=0)
            kept[f"{method}/{quantity}/variance"] = values.var(axis=0, ddof=1)
    aside = file.with_suffix(".part.npz")
    np.savez_compressed(aside, **kept)
    aside.rename(file)
    return kept


def compared(number: int, folder: Path) -> list[list[Any]]:
    """Return rows of a scene: what is measured and predicted, by method, region and quantity."""
    from scipy.stats import chi2

    kept, sigma = measured(number, folder), window_of(number)
    scene = st.Scene.from_dict(scene_of(number))
    body, margin = kept["object_id"], scene.score.interior_margin_px
    # Near the image's border windows are cut, and not all images show what the reference does.
    border = ~mask_interior(xr.Dataset(coords={"y": range(body.shape[0]), "x": range(body.shape[1])}), margin)
    inside = (kept["boundary_distance"] >= margin) & ~border
    regions = {"all": body >= 0, "interior": inside & (body >= 0)}
    regions["border"] = border & (kept["boundary_distance"] >= margin) & (body >= 0)
    regions |= {f"object_{item.name}": inside & (body == k) for k, (_, item) in enumerate(scene.parts)}
    found: list[list[Any]] = []
    for method, count in NOISES.items():
        envelope, bound = (
            predict(scene, model=model, method=method, window_sigma_px=sigma) for model in ("analytic", "maps")
        )
        assert bound.maps is not None
        half = chi2.median(count - 1) / (count - 1)
        for quantity, (variable, component) in QUANTITIES.items():
            name = f"{method}/{quantity}"
            if f"{variable}_std" not in bound.maps or f"{name}/mean" not in kept:
                continue
            variance, std = kept[f"{name}/variance"], _part(bound.maps, f"{variable}_std", component)
            error = kept[f"{name}/mean"] - kept[f"truth/{quantity}"]
            for region, mask in regions.items():
                known = mask & np.isfinite(variance) & np.isfinite(std)
                if region not in (*envelope.regions, "border") or known.sum() < max(
                    FEWEST_PIXELS, LEAST_SHARE * mask.sum()
                ):
                    continue
                scatter = float(np.sqrt(np.median(variance[known]) / half))
                ratio = float(1 / np.sqrt(np.median(variance[known] / std[known] ** 2) / half))
                told = float("nan") if region == "border" else envelope.precision(quantity, region).std
                # The median of |x| of a normal x is 0.674 of its standard deviation.
                bias = float(np.median(np.abs(error[known])) / 0.674 / scatter)
                left = float(np.sqrt(max(bias**2 - 1 / count, 0.0)))
                middle = float(np.median(std[known]))
                found.append([number, method, region, quantity, scatter, middle, told, ratio, told / scatter, left])
    return found


def _part(dataset: xr.Dataset, variable: str, component: int | None) -> Array:
    values = dataset[variable].values
    return np.asarray(values if component is None else values[component], dtype=np.float64)


def summary(rows: Sequence[Sequence[Any]]) -> Iterator[list[Any]]:
    """Give medians of predicted over measured, and how many regions lie within 10 %, 25 % and 30 % of it."""
    for method in NOISES:
        for quantity in ("all", *QUANTITIES):
            for region in ("all", "interior", "object", "border"):
                some = [
                    row
                    for row in rows
                    if row[1] == method and quantity in ("all", row[3]) and row[2].startswith(region)
                ]
                for name, chosen in (("unbiased", [row for row in some if row[9] <= MOST_BIAS]), ("any", some)):
                    if not chosen:
                        continue
                    bound, envelope = (np.array([row[k] for row in chosen]) for k in (7, 8))
                    yield [
                        method,
                        quantity,
                        region,
                        name,
                        len(chosen),
                        f"{np.median(bound):.3f}",
                        f"{np.mean(np.abs(bound - 1) <= 0.25):.2f}",
                        f"{np.median(envelope):.3f}",
                        f"{np.median(np.abs(envelope - 1)):.2f}",
                    ]


def plot(rows: Sequence[Sequence[Any]], file: Path) -> None:
    """Draw predicted over measured scatter, of the interior's objects."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import NullFormatter

    shown = {"depth": "mm", "velocity_x": "mm/frame", "velocity_z": "mm/frame", "growth_rate": "1/frame"}
    figure, axes = plt.subplots(2, len(shown), figsize=(4 * len(shown), 8), layout="constrained")
    for down, (method, label) in enumerate((("refined", "refined"), ("structure_tensor", "structure tensor"))):
        for axis, (quantity, unit) in zip(axes[down], shown.items(), strict=True):
            some = [row for row in rows if row[1] == method and row[3] == quantity and row[2].startswith("object")]
            axis.set_title(f"{quantity}, {label}")
            if not some:
                axis.set_axis_off()
                continue
            for column, colour, name in ((6, "tab:orange", "envelope"), (5, "tab:blue", "bound")):
                for biased, marker in ((False, "o"), (True, "x")):
                    points = [(row[4], row[column]) for row in some if (row[9] > MOST_BIAS) == biased]
                    if points:
                        told = f"{name}{', biased' if biased else ''}"
                        axis.loglog(*zip(*points, strict=True), marker, color=colour, label=told, ms=5, alpha=0.8)
            ends_of = np.array([min(row[4] for row in some), max(row[4] for row in some)])
            axis.loglog(ends_of, ends_of, "k-", lw=0.8)
            axis.fill_between(ends_of, 0.75 * ends_of, 1.25 * ends_of, color="0.85", zorder=0, label="± 25 %")
            for each in (axis.xaxis, axis.yaxis):
                each.set_minor_formatter(NullFormatter())
            axis.set_xlabel(f"measured scatter, {unit}")
            axis.set_ylabel(f"predicted, {unit}")
            axis.legend(fontsize=7)
    figure.savefig(file, dpi=110)


def main() -> None:
    """Print the tables, scene by scene, and write the plot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="where measurements are kept, and the plot is written")
    parser.add_argument("--scenes", type=int, nargs="+", default=range(SCENES), help="only these")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore")
    rows: list[list[Any]] = []
    print(heading(COLUMNS), flush=True)
    for number in given.scenes:
        some = compared(number, given.folder)
        rows += some
        for row in some:
            if row[2] == "interior":
                print(line([f"{cell:.3g}" if isinstance(cell, float) else cell for cell in row]), flush=True)
    columns = ("method", "quantity", "regions", "which", "number", "bound / measured", "within 25 %", "envelope")
    print(heading((*columns, "its deviation")))
    for cells in summary(rows):
        print(line(cells))
    plot(rows, given.folder / "predictions.png")


if __name__ == "__main__":
    main()
