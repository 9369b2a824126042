"""The threshold of the eigenvalues, from the images' noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from scenetruth.estimate.registration import Registration
from scenetruth.estimate.run import Scratch, run_kernel
from scenetruth.estimate.task import Task, common_area

__all__ = ["with_threshold"]

# Eigenvalues of noise scatter around their mean; a texture must stand out from them.
_TAU_OVER_NOISE = 5.0
_SAMPLES = 6


def with_threshold(task: Task, registrations: Sequence[Registration]) -> tuple[Task, float]:
    """Settle τ, from the images' noise if it is to be automatic; return the noise as well, NaN if it was not needed."""
    settings = task.settings
    if settings.tau != "auto":
        return task, float(settings.noise_sigma) if settings.noise_sigma != "auto" else float("nan")
    power = _sample_noise(task, registrations) if settings.noise_sigma == "auto" else float(settings.noise_sigma) ** 2
    tau = _TAU_OVER_NOISE * power * task.noise.gradient
    return replace(task, settings=settings.model_copy(update={"tau": tau})), float(np.sqrt(power))


def _sample_noise(task: Task, registrations: Sequence[Registration]) -> float:
    """Estimate the power of the images' noise from what the model leaves unexplained in the middle of some cells."""
    plain = replace(task, settings=task.settings.model_copy(update={"tau": 0.0}), outputs=task.outputs[:1])
    powers = []
    for item in registrations:
        top, bottom, left, right = common_area(task, item)
        rows = np.linspace(top, bottom - 1, _SAMPLES).astype(np.int64)
        columns = np.linspace(left, right - 1, _SAMPLES).astype(np.int64)
        if bottom <= top or right <= left:
            continue
        tiles = np.array([(y, y + 1, x, x + 1) for y in rows for x in columns], dtype=np.int64)
        scratch = Scratch.empty(1, bottom, task.images.shape[-1])
        run_kernel(plain, item, tiles, scratch, 0, 0, None, 0.0)
        at = (0, tiles[:, 0], tiles[:, 2])
        v, u = scratch.solved[0][at], scratch.solved[1:3, at[0], at[1], at[2]]
        model = task.noise
        if task.rig.sees_depth:
            powers.append(scratch.found[5][at] / (model.residual_s[0] + model.residual_s[1] * v**2))
        if task.rig.sees_motion:
            expected = model.residual_t[0] + model.residual_t[1] * np.sum(u**2, axis=0)
            powers.append(scratch.found[8][at] / expected)
    values = np.concatenate(powers) if powers else np.zeros(1)
    values = values[np.isfinite(values)]
    return float(max(np.median(values), 0.0)) if values.size else 0.0
