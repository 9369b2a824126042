"""A simulated EMVA 1288 measurement of sensors, compared with their nominal values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import PRESETS, EmvaSensor, LinearImage, PhotonTransfer, photon_transfer
from scenetruth.errors import Problem, SceneError
from scenetruth.progress import Progress
from scenetruth.random_streams import generator_for

__all__ = ["SensorComparison", "compare_with_settings", "measure_sensor", "run_emva"]


_MEASURED, _NOMINAL = "#0072B2", "#D55E00"


def draw_transfer(name: str, sensor: EmvaSensor, found: PhotonTransfer, file: Path) -> None:
    """Draw variance over mean, mean over photons and the linearity error, measured and nominal."""
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
    ax.plot(ends, sensor.gain_dn_per_e * ends, color=_NOMINAL, linewidth=1.2, label="nominal: K times mean")
    ax.set(
        xlabel="mean - dark, DN",
        ylabel="temporal variance - dark, DN²",
        title="photon transfer, including saturation",
    )
    ax.legend(fontsize=9)


def _draw_response(ax: Any, sensor: EmvaSensor, found: PhotonTransfer) -> None:
    ax.plot(found.photons, found.mean_dn, "o", color=_MEASURED, markersize=4, label="measured")
    ends = np.array([0.0, sensor.saturation_capacity_e / sensor.quantum_efficiency])
    responsivity = sensor.gain_dn_per_e * sensor.quantum_efficiency
    ax.plot(ends, responsivity * ends, color=_NOMINAL, linewidth=1.2, label="nominal: K η photons")
    saturation = found.saturation_e * found.gain_dn_per_e
    ax.axhline(saturation, color="#999999", linestyle="--", linewidth=1, label="measured saturation")
    ax.set(xlabel="photons per pixel", ylabel="mean - dark, DN", title="response")
    ax.legend(fontsize=9)


def _draw_linearity(ax: Any, sensor: EmvaSensor, found: PhotonTransfer) -> None:
    values = sensor.gain_dn_per_e * sensor.quantum_efficiency * found.photons
    ax.plot(found.photons, 100 * (found.mean_dn / values - 1), "o", color=_MEASURED, markersize=4)
    ax.axhspan(-0.1, 0.1, color="#999999", alpha=0.25, linewidth=0, label="± 0.1 %")
    ax.set(xlabel="photons per pixel", ylabel="mean / nominal - 1, %", ylim=(-0.2, 0.2), title="linearity error")
    ax.legend(fontsize=9)


SHAPE = (300, 400)
LEVELS = 24
STACK = 16
_SEED = 1288
_SHORTEST_S = 1e-6
# Far beyond saturation for every pixel, independent of its sensitivity.
_OVEREXPOSURE = 3.0
_BEYOND = (1.0, 1.02, 1.05, 1.1, 1.2)


@dataclass(frozen=True)
class SensorComparison:
    """A nominal (``nominal``) and a measured sensor parameter; ``linearity_error`` has the nominal value 0.

    ``error``: ``measured / nominal - 1``, or ``measured`` where ``nominal`` is 0.
    """

    sensor: str
    quantity: str
    nominal: float
    measured: float
    error: float


def measure_sensor(
    sensor: EmvaSensor, *, shape: tuple[int, int] = SHAPE, levels: int = LEVELS, stack: int = STACK, name: str = ""
) -> PhotonTransfer:
    """Expose a sensor to uniform light, and measure it by the photon transfer method."""
    operated = sensor.model_copy(update={"gamma": 1.0, "bayer": None, "insert": ()})
    shortest = operated.model_copy(update={"exposure_time_s": min(_SHORTEST_S, operated.exposure_time_s)})
    shares = np.append(np.linspace(0.02, 0.96, levels), _BEYOND)
    bright = operated.photon_rate_per_s * operated.exposure_time_s
    saturation = operated.saturation_capacity_e / operated.quantum_efficiency

    def expose(camera: EmvaSensor, share: float, count: int, place: int) -> NDArray[np.generic]:
        opened = camera.chain().open(shape, partial(_generator, name))
        uniform = np.full(shape, share * saturation / bright, dtype=np.float32)
        # Every stack is a separate camera position with independent noise.
        return np.stack([opened.read(LinearImage(uniform, s=place, t=number)) for number in range(count)])

    # Radiance is float32, as in every image; the photons are rounded equally.
    photons = np.float64(np.float32(shares * saturation / bright)) * bright
    return photon_transfer(
        photons,
        np.stack([expose(operated, float(share), 2, index) for index, share in enumerate(shares)]),
        dark=expose(operated, 0.0, stack, shares.size),
        bias=expose(shortest, 0.0, stack, shares.size + 1),
        flat=expose(operated, 0.5, stack, shares.size + 2),
        saturated=expose(operated, _OVEREXPOSURE, 2, shares.size + 3),
    )


def compare_with_settings(name: str, sensor: EmvaSensor, found: PhotonTransfer) -> list[SensorComparison]:
    """Compare the measured parameters of a sensor with the nominal values."""
    values = {
        "gain_dn_per_e": (sensor.gain_dn_per_e, found.gain_dn_per_e),
        "temporal_dark_noise_e": (sensor.temporal_dark_noise_e, found.temporal_dark_noise_e),
        "dsnu_e": (sensor.dsnu_e, found.dsnu_e),
        "prnu": (sensor.prnu, found.prnu),
        "quantum_efficiency": (sensor.quantum_efficiency, found.quantum_efficiency),
        "saturation_capacity_e": (sensor.saturation_capacity_e, found.saturation_e),
        "linearity_error": (0.0, found.linearity_error),
    }
    return [
        SensorComparison(name, quantity, value, measured, measured / value - 1 if value else measured)
        for quantity, (value, measured) in values.items()
    ]


def run_emva(folder: Path, presets: Sequence[str] = (), *, progress: Progress | None = None) -> list[SensorComparison]:
    """Measure presets; write ``emva.csv``, ``emva_levels.csv`` and a figure of each preset, ``<name>.png``."""
    names = list(presets or PRESETS)
    message = f"no such preset; available: {', '.join(PRESETS)}"
    unknown = [Problem("--preset", message, name) for name in names if name not in PRESETS]
    if unknown:
        raise SceneError(unknown)

    folder.mkdir(parents=True, exist_ok=True)
    found: dict[str, PhotonTransfer] = {}
    comparisons: list[SensorComparison] = []
    for done, name in enumerate(names):
        if progress is not None:
            progress("sensors", done, len(names))
        sensor = EmvaSensor.model_validate({"kind": "emva1288", "preset": name})
        found[name] = measure_sensor(sensor, name=name)
        comparisons += compare_with_settings(name, sensor, found[name])
        draw_transfer(name, sensor, found[name], folder / f"{name}.png")
    if progress is not None:
        progress("sensors", len(names), len(names))
    _write_csv(comparisons, found, folder)
    return comparisons


def _generator(name: str, *purpose: str | int) -> np.random.Generator:
    return generator_for(_SEED, "emva", name, *purpose)


def _write_csv(comparisons: Sequence[SensorComparison], found: Mapping[str, PhotonTransfer], folder: Path) -> None:
    import pandas as pd

    pd.DataFrame(comparisons).to_csv(folder / "emva.csv", index=False)
    levels = [
        {"sensor": name, "photons": photons, "mean_dn": mean, "variance_dn2": variance}
        for name, one in found.items()
        for photons, mean, variance in zip(one.photons, one.mean_dn, one.variance_dn2, strict=True)
    ]
    pd.DataFrame(levels).to_csv(folder / "emva_levels.csv", index=False)
