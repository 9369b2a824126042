"""The figures exist, show something, and do not fall over whatever the estimate is; vectors stand beside pictures."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.axes import Axes
from numpy.typing import NDArray
from PIL import Image

from scenetruth.errors import ScoreError
from scenetruth.schema import STATUS_FALLBACK, STATUS_INVALID, STATUS_VALID
from scenetruth.scoring import plot_all, score, write_report
from scenetruth.scoring.figures import (
    FigureInfo,
    SurfaceView,
    arrow_factor,
    build_surface,
    collect_figure_arrays,
    draw_coherence,
    draw_error_bars,
    draw_estimated_growth,
    draw_growth,
    draw_image,
    draw_surface,
    draw_velocity_arrows,
    draw_velocity_z,
    growth_limits,
    pick_row,
    texture,
)
from tests.helpers.nightly import NIGHTLY, by_night, nightly
from tests.helpers.synthetic_case import (
    OF_ERRORS,
    Case,
    Drawn,
    make_case,
    make_growing_case,
    of_one_camera,
    of_one_frame,
    with_error_bars,
)

FILES = [
    "image.png",
    "surface.png",
    "velocity_z.png",
    "velocity_z_row.png",
    "velocity_arrows.png",
    "depth.png",
    "error_histograms.png",
    "error_bars.png",
    "coherence.png",
]
OF_DEPTH = {"surface.png", "depth.png"}
OF_VELOCITY = {"velocity_z.png", "velocity_z_row.png", "velocity_arrows.png"}
OF_ERROR_BARS = {"error_bars.png"}


LAST = ["error_histograms.png", "error_bars.png"]


def files_without(*left_out: set[str]) -> list[str]:
    return [file for file in FILES if file not in set().union(*left_out)]


def pixels(file: Path) -> NDArray[np.uint8]:
    with Image.open(file) as image:
        return np.asarray(image.convert("RGB"))


def assert_legible(folder: Path) -> None:
    """Check that nothing is cut off at the edges of any picture, and that none is empty or full."""
    for file in sorted(folder.iterdir()):
        inked = (pixels(file) != 255).any(axis=2)
        assert not inked[[0, -1]].any(), file
        assert not inked[:, [0, -1]].any(), file
        assert 0.03 < inked.mean() < 0.97, file


def test_every_figure_is_on_disk_and_described(drawn: Drawn) -> None:
    folder, figures = drawn.folder, drawn.figures
    assert [figure.file for figure in figures] == FILES
    assert sorted(path.name for path in folder.iterdir()) == sorted(FILES)
    assert len({figure.title for figure in figures}) == len(FILES)
    assert all(figure.caption.endswith(".") and len(figure.caption) > 40 for figure in figures)


@pytest.mark.parametrize("file", FILES)
def test_figure_shows_something(drawn: Drawn, file: str) -> None:
    shown = pixels(drawn.folder / file)
    assert min(shown.shape[:2]) > 300
    assert np.count_nonzero(np.bincount((shown @ [1 << 16, 1 << 8, 1]).ravel())) > 50
    inked = (shown != 255).any(axis=2)
    # Nothing is cut off at the edges, and the page is neither empty nor full.
    assert not inked[[0, -1]].any()
    assert not inked[:, [0, -1]].any()
    assert 0.03 < inked.mean() < 0.97


@pytest.mark.parametrize("draw", [draw_velocity_z, *by_night(draw_coherence)])
def test_tall_images_leave_room_for_the_labels(draw: Callable[..., FigureInfo | None], tmp_path: Path) -> None:
    case = with_error_bars(make_case(40, 80))
    figure = draw(collect_figure_arrays(case.recording, case.estimate, case.truth), tmp_path)
    assert figure is not None
    inked = (pixels(tmp_path / figure.file) != 255).any(axis=2)
    assert not inked[:, [0, -1]].any()


def test_progress_counts_the_figures(drawn: Drawn) -> None:
    assert drawn.calls == [("report", done, 9) for done in range(10)]


def test_users_settings_are_left_alone(drawn: Drawn) -> None:
    assert drawn.settings_kept
    assert "matplotlib.pyplot" not in sys.modules or not sys.modules["matplotlib.pyplot"].get_fignums()


# One pixel has no range of values, which matters to maps and histograms; by night, all figures are drawn.
@pytest.mark.parametrize(
    ("what", "names"),
    [
        ("nothing", None),
        ("one pixel", ("velocity_z", "error_histograms")),
        *by_night(("one pixel", None), ("perfect", None)),
    ],
)
def test_odd_estimates_are_drawn(what: str, names: tuple[str, ...] | None, tmp_path: Path) -> None:
    case = make_case(48, 36, 380.0)
    estimate = {
        "nothing": lambda: case.estimate.assign(status=case.estimate["status"] * 0 + STATUS_INVALID),
        "one pixel": lambda: case.estimate.where((case.estimate.x == 20) & (case.estimate.y == 18)),
        "perfect": lambda: case.truth,
    }[what]()
    figures = plot_all(case.recording, estimate, case.truth, score(estimate, case.truth), tmp_path, names=names)
    # The estimate of this case has no error bars, and the truth has neither coherence nor status.
    left_out = {"nothing": (OF_DEPTH, OF_VELOCITY), "one pixel": (), "perfect": ({"coherence.png"},)}[what]
    expected = files_without(OF_ERROR_BARS, *left_out) if names is None else [f"{name}.png" for name in names]
    assert [figure.file for figure in figures] == expected


@pytest.mark.usefixtures("undrawn_figures")
@pytest.mark.parametrize(
    ("reduce", "expected"),
    [
        (of_one_camera, ["image.png", "flow.png", "error_histograms.png", "coherence.png"]),
        pytest.param(of_one_frame, files_without(OF_VELOCITY), marks=nightly),
    ],
)
def test_what_one_camera_or_one_frame_cannot_tell_is_left_out(
    reduce: Callable[[Case], Case], expected: list[str], tmp_path: Path
) -> None:
    case = reduce(with_error_bars(make_case(48, 36, 380.0)))
    result = score(case.estimate, case.truth, settings={"interior_margin_px": 3})
    figures = plot_all(case.recording, case.estimate, case.truth, result, tmp_path)
    assert [figure.file for figure in figures] == expected


@pytest.mark.parametrize(
    ("held", "expected"),
    [
        pytest.param(
            ("depth", "disparity", "depth_std"), ["image.png", "surface.png", "depth.png", *LAST], marks=nightly
        ),
        (("disparity", "disparity_std", "coherence"), ["image.png", "disparity.png", *LAST, "coherence.png"]),
        pytest.param(
            ("flow", "status_motion"), ["image.png", "flow.png", "error_histograms.png", "coherence.png"], marks=nightly
        ),
        pytest.param(
            ("velocity",), ["image.png", "velocity_z.png", "velocity_z_row.png", "error_histograms.png"], marks=nightly
        ),
    ],
)
def test_what_the_estimate_does_not_hold_is_left_out(
    small_case: Case, held: tuple[str, ...], expected: list[str], tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """By day, figures are composed and only that of the disparity is drawn: the others of it are drawn elsewhere."""
    if not NIGHTLY:
        request.getfixturevalue("undrawn_figures")
    case, estimate = small_case, small_case.estimate[[*held]]
    result = score(estimate, case.truth, settings={"interior_margin_px": 3})
    figures = plot_all(case.recording, estimate, case.truth, result, tmp_path / "with")
    assert [figure.file for figure in figures] == expected
    alone = plot_all(case.recording, estimate, folder=tmp_path / "without")
    assert [figure.file for figure in alone] == [file for file in expected if file != "error_histograms.png"]
    if NIGHTLY:
        assert_legible(tmp_path / "with")
        assert_legible(tmp_path / "without")


def test_disparity_alone_is_legible(small_case: Case, tmp_path: Path) -> None:
    estimate = small_case.estimate[["disparity", "disparity_std"]]
    (figure,) = plot_all(small_case.recording, estimate, folder=tmp_path, names=["disparity"])
    assert figure.file == "disparity.png"
    assert_legible(tmp_path)


@nightly
def test_without_truth_the_estimate_is_drawn_alone(small_case: Case, tmp_path: Path) -> None:
    figures = plot_all(small_case.recording, small_case.estimate, folder=tmp_path)
    assert [figure.file for figure in figures] == files_without({"error_histograms.png"})
    assert_legible(tmp_path)
    for figure in figures:
        # What the estimator says about itself is told without any look at the truth.
        assert "truth" not in f"{figure.title} {figure.caption}".replace("computed without the truth", "")
        assert not re.search(r"\berrors?\b(?! bars)", f"{figure.title} {figure.caption}".lower())
        assert not [word for word in OF_ERRORS if word in f"{figure.title} {figure.caption}"]


def test_growth_is_drawn_without_truth(tmp_path: Path) -> None:
    case = make_growing_case(80, 60, 620.0)
    figure = draw_estimated_growth(collect_figure_arrays(case.recording, case.estimate), case.estimate, tmp_path)
    assert figure is not None
    assert "truth" not in f"{figure.title} {figure.caption}"
    assert_legible(tmp_path)
    nothing = case.estimate.assign(status=0 * case.estimate["status"])
    assert draw_estimated_growth(collect_figure_arrays(case.recording, nothing), nothing, tmp_path) is None


def test_truth_and_score_belong_together(small_case: Case, tmp_path: Path) -> None:
    with pytest.raises(ScoreError, match="score: is missing; compute it with"):
        plot_all(small_case.recording, small_case.estimate, small_case.truth, None, tmp_path)
    result = score(small_case.estimate, small_case.truth)
    with pytest.raises(ScoreError, match="truth: is missing"):
        plot_all(small_case.recording, small_case.estimate, None, result, tmp_path)


def test_maps_of_a_part_count_pixels_of_the_whole_image(full_case: Case) -> None:
    part = full_case.estimate.isel(x=slice(40, 100, 2), y=slice(20, 90, 2))
    whole, views = (
        collect_figure_arrays(full_case.recording, estimate, full_case.truth) for estimate in (full_case.estimate, part)
    )
    assert whole.grid.extent == (-0.5, 159.5, 119.5, -0.5)
    assert views.grid.extent == (39.0, 99.0, 89.0, 19.0)
    assert views.map_focal_length_px == whole.map_focal_length_px / 2
    np.testing.assert_array_equal(views.surface_points(), whole.surface_points()[20:90:2, 40:100:2])
    np.testing.assert_array_equal(views.image, whole.image[20:90:2, 40:100:2])
    np.testing.assert_array_equal(views.mixed, whole.mixed[20:90:2, 40:100:2])


def test_sign_of_the_velocity_is_shown(small_case: Case, tmp_path: Path) -> None:
    """The right half of the figure is blue where the wedge approaches, and red where it moves away."""
    reds = []
    for name, factor in (("near", 1.0), ("far", -1.0)):
        estimate = small_case.estimate.assign(velocity=factor * small_case.estimate["velocity"])
        (tmp_path / name).mkdir()
        draw_velocity_z(collect_figure_arrays(small_case.recording, estimate), tmp_path / name)
        shown = pixels(tmp_path / name / "velocity_z.png").astype(int)
        right = shown[:, shown.shape[1] // 2 : int(0.9 * shown.shape[1])]
        strong = right[np.abs(right[..., 0] - right[..., 2]) > 60]
        reds.append(float((strong[:, 0] > strong[:, 2]).mean()))
    assert reds[0] < 0.1
    assert reds[1] > 0.9


@pytest.mark.parametrize(("missing", "title"), [("status", "Coherence of"), ("coherence", "Status of")])
def test_what_the_estimator_does_not_say_is_left_out(case: Case, missing: str, title: str, tmp_path: Path) -> None:
    figure = draw_coherence(
        collect_figure_arrays(case.recording, case.estimate.drop_vars(missing), case.truth), tmp_path
    )
    assert figure is not None
    assert figure.title.startswith(title)
    assert f"The {missing}" not in figure.caption


@pytest.mark.parametrize(
    ("missing", "title"),
    [
        ((), "Coherence, status and reason for invalidity of"),
        *by_night((("coherence", "invalid_reason"), "Status of")),
        *by_night((("coherence", "status", "status_disparity"), "Status and reason for invalidity of")),
        (("coherence", "status", "status_disparity", "status_motion"), "Reason for invalidity of"),
    ],
)
def test_status_and_reasons_are_shown(small_case: Case, missing: tuple[str, ...], title: str, tmp_path: Path) -> None:
    views = collect_figure_arrays(small_case.recording, small_case.estimate.drop_vars(missing), small_case.truth)
    figure = draw_coherence(views, tmp_path)
    assert figure is not None
    assert figure.title.startswith(title)
    colours = pixels(tmp_path / figure.file) @ [1 << 16, 1 << 8, 1]
    assert (0x0072B2 in colours) == ("status_motion" not in missing)
    assert (0xB0006D in colours) == ("invalid_reason" not in missing)


def test_fractions_of_both_statuses_are_reported(small_case: Case, drawn: Drawn) -> None:
    (figure,) = (figure for figure in drawn.figures if figure.file == "coherence.png")
    for name in ("disparity", "motion"):
        share = 100 * float((small_case.estimate[f"status_{name}"] == STATUS_VALID).mean())
        assert f"status of {name}, valid {share:.1f} %" in figure.caption


# Their drawing: `test_figure_shows_something` and `test_odd_error_bars_are_drawn`.
@pytest.mark.usefixtures("undrawn_figures")
@pytest.mark.parametrize(
    ("missing", "title"),
    [
        ((), "Stated standard deviations of depth and velocity"),
        (("depth_std",), "Stated standard deviations of disparity and velocity"),
        (("depth_std", "disparity_std"), "Stated standard deviations of velocity"),
        (("velocity_std",), "Stated standard deviations of depth"),
        (("depth_std", "velocity_std"), "Stated standard deviations of disparity"),
        (("depth_std", "disparity_std", "velocity_std"), None),
    ],
)
def test_error_bars_are_shown_where_there_are_any(
    full_case: Case, missing: tuple[str, ...], title: str | None, tmp_path: Path
) -> None:
    assert error_bars_title(full_case, full_case.estimate.drop_vars(missing), tmp_path) == title


@pytest.mark.parametrize("value", [0.0, 0.1, np.nan])
def test_odd_error_bars_are_drawn(full_case: Case, value: float, tmp_path: Path) -> None:
    estimate = full_case.estimate.drop_vars(["velocity_std", "disparity_std"])
    estimate = estimate.assign(depth_std=xr.full_like(estimate["depth_std"], value))
    assert error_bars_title(full_case, estimate, tmp_path) == (
        "Stated standard deviations of depth" if value > 0 else None
    )


@pytest.mark.usefixtures("undrawn_figures")
def test_common_part_of_error_bars_is_stated(full_case: Case, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    titles: list[str] = []
    monkeypatch.setattr(Axes, "set_title", lambda _, text, **__: titles.append(text))
    common = xr.full_like(full_case.estimate["depth_std"], 0.0123)
    error_bars_title(full_case, full_case.estimate.assign(depth_std_common=common), tmp_path)
    assert "Standard deviation of depth\n0.0123 mm (median) common to all pixels" in titles
    assert not any("common" in title for title in titles if "velocity" in title)


def error_bars_title(case: Case, estimate: xr.Dataset, folder: Path) -> str | None:
    views = collect_figure_arrays(case.recording, estimate, case.truth)
    figure = draw_error_bars(views, estimate, case.truth, score(estimate, case.truth), folder)
    assert (folder / "error_bars.png").is_file() == (figure is not None)
    return None if figure is None else figure.title


@pytest.mark.parametrize("known", [True, False])
def test_growth_is_drawn_where_the_truth_knows_it(known: bool, tmp_path: Path) -> None:
    case = make_growing_case(80, 60, 620.0)
    truth = case.truth if known else case.truth.drop_vars("growth_rate")
    result = score(case.estimate, truth, settings={"growth_window_px": 6})
    figure = draw_growth(
        collect_figure_arrays(case.recording, case.estimate, truth), case.estimate, truth, result, tmp_path
    )
    assert (figure is not None) == (tmp_path / "growth_rate.png").is_file() == known
    if figure is not None:
        assert "of 6 px" in figure.caption
        shown = pixels(tmp_path / figure.file)
        inked = (shown != 255).any(axis=2)
        assert not inked[[0, -1]].any()
        assert not inked[:, [0, -1]].any()
        assert 0.2 < inked.mean() < 0.97


def test_growth_of_windows_that_hold_nothing_is_not_drawn(tmp_path: Path) -> None:
    case = make_growing_case(80, 60, 620.0)
    result = score(case.estimate, case.truth, settings={"growth_window_px": 200})
    assert (
        draw_growth(
            collect_figure_arrays(case.recording, case.estimate, case.truth),
            case.estimate,
            case.truth,
            result,
            tmp_path,
        )
        is None
    )


def test_frame_zero_is_shown_else_the_middle_one() -> None:
    case = make_case(32, 24, 250.0, frames=(-1, 0, 1))
    assert collect_figure_arrays(case.recording, case.estimate, case.truth).frame == 0
    views = collect_figure_arrays(case.recording, case.estimate.sel(t=[1]), case.truth)
    assert (views.frame, views.image_frame) == (1, 1)
    late = [dataset.assign_coords(t=dataset.t + 10) for dataset in (case.estimate, case.truth)]
    views = collect_figure_arrays(case.recording, *late)
    assert (views.frame, views.image_frame) == (10, 0)


def test_marked_row_is_near_the_centre_and_full(case: Case) -> None:
    views = collect_figure_arrays(case.recording, case.estimate, case.truth)
    row = pick_row(views)
    counts = np.isfinite(views.estimate["velocity_z"]).sum(axis=1)
    assert counts[row] >= 0.95 * counts.max()
    assert 45 < row < 75


def step_points(jump_mm: float) -> NDArray[np.float64]:
    """Return a plane with a step in the middle, one pixel a millimetre."""
    y, x = np.indices((6, 8), dtype=np.float64)
    return np.stack([x, y, np.where(x < 4, 100.0, 100.0 + jump_mm)], axis=-1)


def test_surface_has_no_skin_across_jumps() -> None:
    whole = build_surface(step_points(0.0), focal_length_px=100.0)
    torn = build_surface(step_points(50.0), focal_length_px=100.0)
    assert len(whole.corners) == 5 * 7
    assert len(torn.corners) == 5 * 6
    assert np.ptp(torn.corners[..., 2], axis=1).max() == 0


def test_surface_leaves_out_missing_points() -> None:
    points = step_points(0.0)
    points[2, 3] = np.nan
    assert len(build_surface(points, focal_length_px=100.0).corners) == 5 * 7 - 4


def test_large_surfaces_are_thinned_out() -> None:
    y, x = np.indices((60, 80), dtype=np.float64)
    surface = build_surface(np.stack([x, y, 0 * x + 80.0], axis=-1), 80.0, max_quads=300)
    assert surface.step_px == 4
    assert len(surface.corners) == 14 * 19
    assert (surface.rows.max(), surface.columns.max()) == (54, 74)


@pytest.mark.parametrize("step", [1, 4])
def test_texture_is_that_of_the_known_pixels(step: int) -> None:
    """The border of corrected images has no value; the sums of a moving average would carry it to all others."""
    y, x = np.indices((60, 80), dtype=np.float64)
    surface = build_surface(np.stack([x, y, 0 * x + 80.0], axis=-1), 80.0, max_quads=300 if step > 1 else 40_000)
    assert surface.step_px == step
    image = np.random.default_rng(3).uniform(0.0, 1700.0, (60, 80))
    image[:, 72:] = 900.0
    whole = texture(image, surface)
    image[:, 72:] = np.nan
    found = texture(image, surface)
    inside, outside = surface.columns < 72 - step, surface.columns >= 72 + step // 2
    # Medium grey outside keeps the limits of the scale nearly as they were.
    assert np.abs(found - whole)[inside].max() < 0.05
    assert found[inside].std() > 0.1
    assert set(found[outside]) == {0.5}


def test_view_is_a_right_handed_frame() -> None:
    right, up, viewer = SurfaceView(30.0, -90.0).axes()
    np.testing.assert_allclose(right, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(viewer, [0, -0.5, -np.sqrt(0.75)], atol=1e-12)
    np.testing.assert_allclose(np.cross(right, up), viewer, atol=1e-12)


@pytest.mark.parametrize(
    ("speed", "factor"), [(1.0, 5.0), (0.0, 5.0), (3.0, 5.0), (0.01, 500.0), (40.0, 0.1), (100.0, 0.05)]
)
def test_arrows_are_five_times_the_velocity_unless_illegible(speed: float, factor: float) -> None:
    assert arrow_factor(np.tile([0.0, 0.0, -speed], (4, 1)), extent=60.0) == pytest.approx(factor)


def test_arrows_are_as_long_as_those_of_what_moves() -> None:
    mostly_still = np.zeros((40, 3))
    mostly_still[:8, 2] = -0.01
    assert arrow_factor(mostly_still, extent=60.0) == pytest.approx(500.0)


def test_a_single_wild_velocity_does_not_make_all_else_small(case: Case, tmp_path: Path) -> None:
    velocity = case.estimate["velocity"]
    height, width = velocity.sizes["y"], velocity.sizes["x"]
    away = (abs(velocity.x - width / 2) < 0.1 * width) & (abs(velocity.y - height / 2) < 0.1 * height)
    wild = velocity.where(~away | (velocity.component != "Z"), velocity + 1e4)
    calm = draw_velocity_arrows(collect_figure_arrays(case.recording, case.estimate, case.truth), tmp_path)
    views = collect_figure_arrays(case.recording, case.estimate.assign(velocity=wild), case.truth)
    cut = draw_velocity_arrows(views, tmp_path)
    assert "Orange arrows are truncated" in cut.caption
    assert "Orange" not in calm.caption
    assert cut.title == calm.title


def test_scale_of_growth_is_that_of_the_truth() -> None:
    exact = np.linspace(0.0, 3.0, 100).reshape(10, 10)
    noisy = exact + np.linspace(-500, 500, 100).reshape(10, 10)
    assert growth_limits(noisy, exact) == (-6.0, 6.0)
    low, high = growth_limits(noisy, 0 * exact)
    assert low < -300
    assert high > 300


def test_recording_of_floats_is_drawn(case: Case, tmp_path: Path) -> None:
    recording = case.recording.assign(image=case.recording["image"].astype(np.float32) / 255)
    draw_image(collect_figure_arrays(recording, case.estimate, case.truth), tmp_path)
    assert (tmp_path / "image.png").is_file()


@pytest.mark.usefixtures("undrawn_figures")
def test_recording_of_colours_is_drawn_in_grey(tmp_path: Path) -> None:
    case = make_case(48, 36, 380.0)
    image = case.recording["image"]
    colours = case.recording.assign(
        image=xr.concat([image, image // 2, image * 0], dim="channel").transpose(..., "x", "channel")
    )
    views = collect_figure_arrays(colours, case.estimate, case.truth)
    np.testing.assert_allclose(views.image, 0.5 * image.sel(s=0, t=0), atol=0.5)
    for draw in (draw_image, draw_surface, draw_velocity_arrows, draw_coherence):
        assert draw(views, tmp_path) is not None


def test_importing_the_room_loads_no_heavy_library() -> None:
    code = "import sys, scenetruth.scoring; print([n for n in ('matplotlib', 'jinja2') if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


FEW = ("surface", "velocity_z_row")


@nightly
def test_pdf_files_stand_beside_unchanged_pictures(small_case: Case, drawn: Drawn, tmp_path: Path) -> None:
    case, result = small_case, score(small_case.estimate, small_case.truth)
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


def test_a_report_has_them_too(small_case: Case, tmp_path: Path) -> None:
    page = write_report(
        small_case.estimate,
        recording=small_case.recording,
        output=tmp_path,
        figures=("velocity_z_row",),
        figure_formats=("png", "pdf"),
    )
    assert {path.name for path in (page.parent / "figures").iterdir()} == {"velocity_z_row.pdf", "velocity_z_row.png"}


def test_other_formats_are_named_with_those_that_there_are(full_case: Case, tmp_path: Path) -> None:
    with pytest.raises(ScoreError, match=r"figures.*unknown.*\n.*formats.*unknown; available: pdf.*tiff"):
        plot_all(full_case.recording, full_case.estimate, folder=tmp_path / "none", names=("fog",), also=("tiff",))
    assert not (tmp_path / "none").exists()


def test_fallback_values_are_hatched_on_request(small_case: Case, tmp_path: Path) -> None:
    status = np.full(small_case.estimate["depth"].shape, STATUS_VALID, dtype=np.uint8)
    status[..., 20:40, 30:50] = STATUS_FALLBACK
    estimate = small_case.estimate.assign(status_disparity=(("t", "y", "x"), status))
    shown = []
    for include in (False, True):
        result = score(estimate, small_case.truth, settings={"include_fallback": include})
        folder = tmp_path / str(include)
        (figure,) = plot_all(small_case.recording, estimate, small_case.truth, result, folder, names=["depth"])
        shown.append(pixels(folder / figure.file))
        views = collect_figure_arrays(small_case.recording, estimate, small_case.truth, include_fallback=include)
        assert np.isfinite(views.estimate["depth"][25, 40]) == include
    assert_legible(tmp_path / "True")
    assert shown[0].shape != shown[1].shape or (shown[0] != shown[1]).any()


@pytest.mark.parametrize("fate", ["drawn", "failed", "not begun"])
def test_another_process_draws_while_this_one_does_other_work(
    fate: str, small_case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    here: list[str] = []
    before: list[tuple[list[str], list[str]]] = []

    def draw(name: str, where: list[str]) -> FigureInfo:
        where.append(name)
        return FigureInfo(f"{name}.png", name, "")

    def elsewhere(name: str) -> Future[FigureInfo | None]:
        future: Future[FigureInfo | None] = Future()
        if fate == "failed":
            future.set_exception(OSError("ended"))
        figure = draw(name, asked)
        if fate == "drawn":
            future.set_result(figure)
        return future

    plan = {name: lambda name=name: draw(name, here) for name in "abcdef"}
    monkeypatch.setitem(plot_all.__globals__, "_plan", lambda *_: plan)
    figures = plot_all(
        small_case.recording,
        small_case.estimate,
        folder=tmp_path,
        elsewhere=elsewhere,
        meanwhile=lambda: before.append(([*asked], [*here])),
    )
    assert "".join(figure.title for figure in figures) == "abcdef"
    # The other work is done once, after figures are asked for and before the first is drawn here.
    assert before == [(["f", "e"], [])]
    if fate == "drawn":
        assert sorted(asked + here) == [*plan]
        assert len(asked) > 2
    else:
        assert sorted(here) == [*plan]
        assert len(asked) == 2
