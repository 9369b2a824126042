"""Samples are drawn as the recipe says, and points of plans fill the space evenly."""

from __future__ import annotations

import copy
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.dataset.distributions import ConeDistribution, RandomDistribution, SamplingPlan, UniformDistribution
from scenetruth.dataset.recipe_loader import Recipe, load_recipe
from scenetruth.dataset.recipe_validation import refuse_recipe, try_draws
from scenetruth.dataset.sampler import HELD_OUT, Sampler, UniformDraws
from scenetruth.errors import RecipeError
from tests.helpers.nightly import by_night
from tests.helpers.small_recipes import RECIPE, SCENE

Make = Callable[..., Sampler]
DEPTH, MEAN = "objects.1.pose.position_mm.2", "objects.*.texture.mean"
CONTRAST = {"kind": "uniform", "low": 0.4, "high": 0.6}


def test_a_sample_is_the_same_alone_and_among_others(sampler_with: Make) -> None:
    accept = [{"kind": "depth", "object": "tile", "max": 105}]
    one, other = (sampler_with(samples=12, acceptance=accept) for _ in range(2))
    together = [one.draw(number) for number in range(12)]
    assert sum(found.attempts > 1 for found in together) > 1
    for number in (11, 0, 7):
        assert other.draw(number) == together[number]


def test_another_field_changes_no_other_draw(sampler_with: Make) -> None:
    few = sampler_with()
    vary = {"sensor.noise_std": {"kind": "uniform", "low": 0, "high": 0.1}, **RECIPE["distributions"], MEAN: CONTRAST}
    many = sampler_with(distributions=vary, parameters={"unused": {"kind": "normal", "mean": 0, "std": 1}})
    for number in range(len(few)):
        one, other = few.draw(number), many.draw(number)
        assert one.values[DEPTH] == other.values[DEPTH]
        assert one.plain["seed"] == other.plain["seed"]


def test_wildcards_have_a_value_for_each_place_or_one_for_all(sampler_with: Make) -> None:
    apart = sampler_with(distributions={MEAN: CONTRAST}).draw(0)
    assert apart.values["objects.0.texture.mean"] != apart.values["objects.1.texture.mean"]
    together = sampler_with(distributions={MEAN: {**CONTRAST, "together": True}}).draw(0)
    means = {item["texture"]["mean"] for item in together.plain["objects"]}
    assert means == {together.values[MEAN]}


def test_values_reach_formulas_and_other_fields(sampler_with: Make) -> None:
    vary = {
        "objects.0.pose.position_mm.2": "= z + gap",
        **RECIPE["distributions"],
        "objects.0.texture.mean": CONTRAST,
        "objects.1.texture.mean": {"kind": "linked", "of": "objects.0.texture.mean"},
        "frames.count": {"kind": "formula", "formula": "gap / 3", "integer": True},
    }
    found = sampler_with(distributions=vary, parameters={"gap": {"kind": "uniform", "low": 5, "high": 9}}).draw(1)
    scene = found.scene()
    assert scene.objects[0].pose.position_mm[2] == found.values[DEPTH] + found.values["gap"]
    assert scene.frames.count == round(found.values["gap"] / 3)
    assert found.values["objects.0.texture.mean"] == found.values["objects.1.texture.mean"]


def test_whole_parts_of_a_scene_can_vary(sampler_with: Make) -> None:
    sensors = ["ideal", {"kind": "gaussian", "noise_std": 0.03, "bit_depth": 10}]
    found = sampler_with(samples=12, distributions={"sensor": {"kind": "choice", "values": sensors}})
    kinds = {str(type(found.draw(number).scene().sensor)) for number in range(12)}
    assert len(kinds) == 2


def test_ladders_change_one_factor_and_nothing_else(sampler_with: Make) -> None:
    paired = {"sensor.noise_std": [0.02, 0.05], "lighting.drift_per_frame": [0.01]}
    sampler = sampler_with(samples=3, paired_factors=paired)
    assert len(sampler) == 12
    for draw in range(3):
        drawn, *steps = (sampler.draw(4 * draw + step) for step in range(4))
        assert [(step.factor, step.values[step.factor]) for step in steps] == [
            ("sensor.noise_std", 0.02),
            ("sensor.noise_std", 0.05),
            ("lighting.drift_per_frame", 0.01),
        ]
        for step in steps:
            plain = copy.deepcopy(dict(step.plain))
            section, name = step.factor.split(".")
            plain[section][name] = drawn.plain[section][name]
            assert plain == drawn.plain
            assert (step.draw, step.split) == (draw, drawn.split)


