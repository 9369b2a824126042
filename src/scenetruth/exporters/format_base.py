"""The base classes of the export formats: options, requirements, and the list of all formats."""

from __future__ import annotations

import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Iterator
from functools import lru_cache
from importlib import import_module
from inspect import cleandoc
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from scenetruth.discovery import kinds_in
from scenetruth.errors import Problem
from scenetruth.exporters.export_source import CameraPair, ExportSource, FlowKind
from scenetruth.validated_model import FrozenModel

__all__ = ["ExportFormat", "FlowOptions", "PairOptions", "PictureOptions", "load_formats"]

_COMPLETE = "make the truth with `--truth-content complete` (truth_content='complete'; not with a rolling shutter)"


class ExportFormat(FrozenModel, ABC):
    """The options of a format. A format is a model derived from this one, in one of the modules ``*_formats``.

    It has a field ``kind``, its name, and says what it writes in `summary`.
    """

    summary: ClassVar[str]
    """What it writes, in one line."""
    packages: ClassVar[tuple[str, ...]] = ()
    """Modules of optional packages that it takes."""

    @classmethod
    def meaning(cls) -> str:
        """Return what its files mean and what they lose: its docstring."""
        return cleandoc(cls.__doc__ or "")

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Give everything that keeps these data sets from being written in this format."""
        yield from ()

    @abstractmethod
    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write data sets that have no problems into a folder that exists; return what a user should know."""

    def missing_packages(self) -> Iterator[Problem]:
        """Give the packages that it takes and that cannot be imported."""
        for name in self.packages:
            try:
                import_module(name)
            except ImportError as error:
                message = f"needs the package {name}, which cannot be imported ({error})"
                yield Problem("format", f"{message}; install it: pip install 'scenetruth[formats]'", _format_name(self))


def _format_name(chosen: ExportFormat) -> str:
    return str(getattr(chosen, "kind", type(chosen).__name__))


class PictureOptions(ExportFormat):
    """Options of formats that come with images."""

    image_bits: Literal[8, 16] = 8
    """Bits of the images' PNG files; full scale of the recording is their largest value."""

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Give what keeps images from being written."""
        yield from super().problems(source)
        if self.image_bits == 16 and source.has_colours:
            yield Problem("image_bits", "must be 8 for colours: PNG files of 16 bits are written of grey images", 16)


class FlowOptions(ExportFormat):
    """Options of formats that hold motion from a frame to the next."""

    flow: FlowKind = "finite"
    """``finite``: where points are in the next image, as the field takes it; ``instantaneous``: dx/dt per frame, which
    estimates hold, and truths without finite flow."""

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Give what is missing of the motion."""
        yield from super().problems(source)
        yield from self.motion_problems(source, ("flow_next",), ("flow",))
        if not source.pairs_of_frames:
            yield Problem("t", "needs two frames in succession: the last one has no flow", source.frames)

    def motion_problems(
        self, source: ExportSource, finite: tuple[str, ...], instant: tuple[str, ...]
    ) -> Iterator[Problem]:
        """Give the variables that are missing, with what would bring them."""
        names = finite if self.flow == "finite" else instant
        for name in (name for name in names if name not in source.maps):
            if self.flow == "instantaneous":
                yield Problem(name, f"is missing; flow='instantaneous' needs {' and '.join(instant)}")
            elif source.is_truth:
                remedy = "or take flow='instantaneous', which is dx/dt and no displacement"
                yield Problem(name, f"is missing, so there is no motion to another frame; {_COMPLETE}, {remedy}")
            else:
                yield Problem(name, "is not in estimates, which hold dx/dt; take flow='instantaneous'")

    def flow_notes(self) -> list[str]:
        """Return what is to be said of an instantaneous flow."""
        if self.flow == "finite":
            return []
        return ["flow is instantaneous: dx/dt per frame at frame t, not the displacement to frame t + 1"]


class PairOptions(ExportFormat):
    """Options of formats that hold disparities of two cameras."""

    left: Annotated[int, Field(ge=-100_000, le=100_000)] = 0
    """Position s of the left camera; the right one is its neighbour to the right."""
    nominal: bool = False
    """Write disparities f B / Z as planned even where a lens distorts or a stage has errors, so that images differ."""

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Give what keeps two cameras from being a pair."""
        yield from super().problems(source)
        pair = source.pair(self.left)
        if isinstance(pair, Problem):
            yield pair
        elif not self.nominal:
            yield from _differences(source, pair)
        if "depth" not in source.maps and "disparity" not in source.maps:
            yield Problem("depth", "is missing, and disparity too; disparities need one of them")

    def pair_of(self, source: ExportSource) -> CameraPair:
        """Return the pair of data sets that have no problems."""
        pair = source.pair(self.left)
        if isinstance(pair, Problem):
            raise TypeError(pair.message)
        return pair

    def pair_notes(self, source: ExportSource) -> list[str]:
        """Return what is to be said of a pair that is not what it was planned to be."""
        return [
            f"{problem.path}: {problem.message.split(';')[0]}" for problem in _differences(source, self.pair_of(source))
        ]


def _differences(source: ExportSource, pair: CameraPair) -> Iterator[Problem]:
    """Give what makes the images of a pair differ from those of two pinholes side by side at one time."""
    remedy = "undistort or rectify first, or take nominal=true, which writes f B / Z all the same"
    if source.distortion:
        message = f"bends the images, so x of the left minus x of the right image is not f B / Z; {remedy}"
        yield Problem("camera.distortion", message, source.distortion)
    if "camera_position_mm" not in source.maps:
        return
    poses = source.maps[["camera_position_mm", "camera_rotation_rad", "image_time_s"]].sel(t=source.frames)
    left, right = (poses.sel(s=s).load() for s in (pair.left, pair.right))
    apart = (right.camera_position_mm - left.camera_position_mm).values - (pair.baseline_mm, 0, 0)
    turned = max(float(abs(side.camera_rotation_rad).max()) for side in (left, right))
    later = float(abs(right.image_time_s - left.image_time_s).max())
    if abs(apart).max() > _SAME_MM or turned > _SAME_RAD:
        found = f"up to {1000 * abs(apart).max():.3g} um beside their places and {1e6 * turned:.3g} urad turned"
        yield Problem(
            "camera_position_mm", f"tells that cameras were {found}: f B / Z is not what images show; {remedy}"
        )
    if later > _SAME_S:
        message = f"tells that the two images were taken {later:.3g} s apart: f B / Z is not what images show; {remedy}"
        yield Problem("image_time_s", message)


_SAME_MM, _SAME_RAD, _SAME_S = 1e-9, 1e-12, 1e-9


@lru_cache(maxsize=1)
def load_formats() -> dict[str, type[ExportFormat]]:
    """Return all formats by name, in alphabetical order: those of the modules ``*_formats`` of this package."""
    package = __name__.rpartition(".")[0]
    names = [entry.name for entry in pkgutil.iter_modules(import_module(package).__path__)]
    found = kinds_in(ExportFormat, *(f"{package}.{name}" for name in names if name.endswith("_formats")))
    return {kind: model for kind, model in found.items() if issubclass(model, ExportFormat)}
