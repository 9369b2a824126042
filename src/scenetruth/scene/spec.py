"""The models of a scene; a scene file in YAML is only their spelling."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, ValidationInfo, field_validator, model_validator

from scenetruth.camera import Camera, EmvaSensor, Frames, Optics, Sensor, Shutter, Stage
from scenetruth.model import Finite, FrozenModel, NonNegative, Positive
from scenetruth.scene.deformation_spec import Deformation
from scenetruth.scene.leaf_spec import LeafMesh, LeafTexture
from scenetruth.scene.lighting_spec import Lighting
from scenetruth.scene.motions import Motion
from scenetruth.scene.nodal_spec import MeshSeries, Morph, Nodal, NodalModel
from scenetruth.scene.plant_spec import Plant, Rosette, Seedling
from scenetruth.scene.pose_spec import Pose, Rotation
from scenetruth.scene.surface_spec import CylinderMesh, PlaneMesh, ReliefMesh, SaddleMesh, SphereMesh, StairsMesh
from scenetruth.settings import EstimateSettings, ScoreSettings

__all__ = [
    "BoxMesh",
    "CylinderMesh",
    "FileMesh",
    "ImageTexture",
    "LeafMesh",
    "LeafTexture",
    "Lighting",
    "Mesh",
    "Motion",
    "NoiseTexture",
    "OwnTexture",
    "PlaidTexture",
    "PlaneMesh",
    "Plant",
    "Pose",
    "ReliefMesh",
    "RenderSettings",
    "Rosette",
    "Rotation",
    "SaddleMesh",
    "Scene",
    "SceneObject",
    "Seedling",
    "SphereMesh",
    "StairsMesh",
    "Texture",
    "UniformTexture",
]

Radiance = Annotated[float, Field(ge=0, le=1)]


class BoxMesh(FrozenModel):
    """A box, centred on its origin."""

    kind: Literal["box"]
    """``box``."""
    size_mm: tuple[Positive, Positive, Positive]
    """Edge lengths along X, Y, Z in mm."""


class FileMesh(FrozenModel):
    """A triangle mesh from a file (OBJ, PLY, GLB, STL); its coordinates X right, Y down, Z forward."""

    kind: Literal["file"]
    """``file``."""
    file: str
    """Path of the file; relative paths count from the scene file."""
    unit_mm: Positive = 1.0
    """Length of one unit of the file in mm."""


Mesh = Annotated[
    BoxMesh | PlaneMesh | SphereMesh | CylinderMesh | SaddleMesh | ReliefMesh | StairsMesh | LeafMesh | FileMesh,
    Field(discriminator="kind"),
]


class NoiseTexture(FrozenModel):
    """Gaussian noise, strictly limited to a band of wavelengths."""

    kind: Literal["noise"]
    """``noise``."""
    wavelength_mm: tuple[Positive, Positive]
    """Shortest and longest wavelength on the surface in mm."""
    mean: Radiance = 0.5
    """Mean radiance."""
    rms_contrast: Annotated[float, Field(ge=0, le=1 / 3)] = 0.25
    """Standard deviation of the radiance, divided by the mean; extremes are kept within [0, 1] inside the band."""
    spectrum_exponent: Finite = 0.0
    """Power density inside the band is proportional to (spatial frequency) ** spectrum_exponent; 0 is white."""

    @model_validator(mode="after")
    def _displayable(self) -> NoiseTexture:
        if 3 * self.rms_contrast * self.mean > min(self.mean, 1 - self.mean):
            std = self.rms_contrast * self.mean
            msg = f"mean ± 3 rms_contrast mean must stay within [0, 1] (got {self.mean} ± 3 x {std:g})"
            raise ValueError(msg)
        return self

    @field_validator("wavelength_mm")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] >= value[1]:
            msg = "must be (shortest, longest) with shortest < longest"
            raise ValueError(msg)
        return value


class ImageTexture(FrozenModel):
    """An image file, laid on the surface by the mesh's UV coordinates."""

    kind: Literal["image"]
    """``image``."""
    file: str
    """Path of the image; relative paths count from the scene file. Colours become luminance."""
    encoding: Literal["linear", "srgb"] = "linear"
    """Meaning of the grey values: proportional to radiance, or sRGB encoded."""


