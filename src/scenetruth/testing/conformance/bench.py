"""The test bench: a method with its settings and recordings, and the requirements of a check."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.errors import EstimateError, ScenetruthError
from scenetruth.estimators import Estimator, find_method, requirements, validate_settings
from scenetruth.estimators.estimation import output_problems
from scenetruth.progress import Progress
from scenetruth.schema import check_dataset
from scenetruth.testing.conformance.map_comparison import (
    FLOOR,
    MIN_RETAINED_FRACTION,
    CheckFailure,
    Maps,
    NotApplicable,
    compute_magnitude,
    compute_rms,
    require_agreement,
    scalar_maps,
)
from scenetruth.testing.conformance.synthetic_plane import SyntheticPlane
from scenetruth.validated_model import FrozenModel

__all__ = ["CheckRequirement", "ConformanceBench", "ConformanceCheck", "conformance_check"]


_FACTOR = 3.0
"""Tolerance in units of the method's own error: independent errors differ by 1.4, errors that change sign by 2."""


class ConformanceBench:
    """A method with its settings, and the recordings of its checks, with images of ``size`` (height, width) in px.

    ``cameras``, ``frames``: None for three, or the next odd number that the method requires.
    """

    def __init__(
        self,
        method: str | Estimator | Callable[..., Any],
        settings: FrozenModel | Mapping[str, Any] | None = None,
        *,
        size: tuple[int, int] | None = None,
        cameras: int | None = None,
        frames: int | None = None,
    ) -> None:
        self._given, self._settings = method, settings
        self._size, self._cameras, self._frames = size, cameras, frames

    @cached_property
    def method(self) -> Estimator:
        """The method."""
        return find_method(self._given)

    @cached_property
    def settings(self) -> FrozenModel:
        """Its settings, validated."""
        given = self._settings
        fields = given.model_dump() if isinstance(given, FrozenModel) else dict(given or {})
        return validate_settings(self.method, fields)

    @property
    def says_it_is_thread_safe(self) -> bool:
        """Whether it, or the function that it wraps, has an attribute ``thread_safe`` that is true."""
        return any(getattr(item, "thread_safe", False) is True for item in (self.method, self._given))

    @cached_property
    def plane(self) -> SyntheticPlane:
        """The scene of the plain recording."""
        needs = self.method.needs
        cameras = self._cameras or max(3, needs.cameras + (needs.cameras + 1) % 2)
        frames = self._frames or max(3, needs.frames + (needs.frames + 1) % 2)
        while not self._frames and cameras * frames < needs.images:
            frames += 2
        channels = needs.channels if (needs.channels or 1) > 1 else None
        plane = SyntheticPlane(cameras=cameras, frames=frames, channels=channels)
        return plane if self._size is None else replace(plane, size=self._size)

    def recording(self) -> xr.Dataset:
        """Return the plain recording as a new, writable data set."""
        return self.plane.recording()

    def estimate(self, recording: xr.Dataset, progress: Progress | None = None) -> xr.Dataset:
        """Run the method directly, because `scenetruth.estimate` would hide its errors."""
        check_dataset(recording, "recording")
        problems = requirements(recording, self.method, self.settings)
        if problems:
            raise EstimateError(problems)
        found: object = self.method.estimate(recording, self.settings, progress)
        if not isinstance(found, xr.Dataset):
            raise CheckFailure(
                "the method was called",
                "an xarray.Dataset",
                f"a {type(found).__name__}",
                "return scenetruth.make_estimate(recording=recording, ...)",
            )
        return found

    def estimate_if_it_suits(self, recording: xr.Dataset) -> xr.Dataset:
        """Run the method on a recording that it may reject."""
        try:
            return self.estimate(recording)
        except ScenetruthError as error:
            msg = f"such a recording is rejected: {' '.join(str(error).split())}"
            raise NotApplicable(msg) from error

    @cached_property
    def _plain(self) -> xr.Dataset | Exception:
        try:
            found = self.estimate(self.recording())
        except Exception as error:  # any error of the method; the check of the plain recording reports it
            return error
        problems = output_problems(found, self.recording(), frozenset())
        problems = [problem for problem in problems if not problem.path.endswith(".units")]
        return EstimateError(problems) if problems else found.copy(deep=True)

    @property
    def plain(self) -> xr.Dataset:
        """The estimate of the plain recording."""
        if isinstance(self._plain, Exception):
            msg = "the plain recording has no estimate for comparison: see 'declared_outputs' and 'output_schema'"
            raise NotApplicable(msg)
        return self._plain

    @cached_property
    def maps(self) -> dict[str, xr.DataArray]:
        """The maps with valid pixels in the estimate of the plain recording, by component."""
        return {name: item for name, item in scalar_maps(self.plain).items() if bool(np.isfinite(item).any())}

    @cached_property
    def own_error(self) -> dict[str, float]:
        """The RMSE of each of `maps`, in its unit."""
        truth = self.plane.truth()
        return {name: compute_rms((item - truth[name]).values) for name, item in self.maps.items()}

    def tolerances(self, factor: float = _FACTOR) -> dict[str, float]:
        """Return the tolerances of differences between estimates, as RMS."""
        truth = self.plane.truth()
        return {name: factor * error + FLOOR * compute_magnitude(truth, name) for name, error in self.own_error.items()}

    def agrees(
        self,
        found: Maps,
        expected: Maps | None = None,
        *,
        done: str,
        expectation: str,
        remedy: str,
        factor: float = _FACTOR,
        least_kept: float = MIN_RETAINED_FRACTION,
    ) -> None:
        """Require agreement of maps with those of the plain recording, or with others; see `require_agreement`."""
        require_agreement(
            found,
            self.maps if expected is None else expected,
            self.tolerances(factor),
            done=done,
            expectation=expectation,
            remedy=remedy,
            least_kept=least_kept,
        )

    def restrict_truth(self, truth: Maps) -> dict[str, xr.DataArray]:
        """Return a truth, restricted to the valid maps of the estimate of the plain recording."""
        return {name: truth[name].where(np.isfinite(item)) for name, item in self.maps.items()}


