"""Rendered scenes with exact ground truth for measuring depth and 3D motion from a camera on a linear stage."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenetruth.camera import two_point_correction
    from scenetruth.errors import (
        BackendUnavailableError,
        EstimateError,
        OutputExistsError,
        Problem,
        RecordingError,
        RenderError,
        SceneError,
        ScenetruthError,
        SceneWarning,
        ScoreError,
        StoreError,
    )
    from scenetruth.estimate import estimate
    from scenetruth.recording import make_recording
    from scenetruth.scene import Scene, load_scene, scene_from_plain
    from scenetruth.score import Score, score
    from scenetruth.simulate import simulate
    from scenetruth.storage import load, save
    from scenetruth.truth import track_points

__version__ = "0.1.0"

__all__ = [
    "BackendUnavailableError",
    "EstimateError",
    "OutputExistsError",
    "Problem",
    "RecordingError",
    "RenderError",
    "Scene",
    "SceneError",
    "SceneWarning",
    "ScenetruthError",
    "Score",
    "ScoreError",
    "StoreError",
    "estimate",
    "load",
    "load_scene",
    "make_recording",
    "save",
    "scene_from_plain",
    "score",
    "simulate",
    "track_points",
    "two_point_correction",
]

_HOMES = {
    "Scene": "scene",
    "load_scene": "scene",
    "scene_from_plain": "scene",
    "simulate": "simulate",
    "make_recording": "recording",
    "estimate": "estimate",
    "Score": "score",
    "score": "score",
    "load": "storage",
    "save": "storage",
    "track_points": "truth",
    "two_point_correction": "camera",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        msg = f"module 'scenetruth' has no attribute '{name}'"
        raise AttributeError(msg)
    value = getattr(import_module(f"scenetruth.{_HOMES.get(name, 'errors')}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """The package itself; keeps functions such as ``estimate`` from being hidden by the rooms of the same name."""

    def __setattr__(self, name: str, value: Any) -> None:
        # The import system binds every imported submodule as an attribute of its package.
        if name in _HOMES and isinstance(value, ModuleType):
            return
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
