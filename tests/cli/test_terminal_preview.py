"""Small pictures in the terminal: means of what they cover, two pixels to a character, and never in a pipe."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as any_
from rich.console import Console

import scenetruth as st
from scenetruth.cli.terminal_preview import downsample, print_picture, render_rows, shows_pictures


@given(any_.integers(1, 5), any_.integers(1, 6), any_.integers(1, 7), any_.integers(0, 2**31))
def test_whole_blocks_become_their_means(block: int, lines: int, columns: int, seed: int) -> None:
    picture = np.random.default_rng(seed).random((lines * block, columns * block, 3))
    means = picture.reshape(lines, block, columns, block, 3).mean(axis=(1, 3))
    # Sums of 25 numbers at most, each rounded to 1e-16.
    np.testing.assert_allclose(downsample(picture, columns), means, rtol=0, atol=1e-13)


@given(any_.integers(1, 90), any_.integers(1, 90), any_.integers(1, 100))
def test_any_size_keeps_a_constant_and_its_shape(height: int, width: int, columns: int) -> None:
    found = downsample(np.full((height, width, 1), 0.25), columns)
    assert found.shape[1] == min(columns, width)
    assert abs(found.shape[0] - height * found.shape[1] / width) <= 0.5 or found.shape[0] == 1
    assert (found == 0.25).all()


def test_pixels_with_less_than_half_of_them_are_empty() -> None:
    picture = np.full((2, 4, 1), np.nan)
    picture[0, 0] = 1.0
    picture[:, 2] = 3.0
    assert np.array_equal(downsample(picture, 2)[..., 0], [[np.nan, 3.0]], equal_nan=True)


def test_a_character_is_two_pixels() -> None:
    red, blue, none = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (np.nan,) * 3
    lines = render_rows(np.array([[red, red, none, none], [blue, none, blue, none], [blue, red, none, none]]))
    assert [line.plain for line in lines] == ["▀▀▄ ", "▀▀  "]
    assert [str(span.style) for span in lines[0].spans] == ["#ff0000 on #0000ff", "#ff0000", "#0000ff"]


def terminal(**settings: object) -> Console:
    made = Console(
        file=io.StringIO(), force_terminal=True, width=80, color_system="truecolor", no_color=False, highlight=False
    )
    for name, value in settings.items():
        setattr(made, name, value)
    return made


@contextmanager
def on_terminal(encoding: str = "utf-8") -> Iterator[None]:
    """Let standard output be a terminal; the encoding is that of all consoles."""
    with (
        mock.patch.object(sys, "stdout", mock.Mock(isatty=lambda: True, encoding="utf-8")),
        mock.patch.object(Console, "encoding", encoding),
    ):
        yield


def test_terminals_say_whether_they_have_the_colours() -> None:
    with on_terminal():
        assert shows_pictures(terminal())
        assert not shows_pictures(terminal(no_color=True))
        assert not shows_pictures(terminal(width=30))
        assert not shows_pictures(Console(file=io.StringIO(), force_terminal=True, color_system="standard"))
        assert not shows_pictures(Console(file=io.StringIO(), force_terminal=False))
    with on_terminal("ascii"):
        assert not shows_pictures(terminal())


def test_a_pipe_gets_none_even_if_colours_are_forced(tmp_path: Path) -> None:
    console = terminal()
    with mock.patch.object(sys, "stdout", mock.Mock(isatty=lambda: False, encoding="utf-8")):
        print_picture(st.RunDirectory(tmp_path / "nothing"), "any", console)
    assert console.file.getvalue() == ""  # type: ignore[attr-defined]


@pytest.mark.parametrize("with_depth", [True, False])
def test_image_and_depth_are_printed(with_depth: bool, tmp_path: Path) -> None:
    images = np.random.default_rng(1).random((3, 3, 12, 160)).astype(np.float32)
    recording = st.make_recording(images, focal_length_px=50, baseline_mm=2)
    depth = np.tile(np.linspace(70, 90, 160), (3, 12, 1))
    flow = np.zeros((2, 3, 12, 160))
    estimate = st.make_estimate(depth=depth if with_depth else None, flow=flow, recording=recording)
    st.save_store(recording, tmp_path / "recording.zarr")
    st.save_store(estimate, tmp_path / "estimate.zarr")
    console = terminal()
    with on_terminal():
        print_picture(st.RunDirectory(tmp_path, "mine"), "mine", console)
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    # 39 columns for a picture of 160 x 12: three lines of pixels, which take two of characters, and the caption.
    assert len(lines) == 3
    assert [line.count("▀") + line.count("▄") for line in lines] == ([78, 78, 0] if with_depth else [39, 39, 0])
    assert "38;2;" in lines[0]
    caption = re.search(r"depth, (\S+) \(dark\) to (\S+) mm", lines[2])
    assert (caption is not None) == with_depth
    if caption is not None:
        # The 2nd and the 98th percentile of 70 to 90 mm, in columns 20 mm / 159 apart.
        assert [float(number) for number in caption.groups()] == pytest.approx([70.4, 89.6], abs=0.13)
