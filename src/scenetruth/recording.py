"""The labelled arrays that every room exchanges: names, dimensions, units and checks."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from scenetruth.errors import Problem, RecordingError
from scenetruth.indexing import centred_indices

__all__ = [
    "FORMAT_VERSION",
    "KIND_FULL",
    "KIND_NONE",
    "KIND_NORMAL",
    "NO_SURFACE",
    "VARIABLES",
    "Intrinsics",
    "Variable",
    "check_dataset",
    "image_to_grey",
    "intrinsics_of",
    "label",
    "make_recording",
    "object_names_of",
    "scene_of",
]

FORMAT_VERSION = 1
"""Version of the data sets' layout, kept in their attribute ``format_version``."""

NO_SURFACE = -1
"""Value of ``object_id`` and ``face_id`` where no surface is seen."""

KIND_NONE, KIND_NORMAL, KIND_FULL = 0, 1, 2
"""Values of ``kind``: nothing known; minimum-norm solution (aperture problem); everything known."""


@dataclass(frozen=True)
class Variable:
    """What a variable of a data set is."""

    dims: tuple[str, ...]
    units: str
    long_name: str
    attrs: Mapping[str, Any] | None = None


_MAP = ("t", "y", "x")
_SURFACE = {
    "depth": Variable(_MAP, "mm", "depth Z along the optical axis of the camera"),
    "velocity": Variable(
        ("component", *_MAP), "mm/frame", "instantaneous velocity (U_X, U_Y, U_Z) of the surface point"
    ),
    "disparity": Variable(_MAP, "px/step", "disparity per step of s, x_s = x_0 - disparity s"),
    "flow": Variable(("image_component", *_MAP), "px/frame", "optical flow (dx/dt, dy/dt) in the camera's image"),
}

_KINDS = {"flag_values": [KIND_NONE, KIND_NORMAL, KIND_FULL], "flag_meanings": "none normal full"}

VARIABLES: Mapping[str, Mapping[str, Variable]] = {
    "recording": {
        "image": Variable(("s", *_MAP), "1", "image: linear radiance, or digital numbers of the sensor"),
        "ideal": Variable(("s", *_MAP), "1", "linear radiance before the sensor"),
    },
    "truth": {
        **_SURFACE,
        "acceleration": Variable(("component", *_MAP), "mm/frame^2", "acceleration of the surface point"),
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
        "slope": Variable(("slope_component", *_MAP), "1", "slopes of the surface, dZ/dX and dZ/dY"),
        "curvature": Variable(
            ("principal", *_MAP), "1/mm", "principal curvatures, positive where the surface bulges towards the camera"
        ),
        "rotation_rate": Variable(
            ("component", *_MAP), "rad/frame", "rotation vector per frame of the surface element"
        ),
        "growth_rate": Variable(_MAP, "1/frame", "relative rate of growth of the area of the surface element"),
        "growth_principal": Variable(
            ("principal", *_MAP), "1/frame", "relative rates of growth of length, the largest and the least"
        ),
        "growth_direction": Variable(
            ("component", *_MAP), "1", "unit vector along which length grows most; either sign stands for both"
        ),
        "object_id": Variable(_MAP, "1", "index of the object in the scene", {"no_surface": NO_SURFACE}),
        "face_id": Variable(_MAP, "1", "index of the triangle in its object's mesh", {"no_surface": NO_SURFACE}),
        "barycentric": Variable(
            ("corner", *_MAP), "1", "barycentric coordinates of the triangle's second and third corner"
        ),
        "uv": Variable(("texture_component", *_MAP), "1", "coordinates of the surface point in a texture image"),
        "surface_mm": Variable(
            ("texture_component", *_MAP), "mm", "coordinates of the surface point on the surface, laid flat; they stay"
        ),
        "visible": Variable(
            ("s", *_MAP), "1", "whether image (s, t) shows the surface point that the reference pixel shows at t = 0"
        ),
        "view_count": Variable(_MAP, "1", "number of cameras that see the surface point at this frame"),
        "occluded_in_s": Variable(_MAP, "1", "whether some camera does not see the surface point at this frame"),
        "occluded_in_t": Variable(
            _MAP, "1", "whether this camera does not see the surface point at the frame before or after"
        ),
        "boundary_distance": Variable(_MAP, "px", "distance to the nearest mixed pixel"),
        "mixed": Variable(_MAP, "1", "pixel footprint crosses a silhouette or a sharp edge"),
        "camera_position_mm": Variable(("s", "t", "component"), "mm", "true position of the camera in the world"),
        "camera_rotation_rad": Variable(
            ("s", "t", "component"), "rad", "true rotation of the camera (rotation vector): pitch, yaw, roll"
        ),
        "image_time_s": Variable(("s", "t"), "s", "true time at which the image was taken"),
    },
    "estimate": {
        **_SURFACE,
        "divergence": Variable(_MAP, "1/frame", "divergence u_z = -U_Z / Z of the optical flow"),
        "kind": Variable(_MAP, "1", "what could be estimated: the lesser of disparity and motion", _KINDS),
        "kind_disparity": Variable(_MAP, "1", "what could be estimated of disparity and depth", _KINDS),
        "kind_motion": Variable(_MAP, "1", "what could be estimated of flow and divergence", _KINDS),
        "model_violation": Variable(_MAP, "1", "images contradict one surface in one motion: occlusion, motion edge"),
        "depth_std": Variable(_MAP, "mm", "standard deviation of depth that follows from the images' noise"),
        "velocity_std": Variable(
            ("component", *_MAP), "mm/frame", "standard deviation of velocity that follows from the images' noise"
        ),
        "disparity_std": Variable(
            _MAP, "px/step", "standard deviation of disparity that follows from the images' noise"
        ),
        "confidence": Variable(_MAP, "1", "spectral gap between data and null space, ((l3 - l4) / (l3 + l4))^2"),
        "working_point": Variable(_MAP, "px/step", "integer disparity at which the images were registered"),
        "eigenvalues": Variable(("rank", *_MAP), "1", "eigenvalues l1 >= ... >= l5 of the structure tensor"),
    },
}
"""Every variable of the three data sets. A truth for all cameras has ``s`` before ``t``. Where cameras stand in rows,
``s_y`` comes before ``s``."""

