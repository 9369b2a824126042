"""Estimated memory, disk space and run time of a scene, stage by stage, before any work begins."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from scenetruth.resources.system import work_s
from scenetruth.resources.workload import RecordingWorkload, Workload

__all__ = ["Forecast", "StageForecast", "estimate_cost"]

_REFERENCE_WORK_S = 2.2e-3  # `work_s` of the machine on which the constants were measured
_SPEEDS = (0.25, 4.0)  # limits of the speed ratio; a machine outside was probably busy during the measurement


@dataclass(frozen=True)
class StageForecast:
    """Estimated cost of a stage; ``disk_at_most_bytes`` is an upper limit for any compression ratio."""

    memory_bytes: float
    disk_bytes: float
    seconds: float
    disk_at_most_bytes: float


@dataclass(frozen=True)
class Forecast:
    """Estimated cost of a command: its stages by name, in their order.

    ``slower``: Ratio of the times of the stages to times at reference speed, of the machine on which the constants were
    measured.
    """

    stages: Mapping[str, StageForecast]
    slower: float = 1.0

    @property
    def memory_bytes(self) -> float:
        """Peak memory; stages run one after another."""
        return max((stage.memory_bytes for stage in self.stages.values()), default=0.0)

    @property
    def disk_bytes(self) -> float:
        """Total disk space of all stages."""
        return sum(stage.disk_bytes for stage in self.stages.values())

    @property
    def disk_at_most_bytes(self) -> float:
        """Upper limit of the total disk space."""
        return sum(stage.disk_at_most_bytes for stage in self.stages.values())

    @property
    def disk_wanted_bytes(self) -> float:
        """Disk space that should be free: three times the estimate, for poorly compressible maps (measured: 2.7)."""
        return min(self.disk_at_most_bytes, 3 * self.disk_bytes)

    @property
    def seconds(self) -> float:
        """Total time of all stages."""
        return sum(stage.seconds for stage in self.stages.values())

    @property
    def reference_seconds(self) -> float:
        """Total time of all stages at reference speed, equal on all machines."""
        return self.seconds / self.slower


def estimate_cost(demand: RecordingWorkload, stages: Sequence[str], slower: float | None = None) -> Forecast:
    """Estimate the cost of stages on this machine, or at ``slower`` times the time at reference speed."""
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
    return Forecast(found, slower)


@dataclass(frozen=True)
class _Backend:
    """Additional cost of a rendering backend."""

    start_s: float
    pixel_s: float
    """Per pixel of a sharp image."""
    sample_s: float
    """Per sample of such a pixel."""
    start_bytes: float
    sample_bytes: float
    """Per sample of an image tile, with at most `_TILE` samples."""
    face_bytes: float
    texel_bytes: float


_TILE = 1 << 23
_RAYS = _Backend(0.0, 2.7e-7, 1.07e-8, 0.0, 0.0, 0.0, 0.0)
_OPENGL = _Backend(0.6, 2.1e-7, 1.44e-8, 1.6e8, 4.2, 1090.0, 3.7)

_START_S = 3.5
_EDGE_S = 8e-4
"""Per sharp image with adaptive edges, for each row of a square image and each sample along a side of its pixels. The
length of edges is proportional to the side of an image. Bundled scenes of 640 x 480 px take from a third of this
(`cube`, `seedling`) to three times (`rosette`)."""
_LIGHT_S = 9e-7  # per lit pixel of a sharp image
_STRIP_S = 1.35e-2  # per image strip of a rolling shutter
_IMAGE_S, _FACE_IN_IMAGE_S = 1e-2, 1.8e-6  # per sharp image, and per triangle in it
_LEAF_FACE_S = 1.6e-5
_TRUTH_S, _COMPLETE_TRUTH_S = 3.8e-7, 1.9e-6  # per pixel of the ground truth
_TEXEL_S, _NOISE_TEXEL_S, _LEAF_TEXEL_S = 9.7e-8, 2.4e-7, 3.5e-7  # per texel, and in addition if generated

_START_BYTES = 2.55e8
_PIXEL_BYTES, _COMPLETE_PIXEL_BYTES, _FINE_PIXEL_BYTES, _LIT_PIXEL_BYTES = 322.0, 770.0, 27.0, 35.0
_BAND_BYTES = 24.0  # per pixel of a sharp image, for each band but the first
_FACE_BYTES, _TEXEL_BYTES, _PAINTED_TEXEL_BYTES = 995.0, 8.1, 1.0

_STORED_SAMPLE_BYTES: Mapping[int, float] = {1: 0.75, 2: 1.28, 4: 3.0}  # per pixel with noise, by bytes of a sample
_STORED_FLAT_BYTES, _STORED_CURVED_BYTES, _STORED_BYTES_BY_FACES, _FACES_FEW = 8.5, 22.0, 50.0, 1_000
"""Per pixel of the ground truth: with few large faces; otherwise; and in addition per face in a pixel."""
_MOST_FACES_PER_PIXEL = 0.6
_COMPLETE = 2.8
_NARROW = 0.55
_STORED_AT_MOST_BYTES = 65.0  # per pixel of the ground truth, for any surface (largest measured value: 59)
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
    image_bytes = _STORED_SAMPLE_BYTES[demand.sample_bytes] * demand.channels
    image_bytes += _STORED_SAMPLE_BYTES[4] * demand.bands if demand.save_radiance else 0.0
    images = _STORE_BYTES + image_bytes * demand.images * demand.pixels
    per_pixel = demand.sample_bytes * demand.channels + (4 * demand.bands if demand.save_radiance else 0)
    full = per_pixel * demand.images * demand.pixels
    return StageForecast(
        memory,
        images + truth_bytes * scale * truths,
        seconds,
        _STORE_BYTES + full + _STORED_AT_MOST_BYTES * scale * truths,
    )


def _rendered_by(demand: Workload, backend: _Backend) -> tuple[float, float]:
    """Return memory in bytes and time in seconds for rendering by a backend."""
    # Bands are rendered one after the other.
    sharp = demand.images * demand.sharp_images * demand.fine_pixels * demand.bands
    strips = demand.images * demand.sharp_images * (demand.strips if demand.strips > 1 else 0)
    painted = demand.noise_texels_to_paint + demand.leaf_texels_to_paint > 0
    samples = min(demand.fine_pixels * demand.supersampling**2, _TILE)
    truths = demand.frames * demand.views * demand.pixels
    memory = (
        _START_BYTES
        + backend.start_bytes
        + backend.sample_bytes * samples
        + (_FINE_PIXEL_BYTES + _BAND_BYTES * (demand.bands - 1)) * demand.fine_pixels
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
        + _EDGE_S
        * demand.images
        * demand.sharp_images
        * demand.fine_pixels**0.5
        * demand.supersampling
        * demand.adaptive
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


# The stages below read a few frames at a time. Measured on the cube: 5 x 9 images of 640 x 480 and of 2464 x 2056 px,
# and 200 frames of one camera (tests/resources/test_cost_estimate.py), with the structure tensor; other methods specify
# their cost (`MethodWorkload`). OpenCV methods take 0.3 to 0.4 of this memory for small images, and 0.4 to 1.2 of it
# for large images.
_ESTIMATE_START_S, _ESTIMATE_START_BYTES = 2.8, 2.8e8
_LOST_FRAMES = 8  # frames at both ends without an estimate
_WHOLE_BYTES = 150.0
"""Per pixel of every image, for methods that hold all frames (functions, anything but a `StreamingMethod`)."""
_STORED_ESTIMATE_BYTES, _STORED_ESTIMATE_AT_MOST_BYTES = 15.0, 100.0
_SCORE_START_S, _SCORE_S, _GROWTH_S = 3.4, 1.8e-6, 5e-6
_SCORE_START_BYTES, _SCORE_BYTES, _SCORED_AT_ONCE = 3.0e8, 200.0, 1_500_000
_REPORT_START_S, _REPORT_S, _REPORT_FRAME_S = 6.0, 4e-6, 1.3e-6
_REPORT_START_BYTES, _REPORT_BYTES = 3.6e8, 165.0
_STORED_PICTURES_BYTES, _STORED_PICTURE_PIXEL_BYTES = 4e6, 13.0


def _estimated(recorded: RecordingWorkload) -> float:
    """Return the number of pixels in all frames of the estimate."""
    lost = 0 if recorded.effort.in_memory else _LOST_FRAMES
    return recorded.pixels * max(recorded.frames - lost, 1)


def _estimate(recorded: RecordingWorkload) -> StageForecast:
    estimated, pixels, effort = _estimated(recorded), recorded.pixels, recorded.effort
    at_once = min(estimated, max(pixels, effort.pixels_at_once))
    window = (
        min(at_once / pixels + _LOST_FRAMES, recorded.frames)
        * recorded.positions
        * recorded.sample_bytes
        * recorded.channels
        * pixels
    )
    memory = _ESTIMATE_START_BYTES + window
    if pixels > effort.whole_pixels:
        memory += effort.bytes_per_pixel * effort.tile_pixels + effort.bytes_per_tiled_pixel * pixels
    else:
        memory += effort.bytes_per_pixel * at_once
    if effort.in_memory:
        memory += _WHOLE_BYTES * recorded.frames * recorded.positions * pixels
    seconds = _ESTIMATE_START_S + effort.seconds_per_sample * recorded.positions * estimated
    stored = pixels * recorded.frames
    return StageForecast(memory, _STORED_ESTIMATE_BYTES * stored, seconds, _STORED_ESTIMATE_AT_MOST_BYTES * stored)


def _score(recorded: RecordingWorkload) -> StageForecast:
    at_once = min(_estimated(recorded), max(recorded.pixels, _SCORED_AT_ONCE))
    memory = _SCORE_START_BYTES + _SCORE_BYTES * at_once
    # Growth requires depth.
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
