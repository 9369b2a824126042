"""What the work on a scene will take: memory, disk and time, stage by stage, before any of it begins.

Each stage is a row of a table: what one unit of each demand takes on the machine on which the table was measured. To
measure it anew, run ``python -m benchmarks.foresight``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from scenetruth.resources.demand import Demand
from scenetruth.resources.machine import work_s

__all__ = ["Forecast", "StageForecast", "foresee"]

_REFERENCE_WORK_S = 2.2e-3
"""What `work_s` gives on the machine on which the table was measured."""
_SPEEDS = (0.25, 4.0)
"""A machine that seems slower or faster than this was busy when it was measured."""


@dataclass(frozen=True)
class StageForecast:
    """What one stage will take.

    Parameters
    ----------
    memory_bytes
        Its peak memory, all of the process.
    disk_bytes
        What it leaves on disk.
    seconds
        How long it takes.
    """

    memory_bytes: float
    disk_bytes: float
    seconds: float


@dataclass(frozen=True)
class Forecast:
    """What a command will take, stage by stage.

    Parameters
    ----------
    stages
        The stages by name, in their order.
    """

    stages: Mapping[str, StageForecast]

    @property
    def memory_bytes(self) -> float:
        """Peak memory: stages follow each other."""
        return max((stage.memory_bytes for stage in self.stages.values()), default=0.0)

    @property
    def disk_bytes(self) -> float:
        """Disk space of all stages together."""
        return sum(stage.disk_bytes for stage in self.stages.values())

    @property
    def seconds(self) -> float:
        """Time of all stages together."""
        return sum(stage.seconds for stage in self.stages.values())


def foresee(demand: Demand, stages: Sequence[str], slower: float | None = None) -> Forecast:
    """Foresee what stages take.

    Parameters
    ----------
    demand
        What the work grows with.
    stages
        Names of stages.
    slower
        How much slower the machine is than that of the table; measured if not given.

    Returns
    -------
    Forecast
        The stages that the table knows.
    """
    if slower is None:
        least, most = _SPEEDS
        slower = min(max(work_s() / _REFERENCE_WORK_S, least), most)
    found = {}
    for name in stages:
        if name in _STAGES:
            stage = _STAGES[name](demand)
            found[name] = StageForecast(stage.memory_bytes, stage.disk_bytes, stage.seconds * slower)
    return Forecast(found)


@dataclass(frozen=True)
class _Backend:
    """What a backend takes."""

    start_s: float
    pixel_s: float
    sample_s: float
    face_s: float
    start_bytes: float
    pixel_bytes: float
    face_bytes: float
    texel_bytes: float


_RAYS = _Backend(1.0, 4e-7, 3e-8, 1e-7, 1e7, 200.0, 300.0, 0.0)
_OPENGL = _Backend(1.5, 2e-7, 2e-8, 1e-7, 1.5e8, 200.0, 300.0, 12.0)
_START_S, _START_BYTES = 3.0, 3.3e8
_LIGHT_S, _STRIP_S, _READ_OUT_S, _VISIBLE_S = 3e-7, 1e-3, 5e-8, 1e-7
_TRUTH_S, _COMPLETE_TRUTH_S = 1e-6, 4e-6
_FACE_AT_A_TIME_S, _FACE_S, _LEAF_FACE_S = 2e-6, 1e-5, 2e-5
_TEXEL_S, _NOISE_TEXEL_S, _LEAF_TEXEL_S = 1e-8, 1e-6, 5e-6
_PIXEL_BYTES, _COMPLETE_PIXEL_BYTES, _FACE_BYTES, _PAINTED_TEXEL_BYTES = 300.0, 600.0, 700.0, 30.0
_STORED_SAMPLE_BYTES: Mapping[int, float] = {1: 1.0, 2: 1.7, 4: 3.6}
_STORED_BYTES, _COMPLETE_STORED_BYTES, _STORED_VISIBLE_BYTES, _NARROW = 30.0, 90.0, 0.02, 0.6
_STORE_BYTES = 1e5


def _render(demand: Demand) -> StageForecast:
    sharp = demand.images * demand.sharp_images * demand.fine_pixels
    samples = sharp * demand.supersampling**2
    truths = demand.frames * demand.views * demand.pixels
    backend = _RAYS if demand.rays else _OPENGL
    seconds = (
        _START_S
        + backend.start_s
        + backend.pixel_s * sharp
        + backend.sample_s * samples
        + backend.face_s * demand.faces * demand.images * demand.sharp_images
        + _LIGHT_S * sharp * (1 + demand.lamps) * demand.lit
        + _STRIP_S * demand.strips * demand.images * demand.sharp_images * (demand.strips > 1)
        + _READ_OUT_S * demand.images * demand.pixels
        + _VISIBLE_S * demand.images * demand.pixels
        + (_COMPLETE_TRUTH_S if demand.complete else _TRUTH_S) * truths
        + _FACE_AT_A_TIME_S * demand.faces * demand.frames
        + _FACE_S * demand.faces
        + _LEAF_FACE_S * demand.leaf_faces
        + _TEXEL_S * demand.texels
        + _NOISE_TEXEL_S * demand.noise_texels_to_paint
        + _LEAF_TEXEL_S * demand.leaf_texels_to_paint
    )
    memory = (
        _START_BYTES
        + backend.start_bytes
        + backend.pixel_bytes * demand.fine_pixels
        + (_COMPLETE_PIXEL_BYTES if demand.complete else _PIXEL_BYTES) * demand.pixels
        + (_FACE_BYTES + backend.face_bytes) * demand.faces
        + backend.texel_bytes * demand.texels
        + _PAINTED_TEXEL_BYTES
        * demand.largest_texels
        * (demand.noise_texels_to_paint + demand.leaf_texels_to_paint > 0)
    )
    image_bytes = _STORED_SAMPLE_BYTES[demand.sample_bytes] + (_STORED_SAMPLE_BYTES[4] if demand.ideal else 0.0)
    truth_bytes = (_COMPLETE_STORED_BYTES if demand.complete else _STORED_BYTES) * (_NARROW if demand.narrow else 1.0)
    disk = (
        _STORE_BYTES
        + image_bytes * demand.images * demand.pixels
        + truth_bytes * truths
        + _STORED_VISIBLE_BYTES * demand.images * demand.pixels
    )
    return StageForecast(memory, disk, seconds)


_STAGES: dict[str, Callable[[Demand], StageForecast]] = {"render": _render}
