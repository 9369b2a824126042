"""The rig of a recording: its cameras and frames, and the filters and the window that they allow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.estimators.structure_tensor.filters import PAPER, FilterPair, gaussian_window, pair_for
from scenetruth.estimators.structure_tensor.settings import StructureTensorSettings

__all__ = ["Rig", "requirements", "rig_of"]

Array = NDArray[np.float64]

REACH = len(PAPER.nodes) // 2
"""How far the filters in x and y reach, in px."""


@dataclass(frozen=True, eq=False)
class Rig:
    """The axes s and t of a recording, as the estimator uses them."""

    positions: Array
    """Position of each camera in steps, X_s / V_X; the reference stands at 0."""
    centre_s: float
    """Where between the cameras the estimate belongs, in steps; 0 unless the cameras stand on one side or are even in
    number."""
    over_s: FilterPair
    """Filters along s."""
    over_t: FilterPair
    """Filters along t."""
    window_t: Array
    """Window along t."""

    @property
    def frames(self) -> int:
        """How many frames one estimate needs."""
        return len(self.over_t.nodes) + len(self.window_t) - 1

    @property
    def before(self) -> int:
        """How many of these frames come before the one that the estimate is given for."""
        return (self.frames - 1) // 2

    @property
    def centre_t(self) -> float:
        """How much later than that frame the estimate belongs: 0, or half a frame for two frames."""
        return (self.frames - 1) / 2 - self.before

    @property
    def sees_depth(self) -> bool:
        """Whether there is more than one camera."""
        return len(self.positions) > 1

    @property
    def sees_motion(self) -> bool:
        """Whether there is more than one frame."""
        return self.frames > 1

    def outputs(self, count_t: int) -> NDArray[np.int64]:
        """Return the frames for which there are estimates.

        Parameters
        ----------
        count_t
            Number of frames of the recording.

        Returns
        -------
        numpy.ndarray
            Indices of frames, int64; empty if the recording has fewer than `frames`.
        """
        return np.arange(count_t - self.frames + 1) + self.before


def rig_of(positions: Array, count_t: int, settings: StructureTensorSettings) -> Rig:
    """Choose filters and window for the cameras and frames of a recording.

    Along s, all cameras enter one derivative. It belongs to the reference if the others surround it evenly, else to the
    middle of all. Along t, the longest of 2, 3 and 5 taps that fits is taken, then a window up to the one in the
    settings.

    Parameters
    ----------
    positions
        Positions of the cameras in steps, X_s / V_X, ascending.
    count_t
        Number of frames.
    settings
        Window along t.

    Returns
    -------
    Rig
        The rig.
    """
    middle = float(positions.mean())
    gap = (positions.max() - positions.min()) / max(len(positions) - 1, 1)
    centre_s = 0.0 if abs(middle) < gap / 4 else middle
    taps = {1: 1, 2: 2, 3: 3, 4: 3}.get(count_t, 5)
    room = count_t - taps + 1 if taps == 5 else 1
    window = min(settings.window_taps_frames, room - (room + 1) % 2)
    return Rig(
        positions=positions,
        centre_s=centre_s,
        over_s=pair_for(positions - centre_s),
        over_t=pair_for(np.arange(taps) - (taps - 1) / 2),
        window_t=gaussian_window(settings.window_sigma_frames, window),
    )


def requirements(
    settings: StructureTensorSettings, cameras: int, frames: int, width: int, height: int
) -> list[Problem]:
    """Return why a recording is too small for the filters and the window.

    Parameters
    ----------
    settings
        The window.
    cameras, frames
        Number of camera positions and of frames.
    width, height
        Size of the images in px.

    Returns
    -------
    list of Problem
        All problems; empty if the recording is large enough.
    """
    border = 2 * REACH + settings.window_taps_px
    problems = []
    if cameras == 1 and frames == 1:
        message = "one image shows neither depth nor motion: 2 camera positions or 2 frames are needed"
        problems.append(Problem("stage.positions", message, cameras))
    for name, size in (("camera.width", width), ("camera.height", height)):
        if size < border:
            problems.append(Problem(name, f"too small: filters and window need {border} px", size))
    return problems
