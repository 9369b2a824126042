"""The gallery of scenes: every scene of the library is in it, as its comment describes it."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_scene_is_shown() -> None:
    page = (ROOT / "docs" / "reference" / "scene_gallery.md").read_text(encoding="utf-8")
    scenes = sorted(file.stem for file in (ROOT / "scenes").glob("*.yaml"))
    assert [line.split("]")[0].removeprefix("## [") for line in page.splitlines() if line.startswith("## [")] == scenes
    for name in scenes:
        assert f"![The scene {name}: image, depth, and how it moves](gallery/{name}.png)" in page
        assert (ROOT / "docs" / "reference" / "gallery" / f"{name}.png").is_file()


def test_light_and_colour_are_shown() -> None:
    page = (ROOT / "docs" / "reference" / "scene_gallery.md").read_text(encoding="utf-8")
    for name in ("glossy_rosette", "backlit_leaf", "colour_chart"):
        assert f"](../how_to/scenes/{name}.png)" in page
        assert (ROOT / "docs" / "how_to" / "scenes" / f"{name}.png").is_file()
