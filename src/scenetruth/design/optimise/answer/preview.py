"""A scene to look at before the recommended rig is rendered as a whole: a part of its images, and fewer samples."""

from __future__ import annotations

from scenetruth.design.optimise.confirm.lighter import Lighter, lighter
from scenetruth.design.optimise.goal.parts import Confirm
from scenetruth.design.optimise.result import Design
from scenetruth.scene import scene_from_plain

__all__ = ["PREVIEW", "preview_of"]

PREVIEW = "recommended_preview.yaml"
"""File of the preview."""


def preview_of(design: Design) -> Lighter:
    """Return what is rendered quickly of the recommended rig: that of which simulations are made.

    Parameters
    ----------
    design
        The design. Images are cut as its goal says, to the usual size where that leaves them whole.

    Raises
    ------
    SceneError
        If the scene of the recommended rig cannot be made.
    """
    most_px = (design.goal.get("confirm") or {}).get("most_px") or Confirm().most_px
    return lighter(scene_from_plain(design.recommended.scene), design.objectives[0].region, most_px)
