"""Acceptance criteria: conditions on the geometry of a draw, evaluated before anything is rendered."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from scenetruth.camera import Camera
from scenetruth.raycast import RayCaster, Topology
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.scene_report import check_scene
from scenetruth.schema import IncrementalDataset
from scenetruth.truth import TruthOptions, fill_truth, outline_truth
from scenetruth.validated_model import Finite, FrozenModel, Name

__all__ = [
    "AcceptanceCriterion",
    "DepthRangeCriterion",
    "GeometryPreview",
    "ImageMotionCriterion",
    "ObjectCriterion",
    "OccludedFractionCriterion",
    "ResidualDisparityCriterion",
    "TextureWavelengthCriterion",
    "VisibleFractionCriterion",
]


_WIDTH_PX = 160
"""Maximum size in pixels: fractions of an object of a tenth of the image width are accurate to a few per cent."""
_FARTHEST = 4.0
"""Distance beyond the image, in image sizes, to which silhouettes extend."""


class GeometryPreview:
    """Low-resolution truth of a scene in the reference camera at the reference frame.

    Meshes, motions and rays equal those of the truth; the image has at most 160 px per side, sampled at pixel centres.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._small = scene.shrunk_to(_WIDTH_PX)
        self.scale = scene.camera.width / self._small.camera.width
        """Pixels of the camera per pixel of the preview."""
        self.world = build_scene(scene, painted=False)
        with warnings.catch_warnings():
            # Warnings of textures are issued when the sample is generated.
            warnings.simplefilter("ignore")
            check_scene(scene, self.world)
        self.names = [body.name for body in self.world.bodies]

    def truth(self, name: str) -> NDArray[Any]:
        """Return a truth map with lengths in preview pixels; multiply by `scale` for camera pixels."""
        found: NDArray[Any] = self._truth[name].values[..., 0, :, :]
        return found

    @property
    def object_id(self) -> NDArray[Any]:
        """Object index of every pixel, -1 for none."""
        return self.truth("object_id")

    @cached_property
    def _truth(self) -> Any:
        filling = IncrementalDataset(outline_truth(self._small, TruthOptions(), {}).dataset())
        fill_truth(self._small, self.world, TruthOptions(), filling.put)
        return filling.dataset()

    def visible_share(self, number: int) -> float:
        """Return the visible fraction of an object's silhouette, from 0 to 1."""
        alone = self._silhouette(number)
        return float(np.count_nonzero(self.object_id == number) / alone) if alone else 0.0

    def wavelengths_mm(self, number: int) -> tuple[float, float] | None:
        """Return the shortest and longest wavelength of an object's texture; None for an object without texture."""
        items = {item.name: item for _, item in self.scene.parts}
        return items[self.names[number]].texture.shortest_and_longest_mm

    def _silhouette(self, number: int) -> int:
        """Return the pixel count of an object rendered alone, in an image that contains its silhouette."""
        body, camera = self.world.bodies[number], self._small.camera
        vertices = body.vertices_mm
        pixels = camera.project(vertices)
        size = np.array([camera.width, camera.height])
        low = np.maximum(np.floor(pixels.min(axis=0)), -_FARTHEST * size).astype(int)
        high = np.minimum(np.ceil(pixels.max(axis=0)), (1 + _FARTHEST) * size).astype(int)
        if (high < low).any():
            return 0
        whole = _moved(camera, low, high)
        caster = RayCaster(vertices, Topology.of(vertices, body.faces, np.asarray(body.mesh.crease_deg)))
        hits = caster.cast(np.zeros(3), whole.ray_directions(whole.pixel_grid()).reshape(-1, 3), grid_width=whole.width)
        return int(np.count_nonzero(hits.face >= 0))


def _moved(camera: Camera, low: NDArray[np.int_], high: NDArray[np.int_]) -> Camera:
    """Return the camera with an image that spans the given pixels, also outside its own image."""
    x, y = camera.principal_point
    width, height = (int(b - a + 1) for a, b in zip(low, high, strict=True))
    return camera.model_copy(
        update={"width": width, "height": height, "principal_point_px": (x - float(low[0]), y - float(low[1]))}
    )


