"""The search of the site: an index of the pages' sources, ranked by the site's own scripts in node."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from scenetruth_site.search import RANKING, search_script, search_words
from scenetruth_site.toctrees import pages_of

__all__ = ["first_pages"]

DOCS = Path(__file__).parents[2] / "docs"

_RUN = """
const fs = require("fs"), vm = require("vm");
const { scripts, queries } = JSON.parse(fs.readFileSync(0, "utf8"));
const nothing = () => undefined;
const document = { addEventListener: nothing, getElementById: () => ({ querySelectorAll: () => [], firstChild: null }),
                   querySelectorAll: () => [], documentElement: { dataset: {} } };
const context = vm.createContext({ document, localStorage: { setItem: nothing }, _ready: nothing, _: (text) => text,
                                   SPHINX_HIGHLIGHT_ENABLED: false, URLSearchParams, location: { search: "" } });
context.window = context;
for (const script of scripts) vm.runInContext(script, context);
const found = {};
for (const query of queries) {
  context.location.search = `?q=${encodeURIComponent(query)}`;
  context.query = query;
  const results = vm.runInContext("Search._performSearch(...Search._parseQuery(query))", context);
  found[query] = [...new Set(results.reverse().map((result) => result[0]))];
}
console.log(JSON.stringify(found));
"""


def first_pages(queries: list[str], count: int) -> dict[str, list[str]]:
    """Return the first pages of each query, as the search page of the site lists them."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node")
    given = json.dumps({"scripts": _scripts(), "queries": queries})
    done = subprocess.run([node, "-e", _RUN], input=given, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    return {query: pages[:count] for query, pages in json.loads(done.stdout).items()}


@cache
def _scripts() -> list[str]:
    search = pytest.importorskip("sphinx.search.en").SearchEnglish({})
    folder = Path(pytest.importorskip("sphinx").__file__).parent
    stemmers = [
        (folder / "search" / "minified-js" / name).read_text(encoding="utf-8")
        for name in ("base-stemmer.js", "english-stemmer.js")
    ]
    return [
        f"var stopwords = new Set({json.dumps(sorted(search.stopwords))});",
        *stemmers,
        "var Stemmer = EnglishStemmer;",
        search_script(),
        (folder / "themes" / "basic" / "static" / "searchtools.js").read_text(encoding="utf-8"),
        RANKING.read_text(encoding="utf-8"),
        f"Search.setIndex({json.dumps(_index(search))});",
    ]


def _index(search: Any) -> dict[str, Any]:
    """Return an index of titles and words, as Sphinx makes it, of the text in the files."""
    pages = sorted(pages_of(DOCS))
    titles = []
    headings: dict[str, list[tuple[int, str | None]]] = defaultdict(list)
    terms: dict[str, set[int]] = defaultdict(set)
    title_terms: dict[str, set[int]] = defaultdict(set)
    stems = cache(search.stem)

    def add(table: dict[str, set[int]], text: str, number: int) -> None:
        for word in set(search.split(text.lower())):
            if search.word_filter(word):
                table[stems(word)].add(number)

    for number, page in enumerate(pages):
        file = next(path for suffix in (".md", ".ipynb") if (path := DOCS / f"{page}{suffix}").is_file())
        text = re.sub(r"```.*?```|\]\([^)]*\)", " ", file.read_text(encoding="utf-8"), flags=re.DOTALL)
        found = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE) or [page]
        titles.append(found[0])
        for heading in found:
            headings[heading].append((number, None if heading == found[0] else heading.lower().replace(" ", "-")))
            add(title_terms, heading, number)
        add(terms, " ".join([text, *search_words().get(page, ())]), number)
    return {
        "docnames": pages,
        "filenames": [f"{page}.md" for page in pages],
        "titles": titles,
        "alltitles": headings,
        "terms": {word: sorted(files) for word, files in terms.items()},
        "titleterms": {word: sorted(files) for word, files in title_terms.items()},
        "indexentries": {},
        "objects": {},
        "objnames": {},
        "objtypes": {},
    }
