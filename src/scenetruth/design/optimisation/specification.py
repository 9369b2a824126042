"""The design specification: design variables, objectives, constraints, search and confirmation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, ConfigDict, Field, field_validator, model_validator

from scenetruth.design.optimisation.constraints import ConstraintSpec
from scenetruth.design.optimisation.design_records import DesignSpecError, Statistic
from scenetruth.discovery import discriminated_union
from scenetruth.errors import Problem
from scenetruth.input_files import InputFile, SceneFile, validation_context
from scenetruth.plain_data import plain_problems
from scenetruth.scene import Overrides, join_override_problems, override, read_input
from scenetruth.scoring import QUANTITIES
from scenetruth.valid_remainder import FieldRepair, Keys, Reading, read_model
from scenetruth.validated_model import Finite, FrozenModel, Name, Positive
from scenetruth.validation_problems import suggest_word

__all__ = [
    "CATALOGUES", "CONSTRAINT_MODULES", "NAMED_VARIABLES", "ConfirmationSpec", "DesignReading", "DesignSpec",
    "DesignSpecLike", "DesignVariable", "IlluminationSpec", "ObjectiveSpec", "SearchSpec", "load_design_spec",
    "read_design_spec",
]  # fmt: skip


class DesignVariable(FrozenModel):
    """A range ``{from: 2, to: 40, log: true}``, or choices ``{values: [60, 300]}``, also given as a list.

    The choices of a catalogue are names of entries, or ``all``.
    """

    model_config = ConfigDict(populate_by_name=True)

    from_: Finite | None = Field(default=None, alias="from")
    """Lower end of a range."""
    to: Finite | None = None
    """Upper end of a range."""
    log: bool = False
    """Whether the range is searched on a logarithmic scale."""
    values: tuple[Any, ...] | Literal["all"] | None = None
    """Choices."""

    @model_validator(mode="before")
    @classmethod
    def _alone(cls, given: Any) -> Any:
        return {"values": given} if isinstance(given, list | tuple | str) else given

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        low, high = self.from_, self.to
        if (self.values is None) == (low is None and high is None):
            msg = "must be a range, {from: 2, to: 40}, or choices, {values: [60, 300]}"
            raise ValueError(msg)
        if self.values is not None:
            if self.log:
                msg = "has choices, for which log has no effect; omit log"
                raise ValueError(msg)
            return self
        if low is None or high is None:
            msg = f"has no {'from' if low is None else 'to'}; specify both ends of a range"
            raise ValueError(msg)
        if not low < high:
            msg = f"is empty: from {low:g} is not below to {high:g}"
            raise ValueError(msg)
        if self.log and low <= 0:
            msg = f"is logarithmic and must start above 0 (from {low:g}); omit log for a linear range"
            raise ValueError(msg)
        return self


def _scored(quantity: str) -> str:
    if quantity not in QUANTITIES:
        msg = f"unknown quantity{suggest_word(quantity, QUANTITIES)}; valid quantities: {', '.join(QUANTITIES)}"
        raise ValueError(msg)
    return quantity


class ObjectiveSpec(FrozenModel):
    """A quantity whose error is minimised."""

    quantity: Annotated[str, AfterValidator(_scored)]
    """Key of `scenetruth.scoring.QUANTITIES`, such as ``depth`` or ``growth_rate``."""
    region: Name = "interior"
    """Region: ``all``, ``interior``, or ``object_NAME``."""
    statistic: Statistic = "scaled_median_abs_error"
    """Statistic of the errors in the region: ``scaled_median_abs_error``, 1.4826 times the median absolute error (the
    standard deviation of normal errors, robust against outliers); ``rmse``; ``p95_abs_error``, the 95th percentile of
    the absolute error."""
    target: Positive | None = None
    """Sufficient value, in mm, mm/frame or %/h; default: as small as possible."""


class IlluminationSpec(FrozenModel):
    """The illumination of the scene, which determines the photon rate of the camera pixels.

    A white Lambertian surface at E lux gives E / (4 N²) lux on the sensor for an effective f-number N; at 555 nm, 1 lux
    is 1 / 683 W/m².
    """

    illuminance_lux: Positive
    """Illuminance of a surface with radiance 1. Typical: bright office 500, lit bench 10,000, sunlight 100,000."""
    wavelength_um: Annotated[float, Field(ge=0.3, le=1.2)] = 0.55
    """Wavelength for diffraction."""


class SearchSpec(FrozenModel):
    """Allocation of the predictions of a search."""

    predictions: Annotated[int, Field(ge=16, le=1_000_000)] = 2400
    """Maximum total number of predictions."""
    morris_trajectories: Annotated[int, Field(ge=0, le=1000)] = 10
    """Trajectories of Morris' method, with one prediction per design variable plus one each. 0 for none."""
    sobol: Annotated[int, Field(ge=0, le=65536)] = 64
    """Base samples of Sobol' indices, a power of two, with one prediction per design variable plus two each. 0 for
    none."""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Seed of the search."""


class ConfirmationSpec(FrozenModel):
    """Confirmation runs: number of rigs, seeds and image size."""

    rigs: Annotated[int, Field(ge=0, le=1000)] = 3
    """Number of simulated rigs; 0 for no simulations."""
    seeds: Annotated[int, Field(ge=1, le=1000)] = 5
    """Recordings per rig with independent textures, noise and stage errors. The half width of the prediction interval
    of a further recording is 5.0, 3.0 and 2.5 standard deviations for 3, 5 and 8 seeds."""
    most_seeds: Annotated[int, Field(ge=1, le=1000)] | None = None
    """Largest number of recordings of the recommended rig: while its recordings do not decide whether a target is
    reached, their number is doubled, up to this number. null for four times ``seeds``."""
    max_size_px: Annotated[int, Field(ge=32, le=32768)] | None = 240
    """Images are cropped to this size along the longer side, around the centre of the first objective's region; the
    width is increased by the disparity of the outermost positions, and the height reduced. null for full images."""


CONSTRAINT_MODULES = ("scenetruth.design.optimisation.constraints",)
"""Modules that define constraints."""
CATALOGUES = ("lens", "camera", "stage")
"""Parameters with values from catalogues."""
NAMED_VARIABLES = (*CATALOGUES, "f_number", "exposure_s", "working_distance_mm")
"""Parameters that are not fields of the scene."""

if TYPE_CHECKING:
    AnyConstraint = ConstraintSpec
else:
    AnyConstraint = discriminated_union(ConstraintSpec, *CONSTRAINT_MODULES)

_MOST_OBJECTIVES = 6
_PATH_PATTERN = r"^[A-Za-z0-9_*-]+(\.[A-Za-z0-9_*-]+)*$"
FieldPath = Annotated[str, Field(pattern=_PATH_PATTERN, max_length=300)]
"""Path of a scene field: keys and indices separated by dots; ``*`` stands for all list entries."""


class DesignSpec(FrozenModel):
    """A design specification: design variables, objectives and constraints.

    See Also
    --------
    load_design_spec : Load a design specification from a YAML file.
    DesignSpec.from_dict : Validate a design specification given as plain data.
    scenetruth.design.optimisation.optimise : Optimise a rig.

    Examples
    --------
    >>> spec = DesignSpec(
    ...     scene="cube",
    ...     variables={"stage.baseline_mm": {"from": 1, "to": 8}, "stage.positions": {"values": [3, 5, 9]}},
    ...     constraints=[{"kind": "stage_travel", "max": 25}],
    ...     objectives=[{"quantity": "depth"}, {"quantity": "velocity_z", "region": "object_cube"}],
    ... )
    >>> [one.title for one in spec.constraints], [one.quantity for one in spec.objectives]
    (['stage travel'], ['depth', 'velocity_z'])
    >>> spec.search.predictions, spec.confirmation.rigs, spec.confirmation.seeds
    (2400, 3, 5)
    """

    format: Literal[1] = 1
    """Version of the format of design specifications."""
    title: Name = "A rig"
    """Title of the design."""
    description: Annotated[str, Field(max_length=10_000)] = ""
    """Description of the design."""
    scene: SceneFile | dict[str, Any]
    """The measured scene: a file, the name of a bundled scene, or the scene itself. Its camera, stage and times are the
    defaults of the rig."""
    method: str | dict[str, Any] = "refined"
    """Estimation method, with settings as in ``refined[window_sigma_px: 4]`` or as a mapping."""
    set: dict[FieldPath, Any] = Field(default_factory=dict)
    """Changes of the scene: values by path of a field."""
    variables: dict[FieldPath, DesignVariable] = Field(min_length=1)
    """Design variables: ranges or choices by path of a field. In addition, ``lens``, ``camera`` and ``stage`` are
    catalogue entries; ``f_number`` requires a lens; ``exposure_s`` is the exposure time of shutter and sensor;
    ``working_distance_mm`` moves all objects along Z."""
    catalogues: tuple[InputFile, ...] = ()
    """Files with further catalogue entries."""
    light: IlluminationSpec | None = None
    """The illumination; default: adapted to each camera of the catalogue."""
    constraints: tuple[AnyConstraint, ...] = ()
    """Constraints on a rig."""
    objectives: Annotated[tuple[ObjectiveSpec, ...], Field(min_length=1, max_length=_MOST_OBJECTIVES)]
    """Objectives to minimise."""
    search: SearchSpec = SearchSpec()
    """Extent of the search."""
    confirmation: ConfirmationSpec = ConfirmationSpec()
    """Confirmation runs."""

    @field_validator("objectives")
    @classmethod
    def _differ(cls, value: tuple[ObjectiveSpec, ...]) -> tuple[ObjectiveSpec, ...]:
        entries = Counter((one.quantity, one.region, one.statistic) for one in value)
        twice = [key for key, count in entries.items() if count > 1]
        if twice:
            msg = f"must be unique: {', '.join(f'{name} of {region}, {kind}' for name, region, kind in twice)}"
            raise ValueError(msg)
        return value

    @model_validator(mode="after")
    def _variable_or_set(self) -> Self:
        both = sorted(set(self.variables) & set(self.set))
        if both:
            msg = f"fields are both set and variable: {', '.join(both)}"
            raise ValueError(msg)
        return self

    @classmethod
    def from_dict(
        cls, values: Mapping[str, Any], *, source: str | Path | None = None, folder: Path | None = None
    ) -> DesignSpec:
        """Validate a design specification given as plain data.

        Parameters
        ----------
        values
            Plain data, as in a file.
        source
            Name of the source for messages.
        folder
            Base directory of relative paths; None leaves them unchanged.

        Returns
        -------
        DesignSpec
            The validated, immutable specification.

        Raises
        ------
        DesignSpecError
            With every problem and its path.

        See Also
        --------
        load_design_spec : Load a design specification from a YAML file.
        scenetruth.design.optimisation.optimise : Optimise a rig.

        Examples
        --------
        >>> from scenetruth.errors import RecipeError
        >>> try:
        ...     DesignSpec.from_dict({"scene": "cube.yaml", "variables": {"stage.baseline_mm": {"from": 5, "to": 2}}})
        ... except RecipeError as error:
        ...     print(error)
        2 problems with the design specification:
          - variables.stage.baseline_mm: is empty: from 5 is not below to 2 (got {'from': 5, 'to': 2})
          - objectives: is missing
        """
        return _validated(values, source, folder).required()


class DesignReading(Reading[DesignSpec]):
    """A design specification with its problems."""

    refused = DesignSpecError


class _DesignRepair(FieldRepair):
    """Values of a design specification, in which fields with errors are removed or replaced."""

    required: ClassVar[Mapping[str, Any]] = {
        "scene": {}, "variables": {"stage.baseline_mm": {"from": 1, "to": 2}}, "objectives": [{"quantity": "depth"}],
    }  # fmt: skip

    def apply(self, keys: Keys, error: str) -> None:
        """Remove or replace a field with an error; of equal objectives, the first remains."""
        items = self.plain.get("objectives")
        if tuple(keys) == ("objectives",) and isinstance(items, list):
            places = [place for place, each in enumerate(items) if each not in items[:place]][:_MOST_OBJECTIVES]
            if 0 < len(places) < len(items):
                self.plain["objectives"] = [items[place] for place in places]
                self.indices("objectives")[:] = [self.indices("objectives")[place] for place in places]
                self.done.add((error, *keys, "equal"))
                return
        super().apply(keys, error)

    def resolve(self) -> None:
        """Remove changes of design variables."""
        for key in {*self.plain.get("set", {})} & {*self.plain.get("variables", {})}:
            del self.plain["set"][key]
            self.wrong.add(("set", key))


def _validated(values: Any, source: str | Path | None = None, folder: Path | None = None) -> DesignReading:
    if not isinstance(values, Mapping):
        return DesignReading(None, (Problem("", f"must be {_MAPPING}", values),), _DesignRepair({}), source)
    repair = _DesignRepair(values)
    problems = plain_problems(values)
    if problems:
        return DesignReading(None, tuple(problems), repair, source)
    spec, problems = read_model(DesignSpec, values, repair, context=validation_context(folder))
    if spec is not None:
        problems += _find_contradictions(spec, repair.indices("constraints"))
    return DesignReading(spec, tuple(problems), repair, source)


_MAPPING = "a mapping of scene, variables, constraints, objectives, ..."


DesignSpecLike = DesignSpec | Mapping[str, Any] | str | PathLike[str]
"""A specification, its plain data, the path of its file, or the name of a bundled one."""


def load_design_spec(specification: DesignSpecLike, *, overrides: Overrides = ()) -> DesignSpec:
    """Load a design specification.

    Parameters
    ----------
    specification
        The YAML file, with relative paths based on its directory; or the name of a bundled design such as
        ``"leaf_growth"``; or plain data as a mapping; or a specification.
    overrides
        Changes that are applied first, as in `scenetruth.load_scene`.

    Returns
    -------
    DesignSpec
        The validated, immutable specification.

    Raises
    ------
    DesignSpecError
        If the file cannot be read or is invalid; lists every problem.

    See Also
    --------
    DesignSpec.from_dict : Validate a design specification given as plain data.
    scenetruth.design.optimisation.optimise : Optimise a rig.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> text = '''
    ... title: Depth of a cube
    ... scene: cube
    ... variables:
    ...   stage.baseline_mm: {from: 1, to: 8}
    ... constraints:
    ...   - {kind: stage_travel, max: 25}
    ... objectives:
    ...   - {quantity: depth, target: 0.05}
    ... '''
    >>> with TemporaryDirectory() as folder:
    ...     _ = Path(folder, "spec.yaml").write_text(text)
    ...     spec = load_design_spec(f"{folder}/spec.yaml")
    >>> spec.title, spec.objectives[0].target, list(spec.variables)
    ('Depth of a cube', 0.05, ['stage.baseline_mm'])

    A bundled design specification:

    >>> load_design_spec("cube_depth").title
    'Depth and motion of the noise cube'
    """
    return read_design_spec(specification, overrides=overrides).required()


def read_design_spec(specification: DesignSpecLike, *, overrides: Overrides = ()) -> DesignReading:
    """Read a design specification as `load_design_spec` does, without an error for an invalid one."""
    if isinstance(specification, DesignSpec) and not overrides:
        return DesignReading(specification, (), _DesignRepair(specification.model_dump(by_alias=True)))
    given = (
        specification.model_dump(mode="json", by_alias=True) if isinstance(specification, DesignSpec) else specification
    )
    plain, source, folder = read_input(given, "a design specification", DesignSpecError, within="designs")
    plain, wrong = override(plain, overrides)
    reading = _validated(plain, source, folder)
    return replace(reading, problems=tuple(join_override_problems(wrong, reading.problems)))


def _find_contradictions(spec: DesignSpec, indices: Sequence[int]) -> list[Problem]:
    """Return the problems of contradictory bounds on the same property, by the indices of the constraints."""
    found = list[Problem]()
    bounds: dict[str, tuple[int, float | None, float | None]] = {}
    for number, one in zip(indices, spec.constraints, strict=True):
        key = one.model_dump_json(exclude={"min", "max"})
        _, low, high = bounds.get(key, (number, None, None))
        low = one.min if low is None or (one.min or low) > low else low
        high = one.max if high is None or (one.max or high) < high else high
        earlier = bounds.get(key)
        bounds[key] = (number, low, high)
        if low is not None and high is not None and low > high:
            message = f"contradicts constraints.{earlier[0] if earlier else number}: {one.title} must be at least"
            found.append(Problem(f"constraints.{number}", f"{message} {low:g} and at most {high:g} {one.unit}"))
    return found
