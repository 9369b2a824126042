"""The search of the site finds the page that answers a question among the first three."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import pytest

from scenetruth_site.search import RANKING, connect_search, search_words
from scenetruth_site.toctrees import pages_of
from tests.helpers.site_search import DOCS, first_pages

QUESTIONS = {
    "add noise": "how_to/scenes/sensors",
    "kind / status": "reference/data_model",
    "how errors are defined": "reference/statistics",
    "how to cite": "index",
    "how much disk": "how_to/generate_data_sets",
    "add a motion": "how_to/add_motion",
    "growth rate": "explanation/growth_rate",
    "write a method": "how_to/write_a_method",
    "compare methods": "how_to/compare_methods",
    "baseline_mm": "reference/scene_file/stage",
    "print a pattern": "how_to/print_a_pattern",
    "install": "get_started",
    "calibrate": "how_to/calibrate_a_rig",
    "external program": "how_to/external_programs",
    "strain": "how_to/compute_strain",
    "units": "reference/conventions",
    "catalogue columns": "reference/catalogue_columns",
    "choose a method": "how_to/choose_a_method",
    "real images": "how_to/read_real_images",
    "lens distortion": "how_to/scenes/camera_effects",
    "lights": "how_to/scenes/light_and_materials",
    "texture": "how_to/scenes/textures",
    "error bars": "how_to/uncertainty_of_a_capture",
    "export": "how_to/export",
    "cluster": "how_to/run_on_a_cluster",
    "glossary": "reference/glossary",
    "limitations": "reference/limitations",
    "resume an interrupted run": "how_to/run_from_cli",
    "environment variables": "reference/environment",
    "occlusion": "reference/data_model",
    "license": "index",
    "paraview": "how_to/export",
    "MatchID": "how_to/export",
    "train a network": "how_to/generate_data_sets",
    "depth of field": "how_to/scenes/camera_effects",
    "bayer": "explanation/demosaicing",
    "plant leaf": "how_to/scenes/surfaces",
    "NaN": "reference/data_model",
    "what does interior mean": "reference/statistics",
    "machine learning": "how_to/generate_data_sets",
    "speed": "results/scaling",
    "out of memory": "results/scaling",
    "how do I cite this": "index",
    "matlab": "how_to/export",
    "jupyter notebook": "how_to/use_from_python",
    "plot a profile": "how_to/use_from_python",
    "two camera directions": "reference/scene_file/stage",
    # Words of a question, and words that the page lacks, hide no page.
    "how many frames do I need": "how_to/optimise_a_rig",
    "import my own mesh": "tutorials/02_own_mesh",
    "how do I add my own texture": "how_to/scenes/textures",
    "can I use a photo as a texture": "how_to/scenes/textures",
    "how long does it take": "results/scaling",
    "which method is best for optical flow": "how_to/choose_a_method",
    "compare two methods": "how_to/compare_methods",
    "what is density": "reference/statistics",
    "exit code": "how_to/run_from_cli",
    "scene file format": "reference/scene_file/index",
    "sensitivity analysis": "how_to/optimise_a_rig",
    "digital image correlation": "results/dic_challenge",
    "digital twin": "how_to/predict_errors_by_a_twin",
    "time lapse of a plant": "tutorials/03_growing_leaf",
    "save images as png": "how_to/run_from_cli",
    "quick start": "get_started",
    "sweep parameters": "how_to/run_a_sweep",
    "point cloud": "how_to/export",
    "poisson noise": "how_to/scenes/sensors",
}
# Rare words of decisions and of the changelog: these pages are found, but last.
RARE = ("embree", "pydantic", "interrupted")


@cache
def found() -> dict[str, list[str]]:
    return first_pages([*QUESTIONS, *RARE], 1000)


def is_history(page: str) -> bool:
    return page.startswith(("changelog", "explanation/decisions/"))


@pytest.mark.parametrize("question", QUESTIONS)
def test_questions_lead_to_their_page(question: str) -> None:
    assert QUESTIONS[question] in found()[question][:3]


@pytest.mark.parametrize("question", [*QUESTIONS, *RARE])
def test_decisions_and_changelog_come_last(question: str) -> None:
    history = [is_history(page) for page in found()[question]]
    assert history == sorted(history)


def test_decisions_are_found() -> None:
    assert all(any(map(is_history, found()[word])) for word in RARE)


def test_search_words_are_of_pages() -> None:
    assert set(search_words()) <= pages_of(DOCS)


def test_sphinx_indexes_the_search_words(tmp_path: Path) -> None:
    """The pages of the index above are those of Sphinx: keywords become terms, and the search page has the ranking."""
    sphinx = pytest.importorskip("sphinx.application")
    (tmp_path / "index.rst").write_text("First page\n==========\n\nNothing to see.\n")
    (tmp_path / "conf.py").write_text(f"html_search_scorer = {str(RANKING)!r}\n")
    out = tmp_path / "out"
    app = sphinx.Sphinx(tmp_path, tmp_path, out, tmp_path / "trees", "html", status=None, warning=None)
    connect_search(app)
    app.build()
    text = (out / "searchindex.js").read_text()
    index = json.loads(text[text.index("(") + 1 : text.rindex(")")])
    assert {"cite", "licenc"} <= set(index["terms"])
    assert "var Scorer" in (out / "_static" / "language_data.js").read_text()
    assert "const SEARCH_WORDS = " in (out / "search.html").read_text()
    assert "SEARCH_WORDS" not in (out / "index.html").read_text()
