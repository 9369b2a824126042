"""Memory, disk and time that a scene will take, stage by stage, estimated before the work begins."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from scenetruth.resources.system import work_s
from scenetruth.resources.workload import RecordingWorkload, Workload

__all__ = ["Forecast", "StageForecast", "estimate_cost"]

_REFERENCE_WORK_S = 2.2e-3
"""What `work_s` gives on the machine on which the table was measured."""
_SPEEDS = (0.25, 4.0)
"""A machine that seems slower or faster than this was busy when it was measured."""


@dataclass(frozen=True)
class StageForecast:
    """What one stage will take.

    ``memory_bytes``: Its peak memory, all of the process.
    ``disk_bytes``: What it leaves on disk.
    ``seconds``: How long it takes.
    ``disk_at_most_bytes``: Disk space that it does not pass, however badly its results can be packed.
    """

    memory_bytes: float
    disk_bytes: float
    seconds: float
    disk_at_most_bytes: float


@dataclass(frozen=True)
class Forecast:
    """What a command will take, stage by stage.

    ``stages``: The stages by name, in their order.
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
    def disk_at_most_bytes(self) -> float:
        """Disk space that all stages together do not pass."""
        return sum(stage.disk_at_most_bytes for stage in self.stages.values())

    @property
    def disk_wanted_bytes(self) -> float:
        """Disk space that should be free: three times what is foreseen, for maps that pack badly (2.7 was measured)."""
        return min(self.disk_at_most_bytes, 3 * self.disk_bytes)

    @property
    def seconds(self) -> float:
        """Time of all stages together."""
        return sum(stage.seconds for stage in self.stages.values())


def estimate_cost(demand: RecordingWorkload, stages: Sequence[str], slower: float | None = None) -> Forecast:
    """Foresee what stages take."""
    if slower is None:
        least, most = _SPEEDS
        slower = min(max(work_s() / _REFERENCE_WORK_S, least), most)
    found = {}
    for name in stages:
        stage: StageForecast | None = None
        if name in _LATER:
            stage = _LATER[name](demand)
        elif name == "render" and isinstance(demand, Workload):
            stage = _render(demand)
        if stage is not None:
            found[name] = replace(stage, seconds=stage.seconds * slower)
    return Forecast(found)


@dataclass(frozen=True)
class _Backend:
    """What a backend takes beyond what all take."""

    start_s: float
    pixel_s: float
    """For a pixel of a sharp image,"""
    sample_s: float
    """and for each of its samples."""
    start_bytes: float
    sample_bytes: float
    """For a sample of a tile of an image; there are `_TILE` at most."""
    face_bytes: float
    texel_bytes: float


_TILE = 1 << 23
_RAYS = _Backend(0.0, 2.7e-7, 1.07e-8, 0.0, 0.0, 0.0, 0.0)
_OPENGL = _Backend(0.6, 2.1e-7, 1.44e-8, 1.6e8, 4.2, 1090.0, 3.7)

_START_S = 3.5
_LIGHT_S = 9e-7
"""For a lit pixel of a sharp image."""
_STRIP_S = 1.35e-2
"""For each strip of an image that a rolling shutter takes."""
_IMAGE_S, _FACE_IN_IMAGE_S = 1e-2, 1.8e-6
"""For a sharp image, and for every triangle in it."""
_LEAF_FACE_S = 1.6e-5
_TRUTH_S, _COMPLETE_TRUTH_S = 3.8e-7, 1.9e-6
"""For a pixel of the truth."""
_TEXEL_S, _NOISE_TEXEL_S, _LEAF_TEXEL_S = 9.7e-8, 2.4e-7, 3.5e-7
"""For a point of a texture that is kept from an earlier run, and more for one that is to be painted."""

_START_BYTES = 2.55e8
_PIXEL_BYTES, _COMPLETE_PIXEL_BYTES, _FINE_PIXEL_BYTES, _LIT_PIXEL_BYTES = 322.0, 770.0, 27.0, 35.0
_FACE_BYTES, _TEXEL_BYTES, _PAINTED_TEXEL_BYTES = 995.0, 8.1, 1.0

