"""Statistics over regions of standard deviations at points, and of the true signals."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.prediction.prediction_result import PredictedValue, compute_value

__all__ = [
    "NAMES",
    "compute_quantities",
    "compute_spread",
    "compute_values",
    "select_regions",
    "weighted_median",
    "weighted_quantile",
]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_COMPONENTS = {
    "slope_x": "slope.0",
    "slope_y": "slope.1",
    "flow_x": "flow.0",
    "flow_y": "flow.1",
    "velocity_x": "velocity.0",
    "velocity_y": "velocity.1",
    "velocity_z": "velocity.2",
    "growth_rate": "growth_rate",
    "growth_principal_1": "principal_growth_rates.0",
    "growth_principal_2": "principal_growth_rates.1",
}

NAMES = {key: name for name, key in _COMPONENTS.items()}
"""Names of the scored quantities, by the component names of method models."""


def select_regions(names: tuple[str, ...], body: NDArray[np.int64], interior: Mask) -> dict[str, Mask]:
    """Return the masks of all regions."""
    seen = body >= 0
    found = {"all": seen, "interior": seen & interior}
    for number, name in enumerate(names):
        own = body == number
        if own.any():
            found[f"object_{name}"] = own & interior if (own & interior).any() else own
    return found if found["interior"].any() else {"all": seen, **{k: v for k, v in found.items() if "object_" in k}}


def compute_quantities(std: Mapping[str, Array], slopes: Array | None) -> dict[str, Array]:
    """Return standard deviations by quantity; slopes dZ/dX and dZ/dY, shape (2, ...), give the angle of the normal."""
    found = {name: std[name] for name in ("depth", "disparity") if name in std}
    found |= {name: std[key] for name, key in _COMPONENTS.items() if key in std}
    if "velocity_x" in found:
        found["velocity_epe"] = np.sqrt(sum(found[f"velocity_{axis}"] ** 2 for axis in "xyz"))
    if "slope_x" in found and slopes is not None:
        # For n = (a, b, -1) / √(1 + a² + b²), with independent errors of a and b.
        a, b = slopes
        square = (1 + b * b) * found["slope_x"] ** 2 + (1 + a * a) * found["slope_y"] ** 2
        found["normal"] = np.degrees(np.sqrt(square) / (1 + a * a + b * b))
    return found


def compute_values(
    std: Mapping[str, Array],
    signals: Mapping[str, Array],
    regions: Mapping[str, Mask],
    share: Array,
    frame_interval_s: float,
) -> dict[str, dict[str, PredictedValue]]:
    """Return predicted values by region and quantity."""
    found: dict[str, dict[str, PredictedValue]] = {}
    for region, mask in regions.items():
        found[region] = {}
        total = share[mask].sum()
        for quantity, values in std.items():
            known = mask & np.isfinite(values)
            spread = compute_spread(values[known], share[known])
            signal = None
            if quantity in signals:
                there = mask & np.isfinite(signals[quantity])
                weight = share[there]
                square = float(np.sum(weight * signals[quantity][there] ** 2) / max(weight.sum(), 1e-300))
                signal = float(np.sqrt(square))
            part = float(share[known].sum() / total) if total > 0 else 0.0
            found[region][quantity] = compute_value(quantity, spread, signal, part, frame_interval_s)
    return found


def compute_spread(std: Array, weights: Array) -> tuple[float, float, float]:
    """Return median and root mean square of standard deviations, and the 95th percentile of absolute normal errors.

    >>> [round(one, 3) for one in compute_spread(np.full(9, 2.0), np.ones(9))]
    [2.0, 2.0, 3.92]
    """
    if not len(std):
        return (float("inf"),) * 3
    order = np.argsort(std)
    std, weights = std[order], weights[order]
    total = np.cumsum(weights)
    rms = float(np.sqrt(np.sum(weights * std**2) / total[-1]))
    # A sample of nodes with equal weights.
    places = np.searchsorted(total, (np.arange(_NODES) + 0.5) / _NODES * total[-1])
    return weighted_median(std, weights), rms, _percentile(std[places])


_NODES = 256
_PERCENTILE, _TOLERANCE = 0.95, 1e-4


def _percentile(std: Array) -> float:
    """Return the 95th percentile of the absolute values of normal errors with the given standard deviations."""
    from scipy.special import erf

    known = std[std > 0] * 2**0.5
    # Two standard deviations cover more than 95 %.
    low, high = 0.0, float(2**0.5 * known[-1]) if len(known) else 0.0
    while high - low > _TOLERANCE * high:
        middle = (low + high) / 2
        held = len(std) - len(known) + float(erf(middle / known).sum())
        low, high = (middle, high) if held < _PERCENTILE * len(std) else (low, middle)
    return (low + high) / 2


def weighted_median(values: Array, weights: Array) -> float:
    """Return the weighted median."""
    return weighted_quantile(values, weights, 0.5)


def weighted_quantile(values: Array, weights: Array, share: float) -> float:
    """Return the weighted quantile."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, share * total[-1])])
