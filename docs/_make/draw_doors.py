"""Draw the small pictures of the README: a data set, the accuracy of methods, a rig, a capture.

Run ``python docs/_make/draw_doors.py``.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.capture import region_mean, run_capture, simulate_capture
from scenetruth.design.optimisation.report.side_view import draw_side_views
from scenetruth.design.optimisation.report.side_view_geometry import compute_side_view

DOCS = Path(__file__).parents[1]
RECIPE = DOCS.parent / "scenes" / "datasets" / "leaves.yaml"
RIG = DOCS / "results" / "worked_examples" / "leaf_growth_rig.yaml"
# What the recommended rig of the design page changes: its file differs from the stored one of an earlier search.
RECOMMENDED = {
    "camera.focal_length_mm": 16.4398,
    "optics.defocus.aperture_mm": 7.801,
    "optics.defocus.focus_distance_mm": 598.0807,
    "stage.baseline_mm": 11.52,
}
SAMPLES = (0, 4, 7, 9, 12)
METHODS = {"structure_tensor": "structure tensor", "refined": "refined", "opencv_scene_flow": "OpenCV"}
LEAF = {
    "name": "leaf",
    "mesh": {"kind": "leaf", "outline": "ovate", "length_mm": 46, "width_mm": 30, "bend_along_deg": -20},
    "texture": {"kind": "leaf"},
    "pose": {"position_mm": [-20, 0, 600]},
    "deformation": [{"kind": "growth", "rate_per_hour": 0.03, "base_to_tip": [1.6, 0.4]}],
}
SOIL = {
    "name": "soil",
    "mesh": {"kind": "plane", "size_mm": [140, 110]},
    "pose": {"position_mm": [0, 0, 630]},
    "texture": {"kind": "noise", "wavelength_mm": [1.5, 8.0], "mean": 0.3, "rms_contrast": 0.3},
}
LABORATORY = {
    "camera": {"width": 256, "height": 192, "focal_length_px": 2400, "distortion": {"k1": -0.4}},
    "optics": {"psf": {"kind": "gaussian", "sigma_px": 0.6}},
    "stage": {"positions": 5, "baseline_mm": 5.0, "axis_tilt_urad": [800, -1500], "errors": {"preset": "screw_stage"}},
    "frames": {"count": 5, "frame_interval_s": 600},
    "objects": [LEAF, SOIL],
    "sensor": {"kind": "emva1288", "preset": "scientific_cmos"},
    "seed": 4,
}
PARTS_MM = [(-18.0, -8.0), (-8.0, 8.0), (8.0, 20.0)]
INK, ACCENT, SHARP = "#1b1f24", "#0072b2", "#009e73"
STYLE = f"""<style>
svg {{ background: #fff }} text {{ fill: {INK}; font: 13px "DejaVu Sans", sans-serif }}
.field {{ fill: {ACCENT}; opacity: .13 }} .common {{ fill: {ACCENT}; opacity: .2 }}
.border {{ stroke: {ACCENT}; stroke-dasharray: 5 4; opacity: .6 }}
.axis {{ stroke: #667; stroke-dasharray: 12 4 2 4 }} .sharp {{ fill: {SHARP}; opacity: .17 }}
.focus {{ stroke: {SHARP}; stroke-width: 1.5; stroke-dasharray: 3 3 }}
.outline {{ fill-opacity: .35; stroke-width: 2; stroke-linejoin: round }}
.camera {{ fill: #fff; stroke: {INK}; stroke-width: 1.2 }} .reference {{ fill: {INK} }}
.rail {{ stroke: #667; stroke-width: 4 }} .size {{ stroke: {INK} }} .bar {{ stroke: {INK}; stroke-width: 2 }}
.thin {{ stroke: #667; stroke-width: .7 }} .head {{ fill: {INK}; stroke: none }}
</style>"""


def data_set() -> None:
    """Draw samples of a recipe: camera images and growth rate."""
    draws = st.load_recipe(RECIPE).sampler()
    figure, axes = plt.subplots(2, len(SAMPLES), figsize=(4.6, 1.6), layout="constrained")
    for column, number in enumerate(SAMPLES):
        plain = draws.draw(number).scene().to_dict()
        plain["frames"]["count"] = plain["stage"]["positions"] = 1
        plain["render"]["backend"] = "raycast"
        recording, truth = st.simulate(st.Scene.from_dict(plain))
        growth = 60 * 100 * truth["growth_rate"].sel(t=0).values
        axes[0, column].imshow(recording["image"].sel(s=0, t=0), cmap="gray")
        shown = axes[1, column].imshow(np.where(growth > 0, growth, np.nan), cmap="magma", vmin=0, vmax=5)
    for each in axes.flat:
        each.set_axis_off()
    figure.colorbar(shown, ax=axes[1], shrink=0.9, label="%/h")
    figure.savefig(DOCS / "door_data_set.png", dpi=150)


def accuracy() -> None:
    """Draw the error of disparity over image noise for each method, and the Cramér-Rao bound."""
    found = st.compare(list(METHODS), cases=["noise"]).to_dataframe()
    told = found[(found.case == "noise") & (found.quantity == "disparity") & (found.statistic == "noise_std")]
    figure, axes = plt.subplots(figsize=(4.6, 2.3), layout="constrained")
    for method, own in told.groupby("method"):
        own = own.sort_values("value")
        bound = method not in METHODS
        style = {"color": INK, "linestyle": "--", "label": "Cramér-Rao bound"} if bound else {"marker": "o"}
        axes.loglog(100 * own["level"], own["value"], **{"label": METHODS.get(str(method)), **style})
    axes.set_xticks(ticks := [0.5, 1, 2], [f"{tick:g}" for tick in ticks])
    axes.xaxis.set_minor_formatter("")
    axes.set(xlabel="noise of the images, % of full scale", ylabel="error of disparity, px")
    axes.legend(fontsize=8)
    figure.savefig(DOCS / "door_accuracy.png", dpi=150)


def rig() -> None:
    """Draw a recommended rig to scale, upright: its labels are legible on a phone."""
    drawings = draw_side_views(
        compute_side_view(st.load_scene(RIG, overrides=RECOMMENDED).to_dict(), 1.5, "object_leaf")
    )
    drawing = next(each for each in drawings if each.shown == "narrow")
    svg = drawing.svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    start = svg.index(">") + 1
    (DOCS / "door_design.svg").write_text(svg[:start] + STYLE + svg[start:], encoding="utf-8")


def capture() -> None:
    """Draw a board of a simulated capture, the measured growth, and its means with error bars and the truth."""
    with tempfile.TemporaryDirectory() as folder:
        lab = Path(folder) / "lab"
        simulate_capture(LABORATORY, lab, poses=8, exposures=[0.25, 0.5, 1])
        run = run_capture(lab, Path(folder) / "results")
        board = plt.imread(lab / "board" / "p01_s+0.tif")
        estimate = st.open_store(run.folder.path / "estimate.zarr").load()
        truth = st.open_store(lab / "truth" / "truth.zarr").load()
    hourly = 100 * 3600 / estimate.attrs["frame_interval_s"]
    now, exact = estimate.sel(t=0), truth.sel(t=0)
    leaf = (now.valid & (now.depth < 616)).values
    certain = leaf & (hourly * now.growth_rate_std < 1.5).values
    figure, axes = plt.subplots(1, 3, figsize=(4.6, 1.6), layout="constrained", width_ratios=[1, 1.25, 0.9])
    axes[0].imshow(board, cmap="gray")
    shown = axes[1].imshow(hourly * now.growth_rate.where(certain), cmap="magma", vmin=0, vmax=6)
    figure.colorbar(shown, ax=axes[1], shrink=0.8, label="%/h")
    for each in axes[:2]:
        each.set_axis_off()
    for place, limits in enumerate(PARTS_MM):
        region = certain & _is_across(estimate, limits)
        mean = region_mean(estimate, "growth_rate", region)
        axes[2].errorbar(place, hourly * mean.value, yerr=hourly * mean.std, fmt="o", ms=4, color=ACCENT, capsize=3)
        true = exact.growth_rate.where((exact.object_id == 0) & _is_across(truth, limits))
        axes[2].plot(place, hourly * float(true.mean()), "_", color=INK, ms=18)
    axes[2].set(xlim=(-0.6, 2.6), ylim=(0, 6))
    axes[2].set_xticks([0, 2], ["base", "tip"])
    figure.savefig(DOCS / "door_capture.png", dpi=150)


def _is_across(data: xr.Dataset, limits_mm: tuple[float, float]) -> NDArray[np.bool_]:
    """Return the pixels whose surface has X between two limits at the reference frame."""
    camera = data.attrs
    x_mm = data.depth.sel(t=0) * (data.x - camera["principal_point_px"][0]) / camera["focal_length_px"]
    return np.asarray((x_mm > limits_mm[0]) & (x_mm < limits_mm[1]))


if __name__ == "__main__":
    data_set()
    accuracy()
    rig()
    capture()
