"""From a recipe to its samples: what is drawn for each, and the scene that it makes."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from scenetruth.dataset.distributions.base import ByNumber, Derived, Distribution, Random
from scenetruth.dataset.plans import Uniforms
from scenetruth.dataset.recipe.paths import PathError, assign, expand
from scenetruth.dataset.recipe.spec import Recipe
from scenetruth.errors import Problem, RecipeError, SceneError
from scenetruth.randomness import generator_for
from scenetruth.scene import Scene, scene_from_plain

__all__ = ["HELD_OUT", "Draw", "Sampler", "Varied"]

HELD_OUT = "held_out"
"""Split of the samples whose values are held out."""


@dataclass(frozen=True)
class Varied:
    """A value that varies, and where it goes.

    Parameters
    ----------
    key
        Its path, or its name if it goes nowhere.
    distribution
        What it may be.
    places
        Paths of the fields that it goes to.
    name
        What formulas call it; empty if it has no name.
    where
        Where in the recipe it stands.
    """

    key: str
    distribution: Distribution
    places: tuple[str, ...]
    name: str
    where: str


@dataclass(frozen=True)
class Draw:
    """What was drawn for a sample.

    Parameters
    ----------
    number
        Number of the sample in the data set, from 0.
    draw
        Number of the draw that it belongs to; all steps of its ladders belong to the same.
    step
        0 for the sample as it was drawn, then the steps of the ladders.
    factor
        What the step changes; empty for step 0.
    base
        Which of the base scenes.
    values
        All values by key.
    attempts
        How many draws it took.
    rejected
        Why those before were refused.
    split
        Its split; empty if there are none.
    plain
        The scene as plain values.
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

    def scene(self) -> Scene:
        """Return the scene.

        Raises
        ------
        SceneError
            If the values make none.
        """
        return scene_from_plain(self.plain)