class AcceptanceCriterion(FrozenModel):
    """Limits of a quantity of the geometry."""

    unit: ClassVar[str] = ""
    """Unit with a leading space, for messages."""

    min: Finite | None = None
    """Lower limit."""
    max: Finite | None = None
    """Upper limit."""

    @model_validator(mode="after")
    def _some_bound(self) -> Self:
        if self.min is None and self.max is None:
            msg = "has no limit: specify min, max, or both"
            raise ValueError(msg)
        if self.min is not None and self.max is not None and self.min > self.max:
            msg = f"can never hold: min = {self.min:g} is greater than max = {self.max:g}"
            raise ValueError(msg)
        return self

    def measured(self, look: GeometryPreview) -> Iterable[tuple[str, float]]:
        """Return measured values with their names, such as ``("visible share of leaf-3", 0.2)``."""
        raise NotImplementedError

    def refusal(self, look: GeometryPreview) -> str:
        """Return the reason for rejection, the same text for the same cause; empty if the draw is accepted."""
        for what, value in self.measured(look):
            if self.min is not None and not value >= self.min:
                return f"{what} under {self.min:g}{self.unit}"
            if self.max is not None and not value <= self.max:
                return f"{what} over {self.max:g}{self.unit}"
        return ""


class ObjectCriterion(AcceptanceCriterion):
    """Limits of a geometric quantity of single objects."""

    object: Name = "*"
    """Names of the objects; ``*`` matches any characters."""

    def _matching(self, look: GeometryPreview) -> list[int]:
        return [number for number, name in enumerate(look.names) if fnmatchcase(name, self.object)]


class DepthRangeCriterion(ObjectCriterion):
    """Depth of the visible surface of an object in the reference camera at the reference frame, mm."""

    unit: ClassVar[str] = " mm"

    kind: Literal["depth"] = "depth"

    def measured(self, look: GeometryPreview) -> Iterable[tuple[str, float]]:
        """Return the smallest and largest depth of every visible object."""
        for number in self._matching(look):
            seen = look.truth("depth")[look.object_id == number]
            if seen.size:
                yield f"depth of {look.names[number]}", float(seen.min())
                yield f"depth of {look.names[number]}", float(seen.max())


class ImageMotionCriterion(ObjectCriterion):
    """Largest optical flow of the visible surface of an object at the reference frame, px per frame."""

    unit: ClassVar[str] = " px per frame"

    kind: Literal["image_motion"] = "image_motion"

    def measured(self, look: GeometryPreview) -> Iterable[tuple[str, float]]:
        """Return the magnitude of the largest flow of every visible object."""
        speed = np.hypot(*look.truth("flow")) * look.scale
        for number in self._matching(look):
            seen = speed[look.object_id == number]
            if seen.size:
                yield f"image motion of {look.names[number]}", float(seen.max())


class OccludedFractionCriterion(AcceptanceCriterion):
    """Fraction of the surface visible to the reference camera that another camera does not show, from 0 to 1."""

    kind: Literal["occluded_share"] = "occluded_share"

    def measured(self, look: GeometryPreview) -> Iterable[tuple[str, float]]:
        """Return the occluded fraction."""
        seen = look.object_id >= 0
        yield (
            "share not seen by all cameras",
            float(np.mean(look.truth("occluded_across_cameras")[seen])) if seen.any() else 0.0,
        )


class ResidualDisparityCriterion(AcceptanceCriterion):
    """Largest absolute disparity after registration by the rounded mean, px per step."""

    unit: ClassVar[str] = " px per step"

    kind: Literal["residual_disparity"] = "residual_disparity"

    def measured(self, look: GeometryPreview) -> Iterable[tuple[str, float]]:
        """Return the largest absolute value over all visible pixels."""
        disparity = look.truth("disparity")[look.object_id >= 0] * look.scale
        yield "residual disparity", float(np.abs(disparity - np.round(disparity.mean())).max(initial=0.0))


class VisibleFractionCriterion(ObjectCriterion):
    """Visible fraction of an object's silhouette in the reference camera at the reference frame, from 0 to 1.

    Parts outside the image or hidden by other objects are not visible; self-occlusion is ignored.
    """

    kind: Literal["visible_share"] = "visible_share"

    def measured(self, look: GeometryPreview) -> Iterable[tuple[str, float]]:
        """Return the fraction of every object."""
        for number in self._matching(look):
            yield f"visible share of {look.names[number]}", look.visible_share(number)


class TextureWavelengthCriterion(ObjectCriterion):
    """Shortest and longest wavelength of an object's texture in the image, px, at its largest and smallest depth."""

    unit: ClassVar[str] = " px"

    kind: Literal["wavelength"] = "wavelength"

    def measured(self, look: GeometryPreview) -> Iterable[tuple[str, float]]:
        """Return both limits for every visible textured object; foreshortening is ignored."""
        for number in self._matching(look):
            ends, seen = look.wavelengths_mm(number), look.truth("depth")[look.object_id == number]
            if ends is not None and seen.size:
                focal = look.scene.camera.focal_px
                yield f"wavelength of {look.names[number]}", ends[0] * focal / float(seen.max())
                yield f"wavelength of {look.names[number]}", ends[1] * focal / float(seen.min())
