"""Pictures of the fidelity of rendered images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from scenetruth.experiment.fidelity.results import Fidelity, Measurement

__all__ = ["draw_errors", "draw_maps"]

# Okabe and Ito's colours, with a marker each.
_STYLES = {"pyrender": ("#0072B2", "o"), "raycast": ("#D55E00", "s")}


def draw_errors(results: Sequence[Fidelity], file: Path) -> None:
    """Draw shift errors and grey-value errors over the number of samples, a column for each texture.

    Parameters
    ----------
    results
        The results.
    file
        Picture to write.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    textures = list(dict.fromkeys(result.texture for result in results))
    figure = Figure(figsize=(5.5 * len(textures), 8.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(textures), sharex=True, sharey="row", squeeze=False)
    for column, texture in enumerate(textures):
        above, below = axes[0][column], axes[1][column]
        chosen = [result for result in results if result.texture == texture]
        for backend in dict.fromkeys(result.backend for result in chosen):
            line = [result for result in chosen if result.backend == backend]
            colour, marker = _STYLES[backend.split()[0]]
            n = [result.supersampling for result in line]
            style: dict[str, Any] = {"color": colour, "marker": marker, "markersize": 5}
            above.plot(n, [result.rms_px for result in line], label=f"{backend}, rms", **style)
            above.plot(n, [result.max_px for result in line], label="largest", linestyle=":", **style)
            below.plot(n, [result.rms_grey for result in line], label=f"{backend}, rms", **style)
            for result in line:
                if result.bound_px is not None:
                    label = f"bound of rms, {backend.split()[0]}"
                    above.plot([2.8, 5.7], [result.bound_px] * 2, "--", color=colour, linewidth=2, label=label)
        shortest = chosen[0].shortest_wavelength_px
        above.set_title(f"{texture}: wavelengths from {shortest:g} px", loc="left", fontsize=11)
        below.set_xlabel("n, of n x n samples a pixel")
        for ax in (above, below):
            ax.set(xscale="log", yscale="log")
            ax.set_xticks(sorted({result.supersampling for result in results}))
            ax.get_xaxis().set_major_formatter("{x:g}")
            ax.minorticks_off()
            ax.grid(alpha=0.3)
            ax.legend(fontsize=9)
    axes[0][0].set_ylabel("shift error of 25 x 25 px subsets, px")
    axes[1][0].set_ylabel("grey-value error / std of the texture")
    figure.suptitle("Rendered images against the exact pixel integral", fontsize=12)
    figure.savefig(file, dpi=110, metadata={"Software": "scenetruth"})


def draw_maps(measured: Sequence[Measurement], file: Path) -> None:
    """Draw maps of the shift errors of the subsets with the band-limited texture, as rms over all shifts.

    Parameters
    ----------
    measured
        The measurements; a column for each number of samples, a row for each backend.
    file
        Picture to write.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    chosen = [one for one in measured if one.result.texture == "band-limited"]
    maps = {
        (one.result.backend, one.result.supersampling): np.sqrt(np.mean(one.errors_px**2, axis=(0, 3)))
        for one in chosen
    }
    backends, samplings = (list(dict.fromkeys(keys)) for keys in zip(*maps, strict=True))
    figure = Figure(figsize=(3.4 * len(samplings) + 1, 2.9 * len(backends) + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(backends), len(samplings), squeeze=False)
    norm = LogNorm(min(float(one.min()) for one in maps.values()), max(float(one.max()) for one in maps.values()))
    for row, backend in enumerate(backends):
        for column, n in enumerate(samplings):
            ax: Any = axes[row][column]
            shown = ax.imshow(maps[backend, n], norm=norm, cmap="viridis")
            ax.set_title(f"{backend}, {n} x {n}", fontsize=10)
            ax.set(xticks=[], yticks=[])
    figure.colorbar(shown, ax=axes, label="rms shift error over all shifts, px", shrink=0.9)
    figure.suptitle("Shift errors of each 25 x 25 px subset, wavelengths from 6 px", fontsize=12)
    figure.savefig(file, dpi=110, metadata={"Software": "scenetruth"})
