"""Patterns of file names: what they match, what they guess, and what is missing."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenetruth.capture import expected_indices, guess_patterns, list_names, nearest_patterns, read_pattern

SPECS = st.sampled_from(["", ":d", ":+d", ":03d", ":+04d", ":02d"])


@given(SPECS, SPECS, st.integers(-99, 999), st.integers(-99, 999), st.sampled_from(["_", "/", "-x", ".a."]))
def test_pattern_reads_the_name_that_it_writes(first: str, second: str, s: int, t: int, between: str) -> None:
    pattern = read_pattern(f"p{{s{first}}}{between}{{t{second}}}.png")
    name = f"p{format(s, first[1:])}{between}{format(t, second[1:])}.png"
    assert pattern.name(s=s, t=t) == name
    found = pattern.match(name)
    assert found is not None
    assert dict(found.indices) == {"s": s, "t": t}


@given(st.integers(0, 9999), st.sampled_from(["+d", "03d", "+03d"]))
def test_format_matches_no_other_spelling_of_a_number(number: int, spec: str) -> None:
    pattern = read_pattern(f"{{t:{spec}}}.png")
    for spelled in (str(number), f"+{number}", f"0{number}", f"00{number}", f"+0{number}"):
        assert (pattern.match(f"{spelled}.png") is not None) == (spelled == format(number, spec))


def test_wildcards_do_not_cross_folders() -> None:
    pattern = read_pattern("run?/*_{t}.png")
    assert pattern.match("run1/any.thing_4.png") is not None
    assert pattern.match("run1/inner/a_4.png") is None
    assert pattern.match("run12/a_4.png") is None
    assert read_pattern("a.b[1]{t}.png").match("aXb[1]2.png") is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{s}{t}.png", "without a character between"),
        ("{q}.png", "unknown field {q}; fields are"),
        ("{tt}.png", "did you mean {t}?"),
        ("{s:x}.png", "format of an integer"),
        ("{s:.2f}.png", "format of an integer"),
        ("{s}_{s}.png", "twice"),
        ("/tmp/{s}.png", "must be relative"),
        ("../{s}.png", "must be relative"),
        ("a\\{s}.png", "must be relative"),
        ("{s.png", "unpaired brace"),
        ("  ", "must be a path"),
    ],
)
def test_invalid_pattern_says_why(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message.replace("{", r"\{").replace("?", r"\?")):
        read_pattern(text)


def test_all_reasons_are_listed_together() -> None:
    with pytest.raises(ValueError, match=r"unknown field.*lacks the field \{pose\}"):
        read_pattern("/a/{q}.png", required=("pose",))


def test_time_stamps_are_read_and_checked() -> None:
    pattern = read_pattern("{time:%Y%m%d_%H%M%S_%f}-{s}.tif", ("s", "time"))
    one, other = (pattern.match(f"20240229_0000{second}_250000-1.tif") for second in ("01", "31"))
    assert one is not None
    assert other is not None
    assert other.time_s is not None
    assert one.time_s is not None
    assert other.time_s - one.time_s == 30.0
    assert pattern.match("20240230_000001_250000-1.tif") is None  # no such day
    with pytest.raises(ValueError, match="format of time"):
        read_pattern("{time}.tif", ("time",))
    with pytest.raises(ValueError, match="format of time"):
        read_pattern("{time:%Q}.tif", ("time",))


@given(
    st.lists(st.integers(0, 2000), min_size=2, max_size=8, unique=True),
    st.lists(st.integers(-9, 9), min_size=2, max_size=5, unique=True),
    st.sampled_from(["{s:+d}", "{s:+03d}", "{s}"]),
    st.sampled_from(["{t}", "{t:03d}", "{t:05d}"]),
)
def test_guess_matches_all_names_of_its_group(frames: list[int], places: list[int], first: str, second: str) -> None:
    written = read_pattern(f"data/pos{first}_frame{second}.tif")
    names = [written.name(s=s, t=t) for s in places for t in frames]
    (guess,) = guess_patterns(names)
    read = read_pattern(guess.text)
    assert {one.name for one in read.matches(names)} == set(names)
    if any(s >= 0 for s in places):
        # All positions negative: the minus may as well separate words.
        assert {(one.indices["s"], one.indices["t"]) for one in read.matches(names)} == {
            (s, t) for s in places for t in frames
        }
    assert guess.doubts == ()


def test_guess_says_what_it_does_not_know() -> None:
    names = [f"{s}_{t}.png" for s in range(3) for t in range(4)]
    (guess,) = guess_patterns(names)
    assert guess.text == "{s}_{t}.png"
    assert set(guess.doubts) == {"s", "t"}
    (single,) = guess_patterns([f"IMG_{n:04d}.JPG" for n in range(7, 12)])
    assert single.text == "IMG_{t:04d}.JPG"
    (dated,) = guess_patterns([f"2024-01-05_pos{s}.png" for s in range(3)])
    assert dated.text == "2024-01-05_pos{s}.png"


def test_nearest_pattern_is_that_of_the_likely_files() -> None:
    names = [f"images/pos{s}_t{t:03d}.tif" for s in range(3) for t in range(9, 12)] + ["dark/d0.tif", "dark/d1.tif"]
    for wrong in ("images/pos{s}_t{t:02d}.tif", "image/pos{s}_t{t}.tif", "images/pos{s}_t{t:03d}.png"):
        (first, *_) = nearest_patterns(read_pattern(wrong), names)
        assert first.text == "images/pos{s}_t{t:03d}.tif"
    assert nearest_patterns(read_pattern("z{t}"), ["0123456789abcdefghij.png"]) == []


@given(st.integers(2, 9), st.sampled_from(["centred", "zero", "one", "far"]), st.data())
def test_expected_indices_are_complete_or_ambiguous(count: int, kind: str, data: st.DataObject) -> None:
    start = {"centred": -((count - 1) // 2), "zero": 0, "one": 1, "far": 40}[kind]
    true = list(range(start, start + count))
    left = data.draw(st.lists(st.sampled_from(true), min_size=1, max_size=count, unique=True))
    found, why = expected_indices(left, count, signed=kind == "centred")
    # Never another answer than the true one, except where the ends are missing of numbers that start elsewhere.
    if not why and (min(left), max(left)) == (true[0], true[-1]):
        assert found == true
    if kind != "far" and not why:
        assert found == true
    assert bool(why) == (found == [])


def test_names_are_listed_in_natural_order_without_hidden_files(tmp_path: Path) -> None:
    for name in ("t10.png", "t9.PNG", "a/t2.png", ".hidden.png", ".git/x.png", "note.txt"):
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True)
        file.touch()
    assert list_names(tmp_path, suffixes=(".png",)) == ["a/t2.png", "t9.PNG", "t10.png"]
    with pytest.raises(ValueError, match="more than 2 files"):
        list_names(tmp_path, most=2)
