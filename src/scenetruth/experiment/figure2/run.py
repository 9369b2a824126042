"""The paper's figure 2: relative errors of U_X, U_Z and Z over their size, without and with noise."""

from __future__ import annotations

import multiprocessing
import os
import warnings
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Literal

import numpy as np

from scenetruth.errors import EstimateWarning
from scenetruth.experiment.figure2.pattern import (
    FOCAL_LENGTH_PX,
    REFERENCE_DEPTH,
    SHAPE,
    pattern_images,
    pattern_recording,
)
from scenetruth.experiment.figure2.points import Condition, Quantity, Result
from scenetruth.experiment.tables import write_table
from scenetruth.progress import Progress
from scenetruth.schema import KIND_FULL

__all__ = ["conditions", "measure", "run_figure2"]

_PAPERS_TAU = 0.0012

WAVELENGTHS_PX = (4, 8, 16, 32)
NOISE_STDS = (0.0, 0.025)
PHASES = 8
NOISE_RUNS = 60
_PER_DECADE = 5
_RANGES: dict[Quantity, tuple[float, float]] = {"U_X": (0.01, 30.0), "U_Z": (0.001, 3.0), "V_X": (0.01, 30.0)}


def conditions() -> list[Condition]:
    """Return all conditions of the figure.

    Returns
    -------
    list of Condition
        For each quantity, its values in ascending order, with every wavelength and every noise.
    """
    return [
        Condition(quantity, float(value), wavelength, noise)
        for quantity, (low, high) in _RANGES.items()
        for value in np.geomspace(low, high, round(_PER_DECADE * np.log10(high / low)) + 1)
        for wavelength in WAVELENGTHS_PX
        for noise in NOISE_STDS
    ]


def measure(condition: Condition, divergence: Literal["paper", "consistent"], runs: int | None = None) -> Result:
    """Measure one point of the figure at the image's centre, where x_0 = y_0 = 0.

    U_X and U_Z are those of the estimated optical flow at the known depth, u_x Z_0 / f and -u_z Z_0, so that the error
    of Z, which has panels of its own, is not counted twice.

    Parameters
    ----------
    condition
        What to measure.
    divergence
        Setting of the estimator.
    runs
        Number of phases and noise seeds; 8 without and 60 with noise if not given.

    Returns
    -------
    Result
        Statistics of the errors.
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
    # All runs side by side in one recording: at the centre of each, filters and window see nothing of its neighbours.
    recording = pattern_recording(np.concatenate(patterns, axis=-1), baseline)
    with warnings.catch_warnings():
        # The threshold is the paper's; that it leaves out the largest displacements belongs to the figure.
        warnings.simplefilter("ignore", EstimateWarning)
        maps = estimate(
            recording, working_point_px=0, flow_working_point_px=(0, 0), divergence=divergence, tau=_PAPERS_TAU
        )
    height, width = SHAPE[2:]
    centres = {name: maps[name].values[..., 0, height // 2, width // 2 :: width] for name in maps}
    full = centres["kind"] == KIND_FULL
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
    return Result(
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
) -> list[Result]:
    """Measure the whole figure on all cores, and write ``figure2.csv`` and ``figure2.png``.

    Parameters
    ----------
    folder
        Where; it is made.
    divergence
        Setting of the estimator; ``"paper"`` for the paper's figure.
    runs
        How many measurements for each point; 8 without and 60 with noise if not given.
    progress
        Called with (what, done, total).

    Returns
    -------
    list of Result
        In the order of the panels.
    """
    todo = conditions()
    results: dict[Condition, Result] = {}
    # One measurement is small: cores are shared out to processes, each with one thread.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count(), mp_context=context, initializer=_one_thread) as pool:
        try:
            futures: dict[Future[Result], Condition] = {
                pool.submit(measure, condition, divergence, runs): condition for condition in todo
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
    write_table(folder / "figure2.csv", [asdict(result) for result in ordered])
    from scenetruth.experiment.figure2.panels import draw_panels

    draw_panels(ordered, folder / "figure2.png", divergence)
    return ordered


def _one_thread() -> None:
    import numba

    numba.set_num_threads(1)
