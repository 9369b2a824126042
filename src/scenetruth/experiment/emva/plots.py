"""The photon transfer curve and the linearity of a measured sensor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from scenetruth.camera import EmvaSensor, PhotonTransfer

__all__ = ["draw_transfer"]

_MEASURED, _TOLD = "#0072B2", "#D55E00"


def draw_transfer(name: str, sensor: EmvaSensor, found: PhotonTransfer, file: Path) -> None:
    """Draw variance over mean, mean over photons and the deviation from a line, as measured and as set.

    Parameters
    ----------
    name
        Title of the picture.
    sensor
        What was measured.
    found
        Its measurement.
    file
        Picture to write.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 3)
    _draw_variance(axes[0], sensor, found)
    _draw_response(axes[1], sensor, found)
    _draw_linearity(axes[2], sensor, found)
    for ax in axes:
        ax.locator_params(axis="x", nbins=5)
        ax.grid(alpha=0.3)
    title = (
        f"{name}: K = {found.gain_dn_per_e:.4g} DN/e-, σ_d = {found.temporal_dark_noise_e:.3g} e-, "
        f"DSNU = {found.dsnu_e:.3g} e-, PRNU = {100 * found.prnu:.3g} %, saturation = {found.saturation_e:.5g} e-"
    )
    figure.suptitle(title, fontsize=11)
    figure.savefig(file, dpi=110, metadata={"Software": "scenetruth"})


def _draw_variance(ax: Any, sensor: EmvaSensor, found: PhotonTransfer) -> None:
    ax.plot(found.mean_dn, found.variance_dn2, "o", color=_MEASURED, markersize=4, label="measured")
    ends = np.array([0.0, found.mean_dn.max()])
    ax.plot(ends, sensor.gain_dn_per_e * ends, color=_TOLD, linewidth=1.2, label="told: K times mean")
    ax.set(
        xlabel="mean - dark, DN",
        ylabel="temporal variance - dark, DN²",
        title="photon transfer, up to and beyond saturation",
    )
    ax.legend(fontsize=9)


def _draw_response(ax: Any, sensor: EmvaSensor, found: PhotonTransfer) -> None:
    ax.plot(found.photons, found.mean_dn, "o", color=_MEASURED, markersize=4, label="measured")
    ends = np.array([0.0, sensor.saturation_capacity_e / sensor.quantum_efficiency])
    responsivity = sensor.gain_dn_per_e * sensor.quantum_efficiency
    ax.plot(ends, responsivity * ends, color=_TOLD, linewidth=1.2, label="told: K η photons")
    saturation = found.saturation_e * found.gain_dn_per_e
    ax.axhline(saturation, color="#999999", linestyle="--", linewidth=1, label="saturation, measured")
    ax.set(xlabel="photons per pixel", ylabel="mean - dark, DN", title="response")
    ax.legend(fontsize=9)


def _draw_linearity(ax: Any, sensor: EmvaSensor, found: PhotonTransfer) -> None:
    told = sensor.gain_dn_per_e * sensor.quantum_efficiency * found.photons
    ax.plot(found.photons, 100 * (found.mean_dn / told - 1), "o", color=_MEASURED, markersize=4)
    ax.axhspan(-0.1, 0.1, color="#999999", alpha=0.25, linewidth=0, label="± 0.1 %")
    ax.set(xlabel="photons per pixel", ylabel="mean / told - 1, %", ylim=(-0.2, 0.2), title="deviation from the line")
    ax.legend(fontsize=9)
