"""Exact strain of the surfaces of a ground truth, from the geometry of a scene and from its rates of growth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import Problem, ScoreError
from scenetruth.schema import label
from scenetruth.strain.camera_rays import CameraRays
from scenetruth.strain.computation import STRAIN_NO_ESTIMATE, STRAIN_NONE, reference_view
from scenetruth.strain.gauge import StrainSettings, strain_settings
from scenetruth.strain.strain_tensors import COMPONENTS_OF_STRAIN, PRINCIPAL, SurfaceStrain, principal_strain

if TYPE_CHECKING:
    from scenetruth.scene import SceneLike

__all__ = ["compute_true_strain", "rate_of_growth"]

Map = NDArray[np.float64]

_LINEAGE = ("scene_hash", "recording_hash", "scene", "seed", "truth_poses")


def compute_true_strain(
    truth: xr.Dataset,
    scene: SceneLike | None = None,
    *,
    settings: StrainSettings | Mapping[str, Any] | None = None,
    times: Sequence[float] | None = None,
) -> xr.Dataset:
    """Return the exact strain at every pixel of a truth, without a window.

    Strains are those of the triangle that a pixel shows, from the positions of its corners; the triangles approximate a
    curved surface to second order. The rate (``measure="rate"``) follows from the principal growth rates of the truth.

    Parameters
    ----------
    truth
        A truth; of all cameras, the reference camera is used.
    scene
        Its scene; not used by the rate.
    settings
        Only the measure is used.
    times
        Time of the deformed configuration for every frame of the truth, in frames; default: one frame later.

    Returns
    -------
    xarray.Dataset
        As `compute_strain`, at all pixels with a surface.

    Raises
    ------
    ScoreError
        If the truth lacks maps, if a scene is missing, or if the times are invalid.
    SceneError
        If the scene is invalid.

    See Also
    --------
    compute_strain : Strain from points and displacements in windows.

    Examples
    --------
    A sheet whose area grows by 3 % per hour, with one frame per hour:

    >>> import scenetruth as st
    >>> item = {"mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}, "name": "sheet"}
    >>> item |= {"pose": {"position_mm": [0, 0, 100]}, "deformation": [{"kind": "growth", "rate_per_hour": 0.03}]}
    >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 60}, "objects": [item]}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "render": {"backend": "raycast"}}
    >>> scene = st.Scene.from_dict(plain | {"frames": {"count": 3, "frame_interval_s": 3600}})
    >>> strain = compute_true_strain(st.make_truth(scene), scene, settings={"measure": "hencky"})
    >>> strain.exx.sel(t=0, y=15, x=20).round(9).item()
    0.015
    """
    chosen = strain_settings(settings)
    needs = ("object_id", "face_id", "barycentric") if chosen.measure != "rate" else _RATES
    remedy = "" if chosen.measure != "rate" else "; compute the truth with truth_content='complete'"
    problems = [Problem(name, f"is missing{remedy}") for name in ("depth", "normal", *needs) if name not in truth]
    if chosen.measure != "rate" and scene is None:
        problems.append(Problem("scene", "is missing; strains follow from its geometry"))
    frames = [int(t) for t in truth["t"].values]
    later = [t + 1.0 for t in frames] if times is None else [float(time) for time in times]
    if len(later) != len(frames) or not np.isfinite(later).all():
        problems.append(Problem("times", f"must be {len(frames)} finite numbers, one for every frame", times))
    if problems:
        raise ScoreError(problems, source="truth")
    view = reference_view(truth)
    if chosen.measure == "rate":
        found = [_rate(view.isel(t=n)) for n in range(len(frames))]
        moved = view["velocity"].values.astype(np.float64)
    else:
        assert scene is not None  # checked above
        found, moved = _finite(view, truth, scene, later, chosen)
    camera = CameraRays.of(view)
    intrinsics, grid = camera.intrinsics, camera.grid
    strain = np.stack(found, axis=1)
    principal = principal_strain(strain)
    columns = dict(zip(COMPONENTS_OF_STRAIN, strain, strict=True))
    columns |= dict(zip(PRINCIPAL, (principal.larger, principal.smaller, principal.angle), strict=True))
    valid = np.isfinite(strain).all(axis=0)
    depths = view["depth"].values.astype(np.float64)
    points = np.stack([camera.points(depth) for depth in depths], axis=1)
    arrays: dict[str, Any] = {
        **columns,
        "valid": valid,
        "invalid_reason": np.where(valid, STRAIN_NONE, STRAIN_NO_ESTIMATE).astype(np.uint8),
        "point": points,
        "displacement": moved,
    }
    attrs: dict[str, Any] = {name: truth.attrs[name] for name in _LINEAGE if name in truth.attrs}
    attrs |= {"measure": chosen.measure, "displacement_source": "geometry of the scene", "gauge_length_px": 0.0}
    made = label("strain", arrays, intrinsics, t=frames, x=grid.x, y=grid.y, attrs=attrs)
    for name in (*COMPONENTS_OF_STRAIN, "e1", "e2"):
        made[name].attrs["units"] = chosen.units
    return made


_RATES = ("principal_growth_rates", "principal_growth_direction", "velocity")


def _axes(normal: Map) -> Map:
    """Return the axes x and y of the tangent planes with normals towards the camera, shape (2, 3, n)."""
    along = np.array([1.0, 0.0, 0.0])[:, None] - normal[0] * normal
    with np.errstate(invalid="ignore"):
        along = along / np.linalg.norm(along, axis=0)
    return np.stack([along, np.cross(-normal, along, axis=0)])


def _rate(frame: xr.Dataset) -> Map:
    """Return the rate of deformation (xx, yy, xy) of a frame, shape (3, y, x)."""
    shape = frame["depth"].shape
    arrays = (frame[name].values.astype(np.float64).reshape(-1, *shape) for name in ("normal", *_RATES[:2]))
    normal, rates, direction = (values.reshape(len(values), -1) for values in arrays)
    return rate_of_growth(normal, rates, direction).reshape(3, *shape)


def rate_of_growth(normal: Map, rates: Map, direction: Map) -> Map:
    """Return the rate of deformation (xx, yy, xy) with principal rates (2, n) and the direction of the first (3, n)."""
    along = np.einsum("acn,cn->an", _axes(normal), direction)
    with np.errstate(invalid="ignore"):
        along = along / np.linalg.norm(along, axis=0)
    # Without a direction, both rates are equal.
    along = np.where(np.isfinite(along), along, np.array([[1.0], [0.0]]))
    cos, sin = along
    larger, smaller = rates
    return np.stack(
        [larger * cos**2 + smaller * sin**2, larger * sin**2 + smaller * cos**2, (larger - smaller) * cos * sin]
    )


def _finite(
    view: xr.Dataset, truth: xr.Dataset, scene: SceneLike, later: Sequence[float], chosen: StrainSettings
) -> tuple[list[Map], Map]:
    """Return the strains of all frames, each (3, y, x), and the displacements of points (3, t, y, x)."""
    from scenetruth.scene import load_scene
    from scenetruth.scene.built_scene import build_scene

    world = build_scene(load_scene(scene))
    found, moves = [], []
    for n, t in enumerate(view["t"].values):
        frame = view.isel(t=n)
        turn = _camera_axes(truth, n)
        body = frame["object_id"].values
        here = body >= 0
        face = world.faces[world.face_offsets[body[here]] + frame["face_id"].values[here]]
        before, after = (world.at(float(time)).vertices_mm @ turn for time in (t, later[n]))
        corners = np.stack([before[face], after[face] - before[face]])
        sides = corners[:, :, 1:] - corners[:, :, :1]
        points, moved = sides.transpose(0, 2, 3, 1).copy()
        # The order of the corners decides on which side the normal is.
        towards = np.einsum("cn,cn->n", np.cross(points[0], points[1], axis=0), frame["normal"].values[:, here]) > 0
        points[:, :, towards], moved[:, :, towards] = points[::-1][:, :, towards], moved[::-1][:, :, towards]
        strain = np.full((3, *body.shape), np.nan)
        strain[:, here] = SurfaceStrain(points, moved, chosen.measure).values()
        found.append(strain)
        weights = frame["barycentric"].values[:, here]
        step = corners[1, :, 0] + np.einsum("kn,nkc->nc", weights, sides[1])
        move = np.full((3, *body.shape), np.nan)
        move[:, here] = step.T
        moves.append(move)
    return found, np.stack(moves, axis=1)


def _camera_axes(truth: xr.Dataset, n: int) -> Map:
    """Return the axes of the reference camera in the world, as columns."""
    if "camera_rotation_rad" not in truth or truth.attrs.get("truth_poses", "actual") != "actual":
        return np.eye(3)
    from scipy.spatial.transform import Rotation

    turn = truth["camera_rotation_rad"].isel(t=n)
    turn = turn.sel({dim: 0 for dim in ("s_y", "s") if dim in turn.dims})
    return np.asarray(Rotation.from_rotvec(turn.values.astype(np.float64)).as_matrix())
