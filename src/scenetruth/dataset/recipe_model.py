"""The model of a recipe file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from datetime import date
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self
from urllib.parse import urlsplit

from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from scenetruth.dataset.acceptance import AcceptanceCriterion
from scenetruth.dataset.distributions import Distribution
from scenetruth.discovery import discriminated_union
from scenetruth.input_files import SceneFile
from scenetruth.validated_model import FrozenModel, Name, Positive

__all__ = ["PATH_PATTERN", "BaseScene", "RecipeModel", "TruthSettings", "is_address", "is_day"]


def _formula(value: Any) -> Any:
    """Return the formula distribution for a string that begins with an equals sign."""
    if isinstance(value, str) and value.startswith("="):
        return {"kind": "formula", "formula": value[1:]}
    return value


if TYPE_CHECKING:
    AnyDistribution = Distribution
    AnyBound = AcceptanceCriterion
else:
    AnyDistribution = Annotated[
        discriminated_union(Distribution, "scenetruth.dataset.distributions"), BeforeValidator(_formula)
    ]
    AnyBound = discriminated_union(AcceptanceCriterion, "scenetruth.dataset.acceptance")

PATH_PATTERN = r"^[A-Za-z0-9_*-]+(\.[A-Za-z0-9_*-]+)*$"
FieldPath = Annotated[str, Field(pattern=PATH_PATTERN, max_length=300)]
"""Path of a field of the scene: keys and indices separated by dots; ``*`` matches every key or index."""


def _also_alone(schema: dict[str, Any]) -> None:
    """Extend the JSON Schema of a list: a single item may be given without the list, as a scene or its file."""
    schema["anyOf"] = [{"type": "string"}, {"type": "object"}, {"type": "array", "items": schema.pop("items")}]
    schema.pop("type", None)
    schema.pop("minItems", None)


def _also_formulas(schema: dict[str, Any]) -> None:
    """Extend the JSON Schema of distributions: a formula may be a string."""
    for path, values in schema.get("patternProperties", {}).items():
        schema["patternProperties"][path] = {"anyOf": [values, {"type": "string", "pattern": "^="}]}


class BaseScene(FrozenModel):
    """A base scene, from which samples are derived."""

    scene: SceneFile | dict[str, Any]
    """The scene's file, the name of a bundled scene, or the scene itself; a relative path is resolved against the
    directory of the recipe."""
    weight: Positive = 1.0
    """Relative weight of the base scene."""


class TruthSettings(FrozenModel):
    """Truth that is computed for every sample."""

    views: Literal["reference", "all"] = "reference"
    """Cameras with truth."""
    poses: Literal["actual", "nominal"] = "actual"
    """Camera poses: actual or nominal."""
    content: Literal["standard", "complete", "complete_with_light"] = "standard"
    """Maps for scoring, all maps of geometry and motion, or also those of light."""


def _one_line(value: str) -> str:
    if not value.isprintable():
        msg = "must be one line of printable characters"
        raise ValueError(msg)
    return value


_Line = Annotated[str, Field(max_length=1000), AfterValidator(_one_line)]


def is_day(text: str) -> bool:
    """Return whether a text is a date such as 2026-11-23."""
    try:
        return date.fromisoformat(text).isoformat() == text
    except ValueError:
        return False


def is_address(text: str) -> bool:
    """Return whether a text is an address of the web."""
    try:
        parts = urlsplit(text)
    except ValueError:
        return False
    return parts.scheme in ("http", "https") and bool(parts.netloc) and text.isprintable() and " " not in text


class RecipeModel(FrozenModel):
    """Specification of a data set."""

    format: Literal[1] = 1
    """Version of the recipe format."""
    name: Annotated[Name, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    """Name of the data set: letters, digits, points, dashes and underscores."""
    description: Annotated[str, Field(max_length=10_000)] = ""
    """Description and purpose of the data set."""
    licence: _Line = ""
    """Licence: an SPDX identifier such as CC-BY-4.0, or a URL."""
    citation: Annotated[str, Field(max_length=10_000)] = ""
    """Citation; default: creators, name, version, date and address."""
    creators: tuple[_Line, ...] = ()
    """Creators."""
    published: _Line = ""
    """Date of publication in quotes, such as '2026-11-23'."""
    address: _Line = ""
    """Address of the published data set: a URL."""
    base: Annotated[tuple[BaseScene, ...], Field(min_length=1, json_schema_extra=_also_alone)]
    """One or several base scenes, from which samples are derived."""
    set: dict[FieldPath, Any] = Field(default_factory=dict)
    """Changes of the base scenes shared by all samples: values by path."""
    samples: Annotated[int, Field(ge=1, le=1_000_000_000)]
    """Number of draws; paired series add samples to each draw."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of all draws."""
    scene_seed: Literal["per_sample", "as_in_scene"] = "per_sample"
    """Whether the seed of textures, noise and stage errors differs between samples or is that of the base scene."""
    folder: str | None = None
    """Directory of relative file names among the values of ``set``, ``distributions`` and ``paired_factors``, and in
    columns of tables; default: the directory of the recipe."""
    parameters: dict[FieldPath, AnyDistribution] = Field(default_factory=dict, json_schema_extra=_also_formulas)
    """Distributions of named values for formulas; they are not assigned to fields themselves."""
    distributions: dict[FieldPath, AnyDistribution] = Field(default_factory=dict, json_schema_extra=_also_formulas)
    """Distributions of the varied fields, by path."""
    paired_factors: dict[FieldPath, Annotated[tuple[Any, ...], Field(min_length=1)]] = Field(default_factory=dict)
    """Paired factors: every sample is repeated for each value of one factor, with all other values identical."""
    acceptance: tuple[AnyBound, ...] = ()
    """Acceptance criteria for the geometry of a draw; a rejected draw is drawn again."""
    max_draws: Annotated[int, Field(ge=1, le=100_000)] = 200
    """Maximum number of draws per sample."""
    splits: dict[Name, Positive] = Field(default_factory=dict)
    """Relative weights of the splits by name."""
    hold_out: dict[FieldPath, Annotated[tuple[Any, ...], Field(min_length=1)]] = Field(default_factory=dict)
    """Values by path or name; samples with these values form the split ``held_out``."""
    truth: TruthSettings = TruthSettings()
    """Truth that is computed for every sample."""
    save_radiance: bool = False
    """Whether recordings include the linear images before the sensor."""
    layout: Literal["folder", "shards"] = "folder"
    """One directory per sample, or many samples per tar file."""
    samples_per_shard: Annotated[int, Field(ge=1, le=100_000)] = 100
    """Number of samples per tar file."""

    @field_validator("base", mode="before")
    @classmethod
    def _listed(cls, value: Any) -> Any:
        entries = value if isinstance(value, list | tuple) else [value]
        return [{"scene": entry} if isinstance(entry, str) or _is_scene(entry) else entry for entry in entries]

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        names = [
            *self.parameters,
            *(entry.name for entry in (*self.parameters.values(), *self.distributions.values()) if entry.name),
        ]
        twice = sorted(name for name, count in Counter(names).items() if count > 1)
        twice += sorted(set(names) & set(self.distributions))
        if twice:
            msg = f"names of values must be unique; used more than once: {', '.join(twice)}"
            raise ValueError(msg)
        both = sorted(set(self.distributions) & set(self.set))
        if both:
            msg = f"is both set and varied: {', '.join(both)}"
            raise ValueError(msg)
        return self

    @field_validator("published")
    @classmethod
    def _day(cls, value: str) -> str:
        if value and not is_day(value):
            msg = "must be a date, such as 2026-11-23"
            raise ValueError(msg)
        return value

    @field_validator("address")
    @classmethod
    def _url(cls, value: str) -> str:
        if value and not is_address(value):
            msg = "must be an address that begins with https:// or http://"
            raise ValueError(msg)
        return value

    @property
    def steps(self) -> int:
        """Number of samples per draw: one plus the steps of all paired factors."""
        return 1 + sum(len(values) for values in self.paired_factors.values())

    @property
    def count(self) -> int:
        """Total number of samples of the data set."""
        return self.samples * self.steps

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe as plain values, ready for YAML or JSON."""
        return self.model_dump(mode="json")


def _is_scene(entry: Any) -> bool:
    return isinstance(entry, Mapping) and "camera" in entry
