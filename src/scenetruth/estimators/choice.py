"""A method and its settings, as a scene file or a call chooses them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import (
    BaseModel,
    ConfigDict,
    GetJsonSchemaHandler,
    SerializationInfo,
    ValidationError,
    model_serializer,
    model_validator,
)
from pydantic_core import CoreSchema

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.protocol import Estimator
from scenetruth.estimators.registry import DEFAULT_METHOD, find_method, method_entries
from scenetruth.model import FrozenModel
from scenetruth.plain import plain_problems

__all__ = ["MethodChoice", "choose", "validate_settings"]


class MethodChoice(BaseModel):
    """Which method estimates, and with which settings; in a file, both stand side by side.

    ``module:function`` is refused here: a file that is read imports no code but that of installed methods.

    Examples
    --------
    >>> choice = MethodChoice.model_validate({"method": "structure_tensor", "window_sigma_px": 4})
    >>> choice.settings.window_sigma_px, choice.model_dump()["window_taps_px"]
    (4.0, 25)
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: str
    """Name of the method: see `scenetruth methods`."""
    settings: FrozenModel
    """Its settings."""

    @model_validator(mode="before")
    @classmethod
    def _apart(cls, given: Any) -> Any:
        if isinstance(given, Mapping) and isinstance(given.get("settings"), FrozenModel):
            return given
        try:
            chosen = choose(given, from_file=True)
        except EstimateError as error:
            raise ValueError("; ".join(map(str, error.problems))) from error
        return {"method": chosen.method, "settings": chosen.settings}

    @model_serializer(mode="plain")
    def _side_by_side(self, info: SerializationInfo) -> dict[str, Any]:
        return {"method": self.method, **self.settings.model_dump(mode=info.mode)}

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Return one object for every method that can be loaded; broken ones are left out."""
        variants = []
        for entry in method_entries():
            try:
                method = find_method(entry.name)
            except EstimateError:
                continue
            variant = _in_place(method.settings.model_json_schema())
            named = {"const": entry.name, "description": "The method.", "title": "Method", "type": "string"}
            if entry.name == DEFAULT_METHOD:
                named["default"] = entry.name
            else:
                variant["required"] = ["method", *variant.get("required", ())]
            variant["properties"] = {"method": named, **variant.get("properties", {})}
            variants.append(variant)
        return {"oneOf": variants}


def _in_place(schema: dict[str, Any]) -> dict[str, Any]:
    """Return a JSON Schema in which models within models stand where they are used: its own $defs cannot be kept."""
    definitions = schema.pop("$defs", {})

    def spelled(part: Any, within: tuple[str, ...] = ()) -> Any:
        if isinstance(part, list):
            return [spelled(each, within) for each in part]
        if not isinstance(part, dict):
            return part
        name = str(part.get("$ref", "")).removeprefix("#/$defs/")
        rest = {key: spelled(each, within) for key, each in part.items() if key != "$ref"}
        if name not in definitions:
            return rest
        # A model that holds itself is told once.
        return {**({"type": "object"} if name in within else spelled(definitions[name], (*within, name))), **rest}

    return dict(spelled(schema))


def choose(given: Any, *, from_file: bool = False) -> MethodChoice:
    """Return a validated choice from what a scene file says.

    Parameters
    ----------
    given
        A mapping with ``method`` (the paper's if not given) and the method's settings, or a choice as it is.
    from_file
        Whether a file says so: it may name no ``module:function``, as importing runs code.

    Raises
    ------
    EstimateError
        With everything that is wrong with it.
    """
    if isinstance(given, MethodChoice):
        return given
    if not isinstance(given, Mapping):
        raise EstimateError([Problem("", "must be a mapping of method and its settings", given)])
    fields = dict(given)
    method = fields.pop("method", DEFAULT_METHOD)
    if not isinstance(method, str):
        raise EstimateError([Problem("method", "must be the name of a method", method)])
    if from_file and ":" in method:
        message = f"is code, which no file may name; give it to the call (--method {method}) or install it as a plug-in"
        raise EstimateError([Problem("method", message, method)])
    settings = validate_settings(find_method(method), fields)
    return MethodChoice.model_construct(method=method, settings=settings)


def validate_settings(method: Estimator, fields: Mapping[str, Any]) -> FrozenModel:
    """Return the settings of a method.

    Parameters
    ----------
    method
        The method.
    fields
        Its settings by name, as plain values; those that are not given have their defaults.

    Returns
    -------
    MethodSettings
        The settings, of the type ``method.settings``.

    Raises
    ------
    EstimateError
        With every setting that is unknown or impossible.

    See Also
    --------
    scenetruth.estimators.find_method : A method by its name.
    scenetruth.estimators.MethodSettings : What models of settings derive from.

    Examples
    --------
    What is not given has its default; all that is wrong is told at once:

    >>> import scenetruth as st
    >>> from scenetruth.estimators import find_method
    >>> method = find_method("plane_sweep")
    >>> settings = validate_settings(method, {"distinctness": 1.5})
    >>> settings.distinctness, settings.disparity_px
    (1.5, 'auto')
    >>> try:
    ...     validate_settings(method, {"distinctness": -1, "disparity": 20})
    ... except st.EstimateError as error:
    ...     print(error)
    2 problems with the estimate in settings of 'plane_sweep':
      - disparity: unknown setting of 'plane_sweep'; did you mean 'disparity_px'? (got 20)
      - distinctness: input should be greater than or equal to 1 (got -1)
    """
    problems = plain_problems(fields)
    if problems:
        raise EstimateError(problems, source=f"settings of '{method.name}'")
    try:
        return method.settings.model_validate(dict(fields))
    except ValidationError as error:
        told: dict[str, list[Problem]] = {}
        for problem in (_problem_of(entry, method) for entry in error.errors(include_url=False)[:_MOST_TOLD]):
            told.setdefault(problem.path, []).append(problem)
        # Of a setting that may be a number or a word, pydantic reports each on its own.
        problems = [
            Problem(path, ", or ".join(dict.fromkeys(problem.message for problem in found)), found[0].value)
            for path, found in sorted(told.items())
        ]
        raise EstimateError(problems, source=f"settings of '{method.name}'") from error


_MOST_TOLD = 100
"""More wrong settings are not told: to find what each was meant to be takes time."""


def _problem_of(entry: Any, method: Estimator) -> Problem:
    keys = [str(key) for key in entry["loc"]]
    path = ".".join(key for key in keys if not key.startswith(_UNION_TYPES) and key not in _UNION_MEMBERS)
    message, value = entry["msg"].removeprefix("Value error, "), entry.get("input")
    if entry["type"] == "extra_forbidden":
        import difflib

        known = sorted(method.settings.model_fields)
        near = difflib.get_close_matches(keys[-1], known, n=1)
        hint = f"; did you mean '{near[0]}'?" if near else f"; known: {', '.join(known) or 'none'}"
        message = f"unknown setting of '{method.name}'{hint}"
    return Problem(path, message[:1].lower() + message[1:], value)


# What pydantic calls the members of a union, in the places of what is wrong.
_UNION_TYPES = ("literal[", "function-", "tuple[", "list[", "nullable[")
_UNION_MEMBERS = ("int", "float", "str", "constrained-int", "constrained-float", "constrained-str")
