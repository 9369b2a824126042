"""Variables of recordings, ground truth and estimates: names, dimensions, units and meanings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from scenetruth.indexing import centred_indices
from scenetruth.schema.attributes import Intrinsics
from scenetruth.schema.outline import DatasetOutline, OutlineVariable

if TYPE_CHECKING:
    import xarray as xr

__all__ = [
    "COMPONENTS",
    "COORDINATES",
    "DEMOSAICING",
    "FORMAT_VERSION",
    "MOTION_ACCELERATED",
    "MOTION_ACCELERATED_IN_PART",
    "MOTION_AFFINE",
    "MOTION_NONE",
    "MOTION_PLAIN",
    "NO_SURFACE",
    "REASONS",
    "REQUIRED",
    "REQUIRED_ANY",
    "STATUS_FALLBACK",
    "STATUS_INVALID",
    "STATUS_NORMAL",
    "STATUS_VALID",
    "VARIABLES",
    "Variable",
    "describe_variable",
    "label",
    "make_outline",
]


FORMAT_VERSION = 2
"""Version of the data-set layout, stored in the attribute ``format``."""

NO_SURFACE = -1
"""Value of ``object_id`` and ``face_id`` where no surface is visible."""

STATUS_INVALID, STATUS_NORMAL, STATUS_VALID, STATUS_FALLBACK = range(4)
"""Values of ``status``: invalid; component along the grey-value gradient only (aperture problem); valid; fallback
(coarser value, not valid and not scored).
"""

DEMOSAICING = ("bilinear", "malvar", "binomial")
"""Methods of demosaicing that the attribute ``demosaicing`` of a recording names."""

REASONS = (
    "none",
    "border",
    "low_texture",
    "ambiguous_match",
    "occlusion",
    "model_violation",
    "masked",
    "saturated",
    "not_converged",
    "not_determined",
)
"""Meanings of the values of ``invalid_reason``, from 0 on; ``none`` exactly where the estimate is valid."""

MOTION_NONE, MOTION_PLAIN, MOTION_AFFINE, MOTION_ACCELERATED, MOTION_ACCELERATED_IN_PART = range(5)
"""Values of ``motion_model``: none; as specified by the settings; general velocity gradient; accelerated over all
frames; accelerated over fewer frames.
"""


@dataclass(frozen=True)
class Variable:
    """Definition of a variable of a data set."""

    dims: tuple[str, ...]
    units: str
    long_name: str
    attrs: Mapping[str, Any] | None = None
    by_band: bool = False
    """Whether cameras with bands have one for each of them, with the leading dimension ``channel``."""


_MAP = ("t", "y", "x")
_SURFACE = {
    "depth": Variable(_MAP, "mm", "depth Z along the optical axis of the camera"),
    "velocity": Variable(
        ("component", *_MAP),
        "mm/frame",
        "instantaneous velocity (U_X, U_Y, U_Z) of the surface point along the axes of the camera",
    ),
    "disparity": Variable(_MAP, "px/step", "disparity per step of s, x_s = x_0 - disparity s"),
    "flow": Variable(("image_component", *_MAP), "px/frame", "optical flow (dx/dt, dy/dt) in the camera's image"),
}

_ACCELERATION = Variable(("component", *_MAP), "mm/frame^2", "acceleration of the surface point")

_ELEMENT = {
    "slope": Variable(("slope_component", *_MAP), "1", "slopes of the surface, dZ/dX and dZ/dY"),
    "rotation_rate": Variable(("component", *_MAP), "rad/frame", "rotation vector per frame of the surface element"),
    "growth_rate": Variable(_MAP, "1/frame", "relative rate of growth of the area of the surface element"),
    "principal_growth_rates": Variable(
        ("principal", *_MAP), "1/frame", "largest and smallest rate of relative length change"
    ),
    "principal_growth_direction": Variable(
        ("component", *_MAP), "1", "unit vector along the largest growth rate; the sign is arbitrary"
    ),
}


def _std(dims: tuple[str, ...], units: str, what: str) -> Variable:
    return Variable(dims, units, f"standard deviation of {what} due to image noise")


_STRAIN = {
    "exx": Variable(_MAP, "1", "strain along the x axis of the tangent plane, the projection of the camera's X axis"),
    "eyy": Variable(_MAP, "1", "strain along the y axis of the tangent plane"),
    "exy": Variable(_MAP, "1", "shear strain of the tensor, half of the engineering shear"),
    "e1": Variable(_MAP, "1", "larger principal strain"),
    "e2": Variable(_MAP, "1", "smaller principal strain"),
    "angle": Variable(_MAP, "rad", "angle of the larger principal strain from the x axis towards the y axis"),
}

_STATUS = {
    "flag_values": [STATUS_INVALID, STATUS_NORMAL, STATUS_VALID, STATUS_FALLBACK],
    "flag_meanings": "invalid normal_component_only valid fallback",
}

VARIABLES: Mapping[str, Mapping[str, Variable]] = {
    "recording": {
        "image": Variable(("s", *_MAP), "1", "image: linear radiance, or digital numbers of the sensor"),
        "radiance": Variable(("s", *_MAP), "1", "linear radiance before the sensor"),
        "exclusion_mask": Variable(
            ("s", *_MAP), "1", "pixels that must not be used", {"flag_values": [0, 1], "flag_meanings": "usable masked"}
        ),
        "noise_share": Variable(
            ("s", *_MAP), "1", "variance of the image noise after resampling, relative to that of the recorded image"
        ),
    },
    "truth": {
        **_SURFACE,
        "acceleration": _ACCELERATION,
        "displacement_next": Variable(("component", *_MAP), "mm", "displacement of the surface point to t + 1"),
        "displacement_previous": Variable(("component", *_MAP), "mm", "displacement of the surface point to t - 1"),
        "flow_next": Variable(
            ("image_component", *_MAP),
            "px",
            "where the surface point is in the camera's image of t + 1, minus the pixel",
        ),
        "flow_previous": Variable(
            ("image_component", *_MAP),
            "px",
            "where the surface point is in the camera's image of t - 1, minus the pixel",
        ),
        "normal": Variable(("component", *_MAP), "1", "unit normal of the surface, towards the camera"),
        **_ELEMENT,
        "curvature": Variable(
            ("principal", *_MAP), "1/mm", "principal curvatures, positive where the surface bulges towards the camera"
        ),
        "object_id": Variable(_MAP, "1", "index of the object in the scene", {"no_surface": NO_SURFACE}),
        "face_id": Variable(_MAP, "1", "index of the triangle in its object's mesh", {"no_surface": NO_SURFACE}),
        "barycentric": Variable(
            ("corner", *_MAP), "1", "barycentric coordinates of the triangle's second and third corner"
        ),
        "uv": Variable(("texture_component", *_MAP), "1", "coordinates of the surface point in a texture image"),
        "material_coordinates_mm": Variable(
            ("texture_component", *_MAP),
            "mm",
            "material coordinates of the surface point, constant in time",
        ),
        "visible": Variable(
            ("s", *_MAP), "1", "whether image (s, t) shows the surface point that the reference pixel shows at t = 0"
        ),
        "view_count": Variable(_MAP, "1", "number of cameras in which the surface point is visible at this frame"),
        "occluded_across_cameras": Variable(
            _MAP, "1", "whether the surface point is not visible in all cameras at this frame"
        ),
        "occluded_in_time": Variable(
            _MAP, "1", "whether the surface point is not visible in this camera at the previous or next frame"
        ),
        "boundary_distance": Variable(_MAP, "px", "distance to the nearest mixed pixel"),
        "mixed": Variable(_MAP, "1", "pixel footprint crosses a silhouette or a sharp edge"),
        "surface_radiance": Variable(_MAP, "1", "radiance of the surface point towards the camera", by_band=True),
        "diffuse_share": Variable(_MAP, "1", "share of the radiance: lamps, scattered by the surface", by_band=True),
        "specular_share": Variable(
            _MAP, "1", "share of the radiance: lamps, reflected by the boundary or by metal", by_band=True
        ),
        "transmitted_share": Variable(_MAP, "1", "share of the radiance: lamps behind the sheet", by_band=True),
        "ambient_share": Variable(_MAP, "1", "share of the radiance: ambient light", by_band=True),
        "lit_fraction": Variable(
            _MAP,
            "1",
            "irradiance by the lamps, relative to that without shadows; NaN where no lamp faces the surface",
            by_band=True,
        ),
        "shadow_distance": Variable(
            _MAP, "px", "distance to the nearest pixel at which the lit fraction changes along a surface"
        ),
        "camera_position_mm": Variable(("s", "t", "component"), "mm", "true position of the camera in the world"),
        "camera_rotation_rad": Variable(
            ("s", "t", "component"), "rad", "true rotation of the camera (rotation vector): pitch, yaw, roll"
        ),
        "image_time_s": Variable(("s", "t"), "s", "actual acquisition time of the image"),
    },
    "estimate": {
        **_SURFACE,
        **_ELEMENT,
        "normal": Variable(("component", *_MAP), "1", "unit normal of the surface, towards the camera"),
        "mean_curvature": Variable(
            _MAP, "1/mm", "mean of the principal curvatures, positive where the surface bulges towards the camera"
        ),
        "gaussian_curvature": Variable(_MAP, "1/mm^2", "product of the principal curvatures"),
        "acceleration": _ACCELERATION,
        "acceleration_std": _std(("component", *_MAP), "mm/frame^2", "the acceleration"),
        "slope_std": _std(("slope_component", *_MAP), "1", "the slopes"),
        "mean_curvature_std": _std(_MAP, "1/mm", "the mean curvature"),
        "gaussian_curvature_std": _std(_MAP, "1/mm^2", "the Gaussian curvature"),
        "rotation_rate_std": _std(("component", *_MAP), "rad/frame", "the rotation vector"),
        "growth_rate_std": _std(_MAP, "1/frame", "the growth rate"),
        "principal_growth_rates_std": _std(("principal", *_MAP), "1/frame", "the growth rates of length"),
        "principal_growth_direction_std": _std(_MAP, "rad", "the angle of the direction of growth in the surface"),
        "surface_model": Variable(
            _MAP,
            "1",
            "order of the fitted surface",
            {"flag_values": [0, 1, 2, 3], "flag_meanings": "none constant plane curved"},
        ),
        "motion_model": Variable(
            _MAP,
            "1",
            "fitted motion model",
            {
                "flag_values": [
                    MOTION_NONE,
                    MOTION_PLAIN,
                    MOTION_AFFINE,
                    MOTION_ACCELERATED,
                    MOTION_ACCELERATED_IN_PART,
                ],
                "flag_meanings": "none plain affine accelerated accelerated_over_fewer_frames",
            },
        ),
        "image_shift": Variable(
            ("image_component", "s", "t"),
            "px",
            "shift of an image from its expected position, relative to the reference image",
        ),
        "image_roll": Variable(("s", "t"), "rad", "rotation of an image from x to y relative to the reference image"),
        "image_scale": Variable(("s", "t"), "1", "relative deviation of an image from its expected scale"),
        "image_shift_std": _std(("image_component", "s", "t"), "px", "the shift of the image"),
        "image_roll_std": _std(("s", "t"), "rad", "the roll of the image"),
        "image_scale_std": _std(("s", "t"), "1", "the scale of the image"),
        "image_count": Variable(_MAP, "1", "mean number of images that contribute to the pixels of the window"),
        "residual": Variable(
            _MAP,
            "1",
            "standard deviation of the images around the fitted model, in the values of image, up to full_scale",
        ),
        "divergence": Variable(_MAP, "1/frame", "divergence u_z = -U_Z / Z of the optical flow"),
        "status": Variable(_MAP, "1", "status of the estimate: the lower of those of disparity and motion", _STATUS),
        "status_disparity": Variable(_MAP, "1", "status of disparity and depth", _STATUS),
        "status_motion": Variable(_MAP, "1", "status of flow, and of divergence where it is given", _STATUS),
        "valid": Variable(
            _MAP, "1", "whether the estimate is valid", {"flag_values": [0, 1], "flag_meanings": "invalid valid"}
        ),
        "invalid_reason": Variable(
            _MAP,
            "1",
            "reason why the estimate is not valid",
            {"flag_values": list(range(len(REASONS))), "flag_meanings": " ".join(REASONS)},
        ),
        "depth_std": _std(_MAP, "mm", "depth"),
        "depth_std_common": Variable(
            _MAP, "mm", "part of depth_std that pixels have in common, due to errors of stage and lens"
        ),
        "velocity_std_common": Variable(
            ("component", *_MAP),
            "mm/frame",
            "part of velocity_std that pixels have in common, due to errors of stage and lens",
        ),
        "growth_rate_std_common": Variable(
            _MAP, "1/frame", "part of growth_rate_std that pixels have in common, due to the calibration"
        ),
        "slope_std_common": Variable(
            ("slope_component", *_MAP), "1", "part of slope_std that pixels have in common, due to the calibration"
        ),
        "calibration_modes": Variable(
            ("mode", "component", "node_z", "node_y", "node_x"),
            "mm",
            "independent errors of points due to the calibration, each by one standard deviation",
        ),
        "calibration_rates": Variable(
            ("mode", "component", "node_z", "node_y", "node_x"),
            "mm/frame",
            "rates of change of these errors, due to errors of the poses that change linearly with time",
        ),
        "velocity_std": _std(("component", *_MAP), "mm/frame", "velocity"),
        "disparity_std": _std(_MAP, "px/step", "disparity"),
        "coherence": Variable(_MAP, "1", "spectral gap between data and null space, ((l3 - l4) / (l3 + l4))^2"),
        "registration_disparity": Variable(_MAP, "px/step", "integer disparity at which the images were registered"),
        "eigenvalues": Variable(("rank", *_MAP), "1", "eigenvalues l1 >= ... >= l5 of the structure tensor"),
    },
    "strain": {
        **_STRAIN,
        **{
            f"{name}_std{ending}": Variable(entry.dims, entry.units, f"standard deviation of {name}{text}")
            for name, entry in _STRAIN.items()
            for ending, text in (("", ""), ("_common", ", part due to the calibration"))
        },
        "point": Variable(("component", *_MAP), "mm", "surface point in the reference configuration"),
        "displacement": Variable(("component", *_MAP), "mm", "displacement of the surface point, or its velocity"),
        "valid": Variable(
            _MAP, "1", "whether the strain is valid", {"flag_values": [0, 1], "flag_meanings": "invalid valid"}
        ),
        "invalid_reason": Variable(
            _MAP,
            "1",
            "reason why the strain is not valid",
            {"flag_values": [0, 1, 2], "flag_meanings": "none no_estimate window_coverage"},
        ),
    },
}
"""All variables of the data sets. Ground truth for all cameras has ``s`` before ``t``. In a grid of cameras,
``s_y`` precedes ``s``. The exclusion mask and the noise share of a recording may lack dimensions along which they are
constant.
"""

REQUIRED: Mapping[str, tuple[str, ...]] = {
    "recording": ("image",),
    "truth": ("depth", "velocity", "disparity", "flow", "mixed"),
    "estimate": (),
    "strain": ("exx", "eyy", "exy", "valid"),
}
"""Required variables of each data set."""

REQUIRED_ANY: Mapping[str, tuple[str, ...]] = {"estimate": tuple(_SURFACE)}
"""Variables of which at least one is required: stereo methods give no motion, optical-flow methods no depth."""

COORDINATES = {
    "s": ("1", "camera position on the stage, 0 is the reference"),
    "s_y": ("1", "row of camera positions, 0 is the reference"),
    "t": ("1", "frame, 0 is the reference"),
    "y": ("px", "row of the pixel centre"),
    "x": ("px", "column of the pixel centre"),
    "channel": ("1", "band of the images"),
    "stage_x_mm": ("mm", "position of the camera on the stage"),
    "stage_y_mm": ("mm", "position of the row of cameras, positive downwards"),
    "time_s": ("s", "time of the frame"),
    "planned_time_s": ("s", "planned time of the image: mid-exposure of its middle row"),
    "component": (
        "1",
        "component: of maps along the axes of their camera (X right, Y down, Z forward), of camera poses in the world",
    ),
    "image_component": ("1", "component in the image"),
    "rank": ("1", "rank of the eigenvalue, 1 is the largest"),
    "slope_component": ("1", "direction of the slope along the axes of the camera"),
    "principal": ("1", "1 is the larger, 2 the smaller of two principal values"),
    "corner": ("1", "corner of the triangle"),
    "node_x": ("px", "column of a point with calibration modes"),
    "node_y": ("px", "row of a point with calibration modes"),
    "node_z": ("mm", "depth of a point with calibration modes"),
    "texture_component": ("1", "u to the right, v down"),
}


COMPONENTS: Mapping[str, list[str] | list[int]] = {
    "component": ["X", "Y", "Z"],
    "image_component": ["x", "y"],
    "slope_component": ["X", "Y"],
    "principal": [1, 2],
    "corner": [2, 3],
    "texture_component": ["u", "v"],
}


def describe_variable(kind: str, name: str) -> dict[str, Any]:
    """Return the attributes of a variable: units, long name and flags."""
    entry = VARIABLES[kind][name]
    return {"units": entry.units, "long_name": entry.long_name, **(entry.attrs or {})}


def make_outline(
    kind: str,
    arrays: Mapping[str, ArrayLike],
    intrinsics: Intrinsics,
    *,
    t: ArrayLike,
    s: ArrayLike | None = None,
    stage_x_mm: ArrayLike | None = None,
    stage_y_mm: ArrayLike | None = None,
    planned_time_s: ArrayLike | None = None,
    channel: ArrayLike | None = None,
    x: ArrayLike | None = None,
    y: ArrayLike | None = None,
    attrs: Mapping[str, Any] | None = None,
) -> DatasetOutline:
    """Return the outline of a data set with names, coordinates and units from plain arrays.

    ``t``, ``s``: Frame and camera indices, 0 at the reference.
    ``planned_time_s``: Planned time of every image, shape ([s_y, ]s, t); default: not stated.
    ``channel``: Names of the channels of colour images; default: not stated.
    ``x``, ``y``: Pixel indices of the columns and rows, to which the intrinsics refer; default: from 0 on.
    """
    variables: dict[str, OutlineVariable] = {}
    for name, array in arrays.items():
        values = np.asarray(array)
        dims = _list_dims(
            kind, VARIABLES[kind][name], values.ndim, rows=stage_y_mm is not None, bands=channel is not None
        )
        variables[name] = OutlineVariable(dims, values, describe_variable(kind, name))
    sizes = {dim: size for variable in variables.values() for dim, size in variable.sizes.items()}
    # Coordinates are copied so that they share no memory with the caller's arrays.
    frames = np.array(t, dtype=np.int64)
    coordinates: dict[str, tuple[str | tuple[str, ...], ArrayLike]] = {
        "t": ("t", frames),
        "time_s": ("t", frames * intrinsics.frame_interval_s),
        "y": ("y", np.arange(sizes["y"]) if y is None else np.array(y)),
        "x": ("x", np.arange(sizes["x"]) if x is None else np.array(x)),
    }
    if "s" in sizes:
        steps = centred_indices(sizes["s"]) if s is None else np.array(s, dtype=np.int64)
        positions = intrinsics.baseline_mm * steps if stage_x_mm is None else np.array(stage_x_mm, dtype=np.float64)
        coordinates |= {"s": ("s", steps), "stage_x_mm": ("s", positions)}
    if "s_y" in sizes:
        below = np.array(stage_y_mm, dtype=np.float64)
        coordinates |= {"s_y": ("s_y", centred_indices(sizes["s_y"])), "stage_y_mm": ("s_y", below)}
    if planned_time_s is not None:
        images = tuple(dim for dim in ("s_y", "s", "t") if dim in sizes)
        coordinates["planned_time_s"] = (images, np.array(planned_time_s, dtype=np.float64))
    if channel is not None and "channel" in sizes:
        coordinates["channel"] = ("channel", np.asarray(channel, dtype=str))
    for name, names in COMPONENTS.items():
        if name in sizes:
            coordinates[name] = (name, names)
    if "rank" in sizes:
        coordinates["rank"] = ("rank", np.arange(1, sizes["rank"] + 1))
    described = {
        name: OutlineVariable(
            (dim,) if isinstance(dim, str) else dim,
            np.asarray(values),
            {"units": COORDINATES[name][0], "long_name": COORDINATES[name][1]},
        )
        for name, (dim, values) in coordinates.items()
    }
    own = {"scenetruth": kind, "format": FORMAT_VERSION, **intrinsics.to_attrs()}
    return DatasetOutline(variables, described, {**own, **(attrs or {})})


def label(kind: str, arrays: Mapping[str, ArrayLike], intrinsics: Intrinsics, **coordinates: Any) -> xr.Dataset:
    """Return a data set with names, coordinates and units from plain arrays, with the arguments of `make_outline`."""
    return make_outline(kind, arrays, intrinsics, **coordinates).dataset()


def _list_dims(kind: str, entry: Variable, count: int, *, rows: bool, bands: bool) -> tuple[str, ...]:
    """Return the dimension names of an array from its number of dimensions."""
    dims = ("channel", *entry.dims) if entry.by_band and bands else entry.dims
    if rows and "s" in dims:
        at = dims.index("s")
        dims = (*dims[:at], "s_y", *dims[at:])
    if count == len(dims):
        return dims
    if kind == "recording":
        return (*dims, "channel")
    at = dims.index("t")
    return (*dims[:at], *(("s_y", "s") if rows else ("s",)), *dims[at:])
