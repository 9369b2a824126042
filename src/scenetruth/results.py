"""Results of computations: a value with its interval, and the common methods of all results."""

from __future__ import annotations

import json
import math
import types
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, Union, get_args, get_origin, get_type_hints

from scenetruth.errors import ArgumentError, Problem, StoreError
from scenetruth.output import write_atomically
from scenetruth.plain_data import parse_json

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["QuantityValue", "Result", "from_plain_data", "refuse_unknown", "to_plain_data"]

_MAX_HTML_ROWS = 60


@dataclass(frozen=True)
class QuantityValue:
    """One statistic of one quantity in one region.

    Parameters
    ----------
    value
        The value, in ``unit``; NaN or infinite where it is undefined.
    unit
        Its unit, for example ``mm/frame``.
    ci_low, ci_high
        Limits of its 95 % interval; NaN if there is none.
    statistic
        The statistic, for example ``rmse``.
    region
        The region of the image.
    n
        Sample size: number of pixels or seeds; None if not recorded.

    See Also
    --------
    scenetruth.Score : Has values of an estimate.
    scenetruth.Prediction : Has values predicted for a scene.
    scenetruth.Sweep : Has values of simulations over factors.

    Examples
    --------
    >>> from scenetruth.results import QuantityValue
    >>> QuantityValue(0.012, "mm", statistic="rmse", region="interior", n=9000)
    QuantityValue(0.012 mm, rmse, interior, n=9000)
    >>> QuantityValue(0.5, "px/frame", 0.4, 0.7, statistic="bias", region="all")
    QuantityValue(0.5 px/frame [0.4, 0.7], bias, all)
    """

    value: float
    unit: str
    ci_low: float = math.nan
    ci_high: float = math.nan
    statistic: str = ""
    region: str = ""
    n: int | None = None

    def __repr__(self) -> str:
        interval = f" [{self.ci_low:.4g}, {self.ci_high:.4g}]" if math.isfinite(self.ci_low + self.ci_high) else ""
        parts = [f"{self.value:.4g} {self.unit}".rstrip() + interval, self.statistic, self.region]
        parts += [] if self.n is None else [f"n={self.n}"]
        return f"QuantityValue({', '.join(part for part in parts if part)})"

    def __float__(self) -> float:
        return float(self.value)


