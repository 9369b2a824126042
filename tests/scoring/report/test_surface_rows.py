"""Values by surface are the medians of the pixels of each surface, which the depth of the estimate separates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from scenetruth.camera import Camera
from scenetruth.capture.twin import Canvas, find_parts
from scenetruth.scoring import write_report
from scenetruth.scoring.report import describe_maps, describe_parts, describe_surfaces
from tests.helpers.synthetic_case import Case, make_case

SHAPE = (40, 60)


def estimate(step_mm: float, *, stated: bool = True) -> tuple[xr.Dataset, Case]:
    """Return an estimate of a wall with a plate before it that approaches, both with noise of 0.1 mm."""
    case = make_case(SHAPE[1], SHAPE[0], 250.0)
    like = case.estimate
    drawn = np.random.default_rng(3).normal(0.0, 0.1, like["depth"].shape)
    depth, velocity = 600.0 + drawn, np.zeros(like["velocity"].shape)
    depth[..., 40:] -= step_mm
    velocity[2, ..., 40:] = -0.5
    given = {"depth": (like["depth"].dims, depth), "velocity": (like["velocity"].dims, velocity)}
    if stated:
        given["depth_std"] = like["depth"].dims, np.full(depth.shape, 0.1)
    kept = like.drop_vars([name for name in like.data_vars if name not in ("depth", "velocity")])
    return kept.assign(given).assign_attrs(like.attrs), case


def test_each_surface_has_the_medians_of_its_pixels() -> None:
    found, _ = estimate(30.0)
    table = describe_surfaces(found)
    assert table is not None
    assert [row.name for row in table.rows] == ["surface 1", "surface 2"]
    assert table.headings[:2] == ("Depth [mm]", "Velocity in Z [mm/frame]")
    # The pixels are counted in the middle frame, medians are those of all frames.
    for row, columns, x in zip(table.rows, (slice(40), slice(40, None)), (19.5, 49.5), strict=True):
        assert row.pixels == 40 * (40 if x < 40 else 20)
        assert (row.x, row.y) == (x, 19.5)
        assert row.medians[0][0] == pytest.approx(float(np.median(found["depth"].values[..., columns])))
        assert row.medians[0][1].endswith("± 0.10")
        assert row.medians[1][0] == pytest.approx(-0.5 * (x > 40))


@pytest.mark.parametrize(("step_mm", "stated"), [(0.0, True), (30.0, False)])
def test_one_surface_or_unknown_noise_has_no_table(step_mm: float, *, stated: bool) -> None:
    assert describe_surfaces(estimate(step_mm, stated=stated)[0]) is None


def test_surfaces_are_those_of_a_twin() -> None:
    found, case = estimate(30.0)
    table = describe_surfaces(found)
    middle = found.isel(t=found.sizes["t"] // 2)
    canvas = Canvas(Camera(width=SHAPE[1], height=SHAPE[0], focal_length_px=case.estimate.attrs["focal_length_px"]), 0)
    parts = find_parts(canvas, middle["depth"].values, middle["depth_std"].values, 0.0)
    assert table is not None
    assert [part.name.replace("_", " ") for part in parts] == [row.name for row in table.rows]
    assert [int(part.measured.sum()) for part in parts] == [row.pixels for row in table.rows]


def test_parts_of_an_image_together_are_the_whole() -> None:
    found, _ = estimate(30.0)
    left = np.zeros(SHAPE, dtype=bool)
    left[:, :17] = True
    parts = describe_parts(found, {"left": left, "right": ~left, "all": np.ones(SHAPE, dtype=bool)})
    whole = describe_maps(found)
    assert parts["all"] == whole
    assert parts["left"]["depth"].count + parts["right"]["depth"].count == whole["depth"].count


def test_the_page_of_several_surfaces_has_their_table(tmp_path: Path) -> None:
    for step_mm, has in ((30.0, True), (0.0, False)):
        found, case = estimate(step_mm)
        page = write_report(found, recording=case.recording, output=tmp_path / str(step_mm), figures=("image",))
        assert ('id="surfaces-table"' in page.read_text(encoding="utf-8")) == has
