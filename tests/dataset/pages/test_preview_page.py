"""The preview: the same each time, without a full rendering, and honest about what it shows."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np
import pytest

from scenetruth.dataset import preview_dataset
from scenetruth.dataset.pages import PAGE, SIMPLIFIED, render_thumbnail, simplify_scene
from scenetruth.dataset.recipe_validation import draw_samples, select_numbers
from scenetruth.errors import OutputExistsError, RecipeError
from scenetruth.scene import Scene, load_scene
from scenetruth.scene.texture import NoiseTexture
from scenetruth.simulation import simulate
from tests.helpers.command_line import scenetruth
from tests.helpers.dataset_makers import Make
from tests.helpers.nightly import nightly
from tests.helpers.page_words import without_definitions
from tests.helpers.small_recipes import SCENE

SCENES = Path(__file__).parents[3] / "scenes"
HOSTILE = '<script>alert(1)</script> & "quotes" {{ 7 * 7 }} \' \u202e'


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@nightly
def test_page_and_pictures(sampler_with: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sampler = sampler_with(
        description=HOSTILE,
        samples=9,
        distributions={
            "objects.1.pose.position_mm.2": {"kind": "uniform", "low": 80, "high": 130},
            "sensor.noise_std": {"kind": "uniform", "low": 0.001, "high": 0.1},
        },
        acceptance=[{"kind": "depth", "object": "tile", "max": 115}],
        paired_factors={"sensor.bit_depth": [10]},
        splits={"train": 1, "test": 1},
    )
    told: list[str] = []
    page = preview_dataset(
        sampler.recipe, output=tmp_path / "one", progress=lambda what, done, total: told.append(what)
    )
    # As if it took long.
    monkeypatch.setattr("scenetruth.jobs.executors.MIN_PARALLEL_S", 0.0)
    preview_dataset(sampler.recipe, output=tmp_path / "two", workers=2)
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
    assert set(told) == {"draw", "thumbnails"}
    assert {path.name for path in page.parent.iterdir()} == {PAGE, "contact_sheet.png", "values.png", "pairs.png"}
    text = page.read_text(encoding="utf-8")
    assert HOSTILE not in text
    assert "<script>alert" not in text
    assert "{{ 7 * 7 }}" in text
    assert "depth of tile over 115 mm" in without_definitions(text)
    assert html.escape(SIMPLIFIED) in without_definitions(text)
    assert "tile: pose position Z [mm]" in without_definitions(text)


def test_what_exists_stays(sampler_with: Make, tmp_path: Path) -> None:
    sampler = sampler_with(samples=2)
    preview_dataset(sampler.recipe, output=tmp_path / "p")
    (tmp_path / "p" / "notes.txt").write_text("mine")
    with pytest.raises(OutputExistsError, match="--overwrite"):
        preview_dataset(sampler.recipe, output=tmp_path / "p")
    preview_dataset(sampler_with(samples=1, distributions={}).recipe, output=tmp_path / "p", overwrite=True)
    # What is ours is replaced, what is not stays.
    assert {path.name for path in (tmp_path / "p").iterdir()} == {PAGE, "contact_sheet.png", "notes.txt"}
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "a").write_text("mine")
    with pytest.raises(OutputExistsError, match="did not write"):
        preview_dataset(sampler.recipe, output=tmp_path / "other", overwrite=True)


def test_nothing_comes_of_what_cannot_be_drawn(sampler_with: Make, tmp_path: Path) -> None:
    never = sampler_with(acceptance=[{"kind": "depth", "object": "tile", "max": 1}], max_draws=2)
    with pytest.raises(RecipeError, match="none of 2 draws was accepted"):
        preview_dataset(never.recipe, output=tmp_path / "p")
    wrong = sampler_with(distributions={"sensor.noise_std": {"kind": "uniform", "low": -2, "high": -1}})
    with pytest.raises(RecipeError, match=r"noise_std.*in sample 0"):
        preview_dataset(wrong.recipe, output=tmp_path / "p")
    assert list(tmp_path.iterdir()) == []


def test_draws_are_taken_all_over(sampler_with: Make) -> None:
    numbers = select_numbers(10_000, 100)
    assert len(set(numbers)) == 100
    assert numbers == sorted(numbers)
    assert numbers[0] < 1000
    assert numbers[-1] > 9000
    # A grid is not met in step.
    assert {number % 2 for number in numbers} == {0, 1}
    drawn = draw_samples(sampler_with(samples=1000), 7)
    assert drawn.trial.accepted == drawn.trial.drawn == len(drawn.draws) == 7
    assert [draw.number for draw in drawn.draws] == select_numbers(1000, 7)


def test_a_thumbnail_looks_like_the_image() -> None:
    scene = Scene.from_dict({**SCENE, "sensor": "ideal"})
    image = simulate(scene)[0]["image"].sel(s=0, t=0).values
    small = render_thumbnail(scene)
    assert small.shape == image.shape
    # Waves of 6 mm are 4 px long here: nothing is left out.
    assert simplify_scene(scene).objects[0].texture == scene.objects[0].texture
    assert np.corrcoef(small.ravel(), image.ravel())[0, 1] > 0.98


def test_surfaces_are_simplified() -> None:
    leaf = load_scene(SCENES / "leaf.yaml")
    small = simplify_scene(leaf)
    assert small.camera.width == 160
    assert [item.name for _, item in small.parts] == [item.name for _, item in leaf.parts]
    assert small.objects[0].texture.kind == "uniform"
    noise, own = small.objects[1].texture, leaf.objects[1].texture
    assert isinstance(noise, NoiseTexture)
    assert isinstance(own, NoiseTexture)
    assert noise.wavelength_mm[0] > own.wavelength_mm[0]
    assert noise.rms_contrast < own.rms_contrast
    plants = simplify_scene(load_scene(SCENES / "rosette.yaml"))
    assert len(plants.objects) == 12
    assert plants.plants == ()


def test_command(tmp_path: Path) -> None:
    recipe = SCENES / "datasets" / "cubes.yaml"
    done = scenetruth("dataset", "preview", recipe, "-o", tmp_path / "p", "--samples", "2")
    assert done.returncode == 0
    assert done.stdout == f"wrote {tmp_path / 'p' / PAGE}\n"
    again = scenetruth("dataset", "preview", recipe, "-o", tmp_path / "p", "--samples", "2")
    assert again.returncode == 2
    assert "exists already" in again.stderr
