"""Estimation: the recording is validated, the method is called, and its output is validated."""

from __future__ import annotations

import warnings
import zlib
from collections.abc import Iterator, Mapping
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from scenetruth.errors import EstimateError, EstimateWarning, Problem, RecordingError, ScenetruthError, StoreError
from scenetruth.estimators.axis_order import describe_likely_causes, share_of_valid
from scenetruth.estimators.method_specs import MethodLike, MethodSpec
from scenetruth.estimators.protocol import Estimator, StreamingMethod
from scenetruth.estimators.registry import DEFAULT_METHOD, find_method, validate_settings
from scenetruth.estimators.user_code import FunctionMethod, locate_exception
from scenetruth.lazy_exports import lazy_module
from scenetruth.plain_data import argument_problems
from scenetruth.progress import Progress
from scenetruth.schema import VARIABLES, Put, blank_map, check_dataset, estimate_hash, flat_attributes
from scenetruth.schema.plausible_units import describe_disparities, describe_estimated_depth
from scenetruth.schema.validity import (
    STATUS_SOURCES,
    VALIDITY_MAPS,
    complete_validity,
    compute_validity,
    excluded_pixels,
    validity_variable,
)
from scenetruth.validated_model import FrozenModel

if TYPE_CHECKING:
    import xarray as xr
else:
    xr = lazy_module("xarray")

__all__ = ["EstimationTask", "estimate", "is_in_memory", "output_problems", "prepare", "read_only", "requirements"]


def read_only(recording: xr.Dataset) -> xr.Dataset:
    """Return the same recording with read-only arrays and separate containers; data not yet loaded stays lazy."""
    guarded = recording.copy(deep=False)
    indexes = {}
    for name, variable in guarded.variables.items():
        if not is_in_memory(variable):
            continue
        values = variable.values.view()
        values.flags.writeable = False
        if name not in guarded.xindexes:
            variable.data = values
        elif variable.dims == (name,) and variable.values.flags.writeable:
            # pandas before 3 returns the values of an index without a copy.
            indexes[name] = (variable.dims, values, variable.attrs, variable.encoding)
    return guarded.assign_coords(indexes)


def copy_shared_arrays(found: xr.Dataset, recording: xr.Dataset) -> xr.Dataset:
    """Return a data set with writeable arrays that shares no memory with a recording."""
    own = found.copy()
    others = [other.values for other in recording.variables.values() if is_in_memory(other)]
    for name, variable in own.variables.items():
        if name in own.xindexes:
            continue
        values = variable.values
        shared = any(np.may_share_memory(values, other) for other in others)
        if shared or not values.flags.writeable:
            variable.data = values.copy()
    return own


class _MemoryGuard:
    """Detection of changes of a recording in memory that bypass the read-only flags of its arrays.

    Built-in methods are not examined.
    """

    def __init__(self, recording: xr.Dataset, method: Estimator) -> None:
        built_in = type(method).__module__.startswith(_BUILT_IN) and not isinstance(method, FunctionMethod)
        self._arrays = {
            str(name): variable.values
            for name, variable in recording.variables.items()
            if not built_in and is_in_memory(variable) and variable.dtype != object
        }
        self._before = self._checksums()

    def _checksums(self) -> dict[str, int]:
        return {
            name: zlib.crc32(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data)
            for name, values in self._arrays.items()
        }

    def check(self) -> None:
        """Raise if an array of the recording has changed."""
        after = self._checksums()
        if changed := [name for name, number in self._before.items() if after[name] != number]:
            message = (
                f"modifies the recording passed to it ({', '.join(changed)}), past the write protection of the arrays; "
                "use a copy. The recording in memory is no longer the original"
            )
            raise EstimateError([Problem("", message)])


_BUILT_IN = "scenetruth.estimators."


def is_in_memory(variable: xr.Variable) -> bool:
    """Return whether the values of a variable are in memory, so that no store has to be read."""
    return bool(variable._in_memory)  # xarray has no public equivalent


