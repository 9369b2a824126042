"""What is told of a window, as linear functions of what is unknown in it."""

from __future__ import annotations

from scenetruth.bound.geometry import Points
from scenetruth.bound.model import Model, Vector
from scenetruth.schema import Intrinsics

__all__ = ["functionals_of"]


def functionals_of(points: Points, intrinsics: Intrinsics, model: Model) -> dict[str, Vector]:
    """Return what is told, as linear functions of the parameters.

    Parameters
    ----------
    points
        The surface in the windows' middles.
    intrinsics
        Of the camera.
    model
        The parameters.

    Returns
    -------
    dict
        ``disparity`` in px per step, ``depth`` in mm, ``slope``, ``flow`` in px per frame, ``velocity`` in mm per
        frame and ``growth_rate`` per frame, as far as the model has them; components are numbered: ``velocity.2``. Of
        one camera, the flow alone.
    """
    d, focal = points.d, points.focal
    baseline = intrinsics.baseline_mm
    found: dict[str, Vector] = {}
    if model.stereo:
        found |= {"disparity": [(0, 1.0)], "depth": [(0, -focal * baseline / d**2)]}
    if model.stereo and model.surface == "plane":
        # The plane's normal is (f d_x, f d_y, m).
        m = d - points.x * points.d_x - points.y * points.d_y
        for k, slope in enumerate((points.d_x, points.d_y)):
            share = focal * slope / m**2
            vector: Vector = [(0, share), (1, -share * points.x), (2, -share * points.y)]
            vector[1 + k] = (1 + k, vector[1 + k][1] - focal / m)
            found[f"slope.{k}"] = vector
    if model.moving:
        for k, at in enumerate((points.x, points.y)):
            ahead = at / focal
            found[f"flow.{k}"] = [(0, points.q[k] - ahead * points.q[2]), (3 + 3 * k, d), (9, -ahead * d)]
    if model.moving and model.stereo:
        found |= {f"velocity.{k}": [(3 + 3 * k, baseline)] for k in range(3)}
        if model.motion in ("growing", "affine"):
            one, other = points.tangents()
            e, f, g = ((a * b).sum(axis=0) for a, b in ((one, one), (one, other), (other, other)))
            area = e * g - f * f
            # The divergence of q in the surface, with its dual tangents.
            along, down = (g * one - f * other) / area, (e * other - f * one) / area
            found["growth_rate"] = [
                (4 + side + 3 * k, dual[k]) for side, dual in enumerate((along, down)) for k in range(3)
            ]
    return found
