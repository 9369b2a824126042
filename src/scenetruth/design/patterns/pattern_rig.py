"""The camera for which a pattern is made: pixel size on the surface, contrast transfer, grey levels and their noise."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.camera import AnySensor, Defocus, GaussianSensor, build_sensor_chain
from scenetruth.camera.lens import Psf
from scenetruth.design.patterns.pattern_model import PatternError, validate_values
from scenetruth.design.prediction.camera_response import compute_grey_levels
from scenetruth.errors import Problem, SceneError, SceneWarning
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


# Pixels along the longer side of the image from which the distance of a scene's surfaces is taken.
_COARSE_PX = 64


class PatternRig(FrozenModel):
    """A camera on its stage, in front of a flat surface that faces it.

    See Also
    --------
    scenetruth.design.patterns.PatternRig.from_scene : The rig of a scene, or of a few numbers.
    scenetruth.design.patterns.generate_pattern : A pattern for it.

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
    """Nearest and farthest depth that the pattern will be seen at; null if there is no other than ``distance_mm``."""
    image_size_px: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]] | None = None
    """Width and height of the image; null if unknown."""
    baseline_mm: Positive | None = None
    """Distance of neighbouring positions; null if unknown: then nothing can be said of depth in mm."""
    positions: Annotated[int, Field(ge=1)] = 2
    """Camera positions."""
    frames: Annotated[int, Field(ge=1)] = 1
    """Frames at each of them."""
    psf: Psf | None = None
    """Point spread function of the lens in focus; null for a perfect lens."""
    defocus: Defocus | None = None
    """Its aperture and focus; null if everything is sharp."""
    sensor: AnySensor = GaussianSensor(noise_std=0.01)
    """The sensor, for its noise: 1 % of full scale, 8 bits, if nothing is known."""
    light: Positive = 1.0
    """Radiance of a perfectly white surface; textures of scenes without lamps have 1."""

    @classmethod
    def from_scene(
        cls,
        scene: SceneLike | None = None,
        *,
        distance_mm: float | None = None,
        light: float | None = None,
        **changes: Any,
    ) -> PatternRig:
        """Return the rig of a scene, or of a few numbers.

        Parameters
        ----------
        scene
            The scene, its values, its file, or the name of one that is shipped; None for a rig of numbers alone.
        distance_mm
            Depth of the surface; of a scene, the median depth of what the reference camera sees if not given.
        light
            Radiance of a perfectly white surface, 1 if not given.
        **changes
            Other fields of `PatternRig`, which replace the scene's.

        Returns
        -------
        PatternRig
            Positions that are not equidistant count as so many with the same spread.

        Raises
        ------
        PatternError
            If a number is missing or impossible; lists all that is wrong.
        SceneError
            If the scene cannot be made.

        See Also
        --------
        scenetruth.design.patterns.generate_pattern : A pattern for a rig.

        Examples
        --------
        >>> from scenetruth.design.patterns import PatternRig
        >>> rig = PatternRig.from_scene(focal_length_px=5000, distance_mm=600)
        >>> f"{rig.mm_per_px:.2f} mm per px"
        '0.12 mm per px'

        Of a scene, at the depth that its camera sees:

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
            values = {**_read_values(load_scene(scene), measured=distance_mm is None), **values}
        rig, problems = validate_values(cls, values)
        if rig is None:
            raise PatternError(problems, source="the rig")
        return rig

    @property
    def mm_per_px(self) -> float:
        """Size of a pixel on the surface, Z / f, in mm."""
        return self.distance_mm / self.focal_length_px

    @property
    def field_mm(self) -> tuple[float, float] | None:
        """Width and height of what the image shows of the surface in mm; None if the image's size is unknown."""
        if self.image_size_px is None:
            return None
        return self.image_size_px[0] * self.mm_per_px, self.image_size_px[1] * self.mm_per_px


def _read_values(scene: Scene, *, measured: bool) -> dict[str, Any]:
    """Return the fields of a scene's rig; its distance only if it is to be ``measured``."""
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
        # As far apart as gives the same sum of squares.
        even = np.arange(stage.positions)
        values["baseline_mm"] = float(np.std(stage.x_mm) / np.std(even))
    if measured:
        near, middle, far = _depths(scene)
        values |= {"distance_mm": middle, "depth_range_mm": (near, far)}
    return values


def _depths(scene: Scene) -> tuple[float, float, float]:
    """Return the least depth, the median and the largest of what the reference camera sees, on a coarse grid."""
    from scenetruth.truth import make_truth

    with warnings.catch_warnings():
        # What is seen on a coarse grid is not what the scene should be warned of.
        warnings.simplefilter("ignore", SceneWarning)
        depth = make_truth(_unpainted(scene).shrunk_to(_COARSE_PX))["depth"].values
    seen = depth[np.isfinite(depth)]
    if not seen.size:
        message = "cannot be told: the reference camera sees no surface; give it"
        raise SceneError([Problem("distance_mm", message)])
    return float(seen.min()), float(np.median(seen)), float(seen.max())


def _unpainted(scene: Scene) -> Scene:
    """Return a scene whose objects have no textures, which take long to paint."""
    plain = UniformTexture(kind="uniform")
    return scene.model_copy(
        update={"objects": tuple(item.model_copy(update={"texture": plain}) for item in scene.objects)}
    )


Array = NDArray[np.float64]


def compute_contrast_transfer(rig: PatternRig, along_x: Array, along_y: Array) -> Array:
    """Return the modulation transfer of a rig: lens in focus, blur disc out of focus, and the pixel's aperture.

    ``along_x``, ``along_y``: Spatial frequencies in periods per px; they are broadcast.
    Returns: Contrast that is left; negative where a blur disc reverses it. A disc of diameter b px leaves 2 J1(π b f) /
    (π b f), a square pixel sin(π f) / (π f) along each axis.
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


# Levels between which a sensor's response is inverted.
_LEVELS = 257


@dataclass(frozen=True)
class PatternGreyLevel:
    """A grey value, as a share of full scale.

    ``grey``: The grey value.
    ``gain``: What it changes by per radiance.
    ``noise_std``: Standard deviation of the noise that is new in every image, rounding included; 0 of an ideal sensor.
    """

    grey: float
    gain: float
    noise_std: float


def compute_grey_level(rig: PatternRig, radiance: float) -> PatternGreyLevel:
    """Return the grey value that a rig's sensor gives of a radiance."""
    found = compute_grey_levels(rig.sensor, np.array([radiance]))
    return PatternGreyLevel(float(found.level[0]), float(found.gain[0]), float(found.noise[0]))


def find_grey_level(rig: PatternRig, grey: float) -> PatternGreyLevel:
    """Return the level of light at which a rig's sensor gives a grey value."""
    radiances = np.linspace(0.0, build_sensor_chain(rig.sensor).saturation_radiance, _LEVELS)
    return compute_grey_level(rig, float(np.interp(grey, compute_grey_levels(rig.sensor, radiances).level, radiances)))
