"""What a goal file may say: a scene, what is free, catalogues, constraints and objectives."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from scenetruth.design.optimise.constraints.base import Limit
from scenetruth.design.optimise.goal.free import Free
from scenetruth.design.optimise.goal.parts import Confirm, Light, Search, Wanted
from scenetruth.files import InputFile, SceneFile
from scenetruth.kinds import one_of
from scenetruth.model import FrozenModel, Name
from scenetruth.scoring import QUANTITIES

__all__ = ["CATALOGUES", "CONSTRAINT_ROOMS", "KNOWN_BY_NAME", "AnyLimit", "Goal"]

CONSTRAINT_ROOMS = tuple(f"scenetruth.design.optimise.constraints.{room}" for room in ("sight", "capture", "hardware"))
"""Where constraints are found: one module each."""
CATALOGUES = ("lens", "camera", "stage")
"""Parameters that are entries of catalogues."""
KNOWN_BY_NAME = (*CATALOGUES, "f_number", "exposure_s", "working_distance_mm")
"""Parameters that are no fields of the scene."""

if TYPE_CHECKING:
    AnyLimit = Limit
else:
    AnyLimit = one_of(Limit, *CONSTRAINT_ROOMS)

_PATH = r"^[A-Za-z0-9_*-]+(\.[A-Za-z0-9_*-]+)*$"
FieldPath = Annotated[str, Field(pattern=_PATH, max_length=300)]
"""Path of a field of the scene, keys and indices with dots between them; ``*`` stands for every one."""


class Goal(FrozenModel):
    """What is to be designed.

    See Also
    --------
    load_goal : A goal from a file in YAML.
    goal_from_plain : A goal from plain values.
    scenetruth.design.optimise.optimise : Finds the rig.

    Examples
    --------
    >>> goal = Goal(
    ...     scene="cube",
    ...     free={"stage.baseline_mm": {"from": 1, "to": 8}, "stage.positions": {"values": [3, 5, 9]}},
    ...     constraints=[{"kind": "stage_travel", "at_most": 25}],
    ...     objectives=[{"quantity": "depth"}, {"quantity": "velocity_z", "region": "object_cube"}],
    ... )
    >>> [one.title for one in goal.constraints], [one.quantity for one in goal.objectives]
    (['stage travel'], ['depth', 'velocity_z'])
    >>> goal.search.predictions, goal.confirm.rigs, goal.confirm.seeds
    (2400, 3, 5)
    """

    format: Literal[1] = 1
    """Version of the format of goals."""
    title: Name = "A rig"
    """What is designed, in a few words."""
    description: Annotated[str, Field(max_length=10_000)] = ""
    """What it is for."""
    scene: SceneFile | dict[str, Any]
    """What is to be measured: a scene's file, the name of one that is shipped, or the scene itself. Its camera, stage
    and times hold where nothing else is said."""
    method: str | dict[str, Any] = "refined"
    """The method of estimation, with settings as in ``refined[window_sigma_px: 4]`` or in a mapping."""
    set: dict[FieldPath, Any] = Field(default_factory=dict)
    """Changes of the scene: values by path."""
    free: dict[FieldPath, Free] = Field(min_length=1)
    """What is free: ranges and values by path of a field. Besides, ``lens``, ``camera`` and ``stage`` are entries of
    catalogues; ``f_number`` needs a lens; ``exposure_s`` is that of shutter and sensor; ``working_distance_mm`` moves
    all that stands before the camera."""
    catalogues: tuple[InputFile, ...] = ()
    """Files with more entries of catalogues."""
    light: Light | None = None
    """The light; if not given, there is as much as cameras of the catalogue need."""
    constraints: tuple[AnyLimit, ...] = ()
    """What a rig must satisfy."""
    objectives: Annotated[tuple[Wanted, ...], Field(min_length=1, max_length=6)]
    """What is to be known precisely."""
    search: Search = Search()
    """How long to search."""
    confirm: Confirm = Confirm()
    """Which rigs are simulated."""

    @field_validator("objectives")
    @classmethod
    def _scored(cls, value: tuple[Wanted, ...]) -> tuple[Wanted, ...]:
        unknown = sorted({one.quantity for one in value} - set(QUANTITIES))
        if unknown:
            msg = f"no such quantity: {', '.join(unknown)}; there are {', '.join(QUANTITIES)}"
            raise ValueError(msg)
        told = Counter((one.quantity, one.region, one.statistic) for one in value)
        twice = [key for key, count in told.items() if count > 1]
        if twice:
            msg = f"is there twice: {', '.join(f'{name} of {region}, {kind}' for name, region, kind in twice)}"
            raise ValueError(msg)
        return value

    @model_validator(mode="after")
    def _free_or_set(self) -> Self:
        both = sorted(set(self.free) & set(self.set))
        if both:
            msg = f"is both set and free: {', '.join(both)}"
            raise ValueError(msg)
        return self
