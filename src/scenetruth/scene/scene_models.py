"""Models of a scene (YAML scene files are their serialisation), summaries, and image times."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import (
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from scenetruth.bands import BandFraction, ByBand, find_by_band, in_band
from scenetruth.camera import AnySensor, Camera, Frames, Optics, Shutter, Stage, build_sensor_chain
from scenetruth.discovery import discriminated_union
from scenetruth.errors import ArgumentError, Problem, SceneError
from scenetruth.estimators import MethodChoice, choose
from scenetruth.scene.lighting import Lighting
from scenetruth.scene.plant import PlantModel
from scenetruth.scene.scene_object import SceneObject
from scenetruth.settings import ScoreSettings, StorageSettings
from scenetruth.validated_model import FrozenModel

__all__ = ["RenderSettings", "Scene", "compute_image_times"]


def format_line(description: str, camera: Camera, stage: Stage, frames: Frames, names: Sequence[str]) -> str:
    """Return a one-line summary: description, image size and count, and objects."""
    grid = f"{stage.rows} x " if stage.rows > 1 else ""
    parts = [
        *([repr(description)] if description else []),
        f"{camera.width} x {camera.height} px",
        f"{grid}{stage.positions} positions x {frames.count} frames",
        f"objects: {', '.join(names)}",
    ]
    return f"Scene({'; '.join(parts)})"


def make_summary_rows(
    camera: Camera,
    stage: Stage,
    frames: Frames,
    things: Sequence[SceneObject | PlantModel],
    lighting: Lighting,
    sensor: AnySensor,
) -> dict[str, str]:
    """Return the parts of a scene as headings and texts."""
    lens = "" if camera.distortion is None else ", with distortion"
    rows = f"{stage.rows} rows, {stage.row_spacing_mm:g} mm apart, of " if stage.rows > 1 else ""
    bands = f", bands {', '.join(camera.bands)}" if camera.bands else ""
    unequal = "" if stage.positions_mm is None else " on average"
    return {
        "camera": f"{camera.width} x {camera.height} px, f = {camera.focal_px:g} px{lens}{bands}",
        "stage": f"{rows}{stage.positions} positions, {stage.baseline_mm:g} mm apart{unequal}",
        "frames": f"{frames.count}, {frames.frame_interval_s:g} s apart",
        **{f"{_noun(thing)} '{thing.name}'": _describe_item(thing) for thing in things},
        "light": _light(lighting),
        "sensor": _sensor(sensor),
    }


def make_summary_table(caption: str, rows: Mapping[str, str]) -> str:
    """Return an HTML table of headings and texts."""
    lines = "".join(f"<tr><th>{escape(head)}</th><td>{escape(text)}</td></tr>" for head, text in rows.items())
    return f"<table><caption>{escape(caption)}</caption><tbody>{lines}</tbody></table>"


def _noun(thing: SceneObject | PlantModel) -> str:
    return "plant" if isinstance(thing, PlantModel) else "object"


def _describe_item(thing: SceneObject | PlantModel) -> str:
    shape = (
        f"{_plant_kind(thing)} of {len(thing.places())} leaves" if isinstance(thing, PlantModel) else thing.mesh.kind
    )
    growth = [thing.growth] if isinstance(thing, PlantModel) and thing.growth is not None else []
    parts = {
        "": shape,
        "texture ": thing.texture.kind,
        "material ": "" if thing.material.matt else thing.material.preset or "own",
        "deformation ": ", ".join(item.kind for item in (*growth, *thing.deformation)),
        "motion ": ", ".join(item.kind for item in thing.motion),
    }
    return "; ".join(f"{name}{text}" for name, text in parts.items() if text)


def _plant_kind(plant: PlantModel) -> str:
    return str(getattr(plant, "kind", "plant"))


def _light(lighting: Lighting) -> str:
    if not lighting.lit:
        return "unlit: radiance equals the texture"
    ambient = [] if lighting.ambient is None else [f"ambient {_values(lighting.ambient)}"]
    return ", ".join([*ambient, *(light.kind for light in lighting.lights)])


def _values(value: float | ByBand[float]) -> str:
    if isinstance(value, ByBand):
        return ", ".join(f"{band} {each:g}" for band, each in value.items())
    return f"{value:g}"


def _sensor(sensor: AnySensor) -> str:
    if isinstance(sensor, str):
        return sensor
    preset = getattr(sensor, "preset", None)
    bits = getattr(sensor, "bit_depth", None)
    effects = ", ".join(effect.kind for effect in getattr(sensor, "effects", ()))
    parts = [sensor.kind, preset or "", effects, f"{bits} bits" if bits is not None else ""]
    return "; ".join(filter(None, parts))


if TYPE_CHECKING:
    Plant = PlantModel
else:
    Plant = discriminated_union(PlantModel, "scenetruth.scene.plant")


_AUTOMATIC_SAMPLES = 4


class RenderSettings(FrozenModel):
    """Rendering of the images."""

    backend: Literal["auto", "pyrender", "raycast"] = "raycast"
    """``raycast`` (ray casting), ``pyrender`` (OpenGL), or ``auto``: pyrender if available, else raycast."""
    platform: Literal["auto", "osmesa", "egl"] = "auto"
    """OpenGL platform of ``pyrender``; ``auto``: OSMesa if available, else EGL."""
    supersampling: Literal["auto"] | Annotated[int, Field(ge=1, le=16)] = "auto"
    """n: every pixel is the mean of n x n samples. ``auto``: ray casting takes as many samples as texture and edges
    require in each pixel; n is 4 with ``pyrender`` or ``edges: adaptive``.
    """
    image_error: Annotated[float, Field(ge=1e-6, le=1e-2)] = 1e-4
    """With ``supersampling: auto``, RMS error of the radiance by which the samples inside surfaces are chosen."""
    edges: Literal["sampled", "adaptive"] = "sampled"
    """``adaptive``: at least (12 n)² samples in pixels that a step of a texture or a silhouette crosses; ray casting
    only. With ``supersampling: auto``, edges are exact without it.
    """

    @model_serializer(mode="wrap")
    def _without_default(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit the defaults of ``edges`` and ``image_error``, so that hashes of scenes without them remain."""
        plain: dict[str, Any] = write(self)
        omitted = {"edges": "sampled", "image_error": 1e-4}
        return {key: value for key, value in plain.items() if omitted.get(key) != value}

    @property
    def samples(self) -> int:
        """Samples along one axis of a pixel; for ``supersampling: auto``, where it has a fixed number."""
        return _AUTOMATIC_SAMPLES if self.supersampling == "auto" else self.supersampling


