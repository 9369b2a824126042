"""Specifications of methods, with settings and labels, for functions and the command line."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

import yaml

from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators.protocol import Estimator
from scenetruth.estimators.registry import MethodChoice, choose, find_method, offered, validate_settings

__all__ = [
    "MethodLike",
    "MethodSpec",
    "offered_methods",
    "parse_method",
    "parse_methods",
    "read_method",
    "read_methods",
]

_SPELLED = re.compile(r"(?:(?P<label>[^=\[\]]+)=)?(?P<method>[^=\[\]]+)(?:\[(?P<settings>.*)\])?", re.DOTALL)


@dataclass(frozen=True)
class MethodSpec:
    """A method with settings, and a label for tables and plots.

    Parameters
    ----------
    method
        Name of a method, ``"module:function"``, or a method or function object.
    settings
        Settings of the method; default: the defaults of the method.
    label
        Label in tables and plots; default: name and settings.
    fingerprint
        Hash of the code of a user-defined method, empty for an installed method; default: computed.

    Raises
    ------
    EstimateError
        If the method does not exist, or a setting is invalid.

    See Also
    --------
    scenetruth.estimate, scenetruth.compare, scenetruth.sweep : Accept methods in this form.

    Examples
    --------
    >>> from scenetruth.estimators import MethodSpec
    >>> fine = MethodSpec("structure_tensor", {"window_sigma_px": 2}, label="fine")
    >>> fine.label, fine.spelled
    ('fine', 'fine=structure_tensor[window_sigma_px: 2]')
    >>> MethodSpec("refined").label
    'refined'
    """

    method: Any
    settings: Mapping[str, Any] = field(default_factory=dict)
    label: str = ""
    fingerprint: str | None = None

    def __post_init__(self) -> None:
        if isinstance(self.method, str) and ":" not in self.method:
            choose({"method": self.method, **self.settings})
        else:
            validate_settings(find_method(self.method), self.settings)
        object.__setattr__(self, "settings", dict(self.settings))
        if not self.label:
            object.__setattr__(self, "label", self._default_label())
        if self.fingerprint is None:
            from scenetruth.estimators.code_fingerprint import compute_code_fingerprint

            object.__setattr__(self, "fingerprint", compute_code_fingerprint(self.method))

    def _default_label(self) -> str:
        short = (
            "" if isinstance(self.method, str) else getattr(self.method, "name", getattr(self.method, "__name__", ""))
        )
        return short if short and not self.settings else self._unlabelled

    @property
    def _unlabelled(self) -> str:
        plain = yaml.safe_dump(dict(self.settings), default_flow_style=True, width=10**9).strip()[1:-1]
        name = _method_path(self.method)
        return f"{name}[{plain}]" if self.settings else name

    @property
    def spelled(self) -> str:
        """Notation on the command line."""
        spelled = self._unlabelled
        return spelled if self.label == spelled else f"{self.label}={spelled}"

    @property
    def is_own(self) -> bool:
        """Whether the algorithm is implemented in scenetruth itself, unlike OpenCV and user-defined methods."""
        if not isinstance(self.method, str) or ":" in self.method:
            return False
        home = type(find_method(self.method)).__module__
        return home.startswith("scenetruth.estimators.") and "opencv" not in home

    @property
    def words(self) -> tuple[str, ...]:
        """Arguments of the command line that specify the method: one word, or an option and its value."""
        option = getattr(self.method, "as_option", None)
        return (self.spelled,) if option is None else tuple(option(self.label))

    @property
    def identity(self) -> str:
        """Text that identifies the results: the location of the code, all settings and the hash of the code."""
        settings = validate_settings(find_method(self.method), self.settings)
        plain = f"{_method_path(self.method)} {settings.model_dump_json()}"
        # Installed methods have no fingerprint, so that existing results stay valid.
        return f"{plain} {self.fingerprint}" if self.fingerprint else plain

    @property
    def is_installed(self) -> bool:
        """Whether the method is installed and specified by name, so that an error will occur again."""
        return isinstance(self.method, str) and not self.fingerprint

    def choice(self, own: MethodChoice | None = None) -> MethodChoice:
        """Return the name of the method with all settings, including those of ``own`` if it is the same method."""
        name = self.method if isinstance(self.method, str) else find_method(self.method).name
        base = own.settings.model_dump(mode="json") if own is not None and own.method == name else {}
        if own is not None and base and not self.settings:
            return own
        settings = validate_settings(find_method(self.method), {**base, **self.settings})
        return MethodChoice.model_construct(method=name, settings=settings)


MethodLike = str | MethodSpec | Estimator | Callable[..., Any]
"""Name of a method, ``"module:function"``, a function or method object, or a specification with settings."""


def read_method(method: MethodLike) -> MethodSpec:
    """Return the specification of a method."""
    return method if isinstance(method, MethodSpec) else MethodSpec(method)


def read_methods(methods: MethodLike | Iterable[MethodLike]) -> list[MethodSpec]:
    """Return the validated specifications of one or several methods.

    >>> [one.label for one in read_methods(["refined", MethodSpec("refined", {"window_sigma_px": 4}, "fine")])]
    ['refined', 'fine']
    """
    if isinstance(methods, str | MethodSpec) or callable(methods) or hasattr(methods, "estimate"):
        methods = [methods]  # type: ignore[list-item]  # callables are not iterated over
    return _collect(methods, read_method)


def parse_methods(texts: Iterable[MethodLike]) -> list[MethodSpec]:
    """Return methods from the notation of the command line; see `parse_method`.

    >>> [one.label for one in parse_methods(["refined", "fine=refined[window_sigma_px: 4]"])]
    ['refined', 'fine']
    """
    return _collect(texts, lambda given: parse_method(given) if isinstance(given, str) else read_method(given))


def _collect(methods: Iterable[Any], read: Callable[[Any], MethodSpec]) -> list[MethodSpec]:
    found: list[MethodSpec] = []
    problems: list[Problem] = []
    for given in methods:
        try:
            found.append(read(given))
        except EstimateError as error:
            problems += error.problems
    labels = [one.label for one in found]
    problems += [
        Problem("methods", "occurs twice: set a different label, LABEL=METHOD[SETTINGS]", label)
        for label in sorted({label for label in labels if labels.count(label) > 1})
    ]
    if not found and not problems:
        problems.append(Problem("methods", "at least one method is required"))
    if problems:
        raise EstimateError(problems)
    return found


def parse_method(text: str, *, from_file: bool = False) -> MethodSpec:
    """Return a method from its notation on the command line: ``LABEL=NAME[setting: value, ...]``.

    >>> parse_method("fine=refined[window_sigma_px: 4]").settings
    {'window_sigma_px': 4}
    """
    parts = _SPELLED.fullmatch(text.strip())
    if parts is None:
        message = "must have the form LABEL=METHOD[setting: value, ...]; label and settings are optional"
        raise EstimateError([Problem("methods", message, text)])
    settings: Any = {}
    if parts["settings"] is not None:
        try:
            settings = yaml.safe_load("{" + parts["settings"] + "}")
        except yaml.YAMLError as error:
            message = "settings must be valid YAML: [window_sigma_px: 4, motion: rigid]"
            raise EstimateError([Problem("methods", message, text)]) from error
    name = parts["method"].strip()
    if from_file:
        choose({"method": name, **settings}, from_file=True)
    return MethodSpec(name, settings, (parts["label"] or "").strip())


@contextmanager
def offered_methods(methods: Iterable[MethodSpec]) -> Iterator[None]:
    """Make methods that are functions or objects available by name, in this process."""
    with ExitStack() as stack:
        for one in methods:
            if isinstance(one.method, str):
                continue
            found = find_method(one.method)
            try:
                installed = find_method(found.name)
            except EstimateError:
                installed = None
            if installed is not found:
                stack.enter_context(offered(found))
        yield


def _method_path(method: Any) -> str:
    """Return the name of a method, or the import path of a user-defined function or class."""
    if isinstance(method, str):
        return method
    found = method if hasattr(method, "__qualname__") else type(method)
    return f"{found.__module__}:{found.__qualname__}"
