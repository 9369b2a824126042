"""Base classes of the export formats: options, requirements, and the list of all formats."""

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

_COMPLETE = "compute the truth with `--truth-content complete` (truth_content='complete'; not with a rolling shutter)"


class ExportFormat(FrozenModel, ABC):
    """Options of a format; subclasses in the modules ``*_formats`` have a name in ``kind`` and a `summary`."""

    summary: ClassVar[str]
    """One-line description."""
    packages: ClassVar[tuple[str, ...]] = ()
    """Required modules of optional packages."""

    @classmethod
    def meaning(cls) -> str:
        """Return the docstring, which describes contents and losses of its files."""
        return cleandoc(cls.__doc__ or "")

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Yield the reasons why the data cannot be written in this format."""
        yield from ()

    @abstractmethod
    def write(self, source: ExportSource, folder: Path) -> list[str]:
        """Write data without problems into an existing directory; return notes for the user."""

    def missing_packages(self) -> Iterator[Problem]:
        """Yield the required packages that cannot be imported."""
        for name in self.packages:
            try:
                import_module(name)
            except ImportError as error:
                message = f"needs the package {name}, which cannot be imported ({error})"
                yield Problem("format", f"{message}; install it: pip install 'scenetruth[formats]'", _format_name(self))


def _format_name(chosen: ExportFormat) -> str:
    return str(getattr(chosen, "kind", type(chosen).__name__))


class PictureOptions(ExportFormat):
    """Options of formats with images."""

    image_bits: Literal[8, 16] = 8
    """Bits of the PNG files; full scale of the recording is the largest value."""

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Yield the reasons why images cannot be written."""
        yield from super().problems(source)
        yield from source.picture_problems()
        if self.image_bits == 16 and source.has_colours:
            yield Problem("image_bits", "must be 8 for colours: only grey images are written as 16-bit PNG", 16)


class FlowOptions(ExportFormat):
    """Options of formats with motion between frames."""

    flow: FlowKind = "finite"
    """``finite``: displacements to the next frame, as usual in the field; ``instantaneous``: dx/dt per frame, for
    estimates and for truths without finite flow."""

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Yield the missing requirements of motion."""
        yield from super().problems(source)
        yield from self.motion_problems(source, ("flow_next",), ("flow",))
        if not source.pairs_of_frames:
            yield Problem("t", "needs two consecutive frames: the last frame has no flow", source.frames)

    def motion_problems(
        self, source: ExportSource, finite: tuple[str, ...], instant: tuple[str, ...]
    ) -> Iterator[Problem]:
        """Yield the missing variables, with a remedy."""
        names = finite if self.flow == "finite" else instant
        for name in (name for name in names if name not in source.maps):
            if self.flow == "instantaneous":
                yield Problem(name, f"is missing; flow='instantaneous' needs {' and '.join(instant)}")
            elif source.is_truth:
                remedy = "or use flow='instantaneous', which is dx/dt and not a displacement"
                yield Problem(name, f"is missing, so there is no motion to another frame; {_COMPLETE}, {remedy}")
            else:
                yield Problem(name, "is not part of estimates, which contain dx/dt; use flow='instantaneous'")

    def flow_notes(self) -> list[str]:
        """Return the note on an instantaneous flow."""
        if self.flow == "finite":
            return []
        return ["flow is instantaneous: dx/dt per frame at frame t, not the displacement to frame t + 1"]


class PairOptions(ExportFormat):
    """Options of formats with disparities of two cameras."""

    left: Annotated[int, Field(ge=-100_000, le=100_000)] = 0
    """Position s of the left camera; the right camera is its right neighbour."""
    nominal: bool = False
    """Write nominal disparities f B / Z even if lens distortion or stage errors make the images differ from them."""

    def problems(self, source: ExportSource) -> Iterator[Problem]:
        """Yield the reasons why two cameras are not a pair."""
        yield from super().problems(source)
        pair = source.pair(self.left)
        if isinstance(pair, Problem):
            yield pair
        elif not self.nominal:
            yield from _differences(source, pair)
        if "depth" not in source.maps and "disparity" not in source.maps:
            yield Problem("depth", "is missing, and disparity too; disparities need one of them")

    def get_pair(self, source: ExportSource) -> CameraPair:
        """Return the pair of data without problems."""
        pair = source.pair(self.left)
        if isinstance(pair, Problem):
            raise TypeError(pair.message)
        return pair

    def pair_notes(self, source: ExportSource) -> list[str]:
        """Return notes on deviations of a pair from its nominal geometry."""
        return [f"{item.path}: {item.message.split(';')[0]}" for item in _differences(source, self.get_pair(source))]


def _differences(source: ExportSource, pair: CameraPair) -> Iterator[Problem]:
    remedy = "undistort or rectify first, or use nominal=true, which writes the nominal f B / Z"
    if source.distortion:
        message = f"distorts the images: x of the left minus x of the right image is not f B / Z; {remedy}"
        yield Problem("camera.distortion", message, source.distortion)
    if "camera_position_mm" not in source.maps:
        return
    poses = source.maps[["camera_position_mm", "camera_rotation_rad", "image_time_s"]].sel(t=source.frames)
    left, right = (poses.sel(s=s).load() for s in (pair.left, pair.right))
    apart = (right.camera_position_mm - left.camera_position_mm).values - (pair.baseline_mm, 0, 0)
    turned = max(float(abs(side.camera_rotation_rad).max()) for side in (left, right))
    later = float(abs(right.image_time_s - left.image_time_s).max())
    if abs(apart).max() > _SAME_MM or turned > _SAME_RAD:
        found = f"up to {1000 * abs(apart).max():.3g} um off their nominal positions, {1e6 * turned:.3g} urad rotated"
        yield Problem("camera_position_mm", f"shows cameras {found}: the images do not agree with f B / Z; {remedy}")
    if later > _SAME_S:
        message = f"differs by {later:.3g} s between the images, which do not agree with f B / Z; {remedy}"
        yield Problem("image_time_s", message)


_SAME_MM, _SAME_RAD, _SAME_S = 1e-9, 1e-12, 1e-9


@lru_cache(maxsize=1)
def load_formats() -> dict[str, type[ExportFormat]]:
    """Return all formats of the modules ``*_formats`` by name, in alphabetical order."""
    package = __name__.rpartition(".")[0]
    names = [entry.name for entry in pkgutil.iter_modules(import_module(package).__path__)]
    found = kinds_in(ExportFormat, *(f"{package}.{name}" for name in names if name.endswith("_formats")))
    return {kind: model for kind, model in found.items() if issubclass(model, ExportFormat)}