def _refuse_twice(names: list[str]) -> None:
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        entries = [*twice[:5], *([f"and {len(twice) - 5} more"] if len(twice) > 5 else [])]
        msg = f"names must be unique; used more than once: {', '.join(entries)}"
        raise ValueError(msg)


def _band_problems(scene: Scene) -> list[InitErrorDetails]:
    """Return the values by band that do not have one value for each band of the camera."""
    bands = scene.camera.bands
    problems = []
    for where, values in find_by_band(scene):
        unknown = [f"'{name}'" for name in values if name not in bands]
        missing = [f"'{name}'" for name in bands if name not in values]
        if not bands:
            message = "has values by band, but the camera is grey: name them in camera.bands, or specify one value"
            problems.append(_problem_at(where, message, list(values)))
            continue
        if unknown:
            message = f"unknown band{'s' * (len(unknown) > 1)} {', '.join(unknown)}; the camera has {', '.join(bands)}"
            problems.append(_problem_at(where, message, list(values)))
        if missing:
            message = f"has no value for the band{'s' * (len(missing) > 1)} {', '.join(missing)} of the camera"
            problems.append(_problem_at(where, message, list(values)))
    chain = build_sensor_chain(scene.sensor)
    given = scene.sensor if isinstance(scene.sensor, str) else scene.sensor.kind
    return problems + [_problem_at(("sensor",), message, given) for message in chain.band_problems(bands)]


def _problem_at(where: tuple[str | int, ...], message: str, given: Any) -> InitErrorDetails:
    return InitErrorDetails(
        type=PydanticCustomError("bands", "{message}", {"message": message}), loc=where, input=given
    )


