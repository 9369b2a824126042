"""Modules that the process from which workers are forked imports, once for all of them."""

from __future__ import annotations

import gc
from contextlib import suppress
from importlib import import_module

from numpy import float32

__all__ = ["import_for_workers"]

# Simulations are what most tasks consist of; the others are imported by their tasks.
_MODULES = (
    "scenetruth.simulation",
    "scenetruth.render.raycast_backend",
    "scenetruth.render.adaptive_raycast",
    "scenetruth.truth.geometry_maps",
    "scenetruth.truth.map_kernels",
    "scenetruth.dataset.samples",
    "scipy.sparse.csgraph",
    "zarr",
)


def import_for_workers() -> None:
    """Import modules, and load a kernel and with it the libraries of the compiler.

    What fails here fails again, and is reported, where it is used. The collector neither runs during the imports nor
    visits their objects later: workers share memory that they do not write to. No threads are started, because a forked
    process would not have them.
    """
    gc.disable()
    try:
        with suppress(Exception):
            for name in _MODULES:
                import_module(name)
            import_module("scenetruth.scene.texture.texture_kernels").cubic_weights(float32(0.5))
    finally:
        gc.freeze()
        gc.enable()


import_for_workers()
