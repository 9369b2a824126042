"""Which objects are all edge, so that scores of the interior say nothing of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.mesh.file import FileMesh
from scenetruth.scene.world import World

__all__ = ["interior_warnings"]

# A body with a silhouette only has a smaller share of mixed pixels, unless it is tiny.
_MANY_EDGES = 0.25


def interior_warnings(
    world: World, object_id: NDArray[np.integer[Any]], boundary_distance: NDArray[np.float64], margin_px: float
) -> list[str]:
    """Return a warning that names the objects which are seen, but have no pixel in the interior.

    Parameters
    ----------
    world
        The scene's objects.
    object_id
        Number of the object at every pixel of one image, shape (height, width); -1 for none.
    boundary_distance
        How far the nearest mixed pixel is in px, same shape; 0 for mixed pixels.
    margin_px
        Least distance of the interior's pixels from mixed ones, ``score.interior_margin_px``.

    Returns
    -------
    list of str
        One line, or none.
    """
    without, faceted = [], []
    for index, body in enumerate(world.bodies):
        distances = boundary_distance[object_id == index]
        if not distances.size or distances.max() >= margin_px:
            continue
        without.append(body.name)
        if isinstance(body.mesh.source, FileMesh) and np.mean(distances == 0) > _MANY_EDGES:
            faceted.append(body.name)
    if not without:
        return []
    message = (
        f"objects: {_listed(without)} without interior pixels: all that is seen at the reference frame is less than "
        f"{margin_px:g} px from a mixed pixel, so that scores of the interior say nothing of it; use a nearer camera, "
        "a longer focal length or a smaller score.interior_margin_px"
    )
    if faceted:
        message += f"; many pixels of {_listed(faceted)} are mixed: use a larger crease_deg if its surface is smooth"
    return [message]


def _listed(names: list[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)