def output_problems(found: object, recording: xr.Dataset, gives: AbstractSet[str]) -> list[Problem]:
    """Return the problems of the object that a method returned."""
    if not isinstance(found, xr.Dataset):
        remedy = "is not an xarray.Dataset; create one with scenetruth.make_estimate(recording=recording, ...)"
        return [Problem("", remedy, type(found).__name__)]
    problems = [
        Problem(name, "is declared by the method, but missing", sorted(map(str, found.data_vars)))
        for name in sorted(gives)
        if name not in found
    ]
    try:
        check_dataset(found, "estimate")
    except RecordingError as error:
        problems += error.problems
    for name, entry in VARIABLES["estimate"].items():
        if name not in found:
            continue
        variable = found.variables[name]
        units = variable.attrs.get("units")
        if units != entry.units:
            problems.append(Problem(f"{name}.units", f"must be '{entry.units}'", units))
        if name in _REAL and variable.dtype.kind != "f":
            problems.append(Problem(name, "must contain floats, NaN where invalid", str(variable.dtype)))
    for dim in ("t", "y", "x"):
        if dim not in found.coords or dim not in recording.coords:
            if dim not in found.coords:
                problems.append(Problem(dim, "is missing; an estimate has the coordinates of its recording"))
            continue
        extra = sorted(set(found.variables[dim].values.tolist()) - set(recording.variables[dim].values.tolist()))
        if extra:
            message = f"has {len(extra)} values that are missing in the recording"
            problems.append(Problem(dim, message, extra[:3]))
        elif dim != "t" and found.sizes[dim] != recording.sizes[dim]:
            problems.append(Problem(dim, f"must have the recording's {recording.sizes[dim]} pixels", found.sizes[dim]))
    return problems


_REAL = ("depth", "disparity", "flow", "velocity", "divergence", "depth_std", "disparity_std", "velocity_std")


def estimate(
    recording: xr.Dataset,
    method: MethodLike = DEFAULT_METHOD,
    settings: FrozenModel | Mapping[str, Any] | None = None,
    *,
    progress: Progress | None = None,
    **overrides: Any,
) -> xr.Dataset:
    """Estimate depth and 3D motion from a recording, as far as the method provides them.

    Parameters
    ----------
    recording
        Images and intrinsics, from `scenetruth.simulate`, `scenetruth.make_recording` or a store.
    method
        Name of an installed method (``scenetruth list methods`` lists them; ``"structure_tensor"`` is the method of the
        paper), ``"module:function"``, a function or method object, or a `scenetruth.estimators.MethodSpec`.
    settings
        Settings of the method: an instance of its settings model, or a mapping. Settings that are not specified have
        the defaults of the method; the settings in the scene of the recording are ignored.
    progress
        Called with (task, done, total).
    **overrides
        Individual settings; they take precedence over ``settings``.

    Returns
    -------
    xarray.Dataset
        The quantities that the method provides, of ``depth`` (mm), ``disparity`` (px per step), ``flow`` (px per frame)
        and ``velocity`` (mm per frame), and their quality measures, for every frame that can be estimated. Invalid
        pixels are NaN. The arrays share no memory with the recording.

    Raises
    ------
    RecordingError
        If the recording is malformed.
    EstimateError
        If the method does not exist, a setting is invalid, the recording does not meet the requirements of the method,
        or the method fails or returns an invalid estimate; the message names the method.

    Warns
    -----
    EstimateWarning
        If the settings of a method make many pixels invalid unnecessarily, for example if the threshold ``tau`` of the
        structure tensor is too high for low-contrast textures. If under 20 % of the pixels are valid and the images
        move as if the axes s and t, or rows and columns, were swapped, or the sign of the baseline were reversed. If
        the median depth of real images contradicts the distance that the recording states (attribute
        ``distance_mm``), is below ten baselines or 10 mm, or above 200 m, or neighbouring images have nothing in
        common: the message names the unit that is likely to be wrong.

    See Also
    --------
    make_estimate : Create an estimate from arrays that were computed elsewhere.
    score : Compare an estimate with the ground truth.

    References
    ----------
    H. Scharr and R. Küsters: A Linear Model for Simultaneous Estimation of 3D Motion and Depth. IEEE Workshop on Motion
    and Video Computing, 2002.

    Examples
    --------
    >>> import numpy as np
    >>> import scenetruth as st
    >>> y, x = np.mgrid[:40, :60]
    >>> images = [[np.cos(0.6 * (x + 0.25 * s)) * np.cos(0.5 * (y - 0.5 * t)) for t in (0, 1)] for s in (0, 1)]
    >>> recording = st.make_recording(images, focal_length_px=1000, baseline_mm=0.25)
    >>> found = estimate(recording, working_point_px=0).sel(t=0).isel(y=20, x=30)
    >>> found.disparity.round(2).item(), found.depth.round(-1).item(), found.flow.values.round(2).tolist()
    (0.25, 1000.0, [0.0, 0.5])
    """
    return prepare(recording, method, settings, progress, **overrides).estimate()


