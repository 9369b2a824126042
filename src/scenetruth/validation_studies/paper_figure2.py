"""The paper's figure 2: relative errors of velocity and depth over their magnitude."""

from __future__ import annotations

import multiprocessing
import os
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import EstimateWarning, SceneWarning
from scenetruth.progress import Progress
from scenetruth.schema import STATUS_VALID, make_recording

__all__ = [
    "FOCAL_LENGTH_PX",
    "REFERENCE_DEPTH",
    "Condition",
    "ConditionResult",
    "conditions",
    "measure_condition",
    "pattern_images",
    "pattern_recording",
    "run_figure2",
]


Quantity = Literal["U_X", "U_Z", "V_X"]


@dataclass(frozen=True)
class Condition:
    """The condition of one point of the figure; all else as in the paper (f = 10, Z_0 = 100, V_X = 1, no motion).

    ``quantity``: The varied quantity: U_X, U_Z, or the camera distance V_X, whose panel shows the error of Z.
    ``noise_std``: σ_n of the images, for grey values in [-1, 1].
    """

    quantity: Quantity
    value: float
    wavelength_px: int
    noise_std: float


@dataclass(frozen=True)
class ConditionResult:
    """Statistics of abs(measured / true - 1) under one condition, over phases of the pattern and noise realisations.

    ``full``: Number of valid estimates, to which the statistics refer; NaN if there is none.
    """

    quantity: Quantity
    value: float
    wavelength_px: int
    noise_std: float
    runs: int
    full: int
    median_relative_error: float
    rms_relative_error: float
    max_relative_error: float


FOCAL_LENGTH_PX = 10.0
"""f of the paper's experiment."""
REFERENCE_DEPTH = 100.0
"""Z_0 of the paper's experiment, in the units of V_X."""
SHAPE = (5, 9, 29, 29)
"""Number of cameras, frames, rows and columns in the support of filters and window of one estimate."""


def pattern_images(
    wavelength_px: float,
    *,
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    baseline: float = 1.0,
    phase: tuple[float, float] = (0.0, 0.0),
    noise_std: float = 0.0,
    generator: np.random.Generator | None = None,
    shape: tuple[int, int, int, int] = SHAPE,
) -> NDArray[np.float64]:
    """Return images of g = cos(K_X X) cos(K_Y Y) (paper eq. 13), as (1 + g) / 2 + noise.

    X = x Z_t / f - U_X t + V_X s, Y = y Z_t / f - U_Y t and Z_t = Z_0 + U_Z t, with x and y from the image centre and
    K_X = K_Y such that the wavelength in the image is ``wavelength_px`` at t = 0.

    ``velocity``: (U_X, U_Y, U_Z) per frame. ``baseline``: V_X per step of s.
    """
    s, t, y, x = (
        (np.arange(size) - (size - 1) / 2 if axis > 1 else np.arange(size) - (size - 1) // 2).astype(np.float64)
        for axis, size in enumerate(shape)
    )
    wave_number = 2 * np.pi / wavelength_px * FOCAL_LENGTH_PX / REFERENCE_DEPTH
    scale = (REFERENCE_DEPTH + velocity[2] * t) / FOCAL_LENGTH_PX
    across = x * scale[:, None] - velocity[0] * t[:, None] + baseline * s[:, None, None]
    down = y * scale[:, None] - velocity[1] * t[:, None]
    grey: NDArray[np.float64] = (
        np.cos(wave_number * across + phase[0])[:, :, None, :] * np.cos(wave_number * down + phase[1])[None, :, :, None]
    )
    if noise_std > 0:
        assert generator is not None
        grey = grey + noise_std * generator.standard_normal(shape)
    return (grey + 1) / 2


def pattern_recording(images: NDArray[np.float64], baseline: float = 1.0) -> xr.Dataset:
    """Return a recording with the paper's camera; ``baseline`` is V_X per step of s."""
    # Noise may slightly exceed full scale.
    with warnings.catch_warnings():
        # The focal length of the paper is that of a very wide field of view.
        warnings.simplefilter("ignore", SceneWarning)
        return make_recording(images, FOCAL_LENGTH_PX, baseline, full_scale=1.0)


_ROWS = (
    ("U_X", "velocity $U_X$", "rel. error of $U_X$"),
    ("U_Z", "velocity $U_Z$", "rel. error of $U_Z$"),
    ("V_X", "camera distance $V_X$", "rel. error of $Z$"),
)
# Statements of the paper on its panels without noise: value up to which the error is below the bound.
_BOUNDS = {"U_X": ((4.0, 3e-4),), "U_Z": ((0.1, 3e-3), (1.0, 3e-2)), "V_X": ((4.0, 3e-4),)}
_NOISE_BAND = (1e-3, 1e-2)
# Okabe and Ito's colours, with a marker each.
_STYLES = {4: ("#0072B2", "o"), 8: ("#D55E00", "s"), 16: ("#009E73", "^"), 32: ("#CC79A7", "D")}


def draw_panels(results: Sequence[ConditionResult], file: Path, divergence: str) -> None:
    """Draw errors over values, log-log: without noise on the left, with noise on the right, a row for each quantity."""
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
        "Relative errors for the translating pattern (eq. 13); median of phases without noise, RMS of runs with noise\n"
        f"divergence: {divergence}. Points without any valid estimate are omitted.",
        fontsize=11,
    )
    figure.savefig(file, dpi=110, metadata={"Software": "scenetruth"})


