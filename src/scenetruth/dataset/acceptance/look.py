"""A scene seen by its geometry alone: the exact truth of the reference image, at fewer pixels; nothing is painted."""

from __future__ import annotations

import warnings
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera
from scenetruth.raycast import RayCaster, Topology
from scenetruth.scene import Scene
from scenetruth.scene.check import check_scene
from scenetruth.scene.world import build_world
from scenetruth.schema import Filling
from scenetruth.truth import TruthChoice, blank_truth, fill_truth

__all__ = ["Look"]

_WIDTH_PX = 160
"""Most pixels along a side: shares of an object of a tenth of the image's width are then known to a few per cent."""
_FARTHEST = 4.0
"""How far beyond the image, in its sizes, silhouettes are followed."""


class Look:
    """What the reference camera sees of a scene at the reference frame.

    Meshes, motions and rays are those of the truth; the image has at most 160 px along a side, pixels count by their
    centres.

    Parameters
    ----------
    scene
        The scene.

    Raises
    ------
    SceneError
        If the scene cannot be made, or nothing of it can be seen.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._small = scene.shrunk_to(_WIDTH_PX)
        self.scale = scene.camera.width / self._small.camera.width
        """Pixels of the camera per pixel of this picture."""
        self.world = build_world(scene, painted=False)
        with warnings.catch_warnings():
            # Of textures; they are told of when the sample is made.
            warnings.simplefilter("ignore")
            check_scene(scene, self.world)
        self.names = [body.name for body in self.world.bodies]

    def truth(self, name: str) -> NDArray[Any]:
        """Return a map of the truth, lengths in its small pixels: times `scale` they are the camera's."""
        found: NDArray[Any] = self._truth[name].values[..., 0, :, :]
        return found

    @property
    def object_id(self) -> NDArray[Any]:
        """Which object every pixel shows, -1 for none."""
        return self.truth("object_id")

    @cached_property
    def _truth(self) -> Any:
        filling = Filling(blank_truth(self._small, TruthChoice(), {}))
        fill_truth(self._small, self.world, TruthChoice(), filling.put)
        return filling.dataset()

    def visible_share(self, number: int) -> float:
        """Return how much of an object's silhouette is seen, from 0 to 1."""
        alone = self._silhouette(number)
        return float(np.count_nonzero(self.object_id == number) / alone) if alone else 0.0

    def wavelengths_mm(self, number: int) -> tuple[float, float] | None:
        """Return the shortest and longest wavelength of an object's texture; None for one without."""
        items = {item.name: item for _, item in self.scene.parts}
        return items[self.names[number]].texture.shortest_and_longest_mm

    def _silhouette(self, number: int) -> int:
        """Return how many pixels an object would cover alone, in an image that is as large as it needs."""
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
    """Return the camera with an image that reaches from one pixel to another, outside of its own too."""
    x, y = camera.principal_point
    width, height = (int(b - a + 1) for a, b in zip(low, high, strict=True))
    return camera.model_copy(
        update={"width": width, "height": height, "principal_point_px": (x - float(low[0]), y - float(low[1]))}
    )
