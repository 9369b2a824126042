"""YAML becomes plain values, as the library reads them, or problems with their lines, soon and in little memory."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as some

import scenetruth as st
from scenetruth.plain_data import MAX_DEPTH, MAX_VALUES
from scenetruth.scene.yaml_reader import MAX_YAML_BYTES, read_yaml
from tests.helpers.scenes import LIBRARY, SCENES

CUBE = (SCENES / "cube.yaml").read_text(encoding="utf-8")

# What ends a line besides the line feed, yaml itself writes so that it reads as a space.
words = some.text(some.characters(exclude_categories=["Cs"], exclude_characters="\0\x85\u2028\u2029"), max_size=8)
scalars = (
    some.none()
    | some.booleans()
    | some.integers(-(2**63) + 1, 2**63 - 1)
    | some.floats(allow_nan=False)
    | words
    | some.sampled_from(["1:30", "on", "0x1f", "1e3", "1.0e+3", "~", "=", "<<", "0o7", "1_000", ".5", "+.inf"])
)
trees = some.recursive(
    scalars, lambda inner: some.lists(inner, max_size=4) | some.dictionaries(words, inner, max_size=4)
)


@given(tree=trees, flow=some.booleans())
def test_what_yaml_wrote_is_read_again(tree: object, flow: bool) -> None:
    assert read_yaml(yaml.safe_dump(tree, default_flow_style=flow, allow_unicode=True)) == (tree, [])


# Of mixed lengths, plain and quoted: the library's own rules are the yardstick.
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1:30", "in base 60"),
        ("-12:30:45", "in base 60"),
        ("1:30.5", "in base 60"),
        ("0060", "leading zeros in base 8"),
        ("010", "leading zeros in base 8"),
        (r'"C:\Users\me"', r"in double quotes, \ begins a special character"),
    ],
)
def test_numbers_and_paths_that_mean_something_else_are_refused(text: str, message: str) -> None:
    (problem,) = read_yaml(f"value: {text}")[1]
    assert message in problem.message
    assert read_yaml(f"value: '{text}'")[1] == []


@given(text=some.text("0123456789abcdefxon:._+-~ '\"[]{},", max_size=12))
def test_words_mean_what_they_mean_to_the_library(text: str) -> None:
    value, problems = read_yaml(text)
    try:
        expected = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError):
        assert problems
        return
    if not problems:
        assert value == expected or (value != value and expected != expected)


@pytest.mark.parametrize("file", LIBRARY, ids=lambda file: file.stem)
def test_scenes_are_read_as_the_library_reads_them(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    assert read_yaml(text) == (yaml.safe_load(text), [])


def test_aliases_are_copies_and_merges_come_last() -> None:
    text = "base: &base {a: 1, b: [1]}\nother: *base\nthird: {<<: [*base, {c: 3}], b: 2}"
    value, problems = read_yaml(text)
    assert not problems
    assert value == yaml.safe_load(text)
    value["base"]["b"].append(2)
    assert value["other"]["b"] == [1]


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{chr(98 + n)}: &{chr(98 + n)} [{','.join(['*' + chr(97 + n)] * 9)}]\n" for n in range(9)
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seed: 2020-13-45", r"seed: line 1: YAML reads this as a date.*quote it.*\(got '2020-13-45'\)"),
        ("seed: 2020-01-01", "seed: line 1: YAML reads this as a date"),
        ("seed: !!int ''", "seed: line 1: cannot be read as an integer"),
        ("seed: !!timestamp x", "seed: line 1: YAML reads this as a date"),
        ("seed: !!bool maybe", "seed: line 1: cannot be read as a boolean"),
        ("seed: !!float x", "seed: line 1: cannot be read as a number"),
        (f"seed: {2**63}", "seed: line 1: does not fit into 64 bits"),
        (f"seed: !!int {'9' * 5000}", "seed: line 1: does not fit into 64 bits"),
        ("seed: !!binary aGk=", "the tag !!binary is not supported"),
        ("seed: !!python/name:os.system x", r"the tag !!python/name:os\.system is not supported"),
        ("a: {b: !!set {x}}", r"a\.b: line 1: the tag !!set is not supported"),
        ("a: !foo [1]", "a: line 1: the tag !foo is not supported"),
        ("a: 1\nb:\n  - c: 1\n    c: 2", r"b\.0\.c: line 4: duplicate key, first defined in line 3"),
        ("1: 2\non: 3", r"line 1: a key must be text, but YAML reads it as an integer.*\(got '1'\)"),
        ("? [a]\n: 3", "line 1: a mapping or list cannot be a key"),
        ("<<: 3", "line 1: << merges mappings, but this is not a mapping"),
        ("a: &a [*a]", r"line 1: the alias \*a is recursive"),
        ("a: *b", r"line 1: the alias \*b has no preceding anchor"),
        (BOMB, f"has more than {MAX_VALUES:,} values, with each use of an alias counted"),
        ("[" * 100_000, f"line 1: is nested more than {MAX_DEPTH} deep"),
        ("- " * 100_000, f"line 1: is nested more than {MAX_DEPTH} deep"),
        ("a: &a " + "[" * 30 + "]" * 30 + "\nb: " + "[" * 30 + "*a" + "]" * 30, "nested more than"),
        ("a: [" + "1," * 1_900_000 + "]", f"has more than {MAX_VALUES:,} values"),
        ("a:\n\t- b", "line 2, column 1: is not valid YAML: .*cannot start any token; indent with spaces, not tabs$"),
        ("a:\n  b: 1\n\tc: 2", "line 3, column 1: .*; indent with spaces, not tabs$"),
        ("a: 1\r\nb:\r\n  \t- c: \u00e9", "line 3, column 3: .*; indent with spaces, not tabs$"),
        ("description: Leaf: day 3", "line 1, column 18: is not valid YAML: .*; quote text that contains a colon$"),
        (
            "a: 1\n  b: 2",
            "line 2, column 4: .*; align the line with its neighbours, or quote text that contains a colon",
        ),
        ("a: @b", "line 1, column 4: .*; quote text that begins with @$"),
        ("a:\n  b: 1\n c: 2", "line 3, column 2: .*; align lines of one block, and check for an unclosed quote"),
        (r'a: "C:\data\leaf.obj"', r"line 1, column 7: .*; in double quotes, \\ begins a special character: use / in"),
        ("a: {b: 50,5}", "a key must be text.*; a number has a decimal point, not a comma"),
        ("a: 1\nb: \x1b[31m", "line 2: is not valid YAML: contains a control character"),
        ('a: "\\0"', "a: line 1: holds the character NUL"),
        ("--- 1\n--- 2", "line 2: a second document starts"),
        ("%TAG ! tag:x,2000:\n---\n!a b", "the directive %TAG is not supported"),
    ],
    ids=lambda text: text[:20],
)
def test_what_is_no_scene_is_refused_with_its_line_and_soon(text: str, message: str) -> None:
    started = time.process_time()
    problems = read_yaml(text)[1]
    assert time.process_time() - started < 5
    with pytest.raises(st.SceneError, match=message):
        raise st.SceneError(problems)


def test_all_problems_are_told_at_once() -> None:
    problems = read_yaml("a: 2020-01-01\nb: !x 1\na: 3\nc: *d")[1]
    assert [problem.message.partition(":")[0] for problem in problems] == ["line 1", "line 2", "line 3", "line 4"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty; it must be a mapping"),
        (b"# nothing\n", "is empty; it must be a mapping"),
        (CUBE.encode("utf-16"), "is UTF-16 or UTF-32; save it as UTF-8"),
        (CUBE.encode("utf-16-le"), "is UTF-16 or UTF-32"),
        (CUBE.encode("utf-32"), "is UTF-16 or UTF-32"),
        (CUBE.encode("latin-1"), r"line 1: is not UTF-8 \(byte 0xfc\)"),
    ],
)
def test_files_that_are_no_text_of_ours(tmp_path: Path, content: bytes, message: str) -> None:
    file = tmp_path / "scene.yaml"
    file.write_bytes(content)
    with pytest.raises(st.SceneError, match=message):
        st.load_scene(file)


def test_a_mark_of_utf_8_is_no_harm(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_bytes(b"\xef\xbb\xbf" + CUBE.encode())
    assert st.load_scene(file) == st.load_scene(SCENES / "cube.yaml")


def test_large_files_are_refused_before_they_are_read(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    with file.open("wb") as stream:
        stream.truncate(10**12)  # takes no room
    with pytest.raises(
        st.SceneError, match=rf"has 1,000,000,000,000 bytes; a scene file has at most {MAX_YAML_BYTES:,}"
    ):
        st.load_scene(file)


def test_what_is_no_file_is_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(st.SceneError, match=r"is not a regular file \(a pipe, a socket or a device\)"):
            st.load_scene(path)
    with pytest.raises(st.SceneError, match="is a directory; specify the path of a scene file"):
        st.load_scene(tmp_path)


@pytest.mark.parametrize("path", ["", "a\0b", "x" * 5000, "\udc80", None, 3, b"scene.yaml", ["a"]])
def test_paths_that_are_none(path: object) -> None:
    with pytest.raises(st.SceneError):
        st.load_scene(path)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("objects.²=1", "'objects' is a list of 1; '²' is not an index of it"),
        ("objects.--1=1", "'--1' is not an index of it"),
        ("objects.99999999999999999999=1", "is not an index of it"),
        ("a..b=1", r"must have the form path=value, such as camera\.width=320 \(got 'a\.\.b=1'\)"),
        ("", "must have the form path=value"),
        ("seed=*b", r"--set seed: value, line 1: the alias \*b has no preceding anchor"),
        ("camera={width: 1, width: 2}", r"--set camera\.width: value, line 1: duplicate key"),
        ("seed=\udc80", "--set seed: value, is not valid YAML"),
        ("\udc80=1", "a key holds half a character"),
        ("camera." + "x." * 100_000 + "y=1", f"is nested more than {MAX_DEPTH} deep"),
        ("seed=" + BOMB.replace("\n", ", ").join("{}"), "has more than"),
        ("seed=" + "9" * 10**6, "seed: .*maximum size"),
        ("seed=" + " " * (MAX_YAML_BYTES + 1), "value must have at most"),
    ],
    ids=lambda text: text[:20],
)
def test_overrides_are_bounded_alike(override: str, message: str) -> None:
    started = time.process_time()
    with pytest.raises(st.SceneError, match=message) as caught:
        st.load_scene(SCENES / "cube.yaml", overrides=[override])
    assert len(str(caught.value)) < 3000
    assert time.process_time() - started < 5


def test_thousands_of_wrong_fields_are_told_soon(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(CUBE + "\n" + "".join(f"k{n}: {n}\n" for n in range(50_000)))
    started = time.process_time()
    with pytest.raises(st.SceneError, match=r"49,900 more problems are omitted; fix these first"):
        st.load_scene(file)
    assert time.process_time() - started < 5


@pytest.mark.parametrize(
    ("plain", "message"),
    [
        (None, "must be a mapping"),
        ("text", "must be a mapping"),
        ([("camera", 1)], "must be a mapping"),
        ({3: 4}, "keys must be texts, not of type int"),
        ({"seed": 2**64}, "seed: does not fit into 64 bits"),
        ({"seed": 10**5000}, "seed: does not fit into 64 bits .got an integer of 16610 bits"),
        ({"description": "a\0"}, "description: holds the character NUL"),
        ({"description": "\ud800"}, "description: holds half a character"),
    ],
)
def test_plain_values_that_are_none(plain: object, message: str) -> None:
    with pytest.raises(st.SceneError, match=message):
        st.Scene.from_dict(plain)  # type: ignore[arg-type]


def test_plain_values_that_never_end() -> None:
    endless: dict[str, object] = {}
    endless["camera"] = [endless]
    with pytest.raises(st.SceneError, match=r"camera\.0: contains itself"):
        st.Scene.from_dict(endless)
    deep: object = 1
    for _ in range(10_000):
        deep = [deep]
    with pytest.raises(st.SceneError, match=f"is nested more than {MAX_DEPTH} deep"):
        st.Scene.from_dict({"camera": deep})
    wide: list[object] = ["x"]
    for _ in range(60):
        wide = [wide, wide]
    with pytest.raises(st.SceneError, match="nested more than"):
        st.Scene.from_dict({"camera": wide})
