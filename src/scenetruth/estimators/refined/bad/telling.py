"""What an estimate tells of images that were left out, and of frames of which nothing is known."""

from __future__ import annotations

import warnings
from itertools import product
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.errors import EstimateWarning
from scenetruth.estimators.refined.images import Images

__all__ = ["Told", "nothing_to_tell"]

# Frames of the call stack up to whoever called `scenetruth.estimate`, at whose line the warning points.
_CALLER = 7
_MOST_NAMED = 6


def nothing_to_tell(images: Images) -> str:
    """Return why images that are all the same tell nothing; empty if they differ.

    Parameters
    ----------
    images
        The images that are fitted together.
    """
    first = images.coefficients[0][:, :1]
    alike = [bool((frame == frame[:, :1]).all()) for frame in images.coefficients]
    if all(alike) and all(np.array_equal(frame[:, :1], first) for frame in images.coefficients):
        return "all images are equal: copies of one show neither depth nor motion"
    if len(images.positions) > 1 and all(alike):
        return "all cameras show the same in every frame: without disparity, there is no depth"
    return ""


class Told:
    """Collects what is left out.

    Parameters
    ----------
    recording
        The recording, whose s and t name images; s_y, too, if cameras stand in rows.
    """

    def __init__(self, recording: xr.Dataset) -> None:
        self._t = recording["t"].values.tolist()
        self._dims = [dim for dim in ("s_y", "s") if dim in recording["image"].dims]
        self._cameras = list(product(*(recording[dim].values.tolist() for dim in self._dims)))
        self._left_out: set[tuple[int, ...]] = set()
        self._reasons: dict[str, str] = {}

    def leave_out(self, first: int, images: frozenset[tuple[int, int]]) -> None:
        """Note images that were left out.

        Parameters
        ----------
        first
            Place along t of the first frame of their window.
        images
            Places of their frames in the window and cameras.
        """
        self._left_out |= {(*self._cameras[camera], self._t[first + frame]) for frame, camera in images}

    def nothing_known(self, frame: int, reason: str) -> None:
        """Note a frame of which nothing is known.

        Parameters
        ----------
        frame
            Its place along t.
        reason
            Why.
        """
        self._reasons[str(self._t[frame])] = reason

    def attributes(self) -> dict[str, Any]:
        """Return the attributes of the estimate, and warn of what was left out."""
        named = sorted(self._left_out)
        if named:
            dims = [*self._dims, "t"]
            spelled = ([f"{dim} {n}" for dim, n in zip(dims, image, strict=True)] for image in named[:_MOST_NAMED])
            listed = ", ".join(f"({', '.join(each)})" for each in spelled)
            more = f" and {len(named) - _MOST_NAMED} more" if len(named) > _MOST_NAMED else ""
            message = (
                f"images: {listed}{more} were left out: they do not show what the others show there; look for a camera "
                "that was moved, a wrong file or a wrong exposure (attribute images_left_out)"
            )
            warnings.warn(message, EstimateWarning, stacklevel=_CALLER)
        for frame, reason in self._reasons.items():
            warnings.warn(f"frame {frame}: nothing is known: {reason}", EstimateWarning, stacklevel=_CALLER)
        return {"images_left_out": [list(image) for image in named], "nothing_known": self._reasons}
