"""Sources of uncertainty in the calibration."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import xarray as xr

from scenetruth.design.uncertainty.observation_model import (
    Disturbance,
    ImageDisturbance,
    Map,
    ObservationModel,
    compute_growth_error,
)
from scenetruth.design.uncertainty.propagation import Errors, Propagation
from scenetruth.design.uncertainty.source import Calibration, Mitigation, UncertaintySource
from scenetruth.number_format import format_two_digits
from scenetruth.scene import Scene

__all__ = ["CalibrationSource"]


_QUANTITIES = ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z")


class CalibrationSource(UncertaintySource):
    """A calibration parameter with a standard deviation."""

    group = "calibration"
    field: ClassVar[str]
    """Field in `Calibration`."""
    unit: ClassVar[str]
    """Unit of the standard deviation."""
    signs: ClassVar[tuple[str, ...]] = ("+",)
    """Signs of the errors over draws, for each component."""

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return whether the parameter has an uncertainty."""
        return bool(getattr(calibration, self.field) > 0)

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the standard deviation with its unit."""
        return f"{getattr(calibration, self.field):g} {self.unit}"

    def drawn_values(self, draw: int) -> list[float]:
        """Return the errors of a draw, ±1 standard deviation, by an orthogonal design over four draws."""
        return [1.0 if signs[draw % len(signs)] == "+" else -1.0 for signs in self.signs]

    def compute_responses(self, sight: ObservationModel, *off: float) -> Iterator[Errors]:
        """Yield the errors of the affected quantities, for given errors of the components."""
        raise NotImplementedError

    def responses(
        self, sight: ObservationModel, propagation: Propagation, calibration: Calibration
    ) -> Iterator[Errors]:
        """Yield the errors for one standard deviation each; see `UncertaintySource`."""
        return self._completed(sight, [float(getattr(calibration, self.field))] * len(self.signs))

    def responses_drawn(
        self, sight: ObservationModel, propagation: Propagation, calibration: Calibration, scene: Scene, draw: int
    ) -> Iterator[Errors]:
        """Return the errors of a draw; see `UncertaintySource`."""
        size = float(getattr(calibration, self.field))
        return self._completed(sight, [size * one for one in self.drawn_values(draw)])

    def _completed(self, sight: ObservationModel, off: list[float]) -> Iterator[Errors]:
        """Yield the errors of all quantities, zero for those not affected."""
        none = dict.fromkeys(_QUANTITIES, np.zeros_like(sight.depth))
        return ({**none, **errors} for errors in self.compute_responses(sight, *off))

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation:
        """Return a better calibration."""
        size = getattr(calibration, self.field) / 4
        return Mitigation(
            f"a {self.title} uncertainty four times smaller (calibration.{self.field}: {size:g})", {self.kind: 0.25}
        )


class StageScaleSource(CalibrationSource):
    """Scale error of the stage: the same relative error of depth and all velocities, none of growth."""

    kind = "baseline"
    title = "baseline"
    field = "baseline_percent"
    unit = "%"
    signs = ("+-+-",)

    def compute_responses(self, sight: ObservationModel, *off: float) -> Iterator[Errors]:
        """Yield the errors for a relative error."""
        share = off[0] / 100
        velocity = {f"velocity_{axis}": share * sight.velocity[k] for k, axis in enumerate("xyz")}
        yield {"depth": share * sight.depth, **velocity, "growth_rate": 0.0 * sight.depth}

    def miscalibrate(self, recording: xr.Dataset, calibration: Calibration, draw: int) -> None:
        """Change baseline and positions in the recording."""
        (drawn,) = self.drawn_values(draw)
        factor = 1 + calibration.baseline_percent / 100 * drawn
        recording.attrs["baseline_mm"] *= factor
        recording["stage_x_mm"] = recording["stage_x_mm"] * factor


class FocalLengthSource(CalibrationSource):
    """Error of the focal length: the same relative error of depth and U_Z, none of U_X and U_Y."""

    kind = "focal_length"
    title = "focal length"
    field = "focal_length_percent"
    unit = "%"
    signs = ("++--",)

    def compute_responses(self, sight: ObservationModel, *off: float) -> Iterator[Errors]:
        """Yield the errors for a relative error."""
        share = off[0] / 100
        found = {"depth": share * sight.depth, "velocity_z": share * sight.velocity[2]}
        wrong = replace(sight.intrinsics, focal_length_px=sight.intrinsics.focal_length_px * (1 + share))
        yield {**found, "growth_rate": compute_growth_error(sight, found, wrong)}

    def miscalibrate(self, recording: xr.Dataset, calibration: Calibration, draw: int) -> None:
        """Change the focal length in the recording."""
        (drawn,) = self.drawn_values(draw)
        recording.attrs["focal_length_px"] *= 1 + calibration.focal_length_percent / 100 * drawn


class ResidualDistortionSource(UncertaintySource):
    """Residual lens distortion: deviations from a pinhole camera that vary over the image."""

    kind = "lens_residual"
    title = "lens distortion"
    group = "calibration"
    perfect: ClassVar[Mapping[str, Any]] = {"camera.distortion": None}

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the largest displacement in a corner."""
        camera = scene.camera
        if camera.distortion is None:
            return ""
        corner = np.array([0.0, 0.0]) - camera.principal_point
        off = camera.distortion.distort(corner / camera.focal_px) * camera.focal_px - corner
        return f"{format_two_digits(float(np.linalg.norm(off)))} px in a corner"

    def disturbances(self, sight: ObservationModel) -> Iterable[Disturbance]:
        """Yield the difference of the displacement between each image and the reference."""
        distortion = sight.scene.camera.distortion
        if distortion is None:
            return
        focal = sight.intrinsics.focal_length_px

        def shift(x: Map, y: Map) -> Map:
            points = np.stack([x, y], axis=-1) / focal
            return (distortion.distort(points) - points) * focal

        here = shift(sight.points.x, sight.points.y)

        def change(s: int, t: int) -> ImageDisturbance:
            place = sight.place(s, t)
            off = shift(place.x, place.y) - here
            return ImageDisturbance(off[..., 0], off[..., 1])

        yield change

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation:
        """Return a calibration of the lens."""
        return Mitigation("calibration of the lens, with undistorted images", {self.kind: 0.05})


class PrincipalPointSource(CalibrationSource):
    """Error of the principal point: U_X and U_Y have the error -δc U_Z / f."""

    kind = "principal_point"
    title = "principal point"
    field = "principal_point_px"
    unit = "px"
    signs = ("+--+", "+-")

    def compute_responses(self, sight: ObservationModel, *off: float) -> Iterator[Errors]:
        """Yield the errors for a displacement along x, and along y."""
        c_x, c_y = sight.intrinsics.principal_point_px
        for k, one in enumerate(off):
            found = {
                "depth": 0.0 * sight.depth,
                "velocity_z": 0.0 * sight.depth,
                f"velocity_{'xy'[k]}": -one * sight.velocity[2] / sight.intrinsics.focal_length_px,
            }
            wrong = replace(sight.intrinsics, principal_point_px=(c_x + one * (k == 0), c_y + one * (k == 1)))
            yield {**found, "growth_rate": compute_growth_error(sight, found, wrong)}

    def miscalibrate(self, recording: xr.Dataset, calibration: Calibration, draw: int) -> None:
        """Change the principal point in the recording."""
        point = np.asarray(recording.attrs["principal_point_px"], dtype=np.float64)
        point = point + calibration.principal_point_px * np.array(self.drawn_values(draw))
        recording.attrs["principal_point_px"] = point.tolist()
