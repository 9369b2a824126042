"""From a recording to depth and motion; knows nothing of the scene or the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from scenetruth.errors import EstimateError, Problem
from scenetruth.schema import check_dataset
from scenetruth.settings import EstimateSettings

if TYPE_CHECKING:
    import xarray as xr

    from scenetruth.estimators.structure_tensor.run import Progress

__all__ = ["estimate", "estimate_settings"]


def estimate_settings(method: str = "structure_tensor", **settings: Any) -> EstimateSettings:
    """Validate the settings of an estimator.

    Raises
    ------
    EstimateError
        With every setting that is unknown or impossible.
    """
    try:
        return EstimateSettings(method=method, **settings)
    except ValidationError as error:
        problems = [
            Problem(
                ".".join(str(key) for key in entry["loc"] if not str(key).startswith(("literal[", "int"))),
                entry["msg"].removeprefix("Value error, "),
                entry.get("input"),
            )
            for entry in error.errors()
        ]
        raise EstimateError(problems, source="settings") from error


def estimate(
    recording: xr.Dataset,
    method: str = "structure_tensor",
    *,
    progress: Progress | None = None,
    **settings: Any,
) -> xr.Dataset:
    """Estimate depth and 3D motion from a recording.

    Parameters
    ----------
    recording
        Images with their intrinsics, from `scenetruth.simulation`, `scenetruth.make_recording` or a store.
    method
        The estimator; ``"structure_tensor"`` is the paper's.
    progress
        Called with (what, done, total) as the work goes on.
    **settings
        Settings of the estimator, see `scenetruth.settings.EstimateSettings`; what is not given has the paper's value,
        whatever the scene of the recording says.

    Returns
    -------
    xarray.Dataset
        ``depth`` (mm), ``velocity`` (mm per frame), ``disparity`` (px per step), ``flow`` (px per frame), ``kind``,
        ``confidence`` and ``eigenvalues`` for every frame that can be estimated.

    Raises
    ------
    RecordingError
        If the recording does not have the agreed form.
    EstimateError
        If a setting is impossible or the recording does not suit the estimator.
    """
    from scenetruth.estimators.structure_tensor.method import estimate_structure_tensor

    checked = estimate_settings(method, **settings)
    check_dataset(recording, "recording")
    if "s_y" in recording["image"].dims:
        message = "images of a grid: estimate one row of cameras at a time, as recording.sel(s_y=0)"
        raise EstimateError([Problem("s_y", message, recording["s_y"].values.tolist())])
    return estimate_structure_tensor(recording, checked, progress)
