"""Result of a calibration: camera, stage, covariance, and their files."""

from __future__ import annotations

import hashlib
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenetruth.camera import Camera, Viewpoint
from scenetruth.capture.calibration.bundle_adjustment import ViewResidual
from scenetruth.capture.calibration.calibration_file import (
    covariance_problem,
    parameter_names,
    read_calibration_file,
    visits_problem,
)
from scenetruth.capture.calibration.diagnostics import Combination
from scenetruth.capture.calibration.measurement_covariance import CommonError, Moment, RigGeometry, common_error
from scenetruth.capture.calibration.rig_model import (
    INTRINSICS,
    MOTION,
    CalibrationError,
    RigLayout,
    RigPriors,
    RigState,
)
from scenetruth.errors import Problem
from scenetruth.number_format import format_two_digits, format_with_std
from scenetruth.output import check_output, write_atomically

__all__ = ["RigCalibration"]

Array = NDArray[np.float64]

_STRONG = 0.8
_GAUGE, _LISTED = 1e-2, 5
"""Combinations of less information belong to the choice of the frame; and the number of lines in a summary."""
_UNITS = {"f": "px", "c_x": "px", "c_y": "px", "axis_y": "rad", "axis_z": "rad", "step_scale": "", "backlash": "mm"}


@dataclass(frozen=True, eq=False)
class RigCalibration:
    """Calibrated camera on its stage, with the covariance of all parameters except the poses of the targets.

    Attributes
    ----------
    width, height
        Image size in px.
    positions_mm
        Nominal X of every stage position in mm, shape (S,).
    reference
        Index of the position whose camera frame is that of the results.
    names
        Names of the parameters: intrinsics, stage, positions, visits, targets.
    values
        Their values, shape (P,).
    covariance
        Their covariance, shape (P, P); zero for fixed parameters.
    prior_std
        Prior standard deviations; infinite without a prior, 0 for fixed parameters.
    chi2, dof
        Weighted sum of squared residuals and its degrees of freedom.
    images
        Residuals of every image.
    warnings
        Everything that speaks against the calibration; empty if nothing does.
    combinations
        Combinations of parameters with a prior, and how much the images determine them, the best first.
    bit_depth
        Bits of the digital numbers of the camera, by which a calibration of another camera is noticed; None if they are
        not stated.
    measured_visits
        Visits of the measurement by position and frame, if a strip has determined them; else empty.
    measured_images
        Hash of the images of the measurement that show the strip.

    See Also
    --------
    scenetruth.capture.calibration.calibrate : Computes it from images of boards.

    Examples
    --------
    >>> import numpy as np
    >>> from scenetruth.camera import Camera
    >>> from scenetruth.capture.calibration import RigCalibration
    >>> camera = Camera(width=640, height=480, focal_length_px=5000)
    >>> stated = RigCalibration.from_camera(camera, [-5, 0, 5], std={"f": 5.0, "c_x": 5.0, "c_y": 5.0})
    >>> stated.value("f"), stated.std("f")
    (5000.0, 5.0)
    >>> x, y, z = stated.point_errors([[319.5, 239.5]], depth_mm=660)
    >>> print(np.round(z.std, 3))
    [0.66]
    """

    width: int
    height: int
    positions_mm: Array
    reference: int
    names: tuple[str, ...]
    values: Array
    covariance: Array = field(repr=False)
    prior_std: Array = field(repr=False)
    visits: tuple[int, ...] = ()
    targets: tuple[str, ...] = ()
    chi2: float = 0.0
    dof: int = 0
    images: tuple[ViewResidual, ...] = field(default=(), repr=False)
    warnings: tuple[str, ...] = ()
    combinations: tuple[Combination, ...] = field(default=(), repr=False)
    bit_depth: int | None = None
    measured_visits: tuple[tuple[int, ...], ...] = ()
    measured_images: str = ""

    def __post_init__(self) -> None:
        problems = list(self._problems())
        if problems:
            raise CalibrationError(problems)

    @classmethod
    def from_camera(
        cls, camera: Camera, positions_mm: ArrayLike, *, std: Mapping[str, float] | None = None,
        reference: int | None = None, priors: RigPriors | None = None, bit_depth: int | None = None,
    ) -> RigCalibration:  # fmt: skip
        """Return a calibration of a given camera on a stage with given tolerances.

        Parameters
        ----------
        camera
            Camera with its lens distortion.
        positions_mm
            X of the stage positions in mm.
        std
            Standard deviations of intrinsic parameters by name; others are 0.
        reference
            Index of the reference position; default: the middle one.
        priors
            Tolerances of the stage; default: an ideal stage.
        bit_depth
            Bits of the digital numbers of the camera.

        Returns
        -------
        RigCalibration
            The calibration, with a diagonal covariance. With tolerances it has one visit, which states those of all.
        """
        positions = np.array(positions_mm, dtype=np.float64)
        visits = () if priors is None else (0,)
        names = parameter_names(len(positions), visits, ())
        values, deviations = np.zeros(len(names)), np.zeros(len(names))
        values[:3] = camera.focal_px, *camera.principal_point
        if camera.distortion is not None:
            values[3 : len(INTRINSICS)] = [getattr(camera.distortion, name) for name in INTRINSICS[3:]]
        for name, value in (std or {}).items():
            if name not in INTRINSICS:
                raise CalibrationError([Problem(f"std.{name}", f"must be one of {', '.join(INTRINSICS)}")])
            deviations[INTRINSICS.index(name)] = value
        if priors is not None:
            axis = [priors.axis_rad, priors.axis_rad, priors.step_std, 1e-3 * priors.errors.backlash_um, 0.0]
            deviations[len(INTRINSICS) :] = [*axis, *priors.guide_std * len(positions), *priors.visit_std]
        middle = (len(positions) - 1) // 2 if reference is None else reference
        return cls(
            camera.width, camera.height, positions, middle, names, values, np.diag(deviations**2), deviations.copy(),
            visits, bit_depth=bit_depth,
        )  # fmt: skip

    @classmethod
    def from_state(
        cls, state: RigState, covariance: Array, size: tuple[int, int], positions_mm: Array, reference: int,
        targets: tuple[str, ...], **fit: Any,
    ) -> RigCalibration:  # fmt: skip
        """Return the calibration of a fitted state, without the poses."""
        kept = state.layout.first_pose
        return cls(
            *size, np.array(positions_mm, dtype=np.float64), reference, state.layout.names[:kept],
            state.values[:kept].copy(), covariance[:kept, :kept].copy(), state.layout.std[:kept].copy(),
            state.layout.visits, targets, **fit,
        )  # fmt: skip

    def value(self, name: str) -> float:
        """Return the value of a parameter."""
        return float(self.values[self._index(name)])

    def std(self, name: str) -> float:
        """Return the standard deviation of a parameter."""
        index = self._index(name)
        return float(np.sqrt(self.covariance[index, index]))

    def correlation(self, one: str, other: str) -> float:
        """Return the correlation of two parameters; NaN if one of them is fixed."""
        product = self.std(one) * self.std(other)
        return float(self.covariance[self._index(one), self._index(other)] / product) if product else math.nan

    def _index(self, name: str) -> int:
        if name not in self.names:
            raise CalibrationError([Problem(name, f"is no parameter; use one of {', '.join(self.names[:15])}, ...")])
        return self.names.index(name)

    @cached_property
    def camera(self) -> Camera:
        """Camera with its lens distortion."""
        return RigState(self.layout, self.values, np.empty((0, 3, 3))).camera(self.width, self.height)

    @cached_property
    def layout(self) -> RigLayout:
        """Places of the parameters in the vectors."""
        return RigLayout(len(self.positions_mm), self.visits, len(self.targets), (), self.prior_std, self.names)

    @property
    def variance_factor(self) -> float:
        """Chi-squared per degree of freedom; 1 if the stated noise of the corners is right."""
        return self.chi2 / self.dof if self.dof else math.nan

    def viewpoint(self, position: int, visit: int | None = None) -> Viewpoint:
        """Return the pose of the camera at a position in the frame of the reference camera.

        Parameters
        ----------
        position
            Index of the position.
        visit
            Number of the visit whose estimated motion is included; default: the position without a visit's motion.
        """
        motions = np.zeros((len(self.positions_mm), 6))
        if visit is not None:
            start = self.layout.first_visit + 6 * self.visits.index(visit)
            motions[position] = self.values[start : start + 6]
        rig = RigGeometry.from_values(self.values, self.layout, self.positions_mm, self.reference, motions)
        centre, rotation = rig.frame
        place = (rig.centres_mm[position] - centre) @ rotation
        return Viewpoint(place, rotation.T @ rig.rotations[position])

    @property
    def axis(self) -> Array:
        """Direction of the stage axis in the frame of the reference camera, of unit length; shape (3,)."""
        rig = RigGeometry.from_values(self.values, self.layout, self.positions_mm, self.reference)
        axis = np.array([1.0, *self.values[len(INTRINSICS) : len(INTRINSICS) + 2]]) @ rig.frame[1]
        return np.asarray(axis / np.linalg.norm(axis))

    def measured(self) -> RigCalibration:
        """Return the calibration whose positions are the mean poses of the visits of the measurement.

        Returns
        -------
        RigCalibration
            Its visits are those of the measurement, relative to these means. Without a strip, the calibration itself.
        """
        if not self.measured_visits:
            return self
        visits = tuple(visit for each in self.measured_visits for visit in each)
        names = parameter_names(len(self.positions_mm), visits, self.targets)
        places = {name: index for index, name in enumerate(self.names)}
        matrix = np.zeros((len(names), len(self.names)))
        matrix[np.arange(len(names)), [places[name] for name in names]] = 1.0
        rows = {name: index for index, name in enumerate(names)}
        for position, each in enumerate(self.measured_visits):
            for motion in MOTION:
                columns = [places[f"visit[{visit}].{motion}"] for visit in each]
                matrix[rows[f"position[{position}].{motion}"], columns] += 1 / len(each)
                for visit in each:
                    matrix[rows[f"visit[{visit}].{motion}"], columns] -= 1 / len(each)
        covariance = matrix @ self.covariance @ matrix.T
        return replace(
            self, names=names, values=matrix @ self.values, covariance=(covariance + covariance.T) / 2,
            prior_std=self.prior_std[[places[name] for name in names]], visits=visits,
        )  # fmt: skip

    @property
    def visit_std(self) -> Array:
        """Standard deviations of what a new visit adds to a pose: rotation vector in rad and offset in mm, (6,)."""
        start = self.layout.first_visit
        return self.prior_std[start : start + 6].copy() if self.visits else np.zeros(6)

    def point_errors(
        self, pixels: ArrayLike, depth_mm: ArrayLike, *, displacement_mm: ArrayLike | None = None,
        visit_std: ArrayLike | None = None, visits: Sequence[Sequence[int]] | None = None,
    ) -> tuple[CommonError, CommonError, CommonError]:  # fmt: skip
        """Return the errors of X, Y and Z that the uncertainty of the calibration causes.

        Parameters
        ----------
        pixels
            Pixels of the reference camera, shape (n, 2); the covariance has n x n values, so that a coarse grid over
            the image is advised, which varies smoothly.
        depth_mm
            Depth at these pixels, shape (n,) or one value.
        displacement_mm
            Displacement between two frames, shape (n, 3); then the errors are those of the displacement.
        visit_std
            Standard deviations of the motion of a new visit: rotation vector in rad and offset in mm, shape (6,);
            default: the prior of the visits of the calibration.
        visits
            Numbers of the visits of every position, for one or two frames, if the calibration has estimated them, for
            example by a strip; default: new visits.

        Returns
        -------
        tuple of CommonError
            Errors along X, Y and Z in mm, each with its modes over the pixels.
        """
        if len(self.positions_mm) < 2:
            message = "are one, and a point has no depth from it: calibrate from at least two"
            raise CalibrationError([Problem("positions_mm", message, self.positions_mm.tolist())])
        where = np.atleast_2d(np.asarray(pixels, dtype=np.float64))
        depth = np.broadcast_to(np.asarray(depth_mm, dtype=np.float64), (len(where),))
        points = self.camera.ray_directions(where) * depth[:, None]
        if not np.isfinite(points).all():
            raise CalibrationError([Problem("pixels", "must be in the image, where the distortion is invertible")])
        frames = [points] if displacement_mm is None else [points, points + np.asarray(displacement_mm)]
        if visits is not None and (
            len(visits) != len(frames) or any(len(each) != len(self.positions_mm) for each in visits)
        ):
            message = f"must list {len(self.positions_mm)} visits for each of {len(frames)} frames"
            raise CalibrationError([Problem("visits", message)])
        numbers = {visit: number for number, visit in enumerate(self.visits)}
        moments = [
            Moment(each, None if visits is None else tuple(numbers[visit] for visit in visits[number]))
            for number, each in enumerate(frames)
        ]
        deviations = self.visit_std if visit_std is None else np.asarray(visit_std, dtype=np.float64)
        return common_error(
            self.values, self.covariance, self.layout, self.positions_mm, self.reference, moments, visit_std=deviations
        )

    def summary(self) -> str:
        """Return the parameters with their standard deviations, and the quality of the fit, as text."""
        lines = []
        for name in (
            *INTRINSICS,
            "aspect",
            "axis_y",
            "axis_z",
            "step_scale",
            *(f"{name}.scale" for name in self.targets),
        ):
            if name in self.names and (self.std(name) > 0 or self.value(name) != 0):
                unit = f" {_UNITS[name]}" if _UNITS.get(name) else ""
                lines.append(f"{name:>14} = {format_with_std(self.value(name), self.std(name))}{unit}")
        pairs = [("c_x", "p2"), ("c_y", "p1")]
        strong = [f"{a} and {b}" for a, b in pairs if abs(self.correlation(a, b)) > _STRONG]
        if strong:
            lines.append(f"  strongly correlated, to be used together only: {', '.join(strong)}")
        used = [image for image in self.images if image.consistent]
        if self.images:
            points = sum(image.points for image in used)
            rms = math.sqrt(sum(image.points * image.rms_px**2 for image in used) / max(points, 1))
            lines.append(
                f"{points} points in {len(used)} of {len(self.images)} "
                f"images, residual {format_two_digits(rms)} px rms, "
                f"chi-squared / degrees of freedom {self.variance_factor:.2f}"
            )
        weak = [each for each in self.combinations if not each.from_images and each.ratio > _GAUGE]
        lines += [f"determined by tolerances rather than images: {each.words}" for each in weak[:_LISTED]]
        lines += [f"warning: {text}" for text in self.warnings]
        return "\n".join(lines)

    def _problems(self) -> list[Problem]:
        expected = parameter_names(len(self.positions_mm), self.visits, self.targets)
        if tuple(self.names) != expected:
            return [Problem("names", f"must be the {len(expected)} parameters of the rig; got {len(self.names)}")]
        problems = []
        if not 0 <= self.reference < len(self.positions_mm):
            problems.append(Problem("reference", f"must be an index below {len(self.positions_mm)}", self.reference))
        if self.values.shape != (len(expected),) or not np.isfinite(self.values).all():
            problems.append(Problem("values", f"must be {len(expected)} finite numbers"))
        elif self.values[0] <= 0:
            problems.append(Problem("parameters.f", "must be positive", float(self.values[0])))
        message = visits_problem(self.measured_visits, self.visits, len(self.positions_mm))
        problems += [Problem("measured_visits", message)] if message else []
        message = covariance_problem(self.covariance, self.names)
        return problems + ([Problem("covariance", message)] if message else [])

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the calibration as a YAML file, and its covariance as an NPZ file of the same name.

        Parameters
        ----------
        path
            YAML file, for example ``calibration.yaml``.
        overwrite
            Replace existing files.

        Returns
        -------
        pathlib.Path
            The YAML file.

        Raises
        ------
        OutputExistsError
            If a file exists and ``overwrite`` is not set.
        """
        import yaml

        file = Path(path)
        if file.suffix not in (".yaml", ".yml"):
            raise CalibrationError([Problem("path", "must end with .yaml", str(file))])
        matrix = file.with_suffix(".npz")
        for each in (file, matrix):
            check_output(each, overwrite=overwrite)
        buffer = io.BytesIO()
        np.savez_compressed(buffer, names=np.array(self.names), covariance=self.covariance)
        content = buffer.getvalue()
        text = yaml.safe_dump(
            self._plain(matrix.name, hashlib.sha256(content).hexdigest()),
            sort_keys=False,
            width=120,
            allow_unicode=True,
        )
        with write_atomically(matrix, overwrite=overwrite) as partial:
            partial.write_bytes(content)
        with write_atomically(file, overwrite=overwrite) as partial:
            partial.write_text(text, encoding="utf-8")
        return file

    def _plain(self, matrix: str, digest: str) -> dict[str, Any]:
        deviations = np.sqrt(np.diag(self.covariance))
        return {
            "format": 1,
            "camera": {"width": self.width, "height": self.height}
            | ({} if self.bit_depth is None else {"bit_depth": self.bit_depth}),
            "stage": {"positions_mm": self.positions_mm.tolist(), "reference": self.reference},
            "visits": list(self.visits),
            "targets": list(self.targets),
            "parameters": {
                name: {
                    "value": float(value),
                    "std": float(f"{std:.6g}"),
                    "prior_std": float(prior) if math.isfinite(prior) else None,
                }
                for name, value, std, prior in zip(self.names, self.values, deviations, self.prior_std, strict=True)
                # Parameters that are fixed at 0 are not listed.
                if std > 0 or value != 0 or prior > 0
            },
            "chi2": float(self.chi2),
            "dof": int(self.dof),
            "images": [vars(image) for image in self.images],
            "warnings": list(self.warnings),
            "combinations": [{"ratio": float(f"{each.ratio:.3g}"), "words": each.words} for each in self.combinations],
            **(
                {
                    "measured_visits": [list(one) for one in self.measured_visits],
                    "measured_images": self.measured_images,
                }
                if self.measured_visits
                else {}
            ),
            "covariance": {"file": matrix, "sha256": digest},
        }

    @classmethod
    def load(cls, path: str | PathLike[str]) -> RigCalibration:
        """Read a calibration written by `save`.

        Parameters
        ----------
        path
            YAML file; the NPZ file lies next to it.

        Returns
        -------
        RigCalibration
            The calibration.

        Raises
        ------
        ValueError
            A `CalibrationError` that lists every problem, among them a matrix that is no covariance.
        """
        file = Path(path)
        given, covariance = read_calibration_file(file)
        names = parameter_names(len(given.stage.positions_mm), given.visits, given.targets)
        listed = [given.parameters.get(name) for name in names]
        values = np.array([0.0 if each is None else each.value for each in listed])
        priors = [0.0 if each is None else math.inf if each.prior_std is None else each.prior_std for each in listed]
        return cls(
            given.camera.width, given.camera.height, np.array(given.stage.positions_mm), given.stage.reference,
            names, values, covariance, np.array(priors), given.visits, given.targets, given.chi2, given.dof,
            tuple(ViewResidual(**each.model_dump()) for each in given.images), given.warnings,
            tuple(Combination(**each.model_dump()) for each in given.combinations), given.camera.bit_depth,
            given.measured_visits, given.measured_images,
        )  # fmt: skip
