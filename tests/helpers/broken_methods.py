"""The method of gradients, broken in one way at a time: what each breaks is caught by the checks of its name."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import ConfigDict

from scenetruth.estimators import MethodSettings, Needs, StreamingMethod
from scenetruth.progress import Progress
from scenetruth.schema import Put, blank_estimate, make_estimate, put_estimate
from tests.helpers.gradient_method import Gradients

__all__ = ["BROKEN"]

Array = NDArray[np.float64]

BROKEN: dict[type[Gradients], frozenset[str]] = {}
"""Broken methods, and the checks that catch them: these, and no others."""


def caught_by(*names: str) -> Any:
    def note(method: type[Gradients]) -> type[Gradients]:
        BROKEN[method] = frozenset(names)
        return method

    return note


@caught_by("deterministic")
class Random(Gradients):
    """Noise of some digits of float32, drawn anew."""

    def disparity(self, images: Array, reference: int, steps: Array, start: int) -> Array:
        found = super().disparity(images, reference, steps, start)
        return np.asarray(found * (1 + 2e-7 * np.random.default_rng().standard_normal(found.shape)))


@caught_by("input_unchanged", "read_only_input")
class WritesIntoImages(Gradients):
    def images(self, recording: xr.Dataset) -> Array:
        recording["image"].values[..., 0, 0] = 0
        return super().images(recording)


@caught_by("input_unchanged")
class WritesIntoAttributes(Gradients):
    def images(self, recording: xr.Dataset) -> Array:
        recording.attrs["seen_by"] = self.name
        return super().images(recording)


@caught_by("no_shared_memory")
class ReturnsImages(Gradients):
    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        found = super().made(recording, disparity, flow)
        images = recording["image"].isel(s=self.reference(recording)).variable
        return found.assign(residual=images)


@caught_by("no_shared_memory")
class ReturnsTheSameArrays(Gradients):
    def __init__(self) -> None:
        self._kept: dict[tuple[int, ...], NDArray[np.float32]] = {}

    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        found = super().made(recording, disparity, flow)
        kept = self._kept.setdefault(disparity.shape, np.empty(disparity.shape, dtype=np.float32))
        kept[...] = found["depth"].values
        return found.assign(depth=(found["depth"].dims, kept, found["depth"].attrs))


@caught_by("thread_safe")
class SharesItsImages(Gradients):
    thread_safe = True
    _images: Array

    def images(self, recording: xr.Dataset) -> Array:
        self._images = super().images(recording)
        time.sleep(0.02)
        return self._images


@caught_by("unknown_settings")
class TakesAnySetting(Gradients):
    class Loose(MethodSettings):
        model_config = ConfigDict(extra="ignore")
        start_px: int = 4

    settings = Loose


@caught_by("progress")
class CannotBeInterrupted(Gradients):
    def estimate(self, recording: xr.Dataset, settings: Any, progress: Progress | None) -> xr.Dataset:
        def quiet(what: str, done: int, total: int) -> None:
            try:
                assert progress is not None
                progress(what, done, total)
            except Exception:
                pass

        return super().estimate(recording, settings, None if progress is None else quiet)


@caught_by("round_trip")
class TellsWhatCannotBeSaved(Gradients):
    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        return super().made(recording, disparity, flow).assign_attrs(made_by=lambda: self)


@caught_by("output_schema")
class WrongUnits(Gradients):
    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        found = super().made(recording, disparity, flow)
        found["depth"].attrs["units"] = "m"
        return found


@caught_by("declared_outputs")
class PromisesTooMuch(Gradients):
    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        return make_estimate(recording=recording, disparity=disparity, method=self.name)


@caught_by("invalid_is_nan")
class ZeroForMissing(Gradients):
    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        found = super().made(recording, disparity, flow)
        return found.assign(depth=found["depth"].fillna(0.0).assign_attrs(found["depth"].attrs))


@caught_by("standard_deviations")
class CertainOfEverything(Gradients):
    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        std = np.where(np.isnan(disparity), np.nan, 0.0)
        return make_estimate(recording=recording, disparity=disparity, flow=flow, disparity_std=std, method=self.name)


@caught_by("streaming")
class StreamsOtherwise(Gradients, StreamingMethod):
    """What it puts frame by frame differs a little from what it returns."""

    def blank(self, recording: xr.Dataset, settings: Any) -> xr.Dataset:
        names = ["disparity", "flow", "depth_rate"]
        return blank_estimate(names, recording=recording, t=recording["t"].values)

    def fill(self, recording: xr.Dataset, settings: Any, put: Put, progress: Progress | None) -> Mapping[str, Any]:
        found = super().estimate(recording, settings, progress)
        found["depth"] = found["depth"] * np.float32(1.001)
        for place in range(found.sizes["t"]):
            put_estimate(found.isel(t=[place]), place, put)
        return {}


@caught_by("memory_layout")
class ReadsMemoryInItsOrder(Gradients):
    def images(self, recording: xr.Dataset) -> Array:
        values = recording["image"].values
        return np.asarray(values.ravel("K").reshape(values.shape) / recording.attrs["full_scale"])


@caught_by("image_types")
class SubtractsUnsigned(Gradients):
    def images(self, recording: xr.Dataset) -> Array:
        values = recording["image"].values
        half = np.asarray(recording.attrs["full_scale"] / 2).astype(values.dtype)
        return np.asarray((values - half).astype(np.float64) / recording.attrs["full_scale"])


@caught_by("non_finite")
class SpreadsNan(Gradients):
    def look(self, images: Array) -> None:
        images /= images.max() / 0.9


@caught_by("single_camera")
class NeedsCamerasAndDoesNotSayIt(Gradients):
    needs = Needs(frames=2, channels=1)

    def disparity(self, images: Array, reference: int, steps: Array, start: int) -> Array:
        if len(images) < 2:
            msg = "not enough values to unpack"
            raise ValueError(msg)
        return super().disparity(images, reference, steps, start)


@caught_by("single_frame")
class NeedsFramesAndDoesNotSayIt(Gradients):
    needs = Needs(cameras=2, channels=1)


@caught_by("camera_subset")
class AssumesThreeCameras(Gradients):
    """Half of the disparity between the outermost cameras, however many there are."""

    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        return super().made(recording, (recording.sizes["s"] - 1) / 2 * disparity, flow)


@caught_by("frame_numbers", "frame_subset")
class NumbersFramesAnew(Gradients):
    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        found = super().made(recording, disparity, flow)
        return found.assign_coords(t=found["t"] - found["t"][found.sizes["t"] // 2])


@caught_by("crop")
class CountsColumnsFromTheArray(Gradients):
    """Velocity from x and y that begin at 0 in every array."""

    centred: ClassVar[bool] = False

    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        found = super().made(recording, disparity, flow)
        height, width = disparity.shape[-2:]
        c_x, c_y = ((width - 1) / 2, (height - 1) / 2) if self.centred else recording.attrs["principal_point_px"]
        depth, rate = found["depth"], found["velocity"].isel(component=2)
        along = ((np.arange(width) - c_x)[None, :], (np.arange(height) - c_y)[:, None])
        f = recording.attrs["focal_length_px"]
        velocity = np.stack([*((depth * u + at * rate) / f for u, at in zip(flow, along, strict=True)), rate])
        return make_estimate(recording=recording, depth=depth.values, velocity=velocity, flow=flow, method=self.name)


@caught_by("principal_point")
class TakesTheMiddleForThePrincipalPoint(CountsColumnsFromTheArray):
    centred = True


@caught_by("mirror_x", "time_reversal")
class KnowsOneDirection(Gradients):
    def flow(self, images: Array) -> Array:
        found = super().flow(images)
        return np.stack([np.abs(found[0]), found[1]])


@caught_by("mirror_y")
class KnowsOneSlope(Gradients):
    """Right where disparity grows downwards, too large where it falls."""

    def disparity(self, images: Array, reference: int, steps: Array, start: int) -> Array:
        found = super().disparity(images, reference, steps, start)
        falls = np.nanmean(np.gradient(np.abs(found), axis=-2)) < 0
        return np.asarray(found * 1.1 if falls else found)


@caught_by("intensity_invariance")
class AbsoluteThreshold(Gradients):
    def flow(self, images: Array) -> Array:
        found = super().flow(images)
        contrast = images.std(axis=(-2, -1), keepdims=True)
        return np.where(contrast > 0.08, found, np.nan)


@caught_by("baseline_scaling")
class NothingIsFarAway(Gradients):
    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        product = recording.attrs["focal_length_px"] * recording.attrs["baseline_mm"]
        depth = np.clip(product / disparity, 100.0, 2000.0)
        return make_estimate(recording=recording, depth=depth, flow=flow, method=self.name)


@caught_by("reversed_baseline")
class OnlyToTheRight(Gradients):
    """A positive disparity, whatever the baseline."""

    def start(self, recording: xr.Dataset, settings: Any) -> int:
        return int(settings.start_px)

    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        sign = np.sign(recording.attrs["baseline_mm"])
        return super().made(recording, sign * disparity, flow)


@caught_by("frame_interval")
class PerSecond(Gradients):
    def flow(self, images: Array) -> Array:
        return super().flow(images)

    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        return super().made(recording, disparity, flow / recording.attrs["frame_interval_s"])


@caught_by("static_scene")
class RestIsMissing(Gradients):
    def flow(self, images: Array) -> Array:
        found = super().flow(images)
        return np.where(found == 0, np.nan, found)


@caught_by("median_accuracy", "frame_subset", "camera_subset")
class BackwardFlow(Gradients):
    def flow(self, images: Array) -> Array:
        return -super().flow(images)


@caught_by("median_accuracy", "frame_subset", "camera_subset", "single_frame")
class WholeBaseline(Gradients):
    """Disparity between the outermost cameras, two steps apart."""

    needs = Needs(cameras=2, channels=1)

    def flow(self, images: Array) -> Array:
        return super().flow(images) if len(images) > 1 else np.full((2, *images.shape), np.nan)

    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        return super().made(recording, 2 * disparity, flow)


@caught_by("consistency")
class ContradictsItself(Gradients):
    def made(self, recording: xr.Dataset, disparity: Array, flow: Array) -> xr.Dataset:
        found = super().made(recording, disparity, flow)
        return found.assign(disparity=(found["disparity"] * 1.01).assign_attrs(found["disparity"].attrs))


@caught_by("exclusion_mask")
class IgnoresTheMask(Gradients):
    needs = Needs(cameras=2, frames=2, channels=1, exclusion_mask=True)
