"""Terms of pages have their definitions from the glossary, and nothing else of a page changes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenetruth import glossary
from scenetruth.glossary import define_terms, glossary_file, read_glossary

GLOSSARY = Path(__file__).parents[1] / "docs" / "reference" / "glossary.md"


def page_of(body: str) -> str:
    return define_terms(f"<html><head><title>RMSE</title></head><body>{body}</body></html>")


def words(page: str) -> str:
    """The text of a page without its definitions."""
    return re.sub(r"<[^>]*>", "", page.partition('<div id="definitions"')[0])


def test_the_glossary_of_the_documentation_is_the_source() -> None:
    assert glossary_file() == GLOSSARY
    text = GLOSSARY.read_text(encoding="utf-8").replace("`", "").casefold()
    found = read_glossary()
    assert len(found) > 100
    for one in found.values():
        assert one.text.removesuffix(".").casefold() in text
        assert one.term.casefold() in text


def test_terms_of_one_row_have_their_own_definitions() -> None:
    found = read_glossary()
    assert found["sample"].text == "One scene with recording and truth."
    assert found["split"].text == "Partition."
    # Without as many definitions as names, all names share one.
    assert found["z-score"] is found["normalised error"]
    assert found["interior"] is found["occluded"]


def test_other_spellings_lead_to_terms() -> None:
    found = read_glossary()
    for spelling, term in glossary._SPELLINGS.items():
        assert found[spelling] is found[term], spelling


@given(st.lists(st.sampled_from(["RMSE", "stated std", "9 mm/frame", "a < b", "density", "x", "p95_abs_error", "°"])))
def test_no_word_is_changed(parts: list[str]) -> None:
    text = " ".join(parts).replace("<", "&lt;")
    assert words(page_of(f"<p>{text}</p><td>{text}</td>")) == words(f"<title>RMSE</title><p>{text}</p><td>{text}</td>")


def test_first_uses_are_reached_by_the_keyboard_in_every_section() -> None:
    page = page_of("<section><p>RMSE</p><p>RMSE</p></section><section><p>RMSE</p></section>")
    stops = re.findall(r'<span class="term" data-term="rmse"( tabindex="0" aria-describedby="term-rmse")?>', page)
    assert [bool(stop) for stop in stops] == [True, False, True]
    assert page.count('id="term-rmse"') == 1


def test_every_reference_has_its_definition() -> None:
    page = page_of("".join(f"<p>{name}</p>" for name in read_glossary()))
    ids = re.findall(r'<p id="(term-[^"]+)">', page)
    assert len(ids) == len(set(ids)) > 50
    assert set(re.findall(r'aria-describedby="([^"]+)"', page)) == set(ids)
    assert {f"term-{key}" for key in re.findall(r'data-term="([^"]+)"', page)} == set(ids)


def test_headings_of_columns_have_definitions_and_stay_buttons() -> None:
    page = page_of('<table><tr><th scope="col"><button type="button">RMSE of depth</button></th></tr></table>')
    assert '<button type="button" data-term="rmse" aria-describedby="term-rmse">RMSE of depth</button>' in page


@pytest.mark.parametrize("name", ["code", "pre", "script", "style", "svg", "a", "select", "h1", "textarea"])
def test_code_links_and_pictures_are_left_alone(name: str) -> None:
    body = f"<{name}>RMSE, depth in 9 mm</{name}>"
    assert body in page_of(f"<p>bias {body}</p>")


@pytest.mark.parametrize("text", ["nothing in common", "bias.x", "debias", "stage.depth", "depth-first", "a/bias/b"])
def test_parts_of_other_words_are_no_terms(text: str) -> None:
    assert "data-term" not in page_of(f"<p>{text}</p>")


@pytest.mark.parametrize("text", ["0.0351 mm/frame", "5 %", "−2.5 %/h", "3 × 10⁻⁵ 1/frame", "1 204 px", "90 s"])
def test_no_line_breaks_between_a_number_and_its_unit(text: str) -> None:
    spelled = text.replace("1 204", "1\u202f204")
    assert f'<span class="nowrap">{spelled}</span>' in page_of(f"<p>about {spelled}, at most</p>")


def test_plurals_and_identifiers_are_terms() -> None:
    page = page_of("<p>recordings, inlier_rate, P95_ABS_ERROR</p>")
    assert re.findall(r'data-term="([^"]+)"', page) == [
        "recording",
        "bad-pixel-rate",
        "95th-percentile-p95",
    ]


def test_without_a_glossary_pages_stay_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    read_glossary.cache_clear()
    monkeypatch.setattr(glossary, "glossary_file", lambda: None)
    try:
        assert define_terms("<body><p>RMSE</p></body>") == "<body><p>RMSE</p></body>"
    finally:
        monkeypatch.undo()
        read_glossary.cache_clear()
