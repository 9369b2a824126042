"""The rig that a pattern is designed for: pixel size on the surface, contrast transfer, grey levels and noise."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.camera import AnySensor, Defocus, GaussianSensor, build_sensor_chain
from scenetruth.camera.lens import Psf
from scenetruth.design.patterns.pattern_model import validate_values
from scenetruth.design.prediction.camera_response import compute_grey_levels
from scenetruth.errors import ArgumentError, Problem, SceneError, SceneWarning
from scenetruth.scene import Scene, SceneLike, load_scene
from scenetruth.scene.texture.procedural_textures import UniformTexture
from scenetruth.validated_model import FrozenModel, Positive

__all__ = [
    "PatternGreyLevel",
    "PatternRig",
    "compute_contrast_transfer",
    "compute_grey_level",
    "find_grey_level",
]


_COARSE_PX = 64  # pixels along the longer side of the coarse image from which surface distances are measured


class PatternRig(FrozenModel):
    """A camera on its stage, in front of a flat, fronto-parallel surface.

    See Also
    --------
    scenetruth.design.patterns.PatternRig.from_scene : A rig from a scene or from numbers.
    scenetruth.design.patterns.generate_pattern : Generates a pattern for a rig.

    Examples
    --------
    >>> rig = PatternRig(focal_length_px=5000, distance_mm=600, image_size_px=(1280, 960), baseline_mm=5, positions=5)
    >>> f"{rig.mm_per_px:.2f} mm per px, {rig.field_mm[0]:.1f} x {rig.field_mm[1]:.1f} mm in the image"
    '0.12 mm per px, 153.6 x 115.2 mm in the image'
    >>> rig.sensor.noise_std, rig.frames
    (0.01, 1)
    """

    focal_length_px: Positive
    """Focal length f in px."""
    distance_mm: Positive
    """Depth Z of the surface in mm."""
    depth_range_mm: tuple[Positive, Positive] | None = None
    """Smallest and largest depth of the pattern in mm; null if it is used at ``distance_mm`` only."""
    image_size_px: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]] | None = None
    """Width and height of the image in px; null if unspecified."""
    baseline_mm: Positive | None = None
    """Distance of neighbouring positions in mm; null if unspecified: depth is then not assessed."""
    positions: Annotated[int, Field(ge=1)] = 2
    """Number of camera positions."""
    frames: Annotated[int, Field(ge=1)] = 1
    """Number of frames at each position."""
    psf: Psf | None = None
    """Point-spread function of the lens in focus; null for a perfect lens."""
    defocus: Defocus | None = None
    """Aperture and focus distance; null without defocus."""
    sensor: AnySensor = GaussianSensor(noise_std=0.01)
    """Sensor model; default: noise of 1 % of full scale, 8 bits."""
    light: Positive = 1.0
    """Radiance of a perfectly white surface; 1 in scenes without lamps."""

    @classmethod
    def from_scene(
        cls,
        scene: SceneLike | None = None,
        *,
        distance_mm: float | None = None,
        light: float | None = None,
        **changes: Any,
    ) -> PatternRig:
        """Return a rig from a scene or from numbers.

        Parameters
        ----------
        scene
            The scene, its values, its file, or the name of a bundled scene; None for a rig from numbers.
        distance_mm
            Depth of the surface; default: the median depth seen by the reference camera.
        light
            Radiance of a perfectly white surface; default: 1.
        **changes
            Other fields of `PatternRig`, which override those of the scene.

        Returns
        -------
        PatternRig
            Unequal position intervals are replaced by equal intervals with the same variance.

        Raises
        ------
        ArgumentError
            If a number is missing or invalid; lists all errors.
        SceneError
            If the scene is invalid.

        See Also
        --------
        scenetruth.design.patterns.generate_pattern : Generates a pattern for a rig.

        Examples
        --------
        >>> from scenetruth.design.patterns import PatternRig
        >>> rig = PatternRig.from_scene(focal_length_px=5000, distance_mm=600)
        >>> f"{rig.mm_per_px:.2f} mm per px"
        '0.12 mm per px'

        From a scene, at the depth seen by its camera:

        >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}}
        >>> wall |= {"pose": {"position_mm": [0, 0, 100]}}
        >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 60}, "objects": [wall]}
        >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 2}}
        >>> rig = PatternRig.from_scene(plain)
        >>> f"{rig.distance_mm:g} mm, {rig.positions} positions {rig.baseline_mm:g} mm apart, {rig.frames} frames"
        '100 mm, 3 positions 5 mm apart, 2 frames'
        """
        values: dict[str, Any] = dict(changes)
        if distance_mm is not None:
            values["distance_mm"] = distance_mm
        if light is not None:
            values["light"] = light
        if scene is not None:
            known = load_scene(scene)
            known.require_grey("a rig of patterns")
            values = {**_read_values(known, measured=distance_mm is None), **values}
        rig, problems = validate_values(cls, values)
        if rig is None:
            raise ArgumentError(problems, source="the rig")
        return rig

    @property
    def mm_per_px(self) -> float:
        """Size of a pixel on the surface, Z / f, in mm."""
        return self.distance_mm / self.focal_length_px

    @property
    def field_mm(self) -> tuple[float, float] | None:
        """Width and height of the field of view in mm; None without an image size."""
        if self.image_size_px is None:
            return None
        return self.image_size_px[0] * self.mm_per_px, self.image_size_px[1] * self.mm_per_px


def _read_values(scene: Scene, *, measured: bool) -> dict[str, Any]:
    """Return the rig fields of a scene, including its distance if ``measured``."""
    camera, stage = scene.camera, scene.stage
    values: dict[str, Any] = {
        "focal_length_px": camera.focal_px,
        "image_size_px": (camera.width, camera.height),
        "positions": stage.positions,
        "frames": scene.frames.count,
        "psf": scene.optics.psf,
        "defocus": scene.optics.defocus,
        "sensor": scene.sensor,
    }
    if stage.positions > 1:
        even = np.arange(stage.positions)  # equal intervals with the same sum of squares
        values["baseline_mm"] = float(np.std(stage.x_mm) / np.std(even))
    if measured:
        near, middle, far = _depths(scene)
        values |= {"distance_mm": middle, "depth_range_mm": (near, far)}
    return values


def _depths(scene: Scene) -> tuple[float, float, float]:
    """Return the minimum, median and maximum depth seen by the reference camera, on a coarse grid."""
    from scenetruth.simulation import make_truth

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneWarning)  # warnings on a coarse grid do not apply to the scene
        depth = make_truth(_unpainted(scene).shrunk_to(_COARSE_PX))["depth"].values
    seen = depth[np.isfinite(depth)]
    if not seen.size:
        message = "cannot be measured: no surface is visible to the reference camera; specify it"
        raise SceneError([Problem("distance_mm", message)])
    return float(seen.min()), float(np.median(seen)), float(seen.max())


def _unpainted(scene: Scene) -> Scene:
    """Return a scene with uniform textures, which need no painting."""
    plain = UniformTexture(kind="uniform")
    return scene.model_copy(
        update={"objects": tuple(item.model_copy(update={"texture": plain}) for item in scene.objects)}
    )


Array = NDArray[np.float64]


def compute_contrast_transfer(rig: PatternRig, along_x: Array, along_y: Array) -> Array:
    """Return the modulation transfer of a rig: lens in focus, defocus disc, and pixel aperture.

    A disc of diameter b px gives 2 J1(π b f) / (π b f), negative where contrast is reversed, and a square pixel
    sin(π f) / (π f) along each axis. ``along_x``, ``along_y``: Frequencies in periods per px, broadcast.
    """
    from scipy.special import j1

    radial = np.hypot(along_x, along_y)
    left = np.sinc(along_x) * np.sinc(along_y)
    if rig.psf is not None:
        left = left * rig.psf.transfer(radial)
    if rig.defocus is not None:
        blur = float(rig.defocus.blur_diameter_px(np.array(rig.distance_mm), rig.focal_length_px))
        angle = np.pi * blur * radial
        left = left * np.where(angle > 1e-6, 2 * j1(angle) / np.maximum(angle, 1e-6), 1.0)
    return np.asarray(left)


_LEVELS = 257  # number of levels for the inversion of a sensor's response


@dataclass(frozen=True)
class PatternGreyLevel:
    """Grey value relative to full scale, its derivative by radiance, and temporal noise including rounding."""

    grey: float
    gain: float
    noise_std: float


def compute_grey_level(rig: PatternRig, radiance: float) -> PatternGreyLevel:
    """Return the grey level of a rig's sensor for a radiance."""
    found = compute_grey_levels(rig.sensor, np.array([radiance]))
    return PatternGreyLevel(float(found.level[0]), float(found.gain[0]), float(found.noise[0]))


def find_grey_level(rig: PatternRig, grey: float) -> PatternGreyLevel:
    """Return the grey level of a rig's sensor closest to a grey value."""
    radiances = np.linspace(0.0, build_sensor_chain(rig.sensor).saturation_radiance, _LEVELS)
    return compute_grey_level(rig, float(np.interp(grey, compute_grey_levels(rig.sensor, radiances).level, radiances)))
