"""Scenes in which only some causes of errors are on."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from scenetruth.camera import chain_of
from scenetruth.design.budget.cause import all_causes
from scenetruth.scene import Scene, scene_from_plain

__all__ = ["scene_with"]


def scene_with(scene: Scene, kinds: Collection[str], seed: int | None = None) -> Scene:
    """Return a scene with no other causes of errors than some.

    Parameters
    ----------
    scene
        The scene with all of them.
    kinds
        The causes that stay on.
    seed
        Of all its random numbers; the scene's own if not given.

    Returns
    -------
    Scene
        Its sensor is a chain of those effects that stay. Images are ray-cast unless the scene says otherwise: where
        backends differ, their difference must not be taken for a cause.
    """
    plain: dict[str, Any] = scene.to_plain()
    if plain["sensor"] != "ideal":
        plain["sensor"] = chain_of(scene.sensor).model_dump(mode="json")
    for cause in all_causes().values():
        if cause.kind not in kinds:
            cause.switch_off(plain)
    if plain["render"]["backend"] == "auto":
        plain["render"]["backend"] = "raycast"
    if seed is not None:
        plain["seed"] = seed
    return scene_from_plain(plain)
