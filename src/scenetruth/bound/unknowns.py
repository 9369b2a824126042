"""Unknowns of an analysis window (surface, motion, brightness), and the quantities derived from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.surface_geometry import ReferencePoints
from scenetruth.schema import Intrinsics

__all__ = [
    "FIELDS",
    "MOTION",
    "Brightness",
    "Columns",
    "Motion",
    "MotionChoice",
    "Surface",
    "Vector",
    "WindowUnknowns",
    "add_error_products",
    "compute_columns",
    "compute_eigenvalue_bias",
    "compute_functionals",
]


Map = NDArray[np.float64]
Surface = Literal["constant", "plane"]
Motion = Literal["translation", "rigid", "growing", "affine"]
MotionChoice = Literal["translation", "rigid", "growing", "affine", "auto"]
Brightness = Literal["fixed", "per_image"]

Vector = list[tuple[int, "Map | float"]]
"""A sparse vector over the parameters of a window: index of the parameter, and its coefficient at every pixel."""
Columns = list[Vector]
"""Potential unknowns, each a direction in the parameter space of a window."""

FIELDS = 4
"""Fields of a point: the disparity d and the velocity q_X, q_Y, q_Z in baselines per frame."""
MOTION = 3
"""Index of the first parameter of motion."""
_PER_FIELD = 3  # each field has a value at the window centre, and slopes along x and y


@dataclass(frozen=True)
class WindowUnknowns:
    """Unknowns of an estimator in a window.

    The parameters of a window are d, d_x, d_y, then q_X and its slopes along x and y, the same for q_Y and q_Z, and
    one for each field of brightness. Only the directions from `compute_columns` are unknown.

    ``surface``: ``"constant"``: the disparity; ``"plane"``: also its slopes.
    ``motion``: ``"translation"``: the velocity; ``"rigid"``: also a rotation; ``"growing"``: also a rotation and
      isotropic growth; ``"affine"``: also any velocity gradient along the surface.
    ``stereo``: Whether disparity is unknown. A single camera has no disparity; the flow in its windows is linear in
      image coordinates, with all parameters of q_X and q_Y.
    """

    surface: Surface
    motion: Motion
    moving: bool
    brightness: int
    stereo: bool = True

    @property
    def fields(self) -> int:
        """Number of fields of a pixel: disparity, velocity, brightness."""
        return (FIELDS if self.moving else 1) + self.brightness

    @property
    def parameters(self) -> int:
        """Number of parameters of a window."""
        return _PER_FIELD * (self.fields - self.brightness) + self.brightness

    def get_field(self, parameter: int) -> int:
        """Return the field of a parameter."""
        several = self.fields - self.brightness
        own = parameter // _PER_FIELD
        return own if own < several else several + parameter - _PER_FIELD * several

    def get_powers(self, parameter: int) -> tuple[int, int]:
        """Return the powers of the distance along x and y by which a parameter is multiplied."""
        if parameter >= _PER_FIELD * (self.fields - self.brightness):
            return 0, 0
        side = parameter % _PER_FIELD
        return int(side == 1), int(side == 2)

    def get_degree(self, field: int) -> int:
        """Return the highest power of the distance in a field."""
        if field == 0:
            return int(self.surface == "plane")
        return int(field < FIELDS and self.moving and (self.motion != "translation" or not self.stereo))


def compute_columns(model: WindowUnknowns, points: ReferencePoints) -> Columns:
    """Return the unknowns."""
    first = model.parameters - model.brightness
    if not model.stereo:
        flow: Columns = [[(MOTION + k, 1.0)] for k in range(2 * _PER_FIELD)]
        return flow + [[(first + k, 1.0)] for k in range(model.brightness)]
    found: Columns = [[(0, 1.0)]]
    if model.surface == "plane":
        found += [[(1, 1.0)], [(2, 1.0)]]
    if model.moving:
        found += [[(MOTION + _PER_FIELD * k, 1.0)] for k in range(3)]
        found += _gradient(model.motion, points)
    return found + [[(first + k, 1.0)] for k in range(model.brightness)]


def _gradient(motion: Motion, points: ReferencePoints) -> Columns:
    """Return the unknown directions of the slopes of velocity: those of A p_x and A p_y with a matrix A."""
    if motion == "translation":
        return []
    slopes = [[MOTION + _PER_FIELD * k + 1 + side for k in range(3)] for side in range(2)]
    if motion == "affine":
        return [[(place, 1.0)] for side in slopes for place in side]
    tangents = points.tangents()
    found: Columns = []
    for axis in range(3):
        one, other = (axis + 1) % 3, (axis + 2) % 3
        # e_k x p, with the axes k, one, other in cyclic order.
        turned = ((side[one], -p[other]) for side, p in zip(slopes, tangents, strict=True))
        back = ((side[other], p[one]) for side, p in zip(slopes, tangents, strict=True))
        found.append([*turned, *back])
    if motion == "growing":
        found.append([(side[k], p[k]) for side, p in zip(slopes, tangents, strict=True) for k in range(3)])
    return found


def compute_functionals(points: ReferencePoints, intrinsics: Intrinsics, model: WindowUnknowns) -> dict[str, Vector]:
    """Return the results as linear functions of the parameters.

    Returns: ``disparity`` in px per step, ``depth`` in mm, ``slope``, ``flow`` in px per frame, ``velocity`` in mm per
    frame and ``growth_rate`` per frame, where the model defines them; components are numbered, as in ``velocity.2``.
    For one camera, only the flow. For affine motion also ``principal_growth_rates`` along the true principal
    directions (see `compute_eigenvalue_bias`), ``growth_apart``, half their difference, and ``growth_shear``, which
    rotates these directions; ``growth_tilt`` and ``growth_turn`` are for `add_error_products`.
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
            # The divergence of q in the surface, by the dual tangents.
            along, down = (g * one - f * other) / area, (e * other - f * one) / area
            found["growth_rate"] = [
                (4 + side + 3 * k, dual[k]) for side, dual in enumerate((along, down)) for k in range(3)
            ]
            if model.motion == "affine":
                _add_affine_growth(found, points, (one, other), (along, down))
    return found


