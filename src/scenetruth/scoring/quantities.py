"""The scored quantities: names, units, symbols, type of error, and the variable that holds each."""

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
"""Name of the velocity endpoint error, the Euclidean distance between estimated and true velocity."""
OUTLIERS = "outliers"
ErrorKind = Literal["difference", "distance", "angle", "axis_angle"]
"""Type of error: estimate - truth for scalars; for vectors the distance, or the angle (of lines: undirected), °."""


@dataclass(frozen=True)
class Quantity:
    """A map of an estimate that is compared with the truth.

    ``component``: Index along the variable's first dimension, or None for scalars and whole vectors.
    ``units``: Units of its errors; differ from the stored unit for growth (1/frame) and angles.
    ``group``: Its group; a score has either all or no quantities of a group.
    ``needs``: The required estimate: depth ("disparity"), image motion ("motion"), or both.
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
        """Whether it is a growth quantity, which is omitted for rigid scenes."""
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
    # Computed from depth and velocity; no variable holds it.
    "growth_rate_windowed": Quantity("", None, "%/h", "g", "Growth rate, windowed", "windowed growth", _BOTH),
    "growth_principal_1": Quantity(
        "principal_growth_rates", 0, "%/h", "g_1", "Largest principal growth rate", "principal growth", _BOTH
    ),
    "growth_principal_2": Quantity(
        "principal_growth_rates", 1, "%/h", "g_2", "Smallest principal growth rate", "principal growth", _BOTH
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
"""Groups of quantities and their members; a score has either all or no members of a group."""


def get_title(name: str) -> str:
    """Return the title of a scored quantity."""
    return "Outliers" if name == OUTLIERS else QUANTITIES[name].title


def get_units(name: str) -> str:
    """Return the units of a scored quantity's errors, in plain text; ``"1"`` for outlier rates."""
    return QUANTITIES[name].units if name in QUANTITIES else "1"
