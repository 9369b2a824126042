"""Noise of the structure tensor by simulation."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st

__all__ = ["NOISE", "Array", "calibration", "with_noise"]


Array = NDArray[np.float64]


NOISE = 0.025


def with_noise(recording: xr.Dataset, seed: int, sigma: float = NOISE) -> xr.Dataset:
    noise = np.random.default_rng(seed).normal(0, sigma / 2, recording["image"].shape)
    return recording.assign(image=(recording["image"].dims, (recording["image"].values + noise).astype(np.float32)))


def calibration(
    recording: xr.Dataset,
    truth: dict[str, Any],
    seeds: int,
    inner: dict[str, slice],
    *,
    told_only: bool = False,
    **settings: Any,
) -> dict[str, tuple[float, float]]:
    """Return, of depth and every component of velocity, scatter over predicted std and the share within 2 std.

    Of all pixels, which must all be told, or of those that all estimates tell.
    """
    found: dict[str, list[Array]] = {"depth": [], "velocity": []}
    predicted: dict[str, list[Array]] = {"depth": [], "velocity": []}
    for seed in range(seeds):
        estimate = st.estimate(with_noise(recording, seed), **settings).isel(t=0, **inner)  # type: ignore[arg-type]
        for name in found:
            found[name].append(estimate[name].values)
            predicted[name].append(estimate[f"{name}_std"].values.astype(np.float64))
    result = {}
    for name in found:
        values, std = np.array(found[name]), np.array(predicted[name])
        exact = np.asarray(truth[name])
        if name == "depth":
            values, std, exact = values[:, None], std[:, None], exact[None]
        for index, part in enumerate(["Z"] if name == "depth" else ["U_X", "U_Y", "U_Z"]):
            each, bar = values[:, index], std[:, index]
            kept = np.isfinite(each + bar).all(axis=0) if told_only else np.ones(each.shape[1:], dtype=np.bool_)
            ratio = np.sqrt(np.mean(each.var(axis=0, ddof=1)[kept]) / np.mean(bar[:, kept] ** 2))
            within = np.mean((np.abs(each - exact[index]) <= 2 * bar)[:, kept])
            result[part] = (float(ratio), float(within))
    return result
