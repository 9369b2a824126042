"""Words, units and pages: whatever a recipe says stays text."""

from __future__ import annotations

from typing import Any

import pytest

from scenetruth.dataset.distributions import (
    ChoiceDistribution,
    LogUniformDistribution,
    NormalDistribution,
    RotationDistribution,
    UniformDistribution,
)
from scenetruth.dataset.pages import (
    collect_quantities,
    describe_criterion,
    describe_distribution,
    describe_splits,
    escape_markdown,
    format_code,
    format_label,
    format_title,
    split_quantities,
)
from tests.helpers.dataset_makers import Make
from tests.helpers.small_recipes import SCENE

LIT = {
    **SCENE,
    "lighting": {"lights": [{"kind": "directional", "direction": [0, 0, 1], "irradiance": 1.0}]},
    "turned": [{"axis": [0, 1, 0], "angle_deg": {"kind": "linear", "rate_per_frame": 0.2}}],
}


@pytest.mark.parametrize(
    ("path", "label"),
    [
        ("objects.1.pose.position_mm.2", "tile: pose position Z [mm]"),
        ("objects.1.motion.0.velocity_mm_per_frame.0", "tile: motion velocity X [mm per frame]"),
        ("objects.0.texture.wavelength_mm.1", "wall: texture longest wavelength [mm]"),
        ("lighting.lights.0.irradiance", "lights directional irradiance"),
        ("turned.0.angle_deg.rate_per_frame", "turned about Y angle rate [° per frame]"),
        ("sensor.noise_std", "sensor noise std"),
        ("distance_mm", "distance [mm]"),
        ("objects.9.name", "objects (9) name"),
    ],
)
def test_fields_are_told_by_names_and_units(path: str, label: str) -> None:
    assert format_title(*format_label(path, LIT)) == label


def test_values_are_numbers_or_categories() -> None:
    few, others = split_quantities("t", "", [{"kind": "noise"}, {"kind": "plaid"}] * 3)[0].counts
    assert (few, others) == (("noise", 3), ("plaid", 3))
    # Two of a kind are told apart by all that they say.
    (alike,) = split_quantities("t", "", [{"kind": "noise", "mean": mean} for mean in (0.2, 0.3)])
    assert alike.counts == (("noise (mean 0.2)", 1), ("noise (mean 0.3)", 1))
    (many,) = split_quantities("t", "", [f"name {number}" for number in range(30)])
    assert many.counts[-1] == ("19 others", 19)
    vectors = split_quantities("direction", "", [[number / 30, 0.0, 1.0] for number in range(30)])
    assert [one.label for one in vectors] == ["direction X", "direction Y", "direction Z"]
    assert vectors[1].is_constant
    assert not vectors[0].is_constant
    assert split_quantities("t", "mm", [True, False])[0].counts == (("no", 1), ("yes", 1))


def test_drawn_values_know_their_scale(sampler_with: Make) -> None:
    sampler = sampler_with(distributions={"sensor.noise_std": {"kind": "log_uniform", "low": 0.001, "high": 0.1}})
    (noise,) = collect_quantities(sampler, {"sensor.noise_std": [0.01, None, 0.02]})
    assert noise.log
    assert noise.numbers == (0.01, 0.02)


def test_recipes_in_words(sampler_with: Make) -> None:
    sampler = sampler_with(
        distributions={"objects.1.pose.position_mm.2": "=2 * a"},
        parameters={"a": {"kind": "choice", "values": [50, 51]}},
        acceptance=[{"kind": "depth", "object": "tile", "max": 200}],
        splits={"train": 3, "test": 1},
        hold_out={"a": [51]},
    )
    assert [describe_distribution(item.distribution) for item in sampler.varied] == [
        "one of 50, 51",
        "= 2 * a",
    ]
    assert describe_criterion(sampler.recipe.acceptance[0]) == "depth of tile: at most 200 mm"
    assert describe_splits(sampler) == {
        "train": "each sample that is not held out, with a probability of 75 %",
        "test": "each sample that is not held out, with a probability of 25 %",
        "held_out": "all samples with a: 51",
    }


def test_markdown_stays_text() -> None:
    hostile = "# a | b <img src=x> [c](javascript:d) `e`\n\n- f \x1b[31m"
    told = escape_markdown(hostile)
    assert "\n" not in told
    assert "\x1b" not in told
    assert "<" not in told
    assert r"\[c\](javascript:d)" in told
    assert r"a \| b" in told
    assert format_code("a`b|c\nd") == "``a`b\\|c d``"


DISTRIBUTIONS: dict[str, Any] = {
    "choice": ChoiceDistribution,
    "log_uniform": LogUniformDistribution,
    "normal": NormalDistribution,
    "rotation": RotationDistribution,
    "uniform": UniformDistribution,
}


@pytest.mark.parametrize(
    ("plain", "words"),
    [
        ({"kind": "uniform", "low": -1, "high": 2.5}, "uniform from −1 to 2.5"),
        (
            {"kind": "log_uniform", "low": 0.1, "high": 2, "sampling": "sobol"},
            "log-uniform from 0.1 to 2 (Sobol sequence)",
        ),
        ({"kind": "normal", "mean": 1, "std": 0.5}, "normal with mean 1 and standard deviation 0.5"),
        ({"kind": "normal", "mean": 1, "std": 2, "low": 0}, "normal with mean 1 and standard deviation 2, cut from 0"),
        ({"kind": "rotation"}, "random rotation, uniform over all orientations"),
        (
            {"kind": "choice", "values": [{"kind": "ring", "radius_mm": 7}, {"kind": "disc"}], "weights": [1, 3]},
            "one of ring (25 %), disc (75 %)",
        ),
        (
            {"kind": "choice", "values": [{"kind": "noise", "mean": 0.2}, {"kind": "noise", "mean": 0.3}]},
            "one of noise (mean 0.2), noise (mean 0.3)",
        ),
    ],
)
def test_distributions_are_read_as_words(plain: dict[str, Any], words: str) -> None:
    fields = {name: value for name, value in plain.items() if name != "kind"}
    assert describe_distribution(DISTRIBUTIONS[plain["kind"]](**fields)) == words
