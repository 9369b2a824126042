"""Provenance of results: hashes of scenes and recordings, versions of packages, attributes of stores."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
from collections.abc import Mapping
from contextlib import suppress
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scenetruth.camera import Schedule, build_sensor_chain
from scenetruth.input_files import collect_input_files
from scenetruth.random_streams import generator_for
from scenetruth.scene.scene_models import Scene
from scenetruth.schema import DatasetOutline, Intrinsics, blank_map, digest, make_outline, tolerance_attributes

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "acquisition_attributes",
    "blank_recording",
    "build_schedule",
    "content_hash",
    "intrinsics_from",
    "outline_recording",
    "own_release",
    "provenance_attributes",
    "recording_hash",
    "scene_hash",
]

_PACKAGES = (
    "scenetruth",
    "numpy",
    "scipy",
    "numba",
    "xarray",
    "zarr",
    "trimesh",
    "embreex",
    "pyrender-maintained",
    "PyOpenGL",
)
_WITHOUT_EFFECT = ("format", "description", "estimate", "score", "storage")
"""Sections of a scene without effect on images and truth."""


def build_schedule(scene: Scene) -> Schedule:
    """Return the nominal and actual poses and times of a scene's images."""
    return Schedule(scene.stage, scene.frames, partial(generator_for, scene.seed, "stage"))


def intrinsics_from(scene: Scene) -> Intrinsics:
    """Return the intrinsics of a scene's camera and stage."""
    camera = scene.camera
    return Intrinsics(camera.focal_px, camera.principal_point, scene.stage.baseline_mm, scene.frames.frame_interval_s)


def blank_recording(scene: Scene) -> xr.Dataset:
    """Return the recording of a scene with blank images that occupy no memory."""
    return outline_recording(scene).dataset()


def outline_recording(
    scene: Scene, attrs: Mapping[str, Any] | None = None, *, save_radiance: bool = False
) -> DatasetOutline:
    """Return the outline of the recording of a scene, with blank images that occupy no memory."""
    camera, stage, sensor = scene.camera, scene.stage, build_sensor_chain(scene.sensor)
    rows = (stage.rows,) if stage.rows > 1 else ()
    shape = (*rows, stage.positions, scene.frames.count, camera.height, camera.width)
    channels = sensor.channels(camera.bands)
    arrays = {"image": blank_map(sensor.dtype, (*shape, len(channels)) if channels else shape)}
    schedule = build_schedule(scene)
    times = np.array(
        [
            [[schedule.planned_time_s(s, t, s_y) for t in scene.frames.t.tolist()] for s in stage.s.tolist()]
            for s_y in stage.s_y.tolist()
        ]
    )
    if save_radiance:
        arrays["radiance"] = blank_map(np.float32, (*shape, len(camera.bands)) if camera.bands else shape)
    return make_outline(
        "recording",
        arrays,
        intrinsics_from(scene),
        t=scene.frames.t,
        s=stage.s,
        stage_x_mm=stage.x_mm,
        stage_y_mm=stage.y_mm if rows else None,
        planned_time_s=times if rows else times[0],
        channel=channels or camera.bands or None,
        attrs={"full_scale": float(sensor.full_scale), **acquisition_attributes(scene), **(attrs or {})},
    )


def acquisition_attributes(scene: Scene) -> dict[str, Any]:
    """Return what a laboratory would know about stage, lens, shutter and demosaicing.

    Errors are given by their statistics, not by their draws.
    """
    found: dict[str, Any] = dict(tolerance_attributes(scene.stage.stated_tolerances()))
    if scene.camera.distortion is not None:
        found["distortion"] = list(scene.camera.distortion.coefficients)
    demosaicing = build_sensor_chain(scene.sensor).demosaicing
    if demosaicing:
        found["demosaicing"] = demosaicing
    if scene.shutter.readout_time_s > 0:
        found["line_time_s"] = scene.shutter.readout_time_s / max(scene.camera.height - 1, 1)
        if scene.shutter.stage_speed_mm_per_s != 0:
            found["stage_speed_mm_per_s"] = scene.shutter.stage_speed_mm_per_s
    return found


def scene_hash(scene: Scene) -> str:
    """Return the hash of everything in a scene that determines images and truth, 16 hexadecimal digits.

    Estimation, scoring and descriptions are excluded. Files are hashed by content, not by name or path.
    """
    plain = scene.to_dict()
    for where, file in collect_input_files(scene):
        place: Any = plain
        *path, last = where.split(".")
        for key in path:
            place = place[int(key) if isinstance(place, list) else key]
        place[int(last) if isinstance(place, list) else last] = content_hash(file)
    return digest({name: value for name, value in plain.items() if name not in _WITHOUT_EFFECT})


def recording_hash(scene_hash: str, backend: str) -> str:
    """Return the hash of everything that determines the images: scene and rendering backend."""
    return digest([scene_hash, backend])


def provenance_attributes(scene: Scene) -> dict[str, Any]:
    """Return the attributes that describe the provenance of a data set."""
    return {
        "scene": json.dumps(scene.to_dict()),
        "scene_hash": scene_hash(scene),
        "seed": scene.seed,
        "versions": _installed_versions(),
    }


@cache
def _installed_versions() -> str:
    """Return the versions of packages that results depend on, as JSON: reading them takes as long as a small image."""
    versions = {"python": platform.python_version()}
    for name in _PACKAGES:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return json.dumps(versions)


def own_release() -> str:
    """Return the base release: 0.3.0 for 0.3.0.dev7+g1a2b3c4. Its commits share caches and interrupted work."""
    return re.sub(r"((\.post\d+)?\.dev\d+)?(\+.*)?$", "", version("scenetruth"))


def content_hash(path: Path) -> str:
    """Return a hash of the content of a file, of the files that it references, and of its suffix.

    A directory is hashed with all its files, such as a zarr store; a missing file by its name.
    """
    if not path.exists():
        return f"missing: {path.name}"
    found = hashlib.sha256()
    files = sorted(item for item in path.rglob("*") if item.is_file()) if path.is_dir() else [path, *_referred_to(path)]
    for file in files:
        found.update((str(file.relative_to(path)) if path.is_dir() else file.suffix).encode())
        if os.path.isfile(file):
            with file.open("rb") as stream:
                found.update(hashlib.file_digest(stream, "sha256").digest())
    return found.hexdigest() + path.suffix.lower()


def _referred_to(path: Path) -> list[Path]:
    """Return the files referenced by a mesh file."""
    from scenetruth.scene.mesh.mesh_file import list_referenced_files

    return list_referenced_files(path) if path.suffix.lower() in (".obj", ".ply", ".gltf", ".glb") else []
