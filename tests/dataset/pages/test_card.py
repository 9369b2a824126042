"""The card of a tiny data set, and its metadata as others read it."""

from __future__ import annotations

import copy
import json
import logging
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from scenetruth.dataset import write_card
from scenetruth.dataset.fingerprint import open_sampler
from scenetruth.dataset.generation import run_dataset
from scenetruth.dataset.layout import DatasetFolder
from scenetruth.dataset.pages import Publication, describe_column
from scenetruth.dataset.recipe_loader import Recipe
from scenetruth.errors import OutputExistsError, RecipeError, StoreError
from tests.helpers.command_line import scenetruth
from tests.helpers.nightly import nightly
from tests.helpers.page_words import without_definitions
from tests.helpers.small_recipes import RECIPE, SCENE

HOSTILE = "<script>alert(1)</script> | **bold** [link](x) {{ 7 * 7 }}"
PUBLISHED: dict[str, Any] = {"version": "1.2.0", "date": "2026-11-23", "url": "https://example.org/tiles"}
# Libraries that mlcroissant reads with warn of how it calls them.
READS_WITH_OLD_CALLS = pytest.mark.filterwarnings(
    "ignore:ConjunctiveGraph is deprecated:DeprecationWarning", "ignore:The inplace keyword:DeprecationWarning"
)
CARD = ("card", "card.html", "card.md", "croissant.json")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "tiles"
    changes: dict[str, Any] = {
        "description": HOSTILE,
        "licence": "CC-BY-4.0",
        "citation": "Somebody, Tiles & more",
        "creators": ["Somebody", "Somebody Else"],
        "samples": 3,
        "paired_factors": {"sensor.noise_std": [0.05]},
        "splits": {"train": 1, "test": 1},
        "acceptance": [{"kind": "depth", "object": "tile", "max": 100}],
    }
    plain = copy.deepcopy(RECIPE) | changes
    plain["distributions"]["objects.1.pose.rotations"] = {"kind": "rotation"}
    plain["distributions"]["objects.1.texture.mean"] = {"kind": "choice", "values": [0.5, 0.4]}
    run_dataset(Recipe.from_dict(plain), output=folder, workers=1)
    return folder


@pytest.fixture
def dataset(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "tiles"))


@pytest.fixture
def warned(caplog: pytest.LogCaptureFixture) -> Iterator[pytest.LogCaptureFixture]:
    with caplog.at_level(logging.WARNING):
        yield caplog


def files(folder: Path) -> dict[str, bytes]:
    found = [folder / name for name in CARD if (folder / name).is_file()]
    return {path.name: path.read_bytes() for path in [*found, *sorted((folder / "card").iterdir())]}


def test_card(dataset: Path) -> None:
    page = write_card(dataset, **PUBLISHED)
    first = files(dataset)
    assert page == dataset / "card.html"
    assert set(first) == {"card.html", "card.md", "croissant.json", "contact_sheet.png", "values.png", "statistics.png"}
    text = without_definitions(page.read_text(encoding="utf-8"))
    # The only script is that of the tools.
    assert text.count("<script>") == text.count("scenetruthPage = ") == 1
    assert "{{ 7 * 7 }}" in text
    for told in ("tile: pose position Z [mm]", "raycast", "CC-BY-4.0", "Somebody, Tiles &amp; more", "1.2.0", "train"):
        assert told in text
    rejected = pq.read_table(dataset / "catalogue.parquet").to_pydict()
    assert [len(reasons) + 1 for reasons in rejected["rejected"]] == rejected["attempts"]
    refused = sum(
        len(reasons) for reasons, step in zip(rejected["rejected"], rejected["step"], strict=True) if not step
    )
    assert refused > 0
    assert f'<th scope="row">depth of tile over 100 mm</th><td data-label="draws">{refused}</td>' in text
    for name in ("contact_sheet", "values", "statistics"):
        assert f'src="card/{name}.png"' in text
    # Two figures can be copied as SVG, and their values as rows under their titles.
    assert text.count('<template class="copy"><svg') == text.count('class="rows">') == 2
    rows = json.loads(text.split('class="rows">')[1].partition("</script>")[0])
    place = rows[0].index("tile: pose position Z [mm]")
    drawn = [row[place] for row in rows[1:] if row[place] != ""]
    (column,) = (name for name in rejected if name.endswith("position_mm.2"))
    assert drawn == [value for value, step in zip(rejected[column], rejected["step"], strict=True) if not step]
    markdown = (dataset / "card.md").read_text(encoding="utf-8")
    assert "<script>" not in markdown
    assert r"\*\*bold\*\*" in markdown
    assert "](card/contact_sheet.png)" in markdown
    assert f"| depth of tile over 100 mm | {refused} |" in markdown
    with pytest.raises(OutputExistsError, match="--overwrite"):
        write_card(dataset, **PUBLISHED)


