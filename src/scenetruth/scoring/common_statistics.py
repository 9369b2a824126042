"""Statistics of errors that pixels have in common, and of the rest, relative to their stated standard deviations."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import read_intrinsics
from scenetruth.scoring.common_errors import CommonField, MeasuredPoints, has_common_part
from scenetruth.scoring.error_pairs import has_common_std, percent_per_hour, read_common_std
from scenetruth.scoring.quantities import QUANTITIES
from scenetruth.scoring.statistics import ErrorSamples, Statistics

__all__ = ["COMMON_STATISTICS", "CommonAccumulator", "CommonErrors", "CommonSamples", "remove_common_errors"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

COMMON_STATISTICS = ("bias_z", "rms_z_pixel")
"""Statistics of quantities whose standard deviation has a stated common part, in the order of reports."""

_SAMPLES = 5000  # pixels of a frame at which common errors are evaluated; they are smooth


@dataclass(frozen=True)
class CommonSamples:
    """Errors at a lattice of scored pixels, with those that pixels have in common.

    ``where``: The pixels, shape (t, y, x).
    ``modes``: Common errors, each by one standard deviation, shape (m, n).
    ``error``, ``pixel_std``: Errors, and the standard deviations without the common part, shape (n,).
    ``windows_px``: Number of pixels whose errors are correlated by the window of the method.
    ``step_px``: Distance of the lattice.
    """

    where: Mask
    modes: Floats
    error: Floats
    pixel_std: Floats
    windows_px: float
    step_px: int

    def at(self, region: Mask) -> CommonSamples:
        """Return the samples in a region, shape (t, y, x)."""
        some = region[self.where]
        return CommonSamples(
            self.where & region, self.modes[:, some], self.error[some], self.pixel_std[some], self.windows_px,
            self.step_px,
        )  # fmt: skip


class CommonErrors:
    """Common errors of the quantities of an estimate."""

    def __init__(self, estimate: xr.Dataset) -> None:
        self._estimate = estimate
        self._field = CommonField.from_estimate(estimate)
        sizes = estimate.sizes
        self._step = max(1, math.ceil(math.sqrt(sizes["y"] * sizes["x"] / _SAMPLES)))
        self._windows_px = _correlated_pixels(estimate)

    def samples(self, name: str, scored: ErrorSamples) -> CommonSamples | None:
        """Return the samples of a quantity, a key of `QUANTITIES`; None if it states no common part."""
        if not has_common_std(self._estimate, name) or scored.std is None:
            return None
        lattice = np.zeros(scored.scored.shape, dtype=np.bool_)
        first = self._step // 2
        lattice[:, first :: self._step, first :: self._step] = True
        among = lattice[scored.scored]
        where = scored.scored & lattice
        modes = [self._modes(name, t, where[t]) for t in range(len(where))]
        found, std = np.concatenate(modes, axis=1), scored.std[among]
        pixel_std = np.sqrt(np.maximum(std**2 - (found**2).sum(axis=0), 0.0))
        usable = np.isfinite(pixel_std) & (pixel_std > 0)
        where[where] = usable
        return CommonSamples(
            where, found[:, usable], scored.error[among][usable], pixel_std[usable], self._windows_px, self._step
        )

    def _modes(self, name: str, t: int, where: Mask) -> Floats:
        """Return the common errors of a quantity at pixels of a frame, each by one standard deviation, shape (m, n).

        The last has what the modes of the calibration do not contain: it is taken as the same error of all pixels, in
        units of its standard deviation.
        """
        entry, now = QUANTITIES[name], self._estimate.isel(t=[t])
        common = read_common_std(now, name)
        assert common is not None  # asked by the callers
        found = np.zeros((0, int(where.sum())))
        if self._field is not None and has_common_part(now, entry.variable):
            found = np.zeros((len(self._field.modes), found.shape[1]))
            scale = percent_per_hour(read_intrinsics(now)) if entry.units == "%/h" else 1.0
            points = MeasuredPoints.from_estimate(now, 0, where)
            for some in points.slices():
                found[:, some] = scale * self._field.errors(entry.variable, points.part(some))[:, entry.component or 0]
        rest = common[0][where] ** 2 - (found**2).sum(axis=0)
        return np.concatenate([found, np.sqrt(np.maximum(rest, 0.0))[None]])


@dataclass
class CommonAccumulator:
    """Accumulates `COMMON_STATISTICS` of one quantity in one region."""

    _count: int = 0
    _frames: int = 0
    _square: float = 0.0
    _pixel: float = 0.0
    _sums: Floats = field(default_factory=lambda: np.zeros(0))
    _products: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    _projections: Floats = field(default_factory=lambda: np.zeros(0))
    _windows_px: float = 1.0
    _step_px: int = 1

    def add(self, samples: CommonSamples) -> None:
        """Accumulate samples of a region."""
        if self._sums.size == 0:
            size = len(samples.modes)
            self._sums, self._projections = np.zeros(size), np.zeros(size)
            self._products = np.zeros((size, size))
        self._windows_px, self._step_px = samples.windows_px, samples.step_px
        self._count += samples.error.size
        self._frames += int(samples.where.any(axis=(1, 2)).sum())
        modes, error = samples.modes / samples.pixel_std, samples.error / samples.pixel_std
        with np.errstate(over="ignore", invalid="ignore"):
            self._square += float(error @ error)
            self._pixel += float((samples.pixel_std**2).sum())
            self._sums += samples.modes.sum(axis=1)
            self._products += modes @ modes.T
            self._projections += modes @ error

    def statistics(self, bias: float | None, count: int) -> Statistics:
        """Return the statistics; ``bias`` and ``count`` are those of all scored pixels of the region."""
        nothing: Statistics = dict.fromkeys(COMMON_STATISTICS)
        if bias is None or self._count == 0 or not math.isfinite(self._square):
            return nothing
        # Frames share the images of their windows.
        share = min(1.0, self._windows_px * self._frames / count)
        variance = float((self._sums**2).sum()) / self._count**2 + share * self._pixel / self._count
        return {
            "bias_z": bias / math.sqrt(variance) if variance > 0 else None,
            "rms_z_pixel": math.sqrt(max(self._rest(), 0.0) / self._count),
        }

    def _rest(self) -> float:
        """Return the sum of squares that the most likely common errors leave."""
        repeated = _repetitions(self._windows_px, self._step_px, self._frames)
        fitted = _most_likely(self._products / repeated, self._projections / repeated)
        return float(self._square - 2 * fitted @ self._projections + fitted @ self._products @ fitted)


def remove_common_errors(samples: CommonSamples) -> Floats:
    """Return the errors less the most likely common errors, over the standard deviations of pixels, shape (n,)."""
    modes, error = samples.modes / samples.pixel_std, samples.error / samples.pixel_std
    frames = int(samples.where.any(axis=(1, 2)).sum())
    repeated = _repetitions(samples.windows_px, samples.step_px, frames)
    return np.asarray(error - _most_likely(modes @ modes.T / repeated, modes @ error / repeated) @ modes)


def _repetitions(windows_px: float, step_px: int, frames: int) -> float:
    """Return the number of samples with the same noise: those of a window, and all frames."""
    return max(1.0, windows_px / step_px**2) * max(1, frames)


def _most_likely(products: Floats, projections: Floats) -> Floats:
    """Return the most likely amplitudes of modes, whose standard deviations are 1."""
    return np.asarray(np.linalg.solve(products + np.eye(len(projections)), projections))


def _correlated_pixels(estimate: xr.Dataset) -> float:
    """Return the number of pixels with the same noise: 4 π σ² for the Gaussian window that an estimate states, or 1."""
    try:
        value = json.loads(estimate.attrs.get("settings", "{}")).get("window_sigma_px")
    except (TypeError, ValueError, AttributeError):
        return 1.0
    return max(1.0, 4 * math.pi * value**2) if isinstance(value, int | float) else 1.0
