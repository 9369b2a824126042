"""Text of pages: labels of fields, descriptions of distributions and rejections, HTML and Markdown."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from scenetruth.dataset.acceptance import AcceptanceCriterion
from scenetruth.dataset.distributions import Distribution, FormulaDistribution, RandomDistribution
from scenetruth.dataset.sampler import HELD_OUT, Sampler
from scenetruth.errors import visible
from scenetruth.glossary import define_terms
from scenetruth.html import template_environment
from scenetruth.number_format import format_count, format_number
from scenetruth.scene.field_paths import PathError, value_at

if TYPE_CHECKING:
    from jinja2 import Environment

    from scenetruth.scene.scene_models import Scene

__all__ = [
    "RawMarkdown", "describe_criterion", "describe_distribution", "describe_scene", "describe_splits",
    "describe_value", "escape_markdown", "format_code", "format_label", "format_size", "format_title",
    "render_html", "render_markdown", "split_unit", "tabulate_distributions", "tabulate_paired_factors",
    "tabulate_rejections",
]  # fmt: skip


_UNITS = {
    "_mm_per_frame2": "mm per frame²",
    "_mm_per_frame": "mm per frame",
    "_px_per_frame": "px per frame",
    "_deg_per_frame": "° per frame",
    "_rate_per_hour": "1 per hour",
    "_per_hour": "1 per hour",
    "_per_frame": "per frame",
    "_per_mm2": "1 per mm²",
    "_per_mm": "1 per mm",
    "_per_px": "1 per px",
    "_frames": "frames",
    "_share": "share",
    "_mm": "mm",
    "_um": "µm",
    "_nm": "nm",
    "_px": "px",
    "_deg": "°",
    "_ms": "ms",
    "_us": "µs",
    "_s": "s",
}
"""Suffixes of names that specify a unit, longest first."""
_AXES = ("X", "Y", "Z")
_OMITTED = ("lighting",)
"""Sections of a scene that are omitted in labels."""
_ENDS = ("shortest", "longest")
"""Entries of a range of wavelengths."""
_UNIT_VECTORS = ([1, 0, 0], [0, 1, 0], [0, 0, 1])


def split_unit(name: str) -> tuple[str, str]:
    """Return a name in words, and the unit of its suffix; empty for none.

    >>> split_unit("focal_length_px"), split_unit("rate_per_hour"), split_unit("seen_share"), split_unit("seed")
    (('focal length', 'px'), ('rate', '1 per hour'), ('seen share', ''), ('seed', ''))
    """
    for end, unit in _UNITS.items():
        if name.endswith(end) and len(name) > len(end):
            kept = name.removesuffix(end) if unit != "share" else name
            kept += "_rate" if end == "_rate_per_hour" else ""
            return re.sub(r"\brms\b", "RMS", kept.replace("_", " ")), "" if unit == "share" else unit
    if name == "rate_per_hour":
        return "rate", "1 per hour"
    return re.sub(r"\brms\b", "RMS", name.replace("_", " ")), ""


def format_label(path: str, plain: Mapping[str, Any]) -> tuple[str, str]:
    """Return the label of a field, and its unit.

    >>> scene = {"objects": [{"name": "cube", "pose": {"position_mm": [0, 0, 600]}, "motion": [{"kind": "velocity"}]}]}
    >>> paths = "objects.0.pose.position_mm.2", "objects.0.motion.0.velocity_mm_per_frame"
    >>> tuple(format_label(path, scene) for path in paths)
    (('cube: pose position Z', 'mm'), ('cube: motion velocity', 'mm per frame'))
    """
    words: list[str] = []
    unit, above = "", list[str]()
    for key in path.split("."):
        if re.fullmatch(r"[0-9]+", key) and above:
            words = _with_index(words, int(key), _at(plain, above))
        else:
            entries, own = split_unit(key)
            unit = f"{unit} {own}" if unit and own.startswith("per ") else own
            # The word of a section is not repeated.
            words += [] if key in _OMITTED or (words and entries == words[-1]) else [entries]
        above.append(key)
    return " ".join(words), unit


def format_title(title: str, unit: str) -> str:
    """Return a title with its unit, if any, in brackets."""
    return f"{title} [{unit}]" if unit else title


def _with_index(words: list[str], index: int, around: Any) -> list[str]:
    """Append the label of a list entry: its name, type, axis, or index."""
    if isinstance(around, Sequence) and not isinstance(around, str) and index < len(around):
        entry = around[index]
        if isinstance(entry, Mapping) and isinstance(entry.get("name"), str):
            return [*words[:-1], f"{entry['name']}:"]
        if isinstance(entry, Mapping) and isinstance(entry.get("kind"), str):
            return [*words, entry["kind"].replace("_", " ")]
        if isinstance(entry, Mapping) and entry.get("axis") in _UNIT_VECTORS:
            return [*words, f"about {_AXES[_UNIT_VECTORS.index(entry['axis'])]}"]
        if len(around) == len(_AXES) and all(isinstance(one, int | float) for one in around):
            return [*words, _AXES[index]]
    if words and words[-1].endswith("wavelength") and index < len(_ENDS):
        return [*words[:-1], f"{_ENDS[index]} {words[-1]}"]
    return [*words, f"({index})"]


def _at(plain: Mapping[str, Any], keys: Sequence[str]) -> Any:
    try:
        return value_at(plain, ".".join(keys))
    except PathError:
        return None


_LONGEST = 300
_DESCRIBED_SEPARATELY = ("kind", "name", "together", "sampling")


def tabulate_distributions(sampler: Sampler) -> list[tuple[str, str, str]]:
    """Return the varied fields: label, path or name, and description of the distribution."""
    plain = sampler.bases[0].to_dict()
    return [
        (
            format_title(*format_label(item.key, plain)) + (f", in formulas: {item.name}" if item.name else ""),
            item.key,
            describe_distribution(item.distribution),
        )
        for item in sampler.varied
    ]


def describe_scene(scene: Scene) -> str:
    """Return a base scene in words."""
    camera, names = scene.camera, [item.name for item in scene.objects] + [plant.name for plant in scene.plants]
    size = f"{camera.width} x {camera.height} px, {scene.stage.positions} positions x {scene.frames.count} frames"
    return f"{scene.description.rstrip('.') or 'Scene'}: {size}; objects: {', '.join(names) or 'none'}"


def describe_distribution(distribution: Distribution) -> str:
    """Return the description of a distribution.

    >>> from scenetruth.dataset.distributions import UniformDistribution
    >>> describe_distribution(UniformDistribution(low=2, high=4, sampling="sobol"))
    'uniform from 2 to 4 (Sobol sequence)'
    >>> from scenetruth.dataset.distributions import ChoiceDistribution
    >>> describe_distribution(ChoiceDistribution(values=[5, 7, 9], weights=[2, 2, 1]))
    'one of 5 (40 %), 7 (40 %), 9 (20 %)'
    >>> from scenetruth.dataset.distributions import ConeDistribution
    >>> describe_distribution(ConeDistribution(axis=[0, 0, 1], half_angle_deg=50))
    'cone: axis [0, 0, 1], half angle 50°'
    """
    entries = distribution.model_dump(mode="json", exclude_defaults=True)
    if isinstance(distribution, FormulaDistribution):
        return _cut(f"= {distribution.formula}" + (", rounded" if distribution.integer else ""))
    kind = str(getattr(distribution, "kind", "")).replace("_", " ")
    words = _in_words(kind, entries)
    if not words:
        values = ", ".join(
            f"{title} {_value(entries[name])}{unit if unit == '°' else f' {unit}' if unit else ''}"
            for name in entries
            if name not in _DESCRIBED_SEPARATELY
            for title, unit in [split_unit(name)]
        )
        words = f"{kind}: {values}" if values else kind
    if isinstance(distribution, RandomDistribution) and distribution.sampling != "independent":
        words += f" ({_SAMPLING.get(distribution.sampling, distribution.sampling.replace('_', ' '))})"
    return _cut(words)


_SAMPLING = {"sobol": "Sobol sequence", "latin_hypercube": "Latin hypercube"}
_RANGES = {"uniform": "uniform", "log uniform": "log-uniform", "integers": "integers"}


def _in_words(kind: str, entries: Mapping[str, Any]) -> str:
    """Return the common distributions in words; empty for others."""
    others = {*entries} - {*_DESCRIBED_SEPARATELY}
    if kind in _RANGES and others == {"low", "high"}:
        return f"{_RANGES[kind]} from {_value(entries['low'])} to {_value(entries['high'])}"
    if kind == "normal" and others <= {"mean", "std", "low", "high"} and {"mean", "std"} <= others:
        ends = [f"from {_value(entries['low'])}"] if "low" in others else []
        ends += [f"to {_value(entries['high'])}"] if "high" in others else []
        return f"normal with mean {_value(entries['mean'])} and standard deviation {_value(entries['std'])}" + (
            f", cut {' '.join(ends)}" if ends else ""
        )
    if kind == "choice" and others <= {"values", "weights"}:
        weights = entries.get("weights") or []
        shares = [f" ({format_number(100 * one / sum(weights), 2)} %)" for one in weights] or [""] * len(
            entries["values"]
        )
        return "one of " + ", ".join(map("".join, zip(_name_each(entries["values"]), shares, strict=True)))
    return "random rotation, uniform over all orientations" if kind == "rotation" and not others else ""


def _name_each(values: Sequence[Any]) -> list[str]:
    """Return values in words; models of different types by their type alone."""
    kinds = [value.get("kind") for value in values if isinstance(value, Mapping)]
    if len(kinds) == len(values) and None not in kinds and len(set(kinds)) == len(kinds):
        return [str(kind).replace("_", " ") for kind in kinds]
    return [describe_value(value) for value in values]


def describe_value(value: Any) -> str:
    """Return a value in words: a model by its type and fields.

    >>> describe_value({"kind": "ring", "radius_mm": 70, "direction": [0, 0, 1]}), describe_value(0.5)
    ('ring (radius 70 mm, direction [0, 0, 1])', '0.5')
    """
    if not isinstance(value, Mapping):
        return _value(value)
    named = [(*split_unit(str(key)), entry) for key, entry in value.items() if key != "kind"]
    rest = ", ".join(f"{name} {_value(entry)} {unit}".rstrip() for name, unit, entry in named)
    kind = str(value.get("kind", "")).replace("_", " ")
    return f"{kind} ({rest})" if kind and rest else kind or rest


def describe_criterion(bound: AcceptanceCriterion) -> str:
    """Return the description of an acceptance criterion.

    >>> from scenetruth.dataset.acceptance import VisibleFractionCriterion
    >>> describe_criterion(VisibleFractionCriterion(object="leaf-*", min=0.2))
    'visible share of leaf-*: at least 0.2'
    """
    kind = str(getattr(bound, "kind", "")).replace("_", " ")
    entries = bound.model_dump(mode="json", exclude_none=True)
    of = f" of {entries['object']}" if entries.get("object", "*") != "*" else ""
    ends = [
        f"{word} {value:g}{bound.unit}"
        for word, value in (("at least", bound.min), ("at most", bound.max))
        if value is not None
    ]
    others = [
        f"{name.replace('_', ' ')} {_value(value)}"
        for name, value in entries.items()
        if name not in ("kind", "object", "min", "max")
    ]
    return f"{kind}{of}: {', '.join([*ends, *others])}"


def tabulate_paired_factors(sampler: Sampler) -> list[tuple[str, str, str]]:
    """Return the paired factors: label, path, and values of the steps."""
    plain = sampler.bases[0].to_dict()
    return [
        (format_title(*format_label(path, plain)), path, ", ".join(map(_value, values)))
        for path, values in sampler.recipe.paired_factors.items()
    ]


def describe_splits(sampler: Sampler) -> dict[str, str]:
    """Return descriptions of the splits by name: share, or held-out values."""
    recipe = sampler.recipe
    total = sum(recipe.splits.values())
    words = {
        name: f"each sample that is not held out, with a probability of {format_number(100 * share / total, 2)} %"
        for name, share in recipe.splits.items()
    }
    if recipe.hold_out:
        held = "; ".join(f"{key}: {', '.join(map(_value, values))}" for key, values in recipe.hold_out.items())
        words[HELD_OUT] = f"all samples with {held}"
    if not recipe.hold_out:
        words = {name: entries.replace(" that is not held out", "") for name, entries in words.items()}
    return words


def _cut(words: str) -> str:
    return words if len(words) <= _LONGEST else f"{words[: _LONGEST - 1]}…"


def _value(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "none"}[value]
    if isinstance(value, int | float):
        return f"{value:.10g}".replace("-", "−", 1) if value < 0 else f"{value:.10g}"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_value(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    return str(value)


_MAX_LISTED = 20
_NUMBER = re.compile(r"(?<![\w.])-?[0-9]+(\.[0-9]+)?(e[-+]?[0-9]+)?(?![\w]|\.\w)")


def tabulate_rejections(reasons: Mapping[str, int]) -> list[tuple[str, int]]:
    """Return the reasons of rejections with counts, the most frequent first.

    >>> counts = {"depth of cube over 9 mm": 4, "cannot be made: at frame 3": 3, "cannot be made: at frame 12": 2}
    >>> tabulate_rejections(counts)
    [('cannot be made: at frame …', 5), ('depth of cube over 9 mm', 4)]
    """
    found = Counter[str]()
    for reason, count in reasons.items():
        unmade = reason.startswith("cannot be made")
        found[_NUMBER.sub("…", reason) if unmade else reason] += count
    return sorted(found.items(), key=lambda one: (-one[1], one[0]))[:_MAX_LISTED]


_SPECIAL = re.compile(r"([\\`*_{}\[\]#!|~$])")
_AT_BEGIN = re.compile(r"^([-+=]|[0-9]+(?=[.)]))")


class RawMarkdown(str):
    """Markdown text that is not escaped."""

    __slots__ = ()


def render_html(template: str, **content: Any) -> str:
    """Return a rendered HTML page."""
    environment = _environment(autoescape=True)
    return define_terms(environment.get_template(template).render(content))


def render_markdown(template: str, **content: Any) -> str:
    """Return a rendered Markdown text."""
    environment = _environment(autoescape=False, finalize=_finalized)
    environment.filters |= {"code": format_code, "verbatim": RawMarkdown}
    return environment.get_template(template).render(content)


def _environment(**options: Any) -> Environment:
    environment = template_environment("scenetruth.dataset.pages", keep_trailing_newline=True, **options)
    environment.filters |= {"number": format_number, "count": format_count, "size": format_size}
    return environment


def escape_markdown(text: str) -> str:
    r"""Return a text on one line with Markdown and HTML escaped.

    >>> print(escape_markdown("*bold* <b>\nnext"))
    \*bold\* &lt;b&gt; next
    >>> print(escape_markdown("1. first"), escape_markdown("- 2"), escape_markdown("1.5 mm"))
    1\. first \- 2 1\.5 mm
    """
    plain = visible(" ".join(text.split()), lines=False)
    plain = plain.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    begun = _AT_BEGIN.match(plain)
    # A number and a dot at the start of a line would form a list.
    head = "" if begun is None else (f"{begun[1]}\\" if begun[1].isdecimal() else f"\\{begun[1]}")
    return head + _SPECIAL.sub(r"\\\1", plain[0 if begun is None else begun.end() :])


def format_code(text: Any) -> RawMarkdown:
    """Return a text as inline code, with any content.

    >>> print(format_code("a`b"))
    ``a`b``
    """
    plain = visible(" ".join(str(text).split()), lines=False).replace("|", "\\|")
    longest = max((len(run) for run in re.findall("`+", plain)), default=0)
    fence = "`" * (longest + 1)
    space = " " if plain.startswith("`") or plain.endswith("`") else ""
    return RawMarkdown(f"{fence}{space}{plain}{space}{fence}") if plain else RawMarkdown("–")


def format_size(count: float) -> str:
    """Return a number of bytes in decimal units.

    >>> format_size(999), format_size(1_234_567)
    ('999 B', '1.23 MB')
    """
    for size, unit in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if count >= size:
            return f"{format_number(count / size)} {unit}"
    return f"{int(count)} B"


def _finalized(value: Any) -> Any:
    return value if isinstance(value, RawMarkdown) or not isinstance(value, str) else escape_markdown(value)
