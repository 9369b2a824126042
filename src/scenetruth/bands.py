"""Bands of a camera: names, values by band, and models restricted to one band."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TypeVar

from pydantic import AfterValidator, BaseModel, Discriminator, Field, Tag

from scenetruth.validated_model import NonNegative

__all__ = [
    "COLOURS", "BandFraction", "BandName", "BandNonNegative", "ByBand", "as_number", "find_by_band", "in_band",
    "mapping_by_band",
]  # fmt: skip

COLOURS = ("red", "green", "blue")
"""Bands of colour pictures."""

BandName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]
"""Name of a band: lower-case letters, digits and underscores, such as ``red`` or ``nir_850``."""

T = TypeVar("T")
M = TypeVar("M", bound=BaseModel)


class ByBand(dict[str, T]):
    """Immutable values by band, which hash by value.

    >>> ByBand(red=0.2, green=0.6) == {"green": 0.6, "red": 0.2}
    True
    """

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (dict(self),)

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        msg = "values by band cannot be changed"
        raise TypeError(msg)

    __setitem__ = __delitem__ = update = setdefault = pop = popitem = clear = __ior__ = _refuse


def mapping_by_band(value: Any) -> Any:
    """Return the type of a field with one value for each band."""
    return Annotated[dict[BandName, value], Field(min_length=1), AfterValidator(ByBand)]


_ONE, _SEVERAL = "a value for all bands", "values by band"


def _form(value: object) -> str:
    return _SEVERAL if isinstance(value, Mapping) else _ONE


def _per_band(value: Any) -> Any:
    """Return the type of a field with a value for all bands, or one for each."""
    parts: Any = Annotated[value, Tag(_ONE)] | Annotated[mapping_by_band(value), Tag(_SEVERAL)]
    return Annotated[parts, Discriminator(_form)]


if TYPE_CHECKING:
    BandNonNegative = float | ByBand[float]
    BandFraction = float | ByBand[float]
else:
    BandNonNegative = _per_band(NonNegative)
    BandFraction = _per_band(Annotated[float, Field(ge=0, le=1)])


def as_number(value: float | ByBand[float]) -> float:
    """Return a value that is the same in all bands, as in models that are restricted to one (`in_band`)."""
    if isinstance(value, ByBand):
        msg = f"differs between bands ({', '.join(value)}): restrict the model to one band"
        raise TypeError(msg)
    return value


def in_band(model: M, band: str) -> M:
    """Return a model with the values of one band.

    Models may define a method ``in_band``, which takes precedence.
    """
    changes = {}
    for name in type(model).model_fields:
        value = getattr(model, name)
        found = _value_in(value, band)
        if found is not value:
            changes[name] = found
    return model.model_copy(update=changes) if changes else model


def _value_in(value: Any, band: str) -> Any:
    if isinstance(value, ByBand):
        return _value_in(value[band], band)
    if isinstance(value, BaseModel):
        own = getattr(value, "in_band", None)
        return in_band(value, band) if own is None else own(band)
    if isinstance(value, tuple):
        found = tuple(_value_in(each, band) for each in value)
        return value if all(one is other for one, other in zip(found, value, strict=True)) else found
    return value


def find_by_band(value: Any, where: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], ByBand[Any]]]:
    """Yield all values by band in a model, with their paths."""
    if isinstance(value, BaseModel):
        for name in type(value).model_fields:
            yield from find_by_band(getattr(value, name), (*where, name))
    elif isinstance(value, ByBand):
        yield where, value
        for band, item in value.items():
            yield from find_by_band(item, (*where, band))
    elif isinstance(value, tuple):
        for index, item in enumerate(value):
            yield from find_by_band(item, (*where, index))
