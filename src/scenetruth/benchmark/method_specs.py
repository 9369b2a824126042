"""Methods of a benchmark, with settings and labels."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import yaml

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators import Estimator, choose, find_method, validate_settings
from scenetruth.estimators.code_fingerprint import compute_code_fingerprint

__all__ = ["MethodSpec", "parse_methods"]

MethodLike = str | Estimator | Callable[..., Any] | Mapping[str, Any]

_SPELLED = re.compile(r"(?:(?P<label>[^=\[\]]+)=)?(?P<method>[^=\[\]]+)(?:\[(?P<settings>.*)\])?", re.DOTALL)


@dataclass(frozen=True)
class MethodSpec:
    """A method in a comparison.

    Parameters
    ----------
    label
        What it is called in tables and plots.
    method
        What `scenetruth.estimate` takes.
    settings
        Its settings.
    made_of
        A hash of the code of a method of one's own, as it was when it was named; empty for those that are installed.
    """

    label: str
    method: Any
    settings: Mapping[str, Any] = field(default_factory=dict)
    made_of: str = ""

    @property
    def spelled(self) -> str:
        """What the command line calls it."""
        plain = yaml.safe_dump(dict(self.settings), default_flow_style=True, width=10**9).strip()[1:-1]
        name = _method_path(self.method)
        spelled = f"{name}[{plain}]" if self.settings else name
        return spelled if self.label == spelled else f"{self.label}={spelled}"

    @property
    def is_own(self) -> bool:
        """Whether its algorithm is scenetruth's own, and not that of others."""
        if not isinstance(self.method, str) or ":" in self.method:
            return False
        home = type(find_method(self.method)).__module__
        return home.startswith("scenetruth.estimators.") and "opencv" not in home

    @property
    def words(self) -> tuple[str, ...]:
        """Words of the command line that name it: one, or an option and its value."""
        option = getattr(self.method, "as_option", None)
        return (self.spelled,) if option is None else tuple(option(self.label))

    @property
    def identity(self) -> str:
        """What its figures depend on: where its code stands, all of its settings, and what it is made of."""
        settings = validate_settings(find_method(self.method), self.settings)
        plain = f"{_method_path(self.method)} {settings.model_dump_json()}"
        # Of methods that are installed, the identity is as it always was: what was measured stays.
        return f"{plain} {self.made_of}" if self.made_of else plain

    @property
    def is_installed(self) -> bool:
        """Whether it goes by a name, and is nobody's own code: what it refuses, it will refuse again."""
        return isinstance(self.method, str) and not self.made_of


def parse_methods(methods: Iterable[MethodLike] | MethodLike, *, from_file: bool = False) -> list[MethodSpec]:
    """Return the methods of a comparison, all of them checked.

    Parameters
    ----------
    methods
        One or several of: a name, ``"module:function"``, a method or function; with settings in brackets,
        ``"refined[window_sigma_px: 4, motion: rigid]"``; with a label before it, ``"fine=refined[motion: rigid]"``; or
        a mapping with ``method``, settings, and perhaps ``label``.
    from_file
        Whether a file says so: it may name no ``module:function``, as importing runs code.

    Raises
    ------
    EstimateError
        With every method that is not installed, every setting that is impossible, and labels that are there twice.

    Examples
    --------
    >>> [one.label for one in parse_methods(["refined", "fine=refined[window_sigma_px: 4]"])]
    ['refined', 'fine']
    """
    if isinstance(methods, str | Mapping) or callable(methods) or hasattr(methods, "estimate"):
        methods = [methods]  # type: ignore[list-item]  # callables are not iterated over
    found: list[MethodSpec] = []
    problems: list[Problem] = []
    for given in methods:
        try:
            found.append(_parse_method(given, from_file))
        except EstimateError as error:
            problems += error.problems
    labels = [one.label for one in found]
    problems += [
        Problem("methods", "is there twice: give one of them another label, LABEL=METHOD[SETTINGS]", label)
        for label in sorted({label for label in labels if labels.count(label) > 1})
    ]
    if not found and not problems:
        problems.append(Problem("methods", "at least one method is needed"))
    if problems:
        raise EstimateError(problems)
    return found


def _parse_method(given: Any, from_file: bool) -> MethodSpec:
    if isinstance(given, Mapping):
        fields = dict(given)
        label = fields.pop("label", "")
        method = fields.pop("method", None)
        return _checked(method, fields, label, from_file)
    if not isinstance(given, str):
        return _checked(given, {}, "", from_file)
    parts = _SPELLED.fullmatch(given.strip())
    if parts is None:
        message = "is not spelled as LABEL=METHOD[setting: value, ...]; label and settings may be left out"
        raise EstimateError([Problem("methods", message, given)])
    settings: Any = {}
    if parts["settings"] is not None:
        try:
            settings = yaml.safe_load("{" + parts["settings"] + "}")
        except yaml.YAMLError as error:
            message = "settings are not spelled as in YAML: [window_sigma_px: 4, motion: rigid]"
            raise EstimateError([Problem("methods", message, given)]) from error
    return _checked(parts["method"].strip(), settings, (parts["label"] or "").strip(), from_file)


def _checked(method: Any, settings: Mapping[str, Any], label: str, from_file: bool) -> MethodSpec:
    if isinstance(method, str) and (from_file or ":" not in method):
        choose({"method": method, **settings}, from_file=from_file)
    else:
        validate_settings(find_method(method), settings)
    short = "" if isinstance(method, str) else getattr(method, "name", getattr(method, "__name__", ""))
    spelled = MethodSpec("", method, dict(settings)).spelled.removeprefix("=")
    told = label or (short if short and not settings else spelled)
    return MethodSpec(told, method, dict(settings), compute_code_fingerprint(method))


def _method_path(method: Any) -> str:
    """Return the name of a method, or where a function or class of somebody else's stands."""
    if isinstance(method, str):
        return method
    found = method if hasattr(method, "__qualname__") else type(method)
    return f"{found.__module__}:{found.__qualname__}"
