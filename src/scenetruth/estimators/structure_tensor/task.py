"""The task of an estimate: images, filters and settings, the same for all registrations, rows and frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.structure_tensor.filters import PAPER, FilterPair
from scenetruth.estimators.structure_tensor.registration import Registration
from scenetruth.estimators.structure_tensor.rig import REACH, Rig
from scenetruth.estimators.structure_tensor.settings import StructureTensorSettings
from scenetruth.estimators.structure_tensor.tiling import Rectangle
from scenetruth.estimators.structure_tensor.uncertainty import NoiseModel, noise_model
from scenetruth.schema import Intrinsics

__all__ = ["Task", "check_common_view", "columns_of_s", "common_area", "largest_disparity", "make_task"]


@dataclass(frozen=True, eq=False)
class Task:
    """What to estimate, and with what."""

    images: NDArray[Any]
    """Images, shape (channel, s, t, y, x)."""
    rig: Rig
    settings: StructureTensorSettings
    intrinsics: Intrinsics
    over_s: FilterPair
    """Filters along s for grey values, the derivative scaled to the noise of the others."""
    over_t: FilterPair
    scales: tuple[float, float]
    """By what the derivatives along s and t were scaled."""
    noise: NoiseModel
    outputs: NDArray[np.int64]
    """Indices of the frames to estimate."""


def make_task(
    images: NDArray[Any], rig: Rig, settings: StructureTensorSettings, intrinsics: Intrinsics, full_scale: float
) -> Task:
    """Scale the filters of a rig to grey values and to equal noise.

    Parameters
    ----------
    images
        Images, shape (channel, s, t, y, x).
    rig, settings, intrinsics
        What they were taken with, and what to do with them.
    full_scale
        Value of the images that stands for the grey value 1.

    Returns
    -------
    Task
        The task.
    """
    # Grey values in [-1, 1] are 2 image / full scale - 1; derivatives do not depend on the constant.
    grey = 2 / full_scale
    # Total least squares assumes errors of equal size in all derivatives.
    equal = np.sqrt(PAPER.noise_ratio)
    scale_s = equal / np.sqrt(rig.over_s.noise_ratio) if rig.sees_depth else 1.0
    scale_t = equal / np.sqrt(rig.over_t.noise_ratio) if rig.sees_motion else 1.0
    over_s = replace(rig.over_s, derivative=rig.over_s.derivative * scale_s)
    over_t = replace(rig.over_t, derivative=rig.over_t.derivative * scale_t)
    noise = noise_model(rig, over_s, over_t, images.shape[0], settings)
    return Task(
        images=images,
        rig=rig,
        settings=settings,
        intrinsics=intrinsics,
        over_s=replace(over_s, smoothing=over_s.smoothing * grey, derivative=over_s.derivative * grey),
        over_t=over_t,
        scales=(float(scale_s), float(scale_t)),
        noise=noise,
        outputs=rig.outputs(images.shape[2]),
    )


def columns_of_s(rig: Rig, disparity: int) -> NDArray[np.int64]:
    """Return by how many columns the image of each camera is read further to the right at a working point.

    Parameters
    ----------
    rig
        The cameras.
    disparity
        Disparity of the working point in px per step of s.

    Returns
    -------
    numpy.ndarray
        Whole columns, negative to the left, shape (s,), int64.
    """
    return -np.rint(disparity * rig.positions).astype(np.int64)


def common_area(task: Task, registration: Registration) -> Rectangle:
    """Return the pixels whose filters and window lie inside all registered images.

    Parameters
    ----------
    task
        The images, filters and window.
    registration
        The working point.

    Returns
    -------
    Rectangle
        The pixels; empty if the registered images do not overlap by filters and window.
    """
    height, width = task.images.shape[-2:]
    reach = REACH + task.settings.window_taps_px // 2
    after = task.rig.frames - 1 - task.rig.before
    x = np.add.outer(
        columns_of_s(task.rig, registration.disparity), registration.flow[0] * np.array([-task.rig.before, after])
    )
    y = registration.flow[1] * np.array([-task.rig.before, after])
    return Rectangle(
        top=max(0, -int(y.min())) + reach,
        bottom=height - max(0, int(y.max())) - reach,
        left=max(0, -int(x.min())) + reach,
        right=width - max(0, int(x.max())) - reach,
    )


def largest_disparity(task: Task) -> int:
    """Return the largest disparity at which the registered images still overlap by filters and window.

    Parameters
    ----------
    task
        The images, filters and window.

    Returns
    -------
    int
        Disparity in px per step of s.
    """
    width = task.images.shape[-1]
    reach = REACH + task.settings.window_taps_px // 2
    span = task.rig.positions.max() - task.rig.positions.min()
    return int((width - 2 * reach - 1) / max(span, 1.0))


def check_common_view(task: Task, registrations: Sequence[Registration]) -> None:
    """Check that the images of at least one registration overlap by filters and window.

    Parameters
    ----------
    task
        The images, filters and window.
    registrations
        The working points.

    Raises
    ------
    EstimateError
        If there is none.
    """
    areas = [common_area(task, item) for item in registrations]
    if not all(area.is_empty for area in areas):
        return
    item, area = registrations[0], areas[0]
    needed = 2 * REACH + task.settings.window_taps_px
    rows, columns = (max(size + needed - 1, 0) for size in (area.bottom - area.top, area.right - area.left))
    message = f"images registered by {item.disparity} px per step"
    if item.flow != (0, 0):
        message += f" and {item.flow} px per frame"
    message += f" share only {rows} rows and {columns} columns; filters and window need {needed}"
    raise EstimateError([Problem("estimate.working_point_px", message)])