def test_several_bases_are_drawn_by_their_weights(plain: dict[str, Any]) -> None:
    other = {**copy.deepcopy(SCENE), "description": "other"}
    plain |= {"base": [{"scene": SCENE, "weight": 3}, {"scene": other}], "samples": 400}
    sampler = Recipe.from_dict(plain).sampler()
    share = sum(sampler.attempt(number, 0).base for number in range(400)) / 400
    # Three standard deviations of a share of 400.
    assert abs(share - 0.25) < 3 * (0.25 * 0.75 / 400) ** 0.5


def test_splits_have_their_shares_and_held_out_values_go_apart(sampler_with: Make) -> None:
    vary = {
        **RECIPE["distributions"],
        "objects.1.texture.kind": {"kind": "choice", "values": ["noise", "plaid"], "weights": [9, 1]},
    }
    sampler = sampler_with(
        samples=600, distributions=vary, splits={"train": 8, "test": 2}, hold_out={"objects.*.texture.kind": ["plaid"]}
    )
    drawn = [sampler.attempt(number, 0) for number in range(600)]
    assert all((one.split == HELD_OUT) == (one.values["objects.1.texture.kind"] == "plaid") for one in drawn)
    kept = [one.split for one in drawn if one.split != HELD_OUT]
    share = kept.count("test") / len(kept)
    assert abs(share - 0.2) < 3 * (0.2 * 0.8 / len(kept)) ** 0.5


@pytest.mark.parametrize("samples", [1, 2, 7, 10, 99, *by_night(600)])
@pytest.mark.parametrize("weights", [{"train": 7, "val": 1, "test": 2}, {"a": 0.1, "b": 0.2, "c": 0.3}, {"one": 5}])
def test_splits_have_exact_counts(sampler_with: Make, samples: int, weights: dict[str, float]) -> None:
    sampler = sampler_with(samples=samples, splits=weights)
    drawn = [sampler.attempt(number, 0).split for number in range(samples)]
    for name, weight in weights.items():
        share = samples * weight / sum(weights.values())
        assert abs(drawn.count(name) - share) < 1 - 1e-9, name
    if samples == 10 and len(weights) == 3 and "val" in weights:
        assert [drawn.count(name) for name in weights] == [7, 1, 2]
    # In random order, and the same for every sampler.
    another = sampler_with(samples=samples, splits=weights)
    assert drawn == [another.attempt(number, 0).split for number in reversed(range(samples))][::-1]
    if samples == 600 and len(weights) > 1:
        assert drawn[:300].count(drawn[0]) != drawn[300:].count(drawn[0]) or drawn[:300] != sorted(drawn[:300])


def test_refused_draws_are_counted_and_explained(sampler_with: Make) -> None:
    sampler = sampler_with(samples=8, acceptance=[{"kind": "depth", "object": "tile", "max": 100}])
    trial = try_draws(sampler, 8)
    assert trial.accepted == 8
    # Half of all depths are accepted: the number of draws has mean 16 and standard deviation 4; four of them above.
    assert 8 < trial.drawn < 32
    assert str(trial) == f"rejected: {trial.drawn - 8} of {trial.drawn}: depth of tile over 100 mm"
    assert all(sampler.draw(number).values[DEPTH] <= 100 for number in range(8))


