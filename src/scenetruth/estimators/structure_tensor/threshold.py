"""The threshold of the eigenvalues, from the images' noise."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from scenetruth.errors import EstimateWarning
from scenetruth.estimators.structure_tensor.maps import Best, Maps
from scenetruth.estimators.structure_tensor.registration import Registration
from scenetruth.estimators.structure_tensor.run import Candidate, run_kernel
from scenetruth.estimators.structure_tensor.shift import registered
from scenetruth.estimators.structure_tensor.task import Task, common_area
from scenetruth.schema import KIND_FULL

__all__ = ["DimPixels", "with_threshold"]

# Eigenvalues of pure noise scatter around their mean; those of texture must be clearly larger.
_TAU_OVER_NOISE = 5.0
_EPSILON = float(np.finfo(np.float32).eps)
# Rounding of grey values in [-1, 1] and of their filtered sums, with some room.
_LEAST_NOISE = 10 * _EPSILON
# Rows and columns of pixels at which noise is estimated.
_SAMPLES = 9
# Texture is clear of noise if the third eigenvalue is so many times the fourth, and this share of the first, below
# which there is rounding and what the filters leave of texture in one direction.
_CLEAR, _LEAST_SHARE = 10.0, 1e-4
# Share of pixels with such texture below τ from which on there is a warning.
_MANY = 0.1
# Frames of the call stack up to whoever called `scenetruth.estimate`, at whose line the warning points.
_CALLER = 7


def with_threshold(task: Task, registrations: Sequence[Registration]) -> tuple[Task, float]:
    """Set the threshold τ of the eigenvalues; ``"auto"`` takes it from the noise of the images.

    Parameters
    ----------
    task
        Images and settings.
    registrations
        The working points.

    Returns
    -------
    tuple
        The task with a number for τ; and the standard deviation of the noise, of grey values in [-1, 1], NaN if it was
        not needed.
    """
    settings = task.settings
    if settings.tau != "auto":
        return task, float(settings.noise_std) if settings.noise_std != "auto" else float("nan")
    if settings.noise_std == "auto":
        power, largest = _sample(task, registrations)
    else:
        power, largest = float(settings.noise_std) ** 2, 0.0
    # Images without noise leave what float32 cannot tell from zero: beside the largest eigenvalue, and in grey values.
    power = max(power, _LEAST_NOISE**2)
    tau = max(_TAU_OVER_NOISE * power * task.noise.gradient, _EPSILON * largest)
    return replace(task, settings=settings.model_copy(update={"tau": tau})), float(np.sqrt(power))


class DimPixels:
    """Counts the pixels that have texture which is clear of noise, but lies below the threshold τ.

    Such a pixel has its third eigenvalue below τ, and yet ten times the fourth: three dimensions of its structure
    tensor hold texture, two hold noise. A lower τ would make its depth and motion known. Dim images are full of such
    pixels. Without texture, or with texture in one direction only, the third eigenvalue is noise, like the fourth.

    Parameters
    ----------
    task
        Images and settings, with a number for τ.
    """

    def __init__(self, task: Task) -> None:
        self._tau = float(task.settings.tau)
        # As `with_threshold` would set it for images without noise.
        self._least = _TAU_OVER_NOISE * _LEAST_NOISE**2 * task.noise.gradient
        self._tried = self._clear = 0

    def add(self, maps: Maps) -> None:
        """Count those of some frames."""
        for frame in range(maps.kind.shape[0]):
            first, third, fourth = (maps.eigenvalues[rank, frame] for rank in (0, 2, 3))
            clear = (third > _CLEAR * fourth) & (third > np.maximum(self._least, _LEAST_SHARE * first))
            self._clear += int(((third <= self._tau) & clear & (maps.kind[frame] < KIND_FULL)).sum())
            self._tried += int(np.isfinite(third).sum())

    def warn_if_many(self) -> None:
        """Warn if there are many."""
        if self._clear > _MANY * self._tried:
            message = (
                f"tau: {self._tau:g} is too high for {100 * self._clear / self._tried:.0f} % of the pixels: their "
                "texture is clear of noise, but below this threshold, so that it counts as none; tau='auto' takes the "
                "threshold from the images' noise"
            )
            warnings.warn(message, EstimateWarning, stacklevel=_CALLER)


def _sample(task: Task, registrations: Sequence[Registration]) -> tuple[float, float]:
    """Estimate the power of the images' noise from the residuals of the model, at pixels all over the image.

    Returns it, and the largest eigenvalue that was met. Each pixel takes the registration that suits it best, as in the
    estimate itself.
    """
    plain = replace(task, settings=task.settings.model_copy(update={"tau": 0.0}), outputs=task.outputs[:1])
    model, (height, width) = task.noise, task.images.shape[-2:]
    rows, columns = (np.linspace(0, size - 1, _SAMPLES + 2).astype(np.int64)[1:-1] for size in (height, width))
    lines = [(int(y), Best.empty(1, 1, width)) for y in rows]
    for number, item in enumerate(registrations):
        top, bottom, left, right = common_area(task, item)
        images = registered(task, item.disparity)
        inside = columns[(columns >= left) & (columns < right)]
        for y, line in lines:
            if top <= y < bottom:
                tiles = np.array([(y, y + 1, x, x + 1) for x in inside], dtype=np.int64).reshape(-1, 4)
                run_kernel(plain, item, Candidate(number, images, 0.0), tiles, line, y)
    powers, largest = [], 0.0
    for _, line in lines:
        at = (0, 0, np.flatnonzero(line.choice[0, 0] >= 0))
        largest = max(largest, float(line.eigenvalues[0, 0, 0, at[-1]].max(initial=0.0)))
        if task.rig.sees_depth:
            of_unit = model.residual_s[0] + model.residual_s[1] * line.v_x[at] ** 2
            powers.append(line.residual_s[at] / of_unit)
        if task.rig.sees_motion:
            of_unit = model.residual_t[0] + model.residual_t[1] * (line.flow_x[at] ** 2 + line.flow_y[at] ** 2)
            powers.append(line.residual_t[at] / of_unit)
    values = np.concatenate(powers)
    values = values[np.isfinite(values)]
    return (float(max(np.median(values), 0.0)) if values.size else 0.0), largest
