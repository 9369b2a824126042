"""A virtual EMVA 1288 measurement of sensors, which compares measured figures with the ones that were set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import PRESETS, EmvaSensor, LinearImage, PhotonTransfer, photon_transfer
from scenetruth.errors import Problem, SceneError
from scenetruth.experiment.tables import write_table
from scenetruth.progress import Progress
from scenetruth.randomness import generator_for

__all__ = ["Comparison", "compare", "measure_sensor", "run_emva"]

SHAPE = (300, 400)
LEVELS = 24
STACK = 16
_SEED = 1288
_SHORTEST_S = 1e-6
# Far beyond saturation for every pixel, whatever its sensitivity.
_OVEREXPOSURE = 3.0
_BEYOND = (1.0, 1.02, 1.05, 1.1, 1.2)


@dataclass(frozen=True)
class Comparison:
    """A figure of a sensor as it was set, and as it was measured.

    Parameters
    ----------
    sensor
        Name of the sensor.
    quantity
        Name of the figure; ``linearity_error`` is 0 as set.
    told
        Value that was set, in the sensor's fields.
    measured
        Value that was measured.
    error
        measured / told - 1, or measured where ``told`` is 0.
    """

    sensor: str
    quantity: str
    told: float
    measured: float
    error: float


def measure_sensor(
    sensor: EmvaSensor, *, shape: tuple[int, int] = SHAPE, levels: int = LEVELS, stack: int = STACK, name: str = ""
) -> PhotonTransfer:
    """Expose a sensor to uniform light, and measure it by the photon transfer method.

    Parameters
    ----------
    sensor
        The sensor; its exposure time is the operating one, 1 µs the shortest. Gamma and colour filters, which the
        standard excludes, are left out, and so are inserted effects.
    shape
        Rows and columns of the images.
    levels
        Number of levels from 2 % to 96 % of saturation, with two images each; a few beyond show where it ends.
    stack
        Number of images of each of the dark, bias and flat stacks.
    name
        Keys the random numbers: the same name gives the same images.

    Returns
    -------
    PhotonTransfer
        The measured figures.
    """
    operated = sensor.model_copy(update={"gamma": 1.0, "bayer": None, "insert": ()})
    shortest = operated.model_copy(update={"exposure_time_s": min(_SHORTEST_S, operated.exposure_time_s)})
    shares = np.append(np.linspace(0.02, 0.96, levels), _BEYOND)
    bright = operated.photon_rate_per_s * operated.exposure_time_s
    saturation = operated.saturation_capacity_e / operated.quantum_efficiency

    def expose(camera: EmvaSensor, share: float, count: int, place: int) -> NDArray[np.generic]:
        opened = camera.chain().open(shape, partial(_generator, name))
        uniform = np.full(shape, share * saturation / bright, dtype=np.float32)
        # Every stack is a camera position of its own, so that no two share their noise.
        return np.stack([opened.read(LinearImage(uniform, s=place, t=number)) for number in range(count)])

    # Radiance is float32, as in every image: the photons are computed with the same rounding.
    photons = np.float64(np.float32(shares * saturation / bright)) * bright
    return photon_transfer(
        photons,
        np.stack([expose(operated, float(share), 2, index) for index, share in enumerate(shares)]),
        dark=expose(operated, 0.0, stack, shares.size),
        bias=expose(shortest, 0.0, stack, shares.size + 1),
        flat=expose(operated, 0.5, stack, shares.size + 2),
        saturated=expose(operated, _OVEREXPOSURE, 2, shares.size + 3),
    )


def compare(name: str, sensor: EmvaSensor, found: PhotonTransfer) -> list[Comparison]:
    """Compare the measured figures of a sensor with those that were set.

    Parameters
    ----------
    name
        Name of the sensor.
    sensor
        The sensor.
    found
        Its measurement.

    Returns
    -------
    list of Comparison
        One for each figure.
    """
    told = {
        "gain_dn_per_e": (sensor.gain_dn_per_e, found.gain_dn_per_e),
        "temporal_dark_noise_e": (sensor.temporal_dark_noise_e, found.temporal_dark_noise_e),
        "dsnu_e": (sensor.dsnu_e, found.dsnu_e),
        "prnu": (sensor.prnu, found.prnu),
        "quantum_efficiency": (sensor.quantum_efficiency, found.quantum_efficiency),
        "saturation_capacity_e": (sensor.saturation_capacity_e, found.saturation_e),
        "linearity_error": (0.0, found.linearity_error),
    }
    return [
        Comparison(name, quantity, value, measured, measured / value - 1 if value else measured)
        for quantity, (value, measured) in told.items()
    ]


def run_emva(folder: Path, presets: Sequence[str] = (), *, progress: Progress | None = None) -> list[Comparison]:
    """Measure presets; write ``emva.csv``, ``emva_levels.csv`` and a picture of each preset, ``<name>.png``.

    Parameters
    ----------
    folder
        Where; it is made.
    presets
        Their names; all of them if none is given.
    progress
        Called with (what, done, total).

    Returns
    -------
    list of Comparison
        Figures as set and as measured, preset by preset.

    Raises
    ------
    SceneError
        If there is no preset of that name.
    """
    names = list(presets or PRESETS)
    message = f"there is no such preset; there are {', '.join(PRESETS)}"
    unknown = [Problem("--preset", message, name) for name in names if name not in PRESETS]
    if unknown:
        raise SceneError(unknown)
    from scenetruth.experiment.emva.plots import draw_transfer

    folder.mkdir(parents=True, exist_ok=True)
    found: dict[str, PhotonTransfer] = {}
    comparisons: list[Comparison] = []
    for done, name in enumerate(names):
        if progress is not None:
            progress("sensors", done, len(names))
        sensor = EmvaSensor.model_validate({"kind": "emva1288", "preset": name})
        found[name] = measure_sensor(sensor, name=name)
        comparisons += compare(name, sensor, found[name])
        draw_transfer(name, sensor, found[name], folder / f"{name}.png")
    if progress is not None:
        progress("sensors", len(names), len(names))
    _write_csv(comparisons, found, folder)
    return comparisons


def _generator(name: str, *purpose: str | int) -> np.random.Generator:
    return generator_for(_SEED, "emva", name, *purpose)


def _write_csv(comparisons: Sequence[Comparison], found: Mapping[str, PhotonTransfer], folder: Path) -> None:
    write_table(folder / "emva.csv", [asdict(comparison) for comparison in comparisons])
    levels = [
        {"sensor": name, "photons": photons, "mean_dn": mean, "variance_dn2": variance}
        for name, one in found.items()
        for photons, mean, variance in zip(one.photons, one.mean_dn, one.variance_dn2, strict=True)
    ]
    write_table(folder / "emva_levels.csv", levels)
