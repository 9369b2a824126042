"""One scene file tried: it becomes a world that can be rendered, or is refused by an error of ours."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import scenetruth as st
from scenetruth.camera import Viewpoint
from scenetruth.errors import SceneWarning
from scenetruth.raycast import Topology
from scenetruth.resources import Limits, compute_workload, estimate_cost, limited_objects
from scenetruth.resources.quick_preview import make_quick_preview
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.leaf import LeafForm
from scenetruth.scene.scene_report import check_scene, describe_scene
from scenetruth.truth import GeometryPass, truth_maps

__all__ = ["MOST_FACES", "MOST_PIXELS", "MOST_TEXELS", "MOST_VERTICES_IN_TIME", "OUTCOMES", "try_scene"]

OUTCOMES = ("refused", "large", "refused when made", "made")
"""What may become of a scene file."""

MOST_PIXELS, MOST_FACES, MOST_TEXELS, MOST_VERTICES_IN_TIME = 20_000, 100_000, 4_000_000, 500_000
"""Scenes of more are loaded, but not made: whatever their size, they are right."""


def try_scene(file: Path, smaller: float = 1.0) -> str:
    """Load a scene file, and do what ``scenetruth check`` does unless it is large.

    Parameters
    ----------
    file
        The file.
    smaller
        By how much the bounds of what is made are smaller.

    Returns
    -------
    str
        ``refused``, ``large`` (loaded only), ``refused when made`` or ``made``. Any error but ours is not caught.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", SceneWarning)
        try:
            scene = st.load_scene(file)
        except st.SceneError as error:
            _is_told(error)
            return "refused"
        repr(scene), scene._repr_html_(), hash(scene)
        assert st.Scene.from_dict(scene.to_dict()) == scene
        try:
            parts = limited_objects(scene, Limits())
            estimate_cost(compute_workload(scene, parts), ["render"], slower=1.0)
            preview = make_quick_preview(scene, parts)
            describe_scene(scene, preview.world, preview.depth, preview.times)
        except st.SceneError as error:
            _is_told(error)
        if is_large(scene, smaller):
            return "large"
        try:
            world = build_scene(scene)
            check_scene(scene, world)
            at = world.at(0)
            geometry = GeometryPass(world, Topology.of(at.vertices_mm, world.faces, world.crease_deg), 0.0)
            maps = truth_maps(geometry, scene.camera, Viewpoint.on_axis(0.0), scene.stage.baseline_mm, "standard")
            describe_scene(scene, world, maps["depth"])
        except st.SceneError as error:
            _is_told(error)
            return "refused when made"
        assert np.isfinite(at.vertices_mm).all()
        seen = maps["object_id"] >= 0
        assert np.isfinite(maps["depth"][seen]).all()
        assert (maps["depth"][seen] > 0).all()
        return "made"


def _is_told(error: st.SceneError) -> None:
    """Check that an error has something to say, is of a size to be read, and does nothing to a terminal."""
    text = str(error)
    assert error.problems
    assert len(text) < 200_000
    assert text.replace("\n", "").isprintable()


def is_large(scene: Scene, smaller: float = 1.0) -> bool:
    """Whether a scene would take more than a moment to make."""
    faces = [faces_of(item.mesh) for _, item in scene.parts]
    moments = scene.frames.count + 2
    return (
        scene.camera.width * scene.camera.height > MOST_PIXELS / smaller
        or sum(faces) > MOST_FACES / smaller
        or sum(faces) * moments > MOST_VERTICES_IN_TIME / smaller
        or moments * len(scene.parts) > 500 / smaller
        or scene.stage.positions * scene.stage.rows * moments * len(scene.parts) > 40_000 / smaller
        or sum(texels_of(item) for _, item in scene.parts) > MOST_TEXELS / smaller
    )


def faces_of(mesh: Any) -> Any:
    """About how many triangles a mesh has; files are what they are."""
    resolution = getattr(mesh, "resolution_mm", None)
    if isinstance(mesh, LeafForm):
        petiole = 0.0 if mesh.petiole is None else mesh.petiole.length_mm
        return 4 * mesh.full_width_mm * (mesh.length_mm + petiole) / mesh.resolution_mm**2
    if mesh.kind == "stairs":
        return 4.0 * len(mesh.steps_mm)
    if mesh.kind == "file":
        return Path(mesh.file).stat().st_size / 20 if Path(mesh.file).is_file() else 0
    if resolution is None:
        return 12
    match mesh.kind:
        case "sphere":
            area = 4 * math.pi * mesh.radius_mm**2
        case "cylinder":
            area = 2 * math.pi * mesh.radius_mm * max(mesh.length_mm, resolution)
        case "torus":
            area = 40 * (mesh.ring_radius_mm + mesh.tube_radius_mm) * mesh.tube_radius_mm
        case _:
            area = mesh.size_mm[0] * mesh.size_mm[1]
    return 4 * area / resolution**2


def texels_of(item: Any) -> Any:
    """About how many texels a texture has."""
    texture, mesh = item.texture, item.mesh
    match texture.kind:
        case "noise":
            # Whatever the surface, it repeats beyond this.
            return min(max(4 * texture.wavelength_mm[1], extent_of(mesh)) * 16 / texture.wavelength_mm[0], 4096.0) ** 2
        case "leaf" if isinstance(mesh, LeafForm):
            petiole = 0.0 if mesh.petiole is None else mesh.petiole.length_mm
            density = texture.texels_per_mm
            shortest, longest = texture.mottling_wavelength_mm
            noise = min(max(4 * longest, 2 * mesh.length_mm) * 16 / shortest, 4096.0) ** 2
            # By default, what fits into millions.
            blade = 4e6 if density is None else 2 * (mesh.length_mm + petiole) * mesh.full_width_mm * density**2
            return blade + 2 * noise
    return 0


def extent_of(mesh: Any) -> Any:
    """About how large the chart of a mesh is."""
    lengths = [getattr(mesh, name, 0.0) for name in ("radius_mm", "length_mm", "ring_radius_mm")]
    return 3 * max(*lengths, *getattr(mesh, "size_mm", (0.0,)), *getattr(mesh, "tread_mm", (0.0,)), 1.0)
