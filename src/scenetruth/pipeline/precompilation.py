"""Precompilation of the numba kernels, by a small example of each type of task."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from scenetruth.progress import Progress

if TYPE_CHECKING:
    import xarray as xr

    from scenetruth.estimators import MethodChoice

__all__ = ["compile_late_truth_kernels", "compile_method", "precompile", "small_recording"]

_SMALL: dict[str, Any] = {
    "camera": {"width": 48, "height": 36, "focal_length_px": 240.0},
    "stage": {"positions": 3, "baseline_mm": 5.0},
    "frames": {"count": 3, "frame_interval_s": 60.0},
    "render": {"backend": "raycast"},
    "seed": 1,
}
_LARGEST_METHOD = "refined"  # its kernels take as long as all others
_NOISE: dict[str, Any] = {"kind": "noise", "wavelength_mm": [3, 15], "rms_contrast": 0.2}
_SHEET: dict[str, Any] = {
    "name": "sheet",
    "mesh": {"kind": "plane", "size_mm": [300, 240], "resolution_mm": 12.0},
    "pose": {"position_mm": [0, 0, 400], "rotations": [{"axis": [0, 1, 0], "angle_deg": 10}]},
    "texture": _NOISE,
}
_MOVING: dict[str, Any] = {"motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.3, 0, -0.5]}]}
_SCENES: dict[str, dict[str, Any]] = {
    "cube": {
        **_SMALL,
        "objects": [
            {**_SHEET, **_MOVING},
            {
                "name": "cube",
                "mesh": {"kind": "box", "size_mm": [60, 60, 60]},
                "pose": {"position_mm": [0, 0, 330], "rotations": [{"axis": [0, 1, 0], "angle_deg": 30}]},
                "texture": _NOISE,
                **_MOVING,
            },
        ],
        "lighting": {"ambient": 0.3, "lights": [{"kind": "directional", "direction": [0, 0.3, 1], "irradiance": 0.7}]},
        "optics": {"psf": {"kind": "gaussian", "sigma_px": 0.7}},
        "camera": {**_SMALL["camera"], "distortion": {"k1": -0.1}},
        "sensor": {"bit_depth": 8, "noise_std": 0.005},
    },
    "leaf": {
        **_SMALL,
        "objects": [
            {
                "name": "leaf",
                "mesh": {"kind": "leaf", "length_mm": 70, "width_mm": 60, "resolution_mm": 3.0},
                "pose": {"position_mm": [-20, 0, 380]},
                "texture": {"kind": "leaf", "channel": "green"},
                "deformation": [{"kind": "growth", "rate_per_hour": 0.03}],
            },
            _SHEET,
        ],
        "sensor": "ideal",
    },
}

# Rendered only: light does not change what methods need.
_LAMP: dict[str, Any] = {
    **_SCENES["cube"],
    "objects": [{**_SHEET, "material": {"refractive_index": 1.5, "roughness": 0.25}}, _SCENES["cube"]["objects"][1]],
    "stage": {"positions": 1, "baseline_mm": 5.0},
    "frames": {"count": 1, "frame_interval_s": 60.0},
    "lighting": {
        "lights": [
            {
                "kind": "disc",
                "radius_mm": 40,
                "position_mm": [40, -30, 0],
                "direction": [0, 0, 1],
                "irradiance": 0.8,
                "reference_distance_mm": 400,
            }
        ]
    },
}


class SecondProcess(Protocol):
    """Part of `FigureWorker` that compiles."""

    def compile_method(self, choice: MethodChoice, dtype: str) -> None: ...

    def wait(self) -> None: ...


def precompile(progress: Progress | None = None, helper: SecondProcess | None = None) -> list[str]:
    """Compile the kernels of scenes, truth, methods and scores with numba (1 to 2 min), or load them from the cache.

    ``helper``: Second process, which compiles the method with most kernels meanwhile.
    """
    from scenetruth.errors import EstimateError
    from scenetruth.estimators import choose, estimate, list_methods
    from scenetruth.scene import Scene
    from scenetruth.scoring import score
    from scenetruth.simulation import simulate
    from scenetruth.strain import compute_strain

    methods = [entry.name for entry in list_methods() if entry.origin == "scenetruth"]
    steps = 1 + len(_SCENES) * (1 + len(methods))
    done: list[str] = []

    def tell(what: str) -> None:
        if progress is not None:
            progress("precompile", len(done), steps)
        done.append(what)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if helper is not None:
            helper.compile_method(choose({"method": _LARGEST_METHOD}), "uint8")
        simulated = {}
        for name, plain in _SCENES.items():
            tell(f"{name}: images and truth")
            simulated[name] = simulate(Scene.from_dict(plain))
        tell("lamp: images and truth")
        simulate(Scene.from_dict(_LAMP))
        # The method of the second process comes last, so that no kernel is compiled by both.
        for method in sorted(methods, key=lambda method: method == _LARGEST_METHOD):
            if method == _LARGEST_METHOD and helper is not None:
                helper.wait()
            for name, (recording, truth) in simulated.items():
                tell(f"{name}: {method}")
                # Packages of extras may be missing.
                with suppress(EstimateError):
                    found = estimate(recording, method)
                    score(found, truth, settings={"interior_margin_px": 2})
                    if {"depth", "velocity_std"} <= set(found):
                        compute_strain(found, settings={"window": 5})
    if progress is not None:
        progress("precompile", steps, steps)
    return done


def compile_method(method: str, settings: Mapping[str, Any], dtype: str) -> None:
    """Compile the kernels of one method by an estimate of a few small images."""
    from scenetruth.estimators import estimate

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        estimate(small_recording(dtype), method, dict(settings))


def small_recording(dtype: str) -> xr.Dataset:
    """Return a small recording of the given type that every method can estimate."""
    from scenetruth.schema import make_recording

    # Noise smoothed by a binomial filter along both axes.
    wide = np.random.default_rng(0).normal(size=(60, 108))
    for _ in range(6):
        wide = wide[2:] + 2 * wide[1:-1] + wide[:-2]
        wide = wide[:, 2:] + 2 * wide[:, 1:-1] + wide[:, :-2]
    wide = 0.5 + 0.15 * wide / wide.std()
    # Disparity 2 px, and flow of 1 px per frame to the right.
    images = np.array([[wide[:, 16 + 2 * s - t : 80 + 2 * s - t] for t in range(-2, 3)] for s in range(-2, 3)])
    scale = 1.0 if np.dtype(dtype).kind == "f" else float(np.iinfo(dtype).max)
    return make_recording(
        (scale * np.clip(images, 0, 1)).astype(dtype), focal_length_px=240.0, baseline_mm=5.0, full_scale=scale
    )


def compile_late_truth_kernels() -> None:
    """Compile the kernels that the truth needs last: those for visibility in other cameras."""
    from scenetruth.scene import Scene
    from scenetruth.truth import compile_visibility

    compile_visibility(Scene.from_dict(_SCENES["cube"]))
