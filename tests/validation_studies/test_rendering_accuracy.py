"""The registration to the exact image, and the experiment at a small size."""

from __future__ import annotations

import csv
import json
import sys
from functools import partial
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
from typer.testing import CliRunner

import scenetruth as st
from scenetruth import validation_studies
from scenetruth.cli.app import app
from scenetruth.render import opengl
from scenetruth.render.raycast_backend import RaycastRenderer
from scenetruth.validation_studies.noise_plane import PlaneImage, noise_plane, reference_image
from scenetruth.validation_studies.rendering_accuracy import (
    SHIFTS_PX,
    TEXTURES_PX,
    run_fidelity,
    shift_errors,
)
from tests.helpers.nightly import nightly

SMALL = (50, 75)


@pytest.fixture(scope="module")
def exact() -> PlaneImage:
    return reference_image(noise_plane(TEXTURES_PX["band-limited"], SMALL))


@pytest.mark.parametrize("e", [(0.003, 0.0), (0.0, -0.002), (-0.001, 0.004)])
def test_registration_finds_a_known_shift(exact: PlaneImage, e: tuple[float, float]) -> None:
    moved = exact.points(0.5 + e[0], (0.0, -e[1]))
    still = exact.points(0.5)
    h = 1e-4
    across, down = (
        (exact.points(0.5, (h * u, h * v)) - exact.points(0.5, (-h * u, -h * v))) / (2 * h) for u, v in ((1, 0), (0, 1))
    )
    found = shift_errors(moved, still, across, down, 25)
    assert found.shape == (2, 3, 2)
    # One linear step leaves e² / wavelength.
    np.testing.assert_allclose(found, np.broadcast_to(e, found.shape), atol=4e-6)


def test_registration_is_the_least_squares_solution() -> None:
    generator = np.random.default_rng(5)
    image, values, across, down = generator.standard_normal((4, 17, 23))
    found = shift_errors(image, values, across, down, 8)
    assert found.shape == (2, 2, 2)
    part = np.s_[8:16, 8:16]
    design = np.column_stack([-across[part].ravel(), -down[part].ravel()])
    expected = np.linalg.lstsq(design, (image - values)[part].ravel(), rcond=None)[0]
    np.testing.assert_allclose(found[1, 1], expected, rtol=1e-12)


@pytest.fixture
def one_texture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the texture that has a bound: `test_the_whole_experiment` has both."""
    monkeypatch.setattr(
        "scenetruth.validation_studies.rendering_accuracy.TEXTURES_PX", {"band-limited": TEXTURES_PX["band-limited"]}
    )


@pytest.mark.usefixtures("one_texture")
def test_a_shifted_texture_is_found_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A renderer whose images lie a thousandth of a pixel off must not pass."""
    monkeypatch.setattr(opengl, "_why_not", lambda platform: f"no {platform} here")
    monkeypatch.delitem(sys.modules, "OpenGL", raising=False)
    render = RaycastRenderer.render
    monkeypatch.setattr(RaycastRenderer, "render", lambda self, t, viewpoint: render(self, t + 1e-3, viewpoint))
    results, reason = run_fidelity(tmp_path, samplings=[4], shape=SMALL)
    assert "no osmesa here" in reason
    assert [result.backend for result in results] == ["raycast"]
    assert results[0].within_bounds is False
    # Of x and y only x is wrong.
    assert results[0].rms_px == pytest.approx(1e-3 / np.sqrt(2), rel=0.01)


@nightly
def test_the_whole_experiment(tmp_path: Path) -> None:
    calls: list[tuple[str, int, int]] = []
    results, reason = run_fidelity(
        tmp_path / "out", samplings=(1, 4), shape=SMALL, progress=lambda *call: calls.append(call)
    )
    backends = ["raycast"] if reason else ["pyrender", "raycast"]
    assert [result.backend.split()[0] for result in results] == [
        name for _ in range(2) for name in backends for _ in "14"
    ]
    assert calls[-1] == ("fidelity", len(results), len(results))
    for result in results:
        assert result.subsets == 2 * 3 * len(SHIFTS_PX)
        assert (result.bound_px is None) == (result.texture != "band-limited" or result.supersampling != 4)
        assert result.within_bounds is not False
        assert result.rms_px <= result.max_px
    for coarse, fine in zip(results[::2], results[1::2], strict=True):
        assert fine.rms_px < coarse.rms_px / 10
        assert fine.rms_grey < coarse.rms_grey / 10
    with (tmp_path / "out" / "fidelity.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["rms_px"]) for row in rows] == [result.rms_px for result in results]
    content = json.loads((tmp_path / "out" / "fidelity.json").read_text())
    assert content["protocol"]["image"] == {"height": 50, "width": 75}
    assert [row["within_bounds"] for row in content["results"]] == [result.within_bounds for result in results]
    for name in ("fidelity.png", "fidelity_maps.png"):
        picture = imageio.imread(tmp_path / "out" / name)
        assert picture.shape[0] > 300
        assert picture.std() > 10


@pytest.mark.usefixtures("one_texture")
def test_the_command_prints_a_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(validation_studies, "run_fidelity", partial(run_fidelity, samplings=[4], shape=(25, 25)))
    result = CliRunner().invoke(app, ["validation", "rendering", "-o", str(tmp_path / "out")])
    assert result.exception is None
    assert "1e-04, kept" in result.output
    assert (tmp_path / "out" / "fidelity.csv").is_file()


def test_the_command_refuses_an_existing_folder(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    result = CliRunner().invoke(app, ["validation", "rendering", "-o", str(tmp_path)])
    assert isinstance(result.exception, st.OutputExistsError)