_REQUIRED = {
    "recording": ("image",),
    "truth": ("depth", "velocity", "disparity", "flow", "mixed"),
    "estimate": ("depth", "velocity", "disparity", "flow"),
}

_COORDINATES = {
    "s": ("1", "camera position on the stage, 0 is the reference"),
    "s_y": ("1", "row of camera positions, 0 is the reference"),
    "t": ("1", "frame, 0 is the reference"),
    "y": ("px", "row of the pixel centre"),
    "x": ("px", "column of the pixel centre"),
    "stage_x_mm": ("mm", "position of the camera on the stage"),
    "stage_y_mm": ("mm", "position of the row of cameras, positive downwards"),
    "time_s": ("s", "time of the frame"),
    "component": ("1", "component in the world frame"),
    "image_component": ("1", "component in the image"),
    "rank": ("1", "rank of the eigenvalue, 1 is the largest"),
    "slope_component": ("1", "direction of the slope in the world frame"),
    "principal": ("1", "1 is the larger, 2 the lesser of two principal values"),
    "corner": ("1", "corner of the triangle"),
    "texture_component": ("1", "u to the right, v down"),
}


_NAMES: Mapping[str, list[str] | list[int]] = {
    "component": ["X", "Y", "Z"],
    "image_component": ["x", "y"],
    "slope_component": ["X", "Y"],
    "principal": [1, 2],
    "corner": [2, 3],
    "texture_component": ["u", "v"],
}


@dataclass(frozen=True)
class Intrinsics:
    """The numbers that lead from pixels to the world, as a data set's attributes carry them.

    Parameters
    ----------
    focal_length_px
        f, in pixels.
    principal_point_px
        (c_x, c_y), in pixel indices.
    baseline_mm
        V_X, the camera's displacement per step of s.
    frame_interval_s
        Time between two frames.
    """

    focal_length_px: float
    principal_point_px: tuple[float, float]
    baseline_mm: float
    frame_interval_s: float = 1.0

    def to_attrs(self) -> dict[str, Any]:
        """Return the attributes that hold these numbers."""
        return {
            "focal_length_px": float(self.focal_length_px),
            "principal_point_px": [float(value) for value in self.principal_point_px],
            "baseline_mm": float(self.baseline_mm),
            "frame_interval_s": float(self.frame_interval_s),
        }