@nightly
def test_a_card_is_the_same_bytes_again(dataset: Path) -> None:
    """By day `tests.dataset.pages.test_figures` compares figures that are drawn twice."""
    write_card(dataset, **PUBLISHED)
    first = files(dataset)
    write_card(dataset, **PUBLISHED, overwrite=True)
    assert files(dataset) == first


@nightly
def test_statistics_that_do_not_vary_are_listed(tmp_path: Path) -> None:
    """Nothing is drawn of them, and their table is in the page as in the text."""
    recipe = {name: value for name, value in RECIPE.items() if name != "distributions"} | {"samples": 2}
    folder = tmp_path / "same"
    run_dataset(recipe | {"base": [{"scene": SCENE | {"frames": {"count": 1}}}]}, output=folder)
    text = without_definitions(write_card(folder).read_text(encoding="utf-8"))
    assert "statistics.png" not in text
    shown = text.partition("<h2>Distributions</h2>")[2].partition("<h2>Reading</h2>")[0]
    assert '<th scope="row">depth min [mm]</th>' in shown
    assert "| depth min " in (folder / "card.md").read_text(encoding="utf-8")


@pytest.mark.usefixtures("undrawn_figures")
@READS_WITH_OLD_CALLS
def test_croissant_is_valid_and_its_records_are_the_catalogue(dataset: Path, warned: pytest.LogCaptureFixture) -> None:
    mlcroissant = pytest.importorskip("mlcroissant")
    write_card(dataset, **PUBLISHED)
    found = mlcroissant.Dataset(jsonld=dataset / "croissant.json")
    issues = found.metadata.ctx.issues
    assert not issues.errors
    assert not issues.warnings
    assert warned.records == []
    records = list(found.records("catalogue"))
    rows = pq.read_table(dataset / "catalogue.parquet").to_pylist()
    assert len(records) == len(rows) == 6
    for record, row in zip(records, rows, strict=True):
        assert set(record) == {f"catalogue/{name}" for name in row if name != "objects"}
        for name, value in row.items():
            if name != "objects":
                assert plain(record[f"catalogue/{name}"]) == value, name


def plain(value: Any) -> Any:
    """Return what a record holds as Parquet holds it."""
    if isinstance(value, list):
        return [plain(one) for one in value]
    if isinstance(value, bytes):
        return value.decode()
    if value is None or (isinstance(value, float | np.floating) and np.isnan(value)):
        return None
    return value


@pytest.mark.usefixtures("undrawn_figures")
def test_croissant_tells_what_is_there(dataset: Path) -> None:
    write_card(dataset, **PUBLISHED)
    told = json.loads((dataset / "croissant.json").read_text(encoding="utf-8"))
    assert told["license"] == "CC-BY-4.0"
    assert [one["name"] for one in told["creator"]] == ["Somebody", "Somebody Else"]
    assert told["datePublished"] == "2026-11-23"
    by_id = {one["@id"]: one for one in told["distribution"]}
    assert by_id["catalogue.parquet"]["contentSize"] == f"{(dataset / 'catalogue.parquet').stat().st_size} B"
    for name in ("recordings", "truths", "scenes", "rows"):
        assert len(list(dataset.glob(by_id[name]["includes"]))) == 6
    (records,) = told["recordSet"]
    fields = {one["name"]: one for one in records["field"]}
    assert fields["depth_min_mm"]["dataType"] == "cr:Float64"
    assert "tile: pose position Z [mm]" in fields["value.objects.1.pose.position_mm.2"]["description"]
    assert "objects" in records["description"]


@pytest.mark.usefixtures("undrawn_figures")
@READS_WITH_OLD_CALLS
def test_what_a_recipe_leaves_out_is_told(dataset: Path) -> None:
    mlcroissant = pytest.importorskip("mlcroissant")
    recipe = dataset / "dataset.yaml"
    lines = recipe.read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if not line.startswith(("licence:", "citation:"))]
    recipe.write_text("\n".join(kept) + "\n", encoding="utf-8")
    write_card(dataset, **PUBLISHED)
    assert "No licence is specified" in (dataset / "card.html").read_text(encoding="utf-8")
    metadata = json.loads((dataset / "croissant.json").read_text(encoding="utf-8"))
    assert metadata["citeAs"] == (
        "Somebody, Somebody Else: tiles, version 1.2.0, 2026-11-23. Data set generated with scenetruth. "
        "https://example.org/tiles"
    )
    assert metadata["citeAs"] in (dataset / "card.md").read_text(encoding="utf-8")
    issues = mlcroissant.Dataset(jsonld=dataset / "croissant.json").metadata.ctx.issues
    assert not issues.errors
    (warning,) = issues.warnings
    assert "license" in warning


