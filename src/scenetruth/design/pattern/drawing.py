"""A picture of patterns as the rig sees them, with their spectra."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from scenetruth.design.pattern.spectrum import NYQUIST, ring_means
from scenetruth.design.pattern.worth import Worth

__all__ = ["draw_worths"]

# Colours that colour-blind readers can tell apart (after Okabe and Ito).
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
_RINGS = 40


def draw_worths(file: Path, worths: Sequence[Worth]) -> None:
    """Draw what the rig sees of patterns, and the spectrum that lens and pixels leave.

    Parameters
    ----------
    file
        PNG file to write.
    worths
        The patterns.
    """
    import matplotlib.style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.style.context(["default", {"font.size": 9}]):
        figure = Figure(figsize=(3.2 * len(worths) + 5.0, 3.6), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(1, len(worths) + 1, width_ratios=[*[3.2] * len(worths), 5.0])
        for ax, worth in zip(axes[:-1], worths, strict=True):
            ax.imshow(worth.patch, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
            ax.set(title=worth.label, xlabel="x, px", ylabel="y, px")
        edges = np.linspace(0, 1.5 * NYQUIST, _RINGS + 1)
        middle = (edges[1:] + edges[:-1]) / 2
        for worth, colour in zip(worths, _COLOURS * len(worths), strict=False):
            density = ring_means(worth.spectrum, worth.optics, edges)
            # What a ring adds to the square of the gradient: its circumference, and (2 π f)² / 2 for one axis.
            adds = 4 * np.pi**3 * middle**3 * np.maximum(density, 0.0)
            axes[-1].plot(middle, adds, color=colour, label=worth.label)
        axes[-1].axvline(NYQUIST, color="0.5", linestyle=":", label="2 px")
        axes[-1].set(xlabel="spatial frequency, periods per px", ylabel="squared gradient per frequency")
        axes[-1].set(xlim=(0, edges[-1]), ylim=(0, None), title="what its waves give, through lens and pixels")
        axes[-1].legend(frameon=False)
        figure.savefig(file, dpi=110, metadata={"Software": "scenetruth"})