class Sampler:
    """Draws the samples of a recipe, each by itself.

    Parameters
    ----------
    recipe
        The recipe.
    bases
        Its base scenes, with the changes that all samples share.

    Raises
    ------
    RecipeError
        If paths lead nowhere, or values need each other in a circle.
    """

    def __init__(self, recipe: Recipe, bases: Sequence[Scene]) -> None:
        self.recipe, self.bases = recipe, tuple(bases)
        self._plain = [base.to_plain() for base in self.bases]
        problems: list[Problem] = []
        self.varied = tuple(self._varied(problems))
        self.ladders = tuple(self._ladders(problems))
        self._refuse_unknown_hold_outs(problems)
        self._order = self._sorted(problems)
        if problems:
            raise RecipeError(problems)
        random = {item.key: item.distribution for item in self.varied if isinstance(item.distribution, Random)}
        self._uniforms = Uniforms(recipe.seed, recipe.samples, random)
        self._by_key = {item.key: item for item in self.varied}

    def __len__(self) -> int:
        """Return how many samples there are."""
        return self.recipe.count

    def draw(self, number: int) -> Draw:
        """Draw a sample, the same for the same number wherever and whenever.

        Parameters
        ----------
        number
            Number of the sample, from 0.

        Raises
        ------
        IndexError
            If there is no such sample.
        RecipeError
            If no draw is accepted.
        """
        if not 0 <= number < len(self):
            msg = f"there is no sample {number}: they are numbered 0 to {len(self) - 1}"
            raise IndexError(msg)
        draw, step = divmod(number, self.recipe.steps)
        accepted = self._accepted(draw)
        return accepted if step == 0 else self._stepped(accepted, step)

    def attempt(self, draw: int, attempt: int) -> Draw:
        """Return one draw of a sample, whether it is accepted or not."""
        base = self._base_of(draw, attempt)
        values: dict[str, Any] = {}
        named: dict[str, Any] = {}
        for item in self._order:
            value = self._value_of(item, draw, attempt, named)
            values[item.key] = value
            named |= {item.key: value, **({item.name: value} if item.name else {})}
        values = {item.key: values[item.key] for item in self.varied}
        plain = self._scene_with(base, values)
        if self.recipe.scene_seed == "per_sample" and "seed" not in values:
            plain["seed"] = int(generator_for(self.recipe.seed, "scene", draw, attempt).integers(2**63))
        number = draw * self.recipe.steps
        return Draw(number, draw, 0, "", base, values, attempt + 1, (), self._split_of(draw, named), plain)

    def middle(self, base: int) -> dict[str, Any]:
        """Return a scene with every varied field at a value in the middle of its range, as plain values."""
        named: dict[str, Any] = {}
        for item in self._order:
            named[item.key] = value = self._middle_of(item, named)
            if item.name:
                named[item.name] = value
        return self._scene_with(base, {item.key: named[item.key] for item in self.varied})

    @cached_property
    def _last_accepted(self) -> dict[int, Draw]:
        return {}

    def _accepted(self, draw: int) -> Draw:
        found = self._last_accepted.get(draw)
        if found is None:
            found = self._search(draw)
            # The steps of a ladder are asked for one after the other.
            self._last_accepted.clear()
            self._last_accepted[draw] = found
        return found

    def _search(self, draw: int) -> Draw:
        rejected: list[str] = []
        for attempt in range(self.recipe.most_draws):
            found = self.attempt(draw, attempt)
            reason = self.refusal(found) if self.recipe.accept else ""
            if not reason:
                return replace(found, rejected=tuple(rejected))
            rejected.append(reason)
        raise RecipeError([self._impossible(draw, rejected)])

    def _impossible(self, draw: int, rejected: Sequence[str]) -> Problem:
        reasons = {reason: rejected.count(reason) for reason in rejected}
        told = "; ".join(f"{reason}: {count}" for reason, count in sorted(reasons.items(), key=lambda one: -one[1])[:5])
        message = (
            f"sample {draw}: none of {len(rejected)} draws was accepted ({told}); widen the bounds, or what varies"
        )
        return Problem("accept", message)

    def refusal(self, found: Draw) -> str:
        """Return why the geometry of a draw is not accepted; an empty text if it is."""
        from scenetruth.dataset.acceptance.look import Look

        try:
            look = Look(found.scene())
            for bound in self.recipe.accept:
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
        for item in self.varied:
            for place in item.places:
                self._put(plain, place, values[item.key])
        return plain

    def _base_of(self, draw: int, attempt: int) -> int:
        weights = [base.weight for base in self.recipe.base]
        at = generator_for(self.recipe.seed, "base", draw, attempt).random() * math.fsum(weights)
        for place, weight in enumerate(weights):
            at -= weight
            if at < 0:
                return place
        return len(weights) - 1

    def _value_of(self, item: Varied, draw: int, attempt: int, named: Mapping[str, Any]) -> Any:
        distribution = item.distribution
        if isinstance(distribution, Random):
            return distribution.value(self._uniforms.of(item.key, distribution, draw, attempt))
        if isinstance(distribution, ByNumber):
            return distribution.value(self._place_of(item, draw) % len(distribution))
        assert isinstance(distribution, Derived)
        try:
            return distribution.value(named)
        except ValueError as error:
            raise SceneError([Problem(item.where, str(error))]) from error

    def _middle_of(self, item: Varied, named: Mapping[str, Any]) -> Any:
        distribution = item.distribution
        if isinstance(distribution, Random):
            return distribution.middle
        return self._value_of(item, 0, 0, named)

    def _place_of(self, item: Varied, draw: int) -> int:
        """Return how far a field that goes by the sample's number has gone."""
        own = item.distribution
        assert isinstance(own, ByNumber)
        if not own.period:
            return draw
        for other in self.varied:
            if other is item:
                return draw
            if isinstance(other.distribution, ByNumber) and other.distribution.period:
                draw //= len(other.distribution)
        return draw

    def _split_of(self, draw: int, named: Mapping[str, Any]) -> str:
        recipe = self.recipe
        for key, wanted in recipe.hold_out.items():
            if any(named[one] == value for one in self._held[key] for value in wanted):
                return HELD_OUT
        if not recipe.splits:
            return ""
        at = generator_for(recipe.seed, "split", draw).random() * math.fsum(recipe.splits.values())
        for name, share in recipe.splits.items():
            at -= share
            if at < 0:
                return name
        return next(reversed(recipe.splits))

    def _varied(self, problems: list[Problem]) -> Iterator[Varied]:
        for name, distribution in self.recipe.values.items():
            yield Varied(name, distribution, (), name, f"values.{name}")
        for path, distribution in self.recipe.vary.items():
            where = f"vary.{path}"
            places = self._places(path, where, problems)
            name = distribution.name or ""
            if not places or distribution.together or places == [path]:
                yield Varied(path, distribution, tuple(places), name, where)
                continue
            if name:
                message = f"'{path}' stands for {len(places)} places with a value each; add together: true, or no name"
                problems.append(Problem(f"{where}.name", message, name))
            yield from (Varied(place, distribution, (place,), "", where) for place in places)

    def _ladders(self, problems: list[Problem]) -> Iterator[tuple[str, tuple[str, ...], Any]]:
        for path, values in self.recipe.paired.items():
            places = tuple(self._places(path, f"paired.{path}", problems))
            for value in values:
                yield path, places, value

    def _places(self, path: str, where: str, problems: list[Problem]) -> list[str]:
        found: dict[str, None] = {}
        for number, plain in enumerate(self._plain):
            try:
                found |= dict.fromkeys(expand(plain, path))
            except PathError as error:
                of = f" (in base {number})" if len(self._plain) > 1 else ""
                problems.append(Problem(where, f"{error}{of}"))
        return list(found)

    def _refuse_unknown_hold_outs(self, problems: list[Problem]) -> None:
        keys = [item.key for item in self.varied]
        names = {item.name: item.key for item in self.varied if item.name}
        self._held: dict[str, tuple[str, ...]] = {}
        for key in self.recipe.hold_out:
            matching = [one for one in keys if one == names.get(key, key) or _matches(one, key)]
            self._held[key] = tuple(matching)
            if not matching:
                message = f"is neither the path nor the name of a value that varies; these vary: {', '.join(keys)}"
                problems.append(Problem(f"hold_out.{key}", message))

    def _sorted(self, problems: list[Problem]) -> list[Varied]:
        """Return all values so that each comes after those that it needs."""
        known = {item.key for item in self.varied} | {item.name for item in self.varied if item.name}
        left, done, order = list(self.varied), set[str](), list[Varied]()
        for item in left:
            if isinstance(item.distribution, Derived):
                unknown = sorted(item.distribution.needs() - known)
                if unknown:
                    message = f"uses what is no value: {', '.join(unknown)}; values with names: "
                    message += ", ".join(sorted(one.name for one in self.varied if one.name)) or "none"
                    problems.append(Problem(item.where, message))
                    return []
        while left:
            ready = [
                item for item in left if not isinstance(item.distribution, Derived) or item.distribution.needs() <= done
            ]
            if not ready:
                circle = ", ".join(item.key for item in left)
                problems.append(Problem(left[0].where, f"these values need each other in a circle: {circle}"))
                return []
            order += ready
            done |= {item.key for item in ready} | {item.name for item in ready if item.name}
            left = [item for item in left if item not in ready]
        return order


def _matches(path: str, pattern: str) -> bool:
    """Whether a path is one of those that a path with wildcards stands for."""
    one, other = path.split("."), pattern.split(".")
    return len(one) == len(other) and all(b in ("*", a) for a, b in zip(one, other, strict=True))