class EstimationTask:
    """An estimation that is ready to run: a recording, a method and its settings, all validated.

    Parameters
    ----------
    recording
        A validated recording.
    method
        A method whose requirements the recording meets.
    settings
        Settings of the method.
    progress
        Called with (task, done, total).

    See Also
    --------
    scenetruth.estimators.prepare : Validate all inputs and return a task.
    scenetruth.estimate : Validate and estimate in one call.

    Examples
    --------
    Of six frames, two have as many neighbours as the filters require. Each map is passed on when it is complete:

    >>> import numpy as np
    >>> import scenetruth as st
    >>> from scenetruth.estimators import prepare
    >>> y, x = np.mgrid[:40, :60]
    >>> images = [[np.cos(0.6 * (x + 0.25 * s)) * np.cos(0.5 * (y - 0.5 * t)) for t in range(6)] for s in (0, 1)]
    >>> recording = st.make_recording(images, focal_length_px=1000, baseline_mm=0.25)
    >>> estimation = prepare(recording, "structure_tensor", {"working_point_px": 0, "window_sigma_px": 3})
    >>> estimation.blank().t.values.tolist()
    [0, 1]
    >>> def put(name, at, values):
    ...     if name == "disparity":
    ...         print(at, values.shape, values[20, 30].round(2).item())
    >>> result = estimation.fill(put)
    {'t': 0} (40, 60) 0.25
    {'t': 1} (40, 60) 0.25

    In memory, a single call suffices:

    >>> estimation.estimate().disparity[:, 20, 30].values.round(2).tolist()
    [0.25, 0.25]
    """

    def __init__(self, recording: xr.Dataset, method: Estimator, settings: FrozenModel, progress: Progress | None):
        self._recording, self._method, self._settings, self._progress = recording, method, settings, progress
        self._guarded = read_only(recording)

    def estimate(self) -> xr.Dataset:
        """Estimate in memory; see `estimate`."""
        guarded = self._guarded
        if not (isinstance(self._method, StreamingMethod) or getattr(self._method, "reads_frames", False)):
            # Methods that do not stream get all images in memory and read-only, also from a store.
            guarded = read_only(self._recording.copy(deep=False).load())
        with self._telling():
            memory = _MemoryGuard(guarded, self._method)
            found = self._method.estimate(guarded, self._settings, self._progress)
            memory.check()
        checked = complete_validity(self._checked(found), self._recording)
        sample = _DepthSample()
        sample.add(checked["depth"].values if "depth" in checked else ())
        self._warn_of_causes(int(np.count_nonzero(checked["valid"].values)), checked, sample)
        return copy_shared_arrays(checked, self._recording)

    def blank(self) -> xr.Dataset | None:
        """Return the estimate with blank maps to be filled; None if the method estimates in memory only."""
        if not isinstance(self._method, StreamingMethod):
            return None
        with self._telling():
            found = self._method.blank(self._guarded, self._settings)
        checked = self._checked(found)
        shape = [checked.sizes[dim] for dim in ("t", "y", "x")]
        types = {"valid": np.bool_}
        return checked.assign(
            {
                name: validity_variable(name, blank_map(types.get(name, np.uint8), shape))
                for name in VALIDITY_MAPS
                if name not in checked
            }
        )

    def fill(self, put: Put) -> Mapping[str, Any]:
        """Estimate frame by frame.

        Parameters
        ----------
        put
            Receives the maps of `blank`.

        Returns
        -------
        mapping
            Attributes that are available only after the estimation.
        """
        assert isinstance(self._method, StreamingMethod)
        with self._telling():
            memory = _MemoryGuard(self._guarded, self._method)
            blank = self._method.blank(self._guarded, self._settings)
            counted = _ValidCount(put)
            validity = _ValidityPut(blank, self._recording, counted.put)
            found = self._method.fill(self._guarded, self._settings, validity.put, self._progress)
            validity.finish()
            memory.check()
        self._warn_of_causes(counted.pixels, blank, counted.depth)
        return flat_attributes(found)

    def _warn_of_causes(self, valid_pixels: int, estimate: xr.Dataset, depth: _DepthSample) -> None:
        """Warn of few valid pixels, if the order of the axes explains them, or of an implausible depth."""
        share = share_of_valid(valid_pixels, estimate, self._recording)
        cause = describe_likely_causes(self._recording, share)
        for message in [cause] if cause else describe_estimated_depth(depth.median(), self._recording):
            warnings.warn(f"method '{self._method.name}': {message}", EstimateWarning, stacklevel=4)

    def _checked(self, found: Any) -> xr.Dataset:
        """Return the output of the method with its provenance attributes; raise if it is not a valid estimate."""
        method, recording = self._method, self._recording
        problems = output_problems(found, recording, method.gives)
        if problems:
            raise EstimateError(problems, source=f"output of method '{method.name}'")
        stamped: xr.Dataset = found.copy()
        stamped.attrs = flat_attributes(stamped.attrs)
        stamped.attrs |= {"method": method.name, "settings": self._settings.model_dump_json()}
        stamped.attrs |= {key: recording.attrs[key] for key in _TRAVELLING if key in recording.attrs}
        stamped.attrs["estimate_hash"] = estimate_hash(stamped)
        return stamped

    @contextmanager
    def _telling(self) -> Iterator[None]:
        """Convert the exceptions of a method to `EstimateError`."""
        name = self._method.name
        try:
            yield
        except StoreError:  # of the recording, or of the estimate
            raise
        except ScenetruthError as error:
            entries = getattr(error, "problems", (Problem("", str(error)),))
            place = locate_exception(error)
            raise EstimateError(entries, source=f"method '{name}'" + (f" ({place})" if place else "")) from error
        except (Warning, OSError) as error:
            # A warning that the caller has turned into an error, or a full disk.
            if isinstance(error, Warning) or isinstance(self._method, StreamingMethod):
                raise
            raise self._failure(error) from error
        except (Exception, SystemExit) as error:  # code of methods may raise anything; it must not end the program
            raise self._failure(error) from error

    def _failure(self, error: Exception | SystemExit) -> EstimateError:
        message = f"failed: {type(error).__name__}: {error}"
        if isinstance(error, ValueError) and "read-only" in str(error):
            message = f"modifies the recording passed to it: {error}; use a copy"
        elif isinstance(error, SystemExit):
            message = f"failed: it called sys.exit({'' if error.code is None else repr(error.code)})"
        place = locate_exception(error)
        message += f" ({place})" if place else ""
        return EstimateError([Problem(f"method '{self._method.name}'", message)])


