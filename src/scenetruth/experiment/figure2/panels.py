"""The six panels of the paper's figure 2."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from scenetruth.experiment.figure2.points import Result

__all__ = ["draw_panels"]

_ROWS = (
    ("U_X", "velocity $U_X$", "rel. error of $U_X$"),
    ("U_Z", "velocity $U_Z$", "rel. error of $U_Z$"),
    ("V_X", "camera distance $V_X$", "rel. error of $Z$"),
)
# What the paper states of its panels without noise: up to this value, an error below this.
_BOUNDS = {"U_X": ((4.0, 3e-4),), "U_Z": ((0.1, 3e-3), (1.0, 3e-2)), "V_X": ((4.0, 3e-4),)}
_NOISE_BAND = (1e-3, 1e-2)
# Okabe and Ito's colours, with a marker each.
_STYLES = {4: ("#0072B2", "o"), 8: ("#D55E00", "s"), 16: ("#009E73", "^"), 32: ("#CC79A7", "D")}


def draw_panels(results: Sequence[Result], file: Path, divergence: str) -> None:
    """Draw errors over values, log-log: without noise on the left, with noise on the right, a row for each quantity.

    Parameters
    ----------
    results
        The points of the figure.
    file
        Picture to write.
    divergence
        Setting of the estimator, for the title.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    noises = sorted({result.noise_std for result in results})
    figure = Figure(figsize=(11, 12), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(_ROWS), len(noises), sharey="row", squeeze=False)
    for row, (quantity, across, up) in enumerate(_ROWS):
        for column, noise in enumerate(noises):
            ax: Any = axes[row][column]
            chosen = [result for result in results if (result.quantity, result.noise_std) == (quantity, noise)]
            _draw_panel(ax, chosen, noise > 0)
            _draw_bounds(ax, quantity, min(result.value for result in chosen), noise > 0)
            ax.set(xscale="log", yscale="log", ylim=(1e-6, 3), xlabel=across, ylabel=up if column == 0 else None)
            ax.set_title(f"{'abcdef'[2 * row + column]}   $\\sigma_n$ = {noise:g}", loc="left", fontsize=11)
            ax.grid(alpha=0.3)
    axes[0][0].legend(fontsize=9, loc="upper left", ncols=2)
    axes[0][-1].legend(fontsize=9, loc="upper right")
    figure.suptitle(
        "Relative errors on the translating pattern (eq. 13); median of phases without noise, rms of runs with noise\n"
        f"divergence: {divergence}. Points are left out where no run gave a full estimate.",
        fontsize=11,
    )
    figure.savefig(file, dpi=110, metadata={"Software": "scenetruth"})


def _draw_panel(ax: Any, results: Sequence[Result], noisy: bool) -> None:
    for wavelength, (colour, marker) in _STYLES.items():
        line = [result for result in results if result.wavelength_px == wavelength and result.full > 0]
        errors = [result.rms_relative_error if noisy else result.median_relative_error for result in line]
        ax.plot(
            [result.value for result in line],
            errors,
            color=colour,
            marker=marker,
            markersize=4,
            linewidth=1.2,
            label=f"λ = {wavelength} px" if not noisy else None,
        )


def _draw_bounds(ax: Any, quantity: str, least: float, noisy: bool) -> None:
    if noisy:
        ax.axhspan(
            *_NOISE_BAND, color="#999999", alpha=0.25, linewidth=0, label="paper: wide ranges within 0.1 % to 1 %"
        )
        return
    label: str | None = "paper's bound"
    for limit, bound in _BOUNDS[quantity]:
        ax.plot([least, limit], [bound, bound], color="black", linewidth=2, linestyle="--", label=label)
        least, label = limit, None
