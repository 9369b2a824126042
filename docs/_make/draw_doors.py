"""Draw the small pictures of the README: a data set, the accuracy of methods, a rig.

Run ``python docs/_make/draw_doors.py``.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import scenetruth as st
from scenetruth.design.optimisation.report.side_view import draw_side_views
from scenetruth.design.optimisation.report.side_view_geometry import compute_side_view

DOCS = Path(__file__).parents[1]
RECIPE = DOCS.parent / "scenes" / "datasets" / "leaves.yaml"
RIG = DOCS / "results" / "worked_examples" / "leaf_growth_rig.yaml"
SAMPLES = (0, 4, 7, 9, 12)
METHODS = {"structure_tensor": "structure tensor", "refined": "refined", "opencv_scene_flow": "OpenCV"}
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
    """Draw a recommended rig to scale."""
    drawing = draw_side_views(compute_side_view(st.load_scene(RIG).to_dict(), 1.5, "object_leaf"))[0]
    svg = drawing.svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    start = svg.index(">") + 1
    (DOCS / "door_design.svg").write_text(svg[:start] + STYLE + svg[start:], encoding="utf-8")


if __name__ == "__main__":
    data_set()
    accuracy()
    rig()