def _add_affine_growth(
    found: dict[str, Vector], points: ReferencePoints, tangents: tuple[Map, Map], duals: tuple[Map, Map]
) -> None:
    """Add the principal growth rates along the true directions, and the vectors that determine their uncertainty.

    Along a unit vector e = Σ v_i P_i of the surface, the growth rate is λ = e · q_e with q_e = Σ v_i q_i. Errors δP_i
    of the tangents add δe · (q_e - 2 λ e), with δe = Σ v_i δP_i. The error of the rotation contributes in second order.
    """
    slopes = (points.q_x, points.q_y)
    first = tangents[0] / np.sqrt((tangents[0] ** 2).sum(axis=0))
    # The second dual tangent is perpendicular to the first tangent.
    second = duals[1] / np.sqrt((duals[1] ** 2).sum(axis=0))

    def change(one: Map, other: Map) -> Map:
        return np.asarray(
            sum(
                (one * slope).sum(axis=0) * (dual * other).sum(axis=0)
                for slope, dual in zip(slopes, duals, strict=True)
            )
        )

    def vector(terms: list[tuple[float, Map, Map]]) -> Vector:
        return [
            (4 + side + 3 * k, sum(share * one[k] * (dual * other).sum(axis=0) for share, one, other in terms))
            for side, dual in enumerate(duals)
            for k in range(3)
        ]

    half = 0.5 * (change(first, first) - change(second, second))
    angle = 0.5 * np.arctan2(0.5 * (change(first, second) + change(second, first)), half)
    axes = (np.cos(angle) * first + np.sin(angle) * second, np.cos(angle) * second - np.sin(angle) * first)
    normal = np.cross(first, second, axis=0)
    place = np.stack([points.x, points.y, np.full_like(points.x, points.focal)]) / points.d

    def by_shape(along: Map, shares: list[Map]) -> Vector:
        # The surface P = (x, y, f) / d has δP_i = -P_i δ / d - P δ_i / d + P δ d_i / d².
        far = (place * along).sum(axis=0) / points.d
        own = sum(share * (side * along).sum(axis=0) for share, side in zip(shares, tangents, strict=True))
        bent = shares[0] * points.d_x + shares[1] * points.d_y
        return [(0, (far * bent - own) / points.d), (1, -far * shares[0]), (2, -far * shares[1])]

    area: Vector = []
    for k, axis in enumerate(axes):
        shares = [(dual * axis).sum(axis=0) for dual in duals]
        moved = shares[0] * slopes[0] + shares[1] * slopes[1]
        rate = (moved * axis).sum(axis=0)
        shape = by_shape(moved - 2 * rate * axis, shares)
        area = _added(area, shape)
        found[f"principal_growth_rates.{k}"] = [*vector([(1.0, axis, axis)]), *shape]
        found[f"growth_tilt.{k}"] = by_shape(normal, shares)
        found[f"growth_turn.{k}"] = vector([(1.0, normal, axis)])
    found["growth_rate"] = [*found["growth_rate"], *area]
    found["growth_apart"] = vector([(0.5, axes[0], axes[0]), (-0.5, axes[1], axes[1])])
    found["growth_shear"] = vector([(0.5, axes[0], axes[1]), (0.5, axes[1], axes[0])])


def _added(vector: Vector, more: Vector) -> Vector:
    known = dict(vector)
    return [(place, known.get(place, 0.0) + share) for place, share in more]


def add_error_products(std: dict[str, Map]) -> dict[str, Map]:
    """Return standard deviations including products of the errors of the surface's inclination and rotation."""
    kept = {name: values for name, values in std.items() if not name.startswith(("growth_tilt", "growth_turn"))}
    if "growth_tilt.0" not in std:
        return kept
    tilt, turn = ([std[f"growth_{name}.{k}"] ** 2 for k in range(2)] for name in ("tilt", "turn"))
    own = [tilt[k] * turn[k] for k in range(2)]
    crossed = tilt[0] * turn[1] + tilt[1] * turn[0]
    more = {
        "growth_rate": own[0] + own[1],
        "principal_growth_rates.0": own[0],
        "principal_growth_rates.1": own[1],
        "growth_apart": 0.25 * (own[0] + own[1]),
        "growth_shear": 0.25 * crossed,
    }
    return kept | {name: np.sqrt(kept[name] ** 2 + variance) for name, variance in more.items()}


def compute_eigenvalue_bias(half: Map, apart_std: Map, shear_std: Map) -> Map:
    """Return the bias by noise of the largest principal growth rate; that of the smallest has the opposite sign.

    Half the difference of the two rates is the length of the vector (half the difference along the true directions,
    shear). Normal errors of equal variance give a Rice distribution (1945, Bell System Technical Journal 24, 46).
    """
    from scipy.special import i0e, i1e

    sigma = np.sqrt(0.5 * (apart_std**2 + shear_std**2))
    with np.errstate(divide="ignore", invalid="ignore"):
        y = (half / (2 * sigma)) ** 2
        mean = sigma * np.sqrt(np.pi / 2) * ((1 + 2 * y) * i0e(y) + 2 * y * i1e(y))
    return np.asarray(np.where(sigma > 0, mean - half, 0.0))
