"""Figures as vectors, beside the PNG files that do not change by it."""

from __future__ import annotations

from pathlib import Path

import pytest

from scenetruth.errors import ScoreError
from scenetruth.scoring import plot_all, score, write_report
from tests.scoring.conftest import Drawn
from tests.scoring.synthetic import Case

FEW = ("surface", "velocity_z_row")


def test_pdf_files_stand_beside_unchanged_pictures(full_case: Case, drawn: Drawn, tmp_path: Path) -> None:
    case, result = full_case, score(full_case.estimate, full_case.truth)
    for folder, names in (("one", FEW), ("other", FEW[1:])):
        plot_all(case.recording, case.estimate, case.truth, result, tmp_path / folder, names=names, also=("pdf",))
    files = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert files == sorted(f"{name}.{form}" for name in FEW for form in ("pdf", "png"))
    for name in FEW:
        picture = (tmp_path / "one" / f"{name}.png").read_bytes()
        assert picture == (drawn.folder / f"{name}.png").read_bytes()
        vectors = (tmp_path / "one" / f"{name}.pdf").read_bytes()
        assert vectors.startswith(b"%PDF-")
        # Letters are letters, and the maker is told where it is looked for.
        assert b"/FontFile2" in vectors
        assert b"scenetruth" in vectors[-100:]
    again = (tmp_path / "other" / f"{FEW[1]}.pdf").read_bytes()
    assert again == (tmp_path / "one" / f"{FEW[1]}.pdf").read_bytes()


def test_without_asking_there_are_none(drawn: Drawn) -> None:
    assert {path.suffix for path in drawn.folder.iterdir()} == {".png"}


def test_a_report_has_them_too(full_case: Case, tmp_path: Path) -> None:
    page = write_report(
        full_case.estimate,
        recording=full_case.recording,
        output=tmp_path,
        figures=("velocity_z_row",),
        figure_formats=("png", "pdf"),
    )
    assert {path.name for path in (page.parent / "figures").iterdir()} == {"velocity_z_row.pdf", "velocity_z_row.png"}


def test_other_formats_are_named_with_those_that_there_are(full_case: Case, tmp_path: Path) -> None:
    with pytest.raises(ScoreError, match=r"figures.*unknown.*\n.*formats.*unknown; available: pdf.*tiff"):
        plot_all(full_case.recording, full_case.estimate, folder=tmp_path / "none", names=("fog",), also=("tiff",))
    assert not (tmp_path / "none").exists()