_STORED_SAMPLE_BYTES: Mapping[int, float] = {1: 0.75, 2: 1.28, 4: 3.0}
"""Of a pixel of the recording, with noise, by the size of its numbers."""
_STORED_FLAT_BYTES, _STORED_CURVED_BYTES, _STORED_BYTES_BY_FACES, _FACES_FEW = 8.5, 22.0, 50.0, 1_000
"""Of a pixel of the truth of few large faces; of others; and the more, the more faces there are in a pixel."""
_MOST_FACES_PER_PIXEL = 0.6
_COMPLETE = 2.8
_NARROW = 0.55
_STORED_AT_MOST_BYTES = 65.0
"""Of a pixel of the truth, whatever the surface (59 is the most that was measured)."""
_STORE_BYTES = 1e5


def _render(demand: Workload) -> StageForecast:
    backends = [_RAYS] if demand.rays else [_OPENGL] if demand.rays is False else [_RAYS, _OPENGL]
    memory, seconds = (max(each) for each in zip(*(_rendered_by(demand, backend) for backend in backends), strict=True))
    truths = demand.frames * demand.views * demand.pixels
    scale = (_COMPLETE if demand.complete else 1.0) * (_NARROW if demand.narrow else 1.0)
    truth_bytes = _STORED_FLAT_BYTES
    if demand.faces > _FACES_FEW:
        per_pixel = min(demand.faces / demand.pixels, _MOST_FACES_PER_PIXEL)
        truth_bytes = _STORED_CURVED_BYTES + _STORED_BYTES_BY_FACES * per_pixel
    image_bytes = _STORED_SAMPLE_BYTES[demand.sample_bytes] + (_STORED_SAMPLE_BYTES[4] if demand.save_radiance else 0.0)
    images = _STORE_BYTES + image_bytes * demand.images * demand.pixels
    full = (demand.sample_bytes + (4 if demand.save_radiance else 0)) * demand.images * demand.pixels
    return StageForecast(
        memory,
        images + truth_bytes * scale * truths,
        seconds,
        _STORE_BYTES + full + _STORED_AT_MOST_BYTES * scale * truths,
    )


def _rendered_by(demand: Workload, backend: _Backend) -> tuple[float, float]:
    """Return memory and seconds of rendering by a backend."""
    sharp = demand.images * demand.sharp_images * demand.fine_pixels
    strips = demand.images * demand.sharp_images * (demand.strips if demand.strips > 1 else 0)
    painted = demand.noise_texels_to_paint + demand.leaf_texels_to_paint > 0
    samples = min(demand.fine_pixels * demand.supersampling**2, _TILE)
    truths = demand.frames * demand.views * demand.pixels
    memory = (
        _START_BYTES
        + backend.start_bytes
        + backend.sample_bytes * samples
        + _FINE_PIXEL_BYTES * demand.fine_pixels
        + _LIT_PIXEL_BYTES * demand.pixels * demand.lit
        + (_COMPLETE_PIXEL_BYTES if demand.complete else _PIXEL_BYTES) * demand.pixels
        + (_FACE_BYTES + backend.face_bytes) * demand.faces
        + (_TEXEL_BYTES + backend.texel_bytes) * demand.texels
        + _PAINTED_TEXEL_BYTES * demand.largest_texels * painted
    )
    seconds = (
        _START_S
        + backend.start_s
        + backend.pixel_s * sharp
        + backend.sample_s * sharp * demand.supersampling**2
        + _LIGHT_S * sharp * max(demand.lamps, 1) * demand.lit
        + _STRIP_S * strips
        + _IMAGE_S * demand.images * demand.sharp_images
        + _LEAF_FACE_S * demand.leaf_faces
        + _FACE_IN_IMAGE_S * demand.faces * demand.images * demand.sharp_images
        + (_COMPLETE_TRUTH_S if demand.complete else _TRUTH_S) * truths
        + _TEXEL_S * demand.texels
        + _NOISE_TEXEL_S * demand.noise_texels_to_paint
        + _LEAF_TEXEL_S * demand.leaf_texels_to_paint
    )
    return memory, seconds