class Result(ABC):
    """Base class of the results, which are frozen dataclasses.

    Derived classes define `to_dataframe` and `summary`; fields are saved as JSON according to their annotations.
    """

    _FORMAT: ClassVar[int] = 1
    """Version of the file format; to be incremented when fields change."""
    _UNSAVED: ClassVar[frozenset[str]] = frozenset()
    """Fields that are not saved; they have defaults."""

    @abstractmethod
    def to_dataframe(self) -> pd.DataFrame:
        """Return all values as a tidy table."""

    @abstractmethod
    def summary(self) -> str:
        """Return the main statements as text, one per line."""

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as plain values, with the name of the class and the version of the format.

        Returns
        -------
        dict
            JSON-compatible values: NaN is None, infinity is ``"inf"`` or ``"-inf"``.
        """
        saved = {one.name: getattr(self, one.name) for one in fields(self) if one.name not in self._UNSAVED}  # type: ignore[arg-type]
        return {"type": type(self).__name__, "format": self._FORMAT, **to_plain_data(saved)}

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Self:
        """Return the result of a mapping from `to_dict`.

        Raises
        ------
        ValueError
            If the mapping belongs to another class of results, or to another version of the format.
        KeyError, TypeError
            If fields are missing, or have values of another type.
        """
        for key, expected in (("type", cls.__name__), ("format", cls._FORMAT)):
            if plain.get(key) != expected:
                message = f"{key} must be {expected!r}, not {plain.get(key)!r}"
                raise ValueError(message)
        hints = get_type_hints(cls, localns=cls._names())
        saved = [one.name for one in fields(cls) if one.name not in cls._UNSAVED]  # type: ignore[arg-type]
        return cls(**{name: from_plain_data(hints[name], plain[name]) for name in saved})

    @classmethod
    def _names(cls) -> dict[str, Any]:
        """Return names in annotations that the module imports for type checkers only."""
        return {}

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Save the result as JSON.

        Parameters
        ----------
        path
            Path of the file, which is written atomically.
        overwrite
            Whether an existing file may be replaced.

        Returns
        -------
        pathlib.Path
            The file.

        Raises
        ------
        OutputExistsError
            If the file exists and ``overwrite`` is false.
        StoreError
            If it cannot be written.
        """
        file = Path(path)
        text = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
        with write_atomically(file, overwrite=overwrite) as partial:
            partial.write_text(text, encoding="utf-8")
        return file

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Load a result written by `save`.

        Parameters
        ----------
        path
            The file.

        Raises
        ------
        StoreError
            If it is missing, damaged, of another class of results, or of another version of the format.
        """
        file = Path(path)
        try:
            plain = parse_json(file.read_bytes())
            if not isinstance(plain, dict):
                message = "must be a JSON object"
                raise TypeError(message)
            return cls.from_dict(plain)
        except OSError as error:
            raise StoreError(file, f"cannot be read ({error.strerror})") from error
        except KeyError as error:
            raise StoreError(file, f"is not a saved {cls.__name__}: field {error} is missing") from error
        except (ValueError, TypeError, AttributeError) as error:
            raise StoreError(file, f"is not a saved {cls.__name__}: {error}") from error

    def _repr_html_(self) -> str:
        """Return summary and table for display in notebooks."""
        table = self.to_dataframe()
        lines = "".join(f"<p>{escape(line)}</p>" for line in self.summary().splitlines())
        more = f"<p>{len(table)} rows, the first {_MAX_HTML_ROWS} shown.</p>" if len(table) > _MAX_HTML_ROWS else ""
        return (
            f"{lines}{table.head(_MAX_HTML_ROWS).to_html(index=False, na_rep='', float_format='{:.4g}'.format)}{more}"
        )


def refuse_unknown(**choices: tuple[Any, Iterable[Any]]) -> None:
    """Raise an `ArgumentError` that lists every argument, given with its choices, that is none of them.

    >>> refuse_unknown(region=("moon", ["all", "interior"]))
    Traceback (most recent call last):
    scenetruth.errors.ArgumentError: 1 problem with the arguments:
      - region: must be one of all, interior (got 'moon')
    """
    listed = {name: (given, list(known)) for name, (given, known) in choices.items()}
    problems = [
        Problem(name, f"must be one of {', '.join(map(str, known)) or 'none'}", given)
        for name, (given, known) in listed.items()
        if given not in known
    ]
    if problems:
        raise ArgumentError(problems)


def to_plain_data(value: Any) -> Any:
    """Return JSON-compatible plain values.

    >>> to_plain_data({"low": math.nan, "high": math.inf, "seeds": (1, 2)})
    {'low': None, 'high': 'inf', 'seeds': [1, 2]}
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {one.name: to_plain_data(getattr(value, one.name)) for one in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): to_plain_data(one) for key, one in value.items()}
    if isinstance(value, frozenset | set):
        return sorted(to_plain_data(one) for one in value)
    if isinstance(value, list | tuple):
        return [to_plain_data(one) for one in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "inf" if value > 0 else "-inf"
    return value


def from_plain_data(kind: Any, plain: Any) -> Any:
    """Return the value of an annotated type from plain values."""
    if kind is float:
        return math.nan if plain is None else float(plain)
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        given = {one.name: plain[one.name] for one in fields(kind)}
        return kind(**{name: from_plain_data(hints[name], one) for name, one in given.items()})  # type: ignore[operator]
    origin, inner = get_origin(kind), get_args(kind)
    if origin is tuple:
        kinds = inner[:1] * len(plain) if inner[1:] == (...,) else inner
        return tuple(from_plain_data(each, one) for each, one in zip(kinds, plain, strict=True))
    if origin is Sequence:
        return tuple(from_plain_data(inner[0], one) for one in plain)
    if origin is frozenset:
        return frozenset(from_plain_data(inner[0], one) for one in plain)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {key: from_plain_data(inner[1], one) for key, one in plain.items()}
    if origin in (Union, types.UnionType):
        if plain is None:
            return None
        return from_plain_data(next(each for each in inner if each is not types.NoneType), plain)
    if kind is Path:
        return Path(plain)
    if kind in (int, str, bool) and not isinstance(plain, kind):
        message = f"{plain!r} is not of type {kind.__name__}"
        raise TypeError(message)
    if origin is Literal and plain not in inner:
        message = f"{plain!r} is none of {inner}"
        raise ValueError(message)
    return plain