class Scene(FrozenModel):
    """Complete specification of a recording and its ground truth.

    Scenes are created with `load_scene` or `Scene.from_dict`. They are immutable, compare and hash by value, and are
    displayed as a table in notebooks.

    See Also
    --------
    load_scene : Load a scene from a YAML file.
    Scene.from_dict : Create a scene from values.
    simulate : Simulate images and ground truth of a scene.

    Examples
    --------
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}}
    >>> wall |= {"pose": {"position_mm": [0, 0, 100]}}
    >>> scene = Scene(
    ...     camera={"width": 40, "height": 30, "focal_length_px": 60},
    ...     stage={"positions": 3, "baseline_mm": 5},
    ...     frames={"count": 2},
    ...     objects=[wall],
    ... )
    >>> scene
    Scene(40 x 30 px; 3 positions x 2 frames; objects: wall)
    >>> scene.camera.principal_point, scene.stage.s.tolist(), scene.render.backend
    ((19.5, 14.5), [-1, 0, 1], 'raycast')
    >>> st.Scene.from_dict(scene.to_dict()) == scene
    True
    """

    # Short description for the schema of scene files.
    model_config = ConfigDict(
        json_schema_extra={"description": "Complete specification of a recording and its ground truth."}
    )

    format: Literal[1] = 1
    """Format version of scene files."""
    description: str = ""
    """Purpose of the scene."""
    camera: Camera
    """Camera intrinsics."""
    optics: Optics = Optics()
    """Lens effects other than distortion."""
    shutter: Shutter = Shutter()
    """Exposure and readout timing."""
    stage: Stage
    """Linear stage of the camera."""
    frames: Frames
    """Frame times."""
    objects: tuple[SceneObject, ...] = ()
    """Objects of the scene."""
    plants: Annotated[tuple[Plant, ...], Field(validate_default=True)] = ()
    """Plants of the scene; each leaf is an object."""
    background: BandFraction = 0.0
    """Radiance of the background, for all bands or for each."""
    lighting: Lighting = Lighting()
    """Lighting of the objects; unlit, radiance equals the texture."""
    sensor: AnySensor = "ideal"
    """Sensor model; ``ideal`` returns the linear images."""
    render: RenderSettings = RenderSettings()
    """Rendering backend and sampling."""
    estimate: MethodChoice = Field(default_factory=lambda: choose({}))
    """Method and settings for the estimation of depth and motion."""
    score: ScoreSettings = ScoreSettings()
    """Settings of the scores."""
    storage: StorageSettings = StorageSettings()
    """Settings of the stores."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of all random numbers of the scene."""

    @field_validator("frames")
    @classmethod
    def _long_enough(cls, value: Frames, info: ValidationInfo) -> Frames:
        stage = info.data.get("stage")
        if stage is None:
            return value
        problems = [stage.visit_problem(value.count)]
        needed = stage.scan_interval_s
        if value.count > 1 and needed > value.frame_interval_s * (1 + 1e-9):
            problems.append(
                f"the stage needs {needed:g} s per frame, more than frame_interval_s = "
                f"{value.frame_interval_s:g} s: increase it, or reduce stage.time_per_position_s"
            )
        if any(problems):
            raise ValueError("; ".join(filter(None, problems)))
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
            msg = "a scene requires at least one object or plant"
            raise ValueError(msg)
        _refuse_twice(names)
        return value

    @model_validator(mode="after")
    def _share_bands(self) -> Scene:
        problems = _band_problems(self)
        if problems:
            # A validation error raised here preserves the path of each problem.
            raise ValidationError.from_exception_data(type(self).__name__, problems)
        return self

    @cached_property
    def parts(self) -> tuple[tuple[str, SceneObject], ...]:
        """All objects, including plant leaves, with their paths in the scene: ``objects.0``, ``plants.0.leaves.2``."""
        own = [(f"objects.{index}", item) for index, item in enumerate(self.objects)]
        return tuple(own) + tuple(
            (f"plants.{index}.leaves.{number}", leaf)
            for index, plant in enumerate(self.plants)
            for number, leaf in enumerate(plant.leaf_objects())
        )

    @property
    def needs_rays(self) -> str:
        """Features of the scene that require ray casting; empty if none."""
        features = {
            "lens distortion": self.camera.distortion is not None,
            "a rolling shutter": self.shutter.readout_time_s > 0,
            "adaptive edges": self.render.edges == "adaptive",
            "bands": bool(self.camera.bands),
        }
        return " and ".join(name for name, present in features.items() if present)

    def in_band(self, band: str) -> Scene:
        """Return the scene as a grey camera sees it in one of its bands.

        Parameters
        ----------
        band
            Name of one of ``camera.bands``.

        Returns
        -------
        Scene
            Grey scene with the lamps, textures and materials of the band. It renders the same image as the band.

        Raises
        ------
        ArgumentError
            If the camera does not have the band.

        See Also
        --------
        simulate : Simulate images of all bands.

        Examples
        --------
        >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}}
        >>> wall |= {"pose": {"position_mm": [0, 0, 100]}, "tint": {"red": 0.2, "nir_850": 0.9}}
        >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 60, "bands": ["red", "nir_850"]}}
        >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 1}, "objects": [wall]}
        >>> scene = Scene.from_dict(plain)
        >>> scene.in_band("nir_850").objects[0].tint, scene.in_band("nir_850").camera.bands
        (0.9, ())
        """
        if band not in self.camera.bands:
            names = ", ".join(self.camera.bands) or "none: it is grey"
            raise ArgumentError([Problem("band", f"is not one of the bands of the camera ({names})", band)])
        found = in_band(self.model_copy(update={"camera": self.camera.model_copy(update={"bands": ()})}), band)
        # Cached from the scene with all bands.
        found.__dict__.pop("parts", None)
        return found

    def require_grey(self, what: str) -> None:
        """Raise a SceneError if the images have channels, which a computation does not support."""
        if self.camera.bands:
            message = f"{what} is for grey cameras; choose one band with `Scene.in_band`"
            raise SceneError([Problem("camera.bands", message, list(self.camera.bands))])
        channels = build_sensor_chain(self.sensor).channels(())
        if channels:
            message = f"demosaicing gives the channels {', '.join(channels)}, but {what} is for grey images; omit it"
            raise SceneError([Problem("sensor", message)])

    def band_scenes(self) -> list[Scene]:
        """Return the grey scenes of all bands, in order; the scene itself if it is grey."""
        return [self.in_band(band) for band in self.camera.bands] or [self]

    def shrunk_to(self, most_px: int) -> Scene:
        """Return the scene with the reference frame only and at most ``most_px`` along an image side."""
        frames = self.frames.model_copy(update={"count": 1})
        return self.model_copy(update={"camera": self.camera.shrunk_to(most_px), "frames": frames})

    def __repr__(self) -> str:
        names = [item.name for item in self.objects] + [item.name for item in self.plants]
        return format_line(self.description, self.camera, self.stage, self.frames, names)

    __str__ = __repr__

    def _repr_html_(self) -> str:
        """Return a summary table for notebooks."""
        things: list[SceneObject | Plant] = [*self.objects, *self.plants]
        rows = make_summary_rows(self.camera, self.stage, self.frames, things, self.lighting, self.sensor)
        return make_summary_table(self.description or "Scene", rows)

    _reader: ClassVar[Callable[[Any, str | Path | None, Path | None], Scene]]
    """Implementation of `from_dict`, set by the loader."""

    @classmethod
    def from_dict(
        cls, values: Mapping[str, Any], *, source: str | Path | None = None, folder: Path | None = None
    ) -> Scene:
        """Create a scene from its values.

        Parameters
        ----------
        values
            Values as in a scene file.
        source
            Origin of the values, for messages.
        folder
            Base directory of relative file paths; None leaves them unchanged.

        Returns
        -------
        Scene
            Validated and immutable.

        Raises
        ------
        SceneError
            If the values are invalid; lists every problem with its path.

        See Also
        --------
        load_scene : Load a scene from a YAML file.
        Scene.to_dict : Convert a scene into values.

        Examples
        --------
        >>> import scenetruth as st
        >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "texture": {"kind": "uniform"}}
        >>> wall |= {"pose": {"position_mm": [0, 0, 100]}}
        >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 60}, "objects": [wall]}
        >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 2}}
        >>> Scene.from_dict(plain)
        Scene(40 x 30 px; 3 positions x 2 frames; objects: wall)

        All problems are reported together:

        >>> try:
        ...     Scene.from_dict({**plain, "width": 80, "render": {"backend": "raycst"}})
        ... except st.SceneError as error:
        ...     print(error)
        2 problems with the scene:
          - render.backend: input should be 'auto', 'pyrender' or 'raycast'; did you mean 'raycast'? (got 'raycst')
          - width: unknown key; did you mean 'camera.width'? (got 80)
        """
        return cls._reader(values, source, folder)

    def to_dict(self) -> dict[str, Any]:
        """Return the values of the scene for YAML or JSON."""
        return self.model_dump(mode="json")


def compute_image_times(scene: Scene) -> list[float]:
    """Return the times of all frames and of the first and last image, in frames."""
    stage, frames = scene.stage, scene.frames.t.tolist()
    per_image = stage.time_per_position_s / scene.frames.frame_interval_s
    before, last = stage.number_in_scan(0, frames[0]), stage.number_in_scan(0, frames[-1])
    after = stage.positions * stage.rows - 1 - last
    ends = [frames[0] - before * per_image, frames[-1] + after * per_image] if per_image > 0 else []
    return [*map(float, frames), *ends]