# What follows reads a few frames at a time. Measured on the cube: 5 x 9 images of 640 x 480 and of 2464 x 2056 px, and
# 200 frames of one camera (tests/resources/test_forecast.py), estimated by the structure tensor; what another method
# takes, it tells itself (`MethodWorkload`). The methods made of OpenCV take 0.3 to 0.4 of the same memory in small
# images, and 0.4 to 1.2 of it in large ones.
_ESTIMATE_START_S, _ESTIMATE_START_BYTES = 2.8, 2.8e8
_LOST_FRAMES = 8
"""Frames at both ends that have no estimate."""
_WHOLE_BYTES = 150.0
"""For a pixel of every image, where a method (a function, one that is no `StreamingMethod`) holds all frames."""
_STORED_ESTIMATE_BYTES, _STORED_ESTIMATE_AT_MOST_BYTES = 15.0, 100.0
_SCORE_START_S, _SCORE_S, _GROWTH_S = 3.4, 1.8e-6, 5e-6
_SCORE_START_BYTES, _SCORE_BYTES, _SCORED_AT_ONCE = 3.0e8, 200.0, 1_500_000
_REPORT_START_S, _REPORT_S, _REPORT_FRAME_S = 6.0, 4e-6, 1.3e-6
_REPORT_START_BYTES, _REPORT_BYTES = 3.6e8, 165.0
_STORED_PICTURES_BYTES, _STORED_PICTURE_PIXEL_BYTES = 4e6, 13.0


def _estimated(recorded: RecordingWorkload) -> float:
    """Return how many pixels all frames of the estimate have."""
    lost = 0 if recorded.effort.in_memory else _LOST_FRAMES
    return recorded.pixels * max(recorded.frames - lost, 1)


def _estimate(recorded: RecordingWorkload) -> StageForecast:
    estimated, pixels, effort = _estimated(recorded), recorded.pixels, recorded.effort
    at_once = min(estimated, max(pixels, effort.pixels_at_once))
    window = min(at_once / pixels + _LOST_FRAMES, recorded.frames) * recorded.positions * recorded.sample_bytes * pixels
    memory = _ESTIMATE_START_BYTES + effort.bytes_per_pixel * at_once + window
    if effort.in_memory:
        memory += _WHOLE_BYTES * recorded.frames * recorded.positions * pixels
    seconds = _ESTIMATE_START_S + effort.seconds_per_sample * recorded.positions * estimated
    stored = pixels * recorded.frames
    return StageForecast(memory, _STORED_ESTIMATE_BYTES * stored, seconds, _STORED_ESTIMATE_AT_MOST_BYTES * stored)


def _score(recorded: RecordingWorkload) -> StageForecast:
    at_once = min(_estimated(recorded), max(recorded.pixels, _SCORED_AT_ONCE))
    memory = _SCORE_START_BYTES + _SCORE_BYTES * at_once
    # Growth needs depth.
    per_pixel = _SCORE_S + (_GROWTH_S if recorded.positions > 1 else 0.0)
    return StageForecast(memory, _STORE_BYTES, _SCORE_START_S + per_pixel * _estimated(recorded), _STORE_BYTES)


def _report(recorded: RecordingWorkload) -> StageForecast:
    pixels = recorded.pixels
    disk = _STORED_PICTURES_BYTES + _STORED_PICTURE_PIXEL_BYTES * pixels
    at_once = min(_estimated(recorded), max(pixels, _SCORED_AT_ONCE))
    seconds = _REPORT_START_S + _REPORT_S * pixels + _REPORT_FRAME_S * _estimated(recorded)
    return StageForecast(_REPORT_START_BYTES + _REPORT_BYTES * at_once, disk, seconds, 2 * disk)


_LATER: dict[str, Callable[[RecordingWorkload], StageForecast]] = {
    "estimate": _estimate,
    "score": _score,
    "report": _report,
}