BAD: list[tuple[dict[str, Any], list[str]]] = [
    ({"smaples": 3}, ["smaples: unknown key; did you mean 'samples'?"]),
    ({"samples": 0}, ["samples: "]),
    ({"name": "two words"}, ["name: "]),
    ({"base": "missing.yaml"}, ["base.0: no such file"]),
    ({"base": {"camera": {}, "stage": {}}}, ["base.0.camera.width: is missing", "base.0.stage"]),
    ({"base": []}, ["base: "]),
    ({"set": {"camera.widht": 3}}, ["camera.widht: unknown key"]),
    ({"set": {"camra.width": 3}}, ["set.camra.width: there is no 'camra'; did you mean 'camera'?"]),
    (
        {"distributions": {"objects.7.name": "= 1"}},
        ["distributions.objects.7.name: 'objects' is a list of 2; '7' is not an index of it"],
    ),
    ({"distributions": {"plants.*.name": "= 1"}}, ["distributions.plants.*.name: matches nothing"]),
    (
        {"distributions": {"camera.width": {"kind": "unifrm"}}},
        ["distributions.camera.width: unknown `kind`: 'unifrm'"],
    ),
    ({"distributions": {"camera.width": 3}}, ["distributions.camera.width: "]),
    (
        {"distributions": {"camera.width": {"kind": "uniform", "low": 3, "high": 1}}},
        ["distributions.camera.width: has no values"],
    ),
    ({"distributions": {"camera.width": "= foo"}}, ["distributions.camera.width: uses undefined values: foo"]),
    ({"parameters": {"a": "= b", "b": "= a"}}, ["parameters.a: these values depend on each other: a, b"]),
    ({"parameters": {"z": "= 1"}}, ["names of values must be unique; used more than once: z"]),
    ({"set": {DEPTH: 3}}, [f"is both set and varied: {DEPTH}"]),
    ({"paired_factors": {"sensor.noise": [1]}}, ["paired_factors.sensor.noise: unknown key"]),
    (
        {"paired_factors": {"sensor.noise_std": [0.1, -1]}},
        ["paired_factors.sensor.noise_std: input should be greater than or equal"],
    ),
    ({"hold_out": {"camera.width": [3]}}, ["hold_out.camera.width: is neither the path nor the name"]),
    ({"acceptance": [{"kind": "depth"}]}, ["acceptance.0: has no limit"]),
    ({"acceptance": [{"kind": "depth", "min": 3, "max": 1}]}, ["acceptance.0: can never hold"]),
    (
        {
            "distributions": {
                DEPTH: {"kind": "sequence", "values": [100, "far"]},
                "camera.width": {"kind": "integers", "low": 0, "high": 9},
            }
        },
        [f"distributions.{DEPTH}.values.1: ", "distributions.camera.width.low: "],
    ),
    (
        {"distributions": {"sensor": {"kind": "choice", "values": ["ideal", {"noise_std": -1}]}}},
        ["distributions.sensor.values.1: sensor.noise_std: "],
    ),
    (
        {"acceptance": [{"kind": "visible_share", "object": "tile", "min": 1.1}], "max_draws": 7},
        ["acceptance: sample 0: none of 7 draws was accepted (visible share of tile under 1.1: 7)"],
    ),
    (
        {"distributions": {"frames.count": "= 5 - 5 * 2"}},
        ["frames.count: ", "with every value in the middle of its range"],
    ),
    ({"distributions": {"frames.count": "= 1 / 0"}}, ["distributions.frames.count: '1 / 0' has no value"]),
]


@pytest.mark.parametrize(("changes", "told"), BAD, ids=[str(number) for number in range(len(BAD))])
def test_what_is_wrong_is_told_before_the_first_sample(
    sampler_with: Make, changes: dict[str, Any], told: list[str]
) -> None:
    with pytest.raises(RecipeError) as caught:
        refuse_recipe(sampler_with(**changes))
    for text in told:
        assert text in str(caught.value)


def test_a_file_names_itself_and_paths_count_from_it(tmp_path: Any) -> None:
    import yaml

    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(SCENE), encoding="utf-8")
    file = tmp_path / "recipe.yaml"
    file.write_text(yaml.safe_dump({**RECIPE, "base": "scene.yaml"}), encoding="utf-8")
    assert load_recipe(file).sampler().draw(2) == Recipe.from_dict(RECIPE).sampler().draw(2)
    file.write_text("name: [", encoding="utf-8")
    with pytest.raises(RecipeError, match=r"recipe\.yaml"):
        load_recipe(file).sampler()


def one(plan: SamplingPlan) -> UniformDistribution:
    return UniformDistribution(low=0, high=1, sampling=plan)


def points(fields: dict[str, RandomDistribution], count: int, seed: int = 3, attempt: int = 0) -> NDArray[np.float64]:
    uniforms = UniformDraws(seed, count, fields)
    return np.array(
        [[u for key, field in fields.items() for u in uniforms.of(key, field, n, attempt)] for n in range(count)]
    )


def test_sobol_points_are_a_net() -> None:
    """Of 2^m points, every box of 2^-m has one (two dimensions): A digital shift keeps that."""
    found = points({"a": one("sobol"), "b": one("sobol")}, 64)
    for bits in range(7):
        boxes = np.floor(found * [2**bits, 2 ** (6 - bits)]).astype(int)
        assert len({tuple(box) for box in boxes.tolist()}) == 64