def intrinsics_of(dataset: xr.Dataset) -> Intrinsics:
    """Read the intrinsics from the attributes of a checked data set."""
    attrs = dataset.attrs
    c_x, c_y = attrs["principal_point_px"]
    return Intrinsics(
        focal_length_px=float(attrs["focal_length_px"]),
        principal_point_px=(float(c_x), float(c_y)),
        baseline_mm=float(attrs["baseline_mm"]),
        frame_interval_s=float(attrs["frame_interval_s"]),
    )


def scene_of(dataset: xr.Dataset) -> dict[str, Any] | None:
    """Return the scene that a data set was made from, as plain values, or None for data from elsewhere."""
    text = dataset.attrs.get("scene")
    return None if text is None else dict(json.loads(text))


def object_names_of(dataset: xr.Dataset) -> list[str]:
    """Return the names of the objects that ``object_id`` counts, from 0 on; empty for data from elsewhere.

    Examples
    --------
    >>> object_names_of(xr.Dataset(attrs={"object_names": '["leaf", "soil"]'}))
    ['leaf', 'soil']
    """
    return [str(name) for name in json.loads(dataset.attrs.get("object_names", "[]"))]


def label(
    kind: str,
    arrays: Mapping[str, ArrayLike],
    intrinsics: Intrinsics,
    *,
    t: ArrayLike,
    s: ArrayLike | None = None,
    stage_x_mm: ArrayLike | None = None,
    stage_y_mm: ArrayLike | None = None,
    attrs: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Put names, coordinates and units on plain arrays.

    Parameters
    ----------
    kind
        ``"recording"``, ``"truth"`` or ``"estimate"``: which table of `VARIABLES` holds.
    arrays
        The arrays by name. An array with one dimension more than its table says has ``s`` before ``t``; an image then
        has ``channel`` behind ``x``. Whatever has ``s`` has ``s_y`` before it if ``stage_y_mm`` is given.
    intrinsics
        Focal length, principal point, baseline, frame interval.
    t, s
        The frame and camera indices, 0 the reference.
    stage_x_mm
        The camera's position for every s; ``baseline_mm * s`` if not given.
    stage_y_mm
        The position of every row of a grid of cameras; the cameras stand in one row if not given.
    attrs
        More attributes.

    Returns
    -------
    xarray.Dataset
        With ``units`` and ``long_name`` on every variable and coordinate.
    """
    variables: dict[str, xr.Variable] = {}
    for name, array in arrays.items():
        entry = VARIABLES[kind][name]
        values = np.asarray(array)
        dims = _dims_of(kind, entry, values.ndim, rows=stage_y_mm is not None)
        variables[name] = xr.Variable(
            dims, values, {"units": entry.units, "long_name": entry.long_name, **(entry.attrs or {})}
        )
    sizes = {dim: size for variable in variables.values() for dim, size in variable.sizes.items()}
    frames = np.asarray(t, dtype=np.int64)
    coordinates: dict[str, tuple[str, ArrayLike]] = {
        "t": ("t", frames),
        "time_s": ("t", frames * intrinsics.frame_interval_s),
        "y": ("y", np.arange(sizes["y"])),
        "x": ("x", np.arange(sizes["x"])),
    }
    if "s" in sizes:
        steps = centred_indices(sizes["s"]) if s is None else np.asarray(s, dtype=np.int64)
        positions = intrinsics.baseline_mm * steps if stage_x_mm is None else np.asarray(stage_x_mm, dtype=np.float64)
        coordinates |= {"s": ("s", steps), "stage_x_mm": ("s", positions)}
    if "s_y" in sizes:
        below = np.asarray(stage_y_mm, dtype=np.float64)
        coordinates |= {"s_y": ("s_y", centred_indices(sizes["s_y"])), "stage_y_mm": ("s_y", below)}
    for name, names in _NAMES.items():
        if name in sizes:
            coordinates[name] = (name, names)
    if "rank" in sizes:
        coordinates["rank"] = ("rank", np.arange(1, sizes["rank"] + 1))
    dataset = xr.Dataset(
        variables,
        coords={
            name: xr.Variable(dim, values, {"units": _COORDINATES[name][0], "long_name": _COORDINATES[name][1]})
            for name, (dim, values) in coordinates.items()
        },
    )
    dataset.attrs = {
        "scenetruth": kind,
        "format_version": FORMAT_VERSION,
        **intrinsics.to_attrs(),
        **(attrs or {}),
    }
    return dataset


def make_recording(
    images: ArrayLike,
    focal_length_px: float,
    baseline_mm: float,
    principal_point_px: tuple[float, float] | None = None,
    frame_interval_s: float = 1.0,
    *,
    stage_x_mm: ArrayLike | None = None,
    stage_y_mm: ArrayLike | None = None,
    full_scale: float | None = None,
    attrs: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Make a recording from images of any origin.

    Parameters
    ----------
    images
        Grey values, shape (s, t, y, x), or colours, (s, t, y, x, channel); integers are digital numbers, floats linear
        radiance. With ``stage_y_mm``, the cameras stand in a grid, and ``s_y`` comes before ``s``.
    focal_length_px
        f, in pixels.
    baseline_mm
        V_X, the camera's displacement in mm per step of s; positive when larger s stands further to the right.
    principal_point_px
        (c_x, c_y), in pixel indices; the image's centre ((W-1)/2, (H-1)/2) if not given.
    frame_interval_s
        Time between two frames.
    stage_x_mm
        The camera's position for every s, 0 at the reference; ``baseline_mm * s`` if not given.
    stage_y_mm
        The position of every row of a grid of cameras, 0 at the reference, the middle row; one row if not given.
    full_scale
        The largest value that an image can hold; 1 for floats and the type's largest for integers if not given.
        The grey values of the paper, in [-1, 1], are ``2 image / full_scale - 1``.
    attrs
        More attributes to keep with the recording.

    Returns
    -------
    xarray.Dataset
        ``image`` ([s_y, ]s, t, y, x[, channel]) with coordinates, units and intrinsics.

    Raises
    ------
    RecordingError
        If the images or the numbers do not have the agreed form; lists all that is wrong.

    Examples
    --------
    >>> recording = make_recording(np.zeros((5, 9, 32, 64)), focal_length_px=500, baseline_mm=5)
    >>> recording.s.values.tolist()
    [-2, -1, 0, 1, 2]
    >>> recording.attrs["principal_point_px"]
    [31.5, 15.5]
    """
    values = np.asarray(images)
    grid = stage_y_mm is not None
    if values.ndim - grid not in (4, 5) or 0 in values.shape:
        names = "s_y, s, t, y, x" if grid else "s, t, y, x"
        message = f"must be a non-empty array with the dimensions ({names}), or ({names}, channel)"
        raise RecordingError([Problem("images", message, values.shape)])
    count_s, count_t, height, width = values.shape[int(grid) :][:4]
    centre = ((width - 1) / 2, (height - 1) / 2)
    if full_scale is None:
        full_scale = float(np.iinfo(values.dtype).max) if np.issubdtype(values.dtype, np.integer) else 1.0
    positions = None if stage_x_mm is None else np.asarray(stage_x_mm, dtype=np.float64)
    if positions is not None and positions.shape != (count_s,):
        problem = Problem("stage_x_mm", f"must hold one position for each of the {count_s} cameras", positions.shape)
        raise RecordingError([problem])
    rows = None if stage_y_mm is None else np.asarray(stage_y_mm, dtype=np.float64)
    if rows is not None and rows.shape != (len(values),):
        problem = Problem("stage_y_mm", f"must hold one position for each of the {len(values)} rows", rows.shape)
        raise RecordingError([problem])
    dataset = label(
        "recording",
        {"image": values},
        Intrinsics(focal_length_px, principal_point_px or centre, baseline_mm, frame_interval_s),
        t=centred_indices(count_t),
        s=centred_indices(count_s),
        stage_x_mm=positions,
        stage_y_mm=rows,
        attrs={"full_scale": float(full_scale), **(attrs or {})},
    )
    check_dataset(dataset, "recording")
    return dataset


def image_to_grey(recording: xr.Dataset) -> NDArray[np.float32]:
    """Return the images as the paper's grey values: [0, full scale] becomes [-1, 1].

    Returns
    -------
    numpy.ndarray
        float32, shape (s, t, y, x[, channel]).
    """
    scale = np.float32(2.0 / float(recording.attrs["full_scale"]))
    grey: NDArray[np.float32] = recording["image"].values.astype(np.float32)
    grey *= scale
    grey -= np.float32(1.0)
    return grey


def check_dataset(dataset: xr.Dataset, kind: str) -> None:
    """Check that a data set has the agreed form.

    Parameters
    ----------
    dataset
        The data set.
    kind
        ``"recording"``, ``"truth"`` or ``"estimate"``.

    Raises
    ------
    RecordingError
        With every deviation: missing variables, wrong dimensions, missing or impossible intrinsics.
    """
    problems = [*_variable_problems(dataset, kind), *_intrinsics_problems(dataset)]
    if kind == "recording":
        problems += _image_problems(dataset)
    if problems:
        raise RecordingError(problems, source=kind)


def _dims_of(kind: str, entry: Variable, count: int, *, rows: bool) -> tuple[str, ...]:
    """Return the names of an array's dimensions, from how many it has."""
    dims = entry.dims
    if rows and "s" in dims:
        at = dims.index("s")
        dims = (*dims[:at], "s_y", *dims[at:])
    if count == len(dims):
        return dims
    if kind == "recording":
        return (*dims, "channel")
    at = dims.index("t")
    return (*dims[:at], *(("s_y", "s") if rows else ("s",)), *dims[at:])


def _variable_problems(dataset: xr.Dataset, kind: str) -> list[Problem]:
    problems = [
        Problem(name, f"is missing; a {kind} must have it", sorted(map(str, dataset.data_vars)))
        for name in _REQUIRED[kind]
        if name not in dataset
    ]
    for name, entry in VARIABLES[kind].items():
        if name not in dataset:
            continue
        dims = tuple(map(str, dataset[name].dims))
        if kind == "recording" and dims[-1:] == ("channel",):
            dims = dims[:-1]
        # A truth may be that of one camera or of all; a recording needs its cameras.
        views = ("s_y",) if kind == "recording" else ("s_y", "s")
        found, needed = (tuple(dim for dim in names if dim not in views) for names in (dims, entry.dims))
        if found != needed:
            problems.append(Problem(name, f"must have the dimensions {entry.dims}", dims))
    return problems


def _intrinsics_problems(dataset: xr.Dataset) -> list[Problem]:
    problems = []
    for name, positive in (("focal_length_px", True), ("baseline_mm", False), ("frame_interval_s", True)):
        value = dataset.attrs.get(name)
        if not _is_finite_number(value):
            problems.append(Problem(f"attrs.{name}", "must be a finite number", value))
        elif positive and float(value or 0) <= 0:
            problems.append(Problem(f"attrs.{name}", "must be positive", value))
        elif value == 0 and dataset.sizes.get("s", 2) > 1:
            problems.append(
                Problem(f"attrs.{name}", "must not be zero: depth cannot be seen without a baseline", value)
            )
    point = dataset.attrs.get("principal_point_px")
    if not (isinstance(point, Sequence | np.ndarray) and len(point) == 2 and all(map(_is_finite_number, point))):
        problems.append(Problem("attrs.principal_point_px", "must be two finite numbers (c_x, c_y)", point))
    return problems


def _image_problems(dataset: xr.Dataset) -> list[Problem]:
    problems = []
    full_scale = dataset.attrs.get("full_scale")
    if not (_is_finite_number(full_scale) and float(full_scale or 0) > 0):
        problems.append(Problem("attrs.full_scale", "must be a positive number", full_scale))
    if "image" not in dataset:
        return problems
    problems += [
        Problem(name, "is missing; the images need this coordinate", sorted(map(str, dataset.coords)))
        for name in ("s", "t", "stage_x_mm", *(("s_y", "stage_y_mm") if "s_y" in dataset["image"].dims else ()))
        if name not in dataset.coords
    ]
    image = dataset["image"]
    if image.dtype.kind not in "uif":
        problems.append(Problem("image", "must hold real numbers", str(image.dtype)))
    for name in ("s_y", "s", "t"):
        if name in dataset.coords and name in image.dims:
            values = dataset[name].values
            if 0 not in values or np.any(np.diff(values) != 1):
                problems.append(Problem(name, "must be consecutive integers with 0 the reference", values.tolist()))
    for name in ("stage_x_mm", "stage_y_mm"):
        if name in dataset.coords and not np.all(np.isfinite(dataset[name].values)):
            problems.append(Problem(name, "must be finite", dataset[name].values.tolist()))
    return problems


def _is_finite_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool) and bool(np.isfinite(value))
