"""Sampling: the sampling plan, and the draw of each sample from its number alone."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.dataset.distributions import (
    DerivedDistribution,
    Distribution,
    IndexedDistribution,
    RandomDistribution,
    SamplingPlan,
)
from scenetruth.dataset.recipe_model import RecipeModel
from scenetruth.errors import Problem, RecipeError, SceneError
from scenetruth.random_streams import generator_for
from scenetruth.scene import Scene
from scenetruth.scene.field_paths import PathError, assign, expand, order_paths

__all__ = ["HELD_OUT", "Draw", "Sampler", "UniformDraws", "VariedField", "build_drawn_scene"]


# SciPy cannot advance a longer sequence.
_BITS = 32
# Number of points of the Sobol sequence that are computed and cached together.
_BLOCK = 4096


class UniformDraws:
    """Uniform numbers in (0, 1) for the random values of a recipe.

    Each number depends only on the seed, the key of the value, the sample and the draw. A sampling plan makes the
    first draws of all samples space-filling; a repeated draw stays in the stratum of a Latin hypercube, but is
    independent for the Sobol sequence.

    ``samples``: Number of strata of a Latin hypercube. ``fields``: The random values by key, in the order of the
    dimensions of the Sobol sequence.
    """

    def __init__(self, seed: int, samples: int, fields: Mapping[str, RandomDistribution]) -> None:
        self._seed, self._samples = seed, samples
        self._sobol: dict[str, int] = {}
        dimensions = 0
        for key, value in fields.items():
            if value.sampling == "sobol":
                self._sobol[key] = dimensions
                dimensions += value.uniforms

    def of(self, key: str, field: RandomDistribution, sample: int, attempt: int) -> list[float]:
        """Return the uniform numbers of one value of one draw, each above 0 and below 1."""
        own = generator_for(self._seed, "value", sample, attempt, key).random(field.uniforms)
        plan: SamplingPlan = field.sampling
        if plan == "sobol" and attempt == 0:
            return [self._shifted(key, number, sample) for number in range(field.uniforms)]
        if plan == "latin_hypercube":
            strata = [_strata(self._seed, key, number, self._samples)[sample] for number in range(field.uniforms)]
            return _open([(stratum + u) / self._samples for stratum, u in zip(strata, own.tolist(), strict=True)])
        return _open(own.tolist())

    def _shifted(self, key: str, number: int, sample: int) -> float:
        """Return a point of the Sobol sequence with a random digital shift, which preserves its uniformity."""
        block, place = divmod(sample, _BLOCK)
        point = int(_sobol_block(self._sobol[key] + number, block)[place] * 2**_BITS)
        shift = int(generator_for(self._seed, "sobol", key, number).integers(2**_BITS))
        return ((point ^ shift) + 0.5) / float(1 << _BITS)


def _open(numbers: Sequence[float]) -> list[float]:
    """Clip numbers to the open interval, because some distributions are infinite at the limits."""
    return [min(max(number, 2.0**-60), 1 - 2.0**-53) for number in numbers]


@lru_cache(maxsize=256)
def _sobol_block(dimension: int, block: int) -> NDArray[np.float64]:
    """Return a block of points along one dimension of the Sobol sequence; it depends on no other dimension."""
    from scipy.stats import qmc

    engine = qmc.Sobol(dimension + 1, scramble=False, bits=_BITS)
    if block:
        engine.fast_forward(block * _BLOCK)
    found: NDArray[np.float64] = engine.random(_BLOCK)[:, dimension]
    return found


@lru_cache(maxsize=64)
def _strata(seed: int, key: str, number: int, samples: int) -> NDArray[np.int64]:
    return generator_for(seed, "latin_hypercube", key, number).permutation(samples)


def divide_exactly(count: int, weights: Sequence[float]) -> list[int]:
    """Return whole numbers in proportion to weights that sum to a count, by the largest remainder.

    >>> divide_exactly(10, [7, 1, 2])
    [7, 1, 2]
    >>> divide_exactly(11, [8, 2])
    [9, 2]
    """
    shares = [count * weight / math.fsum(weights) for weight in weights]
    found = [math.floor(share + 1e-9) for share in shares]
    order = sorted(range(len(shares)), key=lambda n: found[n] - shares[n])
    for n in order[: count - sum(found)]:
        found[n] += 1
    return found


HELD_OUT = "held_out"
"""Name of the split of held-out values."""


@dataclass(frozen=True)
class VariedField:
    """A varied value with the paths of its fields (``places``) and its location in the recipe (``where``).

    ``key``: Its path, or its name if it is assigned to no field. ``name``: Its name in formulas; empty if it has none.
    """

    key: str
    distribution: Distribution
    places: tuple[str, ...]
    name: str
    where: str


@dataclass(frozen=True)
class Draw:
    """Draw of sample ``number``, from 0: all values by key, and the scene as plain values.

    ``draw``: Number of the draw; all steps of a paired series share it. ``step``: 0 for the sample as drawn, then the
    steps of the paired series. ``factor``: Factor changed by the step; empty for step 0. ``base``: Index of the base
    scene. ``attempts``: Number of draws until acceptance. ``split``: Its split; empty if there are none. ``folder``:
    Directory of relative file names in ``plain``.
    """

    number: int
    draw: int
    step: int
    factor: str
    base: int
    values: Mapping[str, Any]
    attempts: int
    rejected: tuple[str, ...]
    split: str
    plain: Mapping[str, Any] = field(repr=False)
    folder: str | None = field(default=None, repr=False, compare=False)

    def scene(self) -> Scene:
        """Return the scene."""
        return build_drawn_scene(self.plain, self.folder)


def build_drawn_scene(plain: Mapping[str, Any], folder: str | None) -> Scene:
    """Return the scene of drawn values, whose relative file names refer to the directory of the recipe."""
    return Scene.from_dict(plain, folder=None if folder is None else Path(folder))


@dataclass(frozen=True)
class Unexamined:
    """Parts of an invalid recipe whose problems are reported already.

    ``keys``: Paths and names of values. ``parts``: Parts of each base scene (``camera``, ``objects.0``), or fields.
    ``numbers``: Number of each base scene in the recipe.
    """

    keys: frozenset[str]
    parts: tuple[frozenset[str], ...]
    numbers: tuple[int, ...]

    def has(self, number: int, path: str) -> bool:
        """Return whether a path leads into one of the parts of a base scene, or to all of it."""
        return any(
            f"{path}.".startswith(f"{part}.") or f"{part}.".startswith(f"{path}.") for part in self.parts[number]
        )


class Sampler:
    """Draws the samples of a recipe independently of each other; the shared changes are applied to ``bases``.

    ``unexamined``: Parts of an invalid recipe; the sampler then lists its ``problems`` instead of raising them.
    """

    def __init__(self, recipe: RecipeModel, bases: Sequence[Scene], unexamined: Unexamined | None = None) -> None:
        self.recipe, self.bases = recipe, tuple(bases)
        self.unexamined = unexamined
        self._plain = [base.to_dict() for base in self.bases]
        self._misplaced: set[str] = set()
        problems: list[Problem] = []
        self.varied = tuple(self._varied(problems))
        self.ladders = tuple(self._ladders(problems))
        self._refuse_unknown_hold_outs(problems)
        self._order = self._sorted(problems)
        self.problems = tuple(problems)
        if problems and unexamined is None:
            raise RecipeError(problems)
        random = {
            item.key: item.distribution for item in self.varied if isinstance(item.distribution, RandomDistribution)
        }
        self._uniforms = UniformDraws(recipe.seed, recipe.samples, random)
        self._by_key = {item.key: item for item in self.varied}
        self.known: dict[int, tuple[str, ...]] = {}
        """Why the attempts before the accepted attempt were rejected, of draws that need no acceptance test."""

    def __len__(self) -> int:
        return self.recipe.count

    def draw(self, number: int) -> Draw:
        """Return the draw of a sample; it depends on the number alone."""
        if not 0 <= number < len(self):
            msg = f"there is no sample {number}: they are numbered 0 to {len(self) - 1}"
            raise IndexError(msg)
        draw, step = divmod(number, self.recipe.steps)
        accepted = self._accepted(draw)
        return accepted if step == 0 else self._stepped(accepted, step)

    def attempt(self, draw: int, attempt: int) -> Draw:
        """Return one draw of a sample before the acceptance test."""
        base = self._draw_base(draw, attempt)
        values: dict[str, Any] = {}
        named: dict[str, Any] = {}
        for item in self._order:
            value = self._compute_value(item, draw, attempt, named)
            values[item.key] = value
            named |= {item.key: value, **({item.name: value} if item.name else {})}
        values = {item.key: values[item.key] for item in self.varied}
        plain = self._scene_with(base, values)
        if self.recipe.scene_seed == "per_sample" and "seed" not in values:
            plain["seed"] = int(generator_for(self.recipe.seed, "scene", draw, attempt).integers(2**63))
        number = draw * self.recipe.steps
        split, folder = self._draw_split(draw, named), self.recipe.folder
        return Draw(number, draw, 0, "", base, values, attempt + 1, (), split, plain, folder)

    def middle(self, base: int) -> dict[str, Any]:
        """Return a scene as plain values, with every varied field at the centre of its distribution."""
        named: dict[str, Any] = {}
        for item in self._order:
            if not self.is_examined(item, named):
                continue
            named[item.key] = value = self._get_middle_value(item, named)
            if item.name:
                named[item.name] = value
        return self._scene_with(base, named)

    def is_examined(self, item: VariedField, named: Mapping[str, Any]) -> bool:
        """Return whether a value of an invalid recipe, and all that it depends on, has no problem."""
        if self.unexamined is None:
            return True
        has_all = not isinstance(item.distribution, DerivedDistribution) or item.distribution.needs() <= named.keys()
        return has_all and item.where not in self._misplaced and item.key not in self.unexamined.keys

    def place_of(self, number: int) -> str:
        """Return the end of a message with the number of a base scene; empty if there is one only."""
        number = number if self.unexamined is None else self.unexamined.numbers[number]
        return f" (in base {number})" if len(self.recipe.base) > 1 else ""

    @cached_property
    def _last_accepted(self) -> dict[int, Draw]:
        return {}

    def _accepted(self, draw: int) -> Draw:
        found = self._last_accepted.get(draw)
        if found is None:
            found = self._search(draw)
            # The steps of a paired series are requested consecutively.
            self._last_accepted.clear()
            self._last_accepted[draw] = found
        return found

    def _search(self, draw: int) -> Draw:
        if draw in self.known:
            return replace(self.attempt(draw, len(self.known[draw])), rejected=self.known[draw])
        rejected: list[str] = []
        for attempt in range(self.recipe.max_draws):
            found = self.attempt(draw, attempt)
            reason = self.refusal(found) if self.recipe.acceptance else ""
            if not reason:
                return replace(found, rejected=tuple(rejected))
            rejected.append(reason)
        raise RecipeError([self._impossible(draw, rejected)])

    def _impossible(self, draw: int, rejected: Sequence[str]) -> Problem:
        reasons = {reason: rejected.count(reason) for reason in rejected}
        text = "; ".join(f"{reason}: {count}" for reason, count in sorted(reasons.items(), key=lambda one: -one[1])[:5])
        message = f"sample {draw}: none of {len(rejected)} draws was accepted ({text}); relax criteria or distributions"
        return Problem("acceptance", message)

    def refusal(self, found: Draw) -> str:
        """Return why the geometry of a draw is rejected; empty if it is accepted."""
        from scenetruth.dataset.acceptance import GeometryPreview

        try:
            look = GeometryPreview(found.scene())
            for bound in self.recipe.acceptance:
                if reason := bound.refusal(look):
                    return reason
        except SceneError as error:
            first = error.problems[0]
            return f"cannot be made: {first.path}: {first.message}"
        return ""

    def _stepped(self, accepted: Draw, step: int) -> Draw:
        factor, places, value = self.ladders[step - 1]
        plain = copy.deepcopy(dict(accepted.plain))
        for place in places:
            self._put(plain, place, value)
        values = {**accepted.values, factor: value}
        number = accepted.number + step
        return replace(accepted, number=number, step=step, factor=factor, values=values, plain=plain)

    def _put(self, plain: dict[str, Any], place: str, value: Any) -> None:
        try:
            assign(plain, place, copy.deepcopy(value))
        except PathError as error:
            raise SceneError([Problem(place, str(error), value)]) from error

    def _scene_with(self, base: int, values: Mapping[str, Any]) -> dict[str, Any]:
        plain = copy.deepcopy(self._plain[base])
        drawn = {
            place: values[item.key]
            for item in self.varied
            for place in (item.places if item.key in values else ())
            if self.unexamined is None or not self.unexamined.has(base, place)
        }
        for place in order_paths(drawn):
            self._put(plain, place, drawn[place])
        return plain

    def _draw_base(self, draw: int, attempt: int) -> int:
        weights = [base.weight for base in self.recipe.base]
        at = generator_for(self.recipe.seed, "base", draw, attempt).random() * math.fsum(weights)
        for place, weight in enumerate(weights):
            at -= weight
            if at < 0:
                return place
        return len(weights) - 1

    def _compute_value(self, item: VariedField, draw: int, attempt: int, named: Mapping[str, Any]) -> Any:
        distribution = item.distribution
        if isinstance(distribution, RandomDistribution):
            return distribution.value(self._uniforms.of(item.key, distribution, draw, attempt))
        if isinstance(distribution, IndexedDistribution):
            return distribution.value(self._compute_value_index(item, draw) % len(distribution))
        assert isinstance(distribution, DerivedDistribution)
        try:
            return distribution.value(named)
        except ValueError as error:
            raise SceneError([Problem(item.where, str(error))]) from error

    def _get_middle_value(self, item: VariedField, named: Mapping[str, Any]) -> Any:
        distribution = item.distribution
        if isinstance(distribution, RandomDistribution):
            return distribution.middle
        return self._compute_value(item, 0, 0, named)

    def _compute_value_index(self, item: VariedField, draw: int) -> int:
        own = item.distribution
        assert isinstance(own, IndexedDistribution)
        if not own.period:
            return draw
        for other in self.varied:
            if other is item:
                return draw
            if isinstance(other.distribution, IndexedDistribution) and other.distribution.period:
                draw //= len(other.distribution)
        return draw

    def _draw_split(self, draw: int, named: Mapping[str, Any]) -> str:
        recipe = self.recipe
        for key, wanted in recipe.hold_out.items():
            if any(named[one] == value for one in self._held[key] for value in wanted):
                return HELD_OUT
        if not recipe.splits:
            return ""
        return self._splits[draw]

    @cached_property
    def _splits(self) -> list[str]:
        """Split of every draw: exact counts in random order."""
        recipe = self.recipe
        counts = divide_exactly(recipe.samples, list(recipe.splits.values()))
        names = np.repeat(list(recipe.splits), counts)
        return [str(name) for name in names[generator_for(recipe.seed, "split").permutation(recipe.samples)]]

    def _varied(self, problems: list[Problem]) -> Iterator[VariedField]:
        for name, distribution in self.recipe.parameters.items():
            yield VariedField(name, distribution, (), name, f"parameters.{name}")
        for path, distribution in self.recipe.distributions.items():
            where = f"distributions.{path}"
            places = self._places(path, where, problems)
            name = distribution.name or ""
            if not places or distribution.together or places == [path]:
                yield VariedField(path, distribution, tuple(places), name, where)
                continue
            if name:
                message = f"'{path}' matches {len(places)} fields with separate values; add together: true, or no name"
                problems.append(Problem(f"{where}.name", message, name))
            yield from (VariedField(place, distribution, (place,), "", where) for place in places)

    def _ladders(self, problems: list[Problem]) -> Iterator[tuple[str, tuple[str, ...], Any]]:
        for path, values in self.recipe.paired_factors.items():
            where = f"paired_factors.{path}"
            places = tuple(self._places(path, where, problems))
            for value in values if where not in self._misplaced else ():
                yield path, places, value

    def _places(self, path: str, where: str, problems: list[Problem]) -> list[str]:
        found: dict[str, None] = {}
        for number, plain in enumerate(self._plain):
            try:
                found |= dict.fromkeys(expand(plain, path))
            except PathError as error:
                self._misplaced.add(where)
                if self.unexamined is None or not self.unexamined.has(number, path):
                    problems.append(Problem(where, f"{error}{self.place_of(number)}"))
        return list(found)

    def _refuse_unknown_hold_outs(self, problems: list[Problem]) -> None:
        keys = [item.key for item in self.varied]
        names = {item.name: item.key for item in self.varied if item.name}
        self._held: dict[str, tuple[str, ...]] = {}
        for key in self.recipe.hold_out:
            matching = [one for one in keys if one == names.get(key, key) or _matches(one, key)]
            self._held[key] = tuple(matching)
            hidden = self.unexamined is not None and (key in self.unexamined.keys or "*" in key)
            if not matching and not hidden:
                message = f"is neither the path nor the name of a varied value; varied values: {', '.join(keys)}"
                problems.append(Problem(f"hold_out.{key}", message))

    def _sorted(self, problems: list[Problem]) -> list[VariedField]:
        hidden = frozenset() if self.unexamined is None else self.unexamined.keys
        known = {item.key for item in self.varied} | {item.name for item in self.varied if item.name}
        left, done, order = list(self.varied), set[str](), list[VariedField]()
        undefined = set[str]()
        for item in left:
            if isinstance(item.distribution, DerivedDistribution):
                unknown = sorted(item.distribution.needs() - known - hidden)
                undefined |= {*unknown, *(item.distribution.needs() & (hidden - known))}
                if unknown:
                    message = f"uses undefined values: {', '.join(unknown)}; defined values: "
                    message += ", ".join(sorted({one.name for one in self.varied if one.name})) or "none"
                    problems.append(Problem(item.where, message))
        done |= undefined
        while left:
            ready = [
                item
                for item in left
                if not isinstance(item.distribution, DerivedDistribution) or item.distribution.needs() <= done
            ]
            if not ready:
                circle = ", ".join(item.key for item in left)
                problems.append(Problem(left[0].where, f"these values depend on each other: {circle}"))
                return []
            order += ready
            done |= {item.key for item in ready} | {item.name for item in ready if item.name}
            left = [item for item in left if item not in ready]
        return order


def _matches(path: str, pattern: str) -> bool:
    one, other = path.split("."), pattern.split(".")
    return len(one) == len(other) and all(b in ("*", a) for a, b in zip(one, other, strict=True))
