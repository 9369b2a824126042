"""What is unknown in a window: the parameters of its surface, of its motion, and of the images' brightness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.geometry import Points

__all__ = ["FIELDS", "MOTION", "Brightness", "Columns", "Model", "Motion", "Surface", "Vector", "columns_of"]

Map = NDArray[np.float64]
Surface = Literal["constant", "plane"]
Motion = Literal["translation", "rigid", "growing", "affine"]
Brightness = Literal["fixed", "per_image"]

Vector = list[tuple[int, "Map | float"]]
"""A sparse vector over the parameters of a window: which of them, and its coefficient at every pixel."""
Columns = list[Vector]
"""What may be unknown, each as a direction among the parameters of a window."""

FIELDS = 4
"""Fields of a point: the disparity d and the velocity q_X, q_Y, q_Z in baselines per frame."""
MOTION = 3
"""The first parameter of motion."""
# Each field has a value in the window's middle, and slopes along x and y.
_PER_FIELD = 3


@dataclass(frozen=True)
class Model:
    """What an estimator does not know of a window.

    The parameters of a window are d, d_x, d_y, then q_X and its slopes along x and y, q_Y and q_Z alike, and then one
    for each field of brightness. Only directions of `columns_of` among them are unknown.

    Parameters
    ----------
    surface
        ``"constant"``: the disparity; ``"plane"``: its slopes too.
    motion
        ``"translation"``: the velocity; ``"rigid"``: a rotation too; ``"growing"``: a rotation and an isotropic growth;
        ``"affine"``: any velocity gradient along the surface.
    moving
        Whether there is motion to be known: several frames.
    brightness
        Number of fields of brightness.
    stereo
        Whether disparity is unknown and can be seen. Of one camera it is neither: its windows have a flow that is
        linear in the image, in all of q_X and q_Y.
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

    def field_of(self, parameter: int) -> int:
        """Return the field that a parameter belongs to."""
        several = self.fields - self.brightness
        own = parameter // _PER_FIELD
        return own if own < several else several + parameter - _PER_FIELD * several

    def powers_of(self, parameter: int) -> tuple[int, int]:
        """Return the powers of the distance along x and y with which a parameter counts."""
        if parameter >= _PER_FIELD * (self.fields - self.brightness):
            return 0, 0
        side = parameter % _PER_FIELD
        return int(side == 1), int(side == 2)

    def degree_of(self, field: int) -> int:
        """Return the highest power of the distance that a field has."""
        if field == 0:
            return int(self.surface == "plane")
        return int(field < FIELDS and self.moving and (self.motion != "translation" or not self.stereo))


def columns_of(model: Model, points: Points) -> Columns:
    """Return what is unknown.

    Parameters
    ----------
    model
        The model.
    points
        The surface in the windows' middles: its tangents say how a rotation and a growth change the velocity.

    Returns
    -------
    list
        d, then its slopes; q_X, q_Y, q_Z; the velocity gradient; the brightness.
    """
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


def _gradient(motion: Motion, points: Points) -> Columns:
    """Return the directions in which the velocity's slopes may change: those of A p_x and A p_y with a matrix A."""
    if motion == "translation":
        return []
    slopes = [[MOTION + _PER_FIELD * k + 1 + side for k in range(3)] for side in range(2)]
    if motion == "affine":
        return [[(place, 1.0)] for side in slopes for place in side]
    tangents = points.tangents()
    found: Columns = []
    for axis in range(3):
        one, other = (axis + 1) % 3, (axis + 2) % 3
        # e_k x p, with the axes k, one, other in their cyclic order.
        turned = ((side[one], -p[other]) for side, p in zip(slopes, tangents, strict=True))
        back = ((side[other], p[one]) for side, p in zip(slopes, tangents, strict=True))
        found.append([*turned, *back])
    if motion == "growing":
        found.append([(side[k], p[k]) for side, p in zip(slopes, tangents, strict=True) for k in range(3)])
    return found
