"""The quantities that are scored: names, units, symbols, type of error, and the variable that holds each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

__all__ = [
    "ENDPOINT",
    "OUTLIERS",
    "QUANTITIES",
    "QUANTITY_GROUPS",
    "ErrorKind",
    "Quantity",
    "get_title",
    "get_units",
]

ENDPOINT = "velocity_epe"
"""Name of the Euclidean distance between the estimated and the true velocity."""

OUTLIERS = "outliers"
"""Name of the rates of outliers."""

ErrorKind = Literal["difference", "distance", "angle", "axis_angle"]
"""How the error of a quantity is taken: estimate - truth of a scalar; of vectors the distance, the angle in degrees, or
the angle in degrees between lines, which have no sign."""


@dataclass(frozen=True)
class Quantity:
    """A map of an estimate that is compared with the truth.

    ``variable``: The variable of the data set that holds it.
    ``component``: Index along the variable's first dimension, or None for a scalar variable and for whole vectors.
    ``units``: Units of its errors, in plain text. Of what has % per hour, data sets have 1/frame; of angles, vectors.
    ``symbol``: Its symbol, in plain text.
    ``title``: What it is, in words.
    ``group``: What it belongs to; a score has the errors of all of a group or of none.
    ``needs``: What must be known: depth ("disparity"), the motion in the image ("motion"), or both.
    ``error``: How its error is taken.
    """

    variable: str
    component: int | None
    units: str
    symbol: str
    title: str
    group: str
    needs: tuple[Literal["disparity", "motion"], ...]
    error: ErrorKind = "difference"

    @property
    def is_growth(self) -> bool:
        """Whether it tells how something grows: what does not is not worth showing it."""
        return "growth" in self.group


_SHAPE: tuple[Literal["disparity"]] = ("disparity",)
_BOTH: tuple[Literal["disparity"], Literal["motion"]] = ("disparity", "motion")


QUANTITIES: Mapping[str, Quantity] = {
    "depth": Quantity("depth", None, "mm", "Z", "Depth", "depth", _SHAPE),
    "disparity": Quantity("disparity", None, "px/step", "d", "Disparity", "disparity", _SHAPE),
    "velocity_x": Quantity("velocity", 0, "mm/frame", "U_X", "Velocity in X", "velocity", _BOTH),
    "velocity_y": Quantity("velocity", 1, "mm/frame", "U_Y", "Velocity in Y", "velocity", _BOTH),
    "velocity_z": Quantity("velocity", 2, "mm/frame", "U_Z", "Velocity in Z", "velocity", _BOTH),
    "flow_x": Quantity("flow", 0, "px/frame", "dx/dt", "Optical flow in x", "flow", ("motion",)),
    "flow_y": Quantity("flow", 1, "px/frame", "dy/dt", "Optical flow in y", "flow", ("motion",)),
    ENDPOINT: Quantity("velocity", None, "mm/frame", "U", "Velocity endpoint", "velocity", _BOTH, "distance"),
    "growth_rate": Quantity("growth_rate", None, "%/h", "g", "Growth rate", "growth", _BOTH),
    # Follows from depth and velocity; no variable holds it.
    "growth_rate_windowed": Quantity("", None, "%/h", "g", "Growth rate, windowed", "windowed growth", _BOTH),
    "growth_principal_1": Quantity(
        "principal_growth_rates", 0, "%/h", "g_1", "Largest growth of length", "principal growth", _BOTH
    ),
    "growth_principal_2": Quantity(
        "principal_growth_rates", 1, "%/h", "g_2", "Least growth of length", "principal growth", _BOTH
    ),
    "growth_direction": Quantity(
        "principal_growth_direction", None, "°", "e_1", "Direction of growth", "growth direction", _BOTH, "axis_angle"
    ),
    "slope_x": Quantity("slope", 0, "1", "dZ/dX", "Slope in X", "slope", _SHAPE),
    "slope_y": Quantity("slope", 1, "1", "dZ/dY", "Slope in Y", "slope", _SHAPE),
    "normal": Quantity("normal", None, "°", "n", "Normal", "normal", _SHAPE, "angle"),
    "mean_curvature": Quantity("mean_curvature", None, "1/mm", "H", "Mean curvature", "mean curvature", _SHAPE),
    "gaussian_curvature": Quantity(
        "gaussian_curvature", None, "1/mm^2", "K", "Gaussian curvature", "Gaussian curvature", _SHAPE
    ),
    "rotation_rate_x": Quantity("rotation_rate", 0, "rad/frame", "ω_X", "Rotation about X", "rotation", _BOTH),
    "rotation_rate_y": Quantity("rotation_rate", 1, "rad/frame", "ω_Y", "Rotation about Y", "rotation", _BOTH),
    "rotation_rate_z": Quantity("rotation_rate", 2, "rad/frame", "ω_Z", "Rotation about Z", "rotation", _BOTH),
}
"""The quantities by name, in the order in which they are reported."""

QUANTITY_GROUPS: Mapping[str, tuple[str, ...]] = {
    group: tuple(name for name, entry in QUANTITIES.items() if entry.group == group)
    for group in dict.fromkeys(entry.group for entry in QUANTITIES.values())
}
"""What is scored, and the names under which a score has its errors: all of them or none."""


def get_title(name: str) -> str:
    """Return what a scored quantity is, in words."""
    return "Outliers" if name == OUTLIERS else QUANTITIES[name].title


def get_units(name: str) -> str:
    """Return the units of a scored quantity's errors, in plain text; ``"1"`` for rates of outliers."""
    return QUANTITIES[name].units if name in QUANTITIES else "1"