def _draw_panel(ax: Any, results: Sequence[ConditionResult], noisy: bool) -> None:
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


_PAPERS_TAU = 0.0012

WAVELENGTHS_PX = (4, 8, 16, 32)
NOISE_STDS = (0.0, 0.025)
PHASES = 8
NOISE_RUNS = 60
_PER_DECADE = 5
_RANGES: dict[Quantity, tuple[float, float]] = {"U_X": (0.01, 30.0), "U_Z": (0.001, 3.0), "V_X": (0.01, 30.0)}


def conditions() -> list[Condition]:
    """Return all conditions of the figure."""
    return [
        Condition(quantity, float(value), wavelength, noise)
        for quantity, (low, high) in _RANGES.items()
        for value in np.geomspace(low, high, round(_PER_DECADE * np.log10(high / low)) + 1)
        for wavelength in WAVELENGTHS_PX
        for noise in NOISE_STDS
    ]


def measure_condition(
    condition: Condition, divergence: Literal["paper", "consistent"], runs: int | None = None
) -> ConditionResult:
    """Measure one point of the figure at the image centre, where x_0 = y_0 = 0.

    U_X and U_Z are those of the estimated optical flow at the true depth, u_x Z_0 / f and -u_z Z_0, so that the error
    of Z, which has separate panels, is not included.
    """
    from scenetruth.estimators import estimate

    if runs is None:
        runs = NOISE_RUNS if condition.noise_std > 0 else PHASES
    value, quantity = condition.value, condition.quantity
    velocity = {"U_X": (value, 0.0, 0.0), "U_Z": (0.0, 0.0, value), "V_X": (0.0, 0.0, 0.0)}[quantity]
    baseline = value if quantity == "V_X" else 1.0
    patterns = []
    for generator in _generators(condition, runs):
        phase_x, phase_y = generator.uniform(0, 2 * np.pi, 2)
        patterns.append(
            pattern_images(
                condition.wavelength_px,
                velocity=velocity,
                baseline=baseline,
                phase=(float(phase_x), float(phase_y)),
                noise_std=condition.noise_std,
                generator=generator,
            )
        )
    # All runs are tiles of one recording: filters and window at the centre of each do not reach its neighbours.
    recording = pattern_recording(np.concatenate(patterns, axis=-1), baseline)
    with warnings.catch_warnings():
        # The threshold is the paper's; it excludes the largest displacements, as in the figure.
        warnings.simplefilter("ignore", EstimateWarning)
        maps = estimate(
            recording, working_point_px=0, flow_working_point_px=(0, 0), divergence=divergence, tau=_PAPERS_TAU
        )
    height, width = SHAPE[2:]
    centres = {name: maps[name].values[..., 0, height // 2, width // 2 :: width] for name in maps}
    full = centres["status"] == STATUS_VALID
    depth = centres["depth"][full].astype(np.float64)
    if quantity == "V_X":
        errors = abs(depth / REFERENCE_DEPTH - 1)
    elif quantity == "U_X":
        flow = centres["flow"][0, full].astype(np.float64)
        errors = abs(flow * REFERENCE_DEPTH / FOCAL_LENGTH_PX / value - 1)
    else:
        divergence_rate = centres["velocity"][2, full].astype(np.float64) / depth
        errors = abs(divergence_rate * REFERENCE_DEPTH / value - 1)
    found = errors if errors.size else np.array([np.nan])
    return ConditionResult(
        **asdict(condition),
        runs=runs,
        full=errors.size,
        median_relative_error=float(np.median(found)),
        rms_relative_error=float(np.sqrt(np.mean(found**2))),
        max_relative_error=float(np.max(found)),
    )


def _generators(condition: Condition, runs: int) -> Iterator[np.random.Generator]:
    key = tuple(f"figure2/{condition.quantity}/{condition.value:.6g}/{condition.wavelength_px}".encode())
    for child in np.random.SeedSequence(2002, spawn_key=key).spawn(runs):
        yield np.random.default_rng(child)


def run_figure2(
    folder: Path,
    *,
    divergence: Literal["paper", "consistent"] = "paper",
    runs: int | None = None,
    progress: Progress | None = None,
) -> list[ConditionResult]:
    """Measure the complete figure on all cores, and write ``figure2.csv`` and ``figure2.png``."""
    import pandas as pd

    todo = conditions()
    results: dict[Condition, ConditionResult] = {}
    # A single measurement is small: each process uses one thread.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count(), mp_context=context, initializer=_one_thread) as pool:
        try:
            futures: dict[Future[ConditionResult], Condition] = {
                pool.submit(measure_condition, condition, divergence, runs): condition for condition in todo
            }
            for done, future in enumerate(as_completed(futures)):
                if progress is not None:
                    progress("figure 2", done, len(todo))
                results[futures[future]] = future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    if progress is not None:
        progress("figure 2", len(todo), len(todo))
    ordered = [results[condition] for condition in todo]
    folder.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(ordered).to_csv(folder / "figure2.csv", index=False)

    draw_panels(ordered, folder / "figure2.png", divergence)
    return ordered


def _one_thread() -> None:
    import numba

    numba.set_num_threads(1)
