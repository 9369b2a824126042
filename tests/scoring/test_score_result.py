"""Score files that are damaged are told of, with the place; what is read can be shown."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as some

from scenetruth.errors import ScoreError, StoreError
from scenetruth.scoring import Score, score
from scenetruth.scoring.report import build_score_content
from tests.helpers.synthetic_case import make_case

CASE = make_case()
GOOD = score(CASE.estimate, CASE.truth).to_json()
TREE = json.loads(GOOD)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is not JSON"),
        (b"\xff\xfe{}", "is not JSON"),
        (GOOD[: len(GOOD) // 2].encode(), "is not JSON"),
        (b"[" * 100_000, "is not JSON: is nested too deeply"),
        (b"[]", "must be a JSON object"),
        (
            GOOD.replace('"count": ', '"count": 9e400, "x": ', 1).encode(),
            r"all\.\w+\.count: must be a non-negative integer",
        ),
        (GOOD.replace('"bias": ', '"bias": NaN, "x": ', 1).encode(), r"all\.\w+\.bias: must be a finite number"),
        (GOOD.replace('"bias": ', '"bias": "3", "x": ', 1).encode(), r"all\.\w+\.bias: must be a finite number"),
        (GOOD.replace('"bias": ', f'"bias": {10**400}, "x": ', 1).encode(), "does not fit into 64 bits"),
        (
            GOOD.replace('"metadata": {', '"metadata": {"a": ' + "[" * 60 + "]" * 60 + ",").encode(),
            "is nested more than",
        ),
        (GOOD.replace('"margin_px": ', '"margin_px": "a", "x": ').encode(), "metadata.margin_px: must be a finite"),
        (
            GOOD.replace('"score_settings": ', '"score_settings": 3, "x": ').encode(),
            "metadata.score_settings: invalid",
        ),
    ],
)
def test_damaged_scores_are_told_of(tmp_path: Path, content: bytes, message: str) -> None:
    with pytest.raises(ScoreError, match=message):
        Score.from_json(content)
    file = tmp_path / "score.json"
    file.write_bytes(content)
    with pytest.raises(StoreError, match=message) as caught:
        Score.load(file)
    assert str(caught.value).startswith(str(file))


@pytest.mark.parametrize("text", [None, 3, ["a"]])
def test_what_is_no_text(text: Any) -> None:
    with pytest.raises(ScoreError, match="is not JSON"):
        Score.from_json(text)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="cannot be read"):
        Score.load(tmp_path / "score.json")
    with pytest.raises(StoreError, match="is a directory"):
        Score.load(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(StoreError, match="is not a regular file"):
        Score.load(tmp_path / "pipe")


values: some.SearchStrategy[Any] = (
    some.none()
    | some.booleans()
    | some.integers()
    | some.floats()
    | some.text(max_size=3)
    | some.just([])
    | some.just({})
)


@given(some.data())
def test_any_change_is_refused_or_can_be_shown(data: Any) -> None:
    tree = json.loads(GOOD)
    here = tree
    for _ in range(data.draw(some.integers(0, 3))):
        inner = [item for item in here.values() if isinstance(item, dict) and item]
        if not inner:
            break
        here = data.draw(some.sampled_from(inner))
    here[data.draw(some.sampled_from([*here, "new"]))] = data.draw(values)
    with contextlib.suppress(ScoreError):
        found = Score.from_json(json.dumps(tree))
        repr(found), found.to_csv(), found._repr_html_(), build_score_content(found)