class UniformTexture(FrozenModel):
    """One radiance everywhere."""

    kind: Literal["uniform"]
    """``uniform``."""
    radiance: Radiance = 0.5
    """The radiance."""


class PlaidTexture(FrozenModel):
    """The paper's pattern (eq. 13): mean + amplitude cos(K_X X) cos(K_Y Y) in surface coordinates."""

    kind: Literal["plaid"]
    """``plaid``."""
    wavelength_mm: tuple[Positive, Positive]
    """Wavelengths 2π/K_X and 2π/K_Y on the surface in mm."""
    mean: Radiance = 0.5
    """Mean radiance."""
    amplitude: NonNegative = 0.5
    """Amplitude of the pattern; 0.5 gives grey values in [-1, 1] as in the paper."""
    phase_deg: tuple[Finite, Finite] = (0.0, 0.0)
    """Phases in X and Y at the surface's origin, in degrees."""

    @model_validator(mode="after")
    def _displayable(self) -> PlaidTexture:
        if self.mean - self.amplitude < 0 or self.mean + self.amplitude > 1:
            msg = f"mean ± amplitude must stay within [0, 1] (got {self.mean} ± {self.amplitude})"
            raise ValueError(msg)
        return self


class OwnTexture(FrozenModel):
    """The texture image or the vertex colours that a mesh file brings along."""

    kind: Literal["own"]
    """``own``."""
    encoding: Literal["linear", "srgb"] = "linear"
    """Meaning of the grey values: proportional to radiance, or sRGB encoded."""


Texture = Annotated[
    NoiseTexture | ImageTexture | UniformTexture | PlaidTexture | LeafTexture | OwnTexture, Field(discriminator="kind")
]


AnyDeformation = Annotated[Deformation | Nodal | MeshSeries | Morph, Field(discriminator="kind")]


class SceneObject(FrozenModel):
    """A textured mesh that stands and moves before the camera."""

    name: Annotated[str, Field(min_length=1)]
    """Name, unique in the scene; keys the object's random numbers."""
    mesh: Mesh
    """Its shape."""
    texture: Texture
    """Its surface."""
    pose: Pose = Pose()
    """Where it stands at t = 0."""
    deformation: tuple[AnyDeformation, ...] = ()
    """How it changes in its own frame, before it is posed; several deformations are applied one after the other."""
    motion: tuple[Motion, ...] = ()
    """How it moves in the world; several motions are applied one after the other."""

    @field_validator("deformation")
    @classmethod
    def _vertices_come_first(
        cls, value: tuple[AnyDeformation, ...], info: ValidationInfo
    ) -> tuple[AnyDeformation, ...]:
        given = [index for index, entry in enumerate(value) if isinstance(entry, NodalModel)]
        mesh = info.data.get("mesh")
        if given and (given != [0] or not (mesh is None or isinstance(mesh, FileMesh))):
            msg = f"'{value[given[-1]].kind}' says where the vertices of a mesh file are: "
            msg += "it must be the first deformation and the only one of its sort, of a mesh of kind 'file'"
            raise ValueError(msg)
        return value


class RenderSettings(FrozenModel):
    """How images are made."""

    backend: Literal["auto", "pyrender", "raycast"] = "auto"
    """``pyrender`` (OpenGL), ``raycast`` (the reference), or ``auto``: pyrender where it runs, else raycast."""
    platform: Literal["auto", "osmesa", "egl"] = "auto"
    """OpenGL platform of ``pyrender``; ``auto`` takes OSMesa where it runs, else EGL."""
    supersampling: Annotated[int, Field(ge=1, le=16)] = 4
    """n: every pixel is the mean of n x n samples."""