class _DepthSample:
    """Sample of depth maps, for their median."""

    _MOST = 2048  # values of an array, which determine its median to some per cent of the spread

    def __init__(self) -> None:
        self._parts: list[np.ndarray[Any, Any]] = []

    def add(self, depth: Any) -> None:
        """Take a sample of the finite values of an array."""
        values = np.ravel(depth)
        values = values[np.isfinite(values)]
        if values.size:
            self._parts.append(np.array(values[:: -(-values.size // self._MOST)], dtype=np.float64))

    def median(self) -> float:
        """Return the median of the samples; NaN without any."""
        return float(np.median(np.concatenate(self._parts))) if self._parts else np.nan


class _ValidCount:
    """Counts the valid pixels among the values that it passes on, and samples depth."""

    def __init__(self, put: Put) -> None:
        self._put, self.pixels, self.depth = put, 0, _DepthSample()

    def put(self, name: str, at: Mapping[str, int], values: np.ndarray[Any, Any]) -> None:
        """Pass values on; see `Put`."""
        if name == "valid":
            self.pixels += int(np.count_nonzero(values))
        elif name == "depth":
            self.depth.add(values)
        self._put(name, at, values)


class _ValidityPut:
    """Writes the maps of a method and derives those of `VALIDITY_MAPS` that the method lacks, frame by frame."""

    def __init__(self, blank: xr.Dataset, recording: xr.Dataset, put: Put) -> None:
        self._blank, self._recording, self._put = blank, recording, put
        self._missing = [name for name in VALIDITY_MAPS if name not in blank]
        sources = [
            "status",
            "invalid_reason",
            *STATUS_SOURCES,
            *(one for few in STATUS_SOURCES.values() for one in few),
        ]
        self._sources = {name: blank.variables[name] for name in sources if name in blank}
        self._held: dict[int, dict[str, np.ndarray[Any, Any]]] = {}
        self._parts: dict[tuple[int, str], int] = {}

    def put(self, name: str, at: Mapping[str, int], values: np.ndarray[Any, Any]) -> None:
        """Write values at their position; see `Put`."""
        self._put(name, at, values)
        if not self._missing or name not in self._sources:
            return
        variable = self._sources[name]
        dims = [str(dim) for dim in variable.dims if dim != "t"]
        frames = [at["t"]] if "t" in at else range(variable.sizes["t"])
        place = tuple(at.get(dim, slice(None)) for dim in dims)
        for frame in frames:
            held = self._held.setdefault(frame, {})
            if name not in held:
                held[name] = np.zeros([variable.sizes[dim] for dim in dims], dtype=variable.dtype)
            of_frame = (
                values if "t" in at else values.take(frame, axis=[d for d in variable.dims if d not in at].index("t"))
            )
            held[name][place] = of_frame
            self._parts[frame, name] = self._parts.get((frame, name), 0) + np.asarray(of_frame).size
            whole = all(self._parts.get((frame, one), 0) >= held[one].size for one in self._sources if one in held)
            if whole and len(held) == len(self._sources):
                self._complete(frame)

    def finish(self) -> None:
        """Write the maps of frames for which not every source was written."""
        for frame in list(self._held):
            self._complete(frame)

    def _complete(self, frame: int) -> None:
        held = self._held.pop(frame)
        excluded = excluded_pixels(self._recording, self._blank["t"].values[frame])
        found = compute_validity(held, None if excluded is None else excluded[0])
        for name in self._missing:
            self._put(name, {"t": frame}, found[name])


def prepare(
    recording: xr.Dataset,
    method: MethodLike = DEFAULT_METHOD,
    settings: FrozenModel | Mapping[str, Any] | None = None,
    progress: Progress | None = None,
    **overrides: Any,
) -> EstimationTask:
    """Validate all inputs of an estimation and return it, ready to run; see `estimate`."""
    spec = method if isinstance(method, MethodSpec) else None
    chosen = find_method(method if spec is None else spec.method)
    wrong = argument_problems(progress)
    if not (settings is None or isinstance(settings, FrozenModel | Mapping)):
        wrong.append(Problem("settings", "must be a mapping or an instance of the method's settings model", settings))
    if wrong:
        raise EstimateError(wrong)
    given = settings.model_dump() if isinstance(settings, FrozenModel) else dict(settings or {})
    own = {} if spec is None else spec.settings
    checked = validate_settings(chosen, {**own, **given, **overrides})
    check_dataset(recording, "recording")
    problems = requirements(recording, chosen, checked)
    if problems:
        raise EstimateError(problems)
    for message in chosen.needs.describe_ignored(recording, chosen.name):
        warnings.warn(message, EstimateWarning, stacklevel=3)
    for name in _STATED_DISPARITIES:
        stated = getattr(checked, name, None)
        low, high = stated if isinstance(stated, tuple) else (stated, stated)
        if isinstance(low, int | float) and isinstance(high, int | float):
            for message in describe_disparities(low, high, recording):
                warnings.warn(f"{name}: {message}", EstimateWarning, stacklevel=3)
    return EstimationTask(recording, chosen, checked, progress)


_STATED_DISPARITIES = ("disparity_px", "working_point_px")
_TRAVELLING = ("scene", "scene_hash", "recording_hash", "distortion")


def requirements(recording: xr.Dataset, method: Estimator, settings: FrozenModel) -> list[Problem]:
    """Return the requirements that a recording violates, from its sizes, coordinates and attributes alone."""
    problems = method.needs.problems(recording, method.name)
    if "s_y" in recording["image"].dims and problems:
        return problems
    # Both may report the same problem: too few images.
    return list(dict.fromkeys([*problems, *method.requirements(recording, settings)]))