@pytest.mark.usefixtures("undrawn_figures")
@READS_WITH_OLD_CALLS
def test_date_and_address_are_those_of_the_recipe_unless_given(dataset: Path) -> None:
    mlcroissant = pytest.importorskip("mlcroissant")
    with (dataset / "dataset.yaml").open("a", encoding="utf-8") as file:
        file.write("published: '2026-10-01'\naddress: https://example.org/recipe\n")
    write_card(dataset)
    assert not mlcroissant.Dataset(jsonld=dataset / "croissant.json").metadata.ctx.issues.warnings
    for given, date, url in (
        ({}, "2026-10-01", "https://example.org/recipe"),
        (PUBLISHED, PUBLISHED["date"], PUBLISHED["url"]),
    ):
        write_card(dataset, **given, overwrite=True)
        metadata = json.loads((dataset / "croissant.json").read_text(encoding="utf-8"))
        assert (metadata["datePublished"], metadata["url"]) == (date, url)
        assert date in (dataset / "card.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("field", "value"), [("published", "23.11.2026"), ("published", "2026-13-01"), ("address", "example.org")]
)
def test_dates_and_addresses_that_are_none_are_problems_of_the_recipe(field: str, value: str) -> None:
    with pytest.raises(RecipeError, match=f"{field}: must be"):
        Recipe.from_dict(copy.deepcopy(RECIPE) | {field: value})


def test_every_column_is_described(made: Path) -> None:
    places = DatasetFolder(made)
    sampler = open_sampler(places)
    for name in pq.read_schema(places.catalogue).names:
        assert describe_column(name, sampler) != name.replace("_", " ")


@pytest.mark.usefixtures("undrawn_figures")
def test_reading_it_works_as_the_card_says(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_card(dataset)
    code = (dataset / "card.md").read_text(encoding="utf-8").partition("```python\n")[2].partition("```")[0]
    monkeypatch.chdir(dataset)
    found: dict[str, Any] = {}
    exec(code, found)
    assert found["image"].dims == found["depth_mm"].dims == ("y", "x")


def test_a_part_of_a_data_set_has_no_card(dataset: Path) -> None:
    (dataset / "catalogue.parquet").unlink()
    with pytest.raises(StoreError, match="generate the missing samples first"):
        write_card(dataset)
    assert not any((dataset / name).exists() for name in CARD)
    with pytest.raises(StoreError, match="is not a data set"):
        write_card(dataset / "samples")


@pytest.mark.usefixtures("undrawn_figures")
def test_nothing_half_written_stays(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_text = Path.write_text

    def write_all_but_metadata(path: Path, text: str, **options: Any) -> int:
        if text.startswith("{"):
            raise OSError(28, "No space left on device")
        return write_text(path, text, **options)

    monkeypatch.setattr(Path, "write_text", write_all_but_metadata)
    before = {path.name for path in dataset.iterdir()}
    with pytest.raises(StoreError, match="disk is full"):
        write_card(dataset)
    assert {path.name for path in dataset.iterdir()} == before


@nightly
def test_samples_in_tar_files(tmp_path: Path) -> None:
    plain = copy.deepcopy(RECIPE) | {"samples": 2, "layout": "shards", "samples_per_shard": 1}
    run_dataset(Recipe.from_dict(plain), output=tmp_path / "tiles", workers=1)
    write_card(tmp_path / "tiles")
    assert (tmp_path / "tiles" / "card" / "contact_sheet.png").exists()
    told = json.loads((tmp_path / "tiles" / "croissant.json").read_text(encoding="utf-8"))
    by_id = {one["@id"]: one for one in told["distribution"]}
    assert len(list((tmp_path / "tiles").glob(by_id["shards"]["includes"]))) == 2
    assert "recordings" not in by_id


@pytest.mark.parametrize(
    ("given", "where"),
    [({"version": "one"}, "version"), ({"date": "23.11.2026"}, "published"), ({"url": "javascript:x"}, "url")],
)
def test_publication_has_its_form(given: dict[str, str], where: str) -> None:
    with pytest.raises(RecipeError, match=where):
        Publication(**given)


@pytest.mark.usefixtures("undrawn_figures")
def test_command(dataset: Path) -> None:
    done = scenetruth("dataset", "card", dataset, "--date", "2026-11-23")
    assert done.returncode == 0
    assert done.stdout == f"wrote {dataset / 'card.html'}\n"
    assert scenetruth("dataset", "card", dataset).returncode == 2
    assert "version" in scenetruth("dataset", "card", dataset, "--version", "x", "--overwrite").stderr