def _sensor_kind(value: object) -> str:
    """Tell sensors apart; the plain one need not say its kind."""
    if isinstance(value, str):
        return "ideal"
    kind = value.get("kind", "gaussian") if isinstance(value, dict) else getattr(value, "kind", "gaussian")
    return str(kind)


def _refuse_twice(names: list[str]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        msg = f"names must be unique; used more than once: {', '.join(twice)}"
        raise ValueError(msg)


class Scene(FrozenModel):
    """Everything that a recording and its truth are made from."""

    description: str = ""
    """What the scene is for."""
    camera: Camera
    """The camera."""
    optics: Optics = Optics()
    """What its lens does besides distorting."""
    shutter: Shutter = Shutter()
    """When its pixels collect light."""
    stage: Stage
    """Its linear stage."""
    frames: Frames
    """When it takes images."""
    objects: tuple[SceneObject, ...] = ()
    """What stands before it."""
    plants: Annotated[tuple[Plant, ...], Field(validate_default=True)] = ()
    """Plants that stand before it; each leaf is an object."""
    background: Radiance = 0.0
    """Radiance where no object is seen."""
    lighting: Lighting = Lighting()
    """The light on the objects; unlit, the radiance is the textures' own."""
    sensor: Annotated[
        Annotated[Literal["ideal"], Tag("ideal")]
        | Annotated[Sensor, Tag("gaussian")]
        | Annotated[EmvaSensor, Tag("emva1288")],
        Discriminator(_sensor_kind),
    ] = "ideal"
    """The sensor; ``ideal`` delivers the linear images themselves."""
    render: RenderSettings = RenderSettings()
    """Backend and sampling of the images."""
    estimate: EstimateSettings = EstimateSettings()
    """How depth and motion are estimated from them."""
    score: ScoreSettings = ScoreSettings()
    """How the estimate is scored."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of every random number of the scene."""

    @field_validator("frames")
    @classmethod
    def _long_enough(cls, value: Frames, info: ValidationInfo) -> Frames:
        stage = info.data.get("stage")
        if stage is None or value.count == 1:
            return value
        needed = stage.scan_interval_s
        if needed > value.frame_interval_s * (1 + 1e-9):
            msg = (
                f"the stage needs {needed:g} s from frame to frame, more than frame_interval_s = "
                f"{value.frame_interval_s:g} s: make it longer, or stage.time_per_position_s shorter"
            )
            raise ValueError(msg)
        return value

    @field_validator("objects")
    @classmethod
    def _unique_names(cls, value: tuple[SceneObject, ...]) -> tuple[SceneObject, ...]:
        _refuse_twice([item.name for item in value])
        return value

    @field_validator("plants")
    @classmethod
    def _unique_among_objects(cls, value: tuple[Plant, ...], info: ValidationInfo) -> tuple[Plant, ...]:
        objects = info.data.get("objects")
        if objects is None:
            return value
        names = [item.name for item in (*objects, *value)]
        if not names:
            msg = "a scene needs at least one object or plant"
            raise ValueError(msg)
        _refuse_twice(names)
        return value

    @cached_property
    def parts(self) -> tuple[tuple[str, SceneObject], ...]:
        """All objects, those of plants too, each with its path in the scene: ``objects.0``, ``plants.0.leaves.2``."""
        from scenetruth.scene.plants import leaves_of

        own = [(f"objects.{index}", item) for index, item in enumerate(self.objects)]
        return tuple(own) + tuple(
            (f"plants.{index}.leaves.{number}", leaf)
            for index, plant in enumerate(self.plants)
            for number, leaf in enumerate(leaves_of(plant))
        )

    @property
    def needs_rays(self) -> str:
        """What of the scene only ray casting can render; empty if nothing."""
        parts = ["a lens that distorts"] if self.camera.distortion is not None else []
        return " and ".join(parts + (["a rolling shutter"] if self.shutter.readout_time_s > 0 else []))

    def to_plain(self) -> dict[str, Any]:
        """Return the scene as plain values, ready for YAML or JSON."""
        return self.model_dump(mode="json")