def test_a_latin_hypercube_has_one_point_in_every_stratum() -> None:
    fields: dict[str, RandomDistribution] = {
        "a": one("latin_hypercube"),
        "b": ConeDistribution(axis=(0, 0, 1), half_angle_deg=9, sampling="latin_hypercube"),
    }
    for attempt in (0, 3):
        found = points(fields, 50, attempt=attempt)
        assert (np.sort(np.floor(found * 50).astype(int), axis=0) == np.arange(50)[:, None]).all()


@pytest.mark.parametrize("plan", ["independent", "sobol", "latin_hypercube"])
def test_another_field_changes_no_number(plan: SamplingPlan) -> None:
    alone = points({"a": one(plan)}, 20)
    with_more = points({"a": one(plan), "b": one(plan), "c": one("independent")}, 20)
    assert (alone[:, 0] == with_more[:, 0]).all()
    assert not (with_more[:, 0] == with_more[:, 1]).any()


def test_numbers_depend_on_seed_sample_and_draw_alone() -> None:
    fields: dict[str, RandomDistribution] = {"a": one("independent")}
    uniforms = UniformDraws(3, 10, fields)
    backwards = [uniforms.of("a", fields["a"], n, 0)[0] for n in reversed(range(10))]
    assert backwards[::-1] == points(fields, 10)[:, 0].tolist()
    everything = np.concatenate([points(fields, 200, seed, attempt).ravel() for seed in (1, 2) for attempt in (0, 1)])
    assert len(set(everything.tolist())) == everything.size


def test_points_far_along_are_those_of_the_sequence() -> None:
    """Blocks are made apart; SciPy's own engine goes through all of them."""
    from scipy.stats import qmc

    fields: dict[str, RandomDistribution] = {"a": one("sobol"), "b": one("sobol")}
    uniforms = UniformDraws(3, 10_000, fields)
    engine = qmc.Sobol(2, scramble=False, bits=32).random(8192)
    shift = round(uniforms.of("b", fields["b"], 0, 0)[0] * 2**32 - 0.5) ^ int(engine[0, 1] * 2**32)
    for n in (1, 4095, 4096, 8191):
        expected = ((int(engine[n, 1] * 2**32) ^ shift) + 0.5) / 2**32
        assert uniforms.of("b", fields["b"], n, 0)[0] == pytest.approx(expected, abs=2**-50)


class ThreadCrew:
    """Executor of two threads whose first task is lost."""

    lost: tuple[type[BaseException], ...] = (BrokenExecutor,)
    count = 2

    def __init__(self) -> None:
        self._pool, self.draws = ThreadPoolExecutor(2), list[int]()

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        self.draws.append(arguments[1])
        if len(self.draws) == 1:
            lost: Future[Any] = Future()
            lost.set_exception(BrokenExecutor())
            return lost
        return self._pool.submit(work, *arguments)

    def renew(self) -> None:
        pass

    def refuse_unfit(self) -> None:
        pass

    def close(self) -> None:
        self._pool.shutdown()


def test_first_draws_by_a_crew_are_known_afterwards(sampler_with: Make) -> None:
    accept = [{"kind": "depth", "object": "tile", "max": 100}]
    sampler, plain = (sampler_with(samples=8, acceptance=accept) for _ in range(2))
    with closing(ThreadCrew()) as crew:
        refuse_recipe(sampler, crew, tried=6)
    assert crew.draws == list(range(6)) == list(sampler.known)
    expected = [plain.draw(number) for number in range(8)]
    assert any(found.rejected for found in expected[:6])
    # No further acceptance test of these draws.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Sampler, "refusal", lambda *_: pytest.fail("tested again"))
        assert [sampler.draw(number) for number in range(6)] == expected[:6]
    assert sampler.draw(7) == expected[7]


def test_first_draws_by_a_crew_state_the_same_problems(sampler_with: Make) -> None:
    impossible = {"samples": 4, "max_draws": 3, "acceptance": [{"kind": "depth", "object": "tile", "max": 1}]}
    with pytest.raises(RecipeError) as alone:
        refuse_recipe(sampler_with(**impossible))
    with closing(ThreadCrew()) as crew, pytest.raises(RecipeError) as together:
        refuse_recipe(sampler_with(**impossible), crew)
    assert together.value.problems == alone.value.problems
    assert len(crew.draws) < 4
