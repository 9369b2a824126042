"""The model of a recipe file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from scenetruth.dataset.acceptance import AcceptanceCriterion
from scenetruth.dataset.distributions import Distribution
from scenetruth.discovery import discriminated_union
from scenetruth.input_files import SceneFile
from scenetruth.validated_model import FrozenModel, Name, Positive

__all__ = ["PATH_PATTERN", "BaseScene", "RecipeModel", "TruthSettings"]


def _formula(value: Any) -> Any:
    """Return what a text that begins with an equals sign stands for."""
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
"""Path of a field of the scene, keys and indices with dots between them; ``*`` stands for every one."""


def _also_alone(schema: dict[str, Any]) -> None:
    """Tell in a JSON Schema of a list that its only item may stand alone, as a scene or its file."""
    schema["anyOf"] = [{"type": "string"}, {"type": "object"}, {"type": "array", "items": schema.pop("items")}]
    schema.pop("type", None)
    schema.pop("minItems", None)


def _also_formulas(schema: dict[str, Any]) -> None:
    """Tell in a JSON Schema of distributions that a formula may be a text."""
    for path, values in schema.get("patternProperties", {}).items():
        schema["patternProperties"][path] = {"anyOf": [values, {"type": "string", "pattern": "^="}]}


class BaseScene(FrozenModel):
    """A scene that samples are made from."""

    scene: SceneFile | dict[str, Any]
    """The scene's file, the name of one that is shipped, or the scene itself; a relative path counts from the recipe's
    folder."""
    weight: Positive = 1.0
    """How likely it is, in any unit."""


class TruthSettings(FrozenModel):
    """Which truth every sample gets."""

    views: Literal["reference", "all"] = "reference"
    """Cameras that it is made for."""
    poses: Literal["actual", "nominal"] = "actual"
    """Where the camera stood, or where it should have stood."""
    content: Literal["standard", "complete"] = "standard"
    """What estimates are scored against, or everything known of the surface."""


def _one_line(value: str) -> str:
    if not value.isprintable():
        msg = "must be one line of printable characters"
        raise ValueError(msg)
    return value


_Line = Annotated[str, Field(max_length=1000), AfterValidator(_one_line)]


class RecipeModel(FrozenModel):
    """Everything that a data set is made from."""

    format: Literal[1] = 1
    """Version of the format of recipes."""
    name: Annotated[Name, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    """What the data set is called: letters, digits, points, dashes and underscores."""
    description: Annotated[str, Field(max_length=10_000)] = ""
    """What it is for."""
    licence: _Line = ""
    """Under which licence it may be used, an SPDX name such as CC-BY-4.0, or an address."""
    citation: Annotated[str, Field(max_length=10_000)] = ""
    """How to cite it."""
    creators: tuple[_Line, ...] = ()
    """Who made it."""
    base: Annotated[tuple[BaseScene, ...], Field(min_length=1, json_schema_extra=_also_alone)]
    """The scene that samples are variations of, or several."""
    set: dict[FieldPath, Any] = Field(default_factory=dict)
    """Changes of the base scenes that all samples share: values by path."""
    samples: Annotated[int, Field(ge=1, le=1_000_000_000)]
    """How many samples are drawn; of ladders, each has several steps."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of every draw."""
    scene_seed: Literal["per_sample", "as_in_scene"] = "per_sample"
    """Whether textures, noise and stage errors differ from sample to sample, or have the base scene's seed."""
    parameters: dict[FieldPath, AnyDistribution] = Field(default_factory=dict, json_schema_extra=_also_formulas)
    """Parameters: distributions of values that formulas use, by name; they go into no field themselves."""
    distributions: dict[FieldPath, AnyDistribution] = Field(default_factory=dict, json_schema_extra=_also_formulas)
    """Distributions of the varied fields, by path."""
    paired_factors: dict[FieldPath, Annotated[tuple[Any, ...], Field(min_length=1)]] = Field(default_factory=dict)
    """Paired factors: every sample again with one factor changed, value by value, all else to the bit alike."""
    acceptance: tuple[AnyBound, ...] = ()
    """Acceptance criteria for the geometry of a draw; a rejected draw is drawn again."""
    max_draws: Annotated[int, Field(ge=1, le=100_000)] = 200
    """Draws of one sample, after which it is given up."""
    splits: dict[Name, Positive] = Field(default_factory=dict)
    """Shares of samples by the name of their split, in any unit."""
    hold_out: dict[FieldPath, Annotated[tuple[Any, ...], Field(min_length=1)]] = Field(default_factory=dict)
    """Values, by path or name, whose samples go to the split ``held_out``."""
    truth: TruthSettings = TruthSettings()
    """Which truth every sample gets."""
    save_radiance: bool = False
    """Whether recordings hold the linear images before the sensor too."""
    layout: Literal["folder", "shards"] = "folder"
    """One folder for each sample, or many samples in one tar file."""
    samples_per_shard: Annotated[int, Field(ge=1, le=100_000)] = 100
    """Samples in one tar file."""

    @field_validator("base", mode="before")
    @classmethod
    def _listed(cls, value: Any) -> Any:
        """Return one scene as a list of one."""
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

    @property
    def steps(self) -> int:
        """How many samples a draw makes: itself, and every step of every ladder."""
        return 1 + sum(len(values) for values in self.paired_factors.values())

    @property
    def count(self) -> int:
        """How many samples the data set has in all."""
        return self.samples * self.steps

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe as plain values, ready for YAML or JSON."""
        return self.model_dump(mode="json")


def _is_scene(entry: Any) -> bool:
    return isinstance(entry, Mapping) and "camera" in entry