@dataclass(frozen=True)
class CheckRequirement:
    """The outputs and recordings that a check requires of a method.

    ``any_of``: Quantities of which the plain estimate must have at least one, as in `map_comparison.scalar_maps`.
    ``plain``: Whether the plain recording, with at least ``cameras`` and ``frames``, must have an estimate.
    ``odd_cameras``, ``odd_frames``: Whether the number must be odd, with the reference in the middle.
    """

    any_of: tuple[str, ...] = ()
    plain: bool = True
    odd_cameras: bool = False
    odd_frames: bool = False
    cameras: int = 1
    frames: int = 1

    def __str__(self) -> str:
        parts = [" or ".join(self.any_of)] if self.any_of else []
        parts += [f"{self.cameras} cameras"] if self.cameras > 1 else []
        parts += [f"{self.frames} frames"] if self.frames > 1 else []
        parts += ["an odd number of cameras"] if self.odd_cameras else []
        parts += ["an odd number of frames"] if self.odd_frames else []
        return ", ".join(parts) or "nothing"

    def demand(self, bench: ConformanceBench) -> None:
        """Raise `NotApplicable` if the check does not apply to a method."""
        plane = bench.plane
        for name, least, odd, count in (
            ("cameras", self.cameras, self.odd_cameras, plane.cameras),
            ("frames", self.frames, self.odd_frames, plane.frames),
        ):
            if count < least or (odd and count % 2 == 0):
                msg = f"needs {f'{least} {name}' if count < least else f'an odd number of {name}'}, not {count}"
                raise NotApplicable(msg)
        if self.plain:
            known = bench.maps
            if self.any_of and not any(name in known for name in self.any_of):
                msg = f"the method estimates no {' and no '.join(self.any_of)}"
                raise NotApplicable(msg)


CheckFunction = Callable[[ConformanceBench], None]
"""Raises `CheckFailure` if a method fails the check, `NotApplicable` if the check does not apply."""


@dataclass(frozen=True)
class ConformanceCheck:
    """One requirement for methods, named as its function without ``check_``; ``says``: its docstring's first line."""

    name: str
    says: str
    needs: CheckRequirement
    function: CheckFunction

    def run(self, bench: ConformanceBench) -> None:
        """Run the check on a method."""
        self.needs.demand(bench)
        self.function(bench)


def conformance_check(**needs: Any) -> Callable[[CheckFunction], CheckFunction]:
    """Return a decorator that registers a function ``check_NAME(bench)`` as a conformance check."""

    def attach(function: CheckFunction) -> CheckFunction:
        says = (function.__doc__ or "").strip().splitlines()[0]
        check = ConformanceCheck(function.__name__.removeprefix("check_"), says, CheckRequirement(**needs), function)
        vars(function)["conformance_check"] = check
        return function

    return attach
