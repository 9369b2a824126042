"""What a recipe says, in rows of words for tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenetruth.dataset.acceptance.base import Bound
from scenetruth.dataset.distributions.base import Distribution, Random
from scenetruth.dataset.distributions.formula import Formula
from scenetruth.dataset.pages.labels import bracketed, label_of
from scenetruth.dataset.sampler import HELD_OUT, Sampler
from scenetruth.scoring._format import format_number

__all__ = ["bound_words", "distribution_words", "ladder_rows", "split_words", "varied_rows"]

_LONGEST = 300
_TOLD_APART = ("kind", "name", "together", "plan")


def varied_rows(sampler: Sampler) -> list[tuple[str, str, str]]:
    """Return what varies: label, path or name, and the distribution in words."""
    plain = sampler.bases[0].to_plain()
    return [
        (bracketed(*label_of(item.key, plain)), item.key, distribution_words(item.distribution))
        for item in sampler.varied
    ]


def distribution_words(distribution: Distribution) -> str:
    """Return a distribution in words.

    Examples
    --------
    >>> from scenetruth.dataset.distributions.uniform import Uniform
    >>> distribution_words(Uniform(low=2, high=4, plan="sobol"))
    'uniform: low 2, high 4 (sobol)'
    """
    told = distribution.model_dump(mode="json", exclude_defaults=True)
    if isinstance(distribution, Formula):
        return _cut(f"= {distribution.formula}" + (", rounded" if distribution.whole else ""))
    kind = str(getattr(distribution, "kind", "")).replace("_", " ")
    values = ", ".join(f"{name.replace('_', ' ')} {_value(told[name])}" for name in told if name not in _TOLD_APART)
    words = f"{kind}: {values}" if values else kind
    if isinstance(distribution, Random) and distribution.plan != "independent":
        words += f" ({distribution.plan.replace('_', ' ')})"
    return _cut(words)


def bound_words(bound: Bound) -> str:
    """Return a bound of geometry in words.

    Examples
    --------
    >>> from scenetruth.dataset.acceptance.visible_share import VisibleShare
    >>> bound_words(VisibleShare(object="leaf-*", at_least=0.2))
    'visible share of leaf-*: at least 0.2'
    """
    kind = str(getattr(bound, "kind", "")).replace("_", " ")
    told = bound.model_dump(mode="json", exclude_none=True)
    of = f" of {told['object']}" if told.get("object", "*") != "*" else ""
    ends = [
        f"{word} {value:g}{bound.unit}"
        for word, value in (("at least", bound.at_least), ("at most", bound.at_most))
        if value is not None
    ]
    others = [
        f"{name.replace('_', ' ')} {_value(value)}"
        for name, value in told.items()
        if name not in ("kind", "object", "at_least", "at_most")
    ]
    return f"{kind}{of}: {', '.join([*ends, *others])}"


def ladder_rows(sampler: Sampler) -> list[tuple[str, str, str]]:
    """Return ladders: label, path, and the values of their steps."""
    plain = sampler.bases[0].to_plain()
    return [
        (bracketed(*label_of(path, plain)), path, ", ".join(map(_value, values)))
        for path, values in sampler.recipe.paired.items()
    ]


def split_words(sampler: Sampler) -> dict[str, str]:
    """Return what each split is for, by its name: its share, or the values that are held out."""
    recipe = sampler.recipe
    total = sum(recipe.splits.values())
    words = {
        name: f"{format_number(100 * share / total)} % of what is not held out" for name, share in recipe.splits.items()
    }
    if recipe.hold_out:
        held = "; ".join(f"{key}: {', '.join(map(_value, values))}" for key, values in recipe.hold_out.items())
        words[HELD_OUT] = f"all samples with {held}"
    if not recipe.hold_out:
        words = {name: told.replace(" of what is not held out", "") for name, told in words.items()}
    return words


def _cut(words: str) -> str:
    return words if len(words) <= _LONGEST else f"{words[: _LONGEST - 1]}…"


def _value(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "none"}[value]
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_value(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    return str(value)
