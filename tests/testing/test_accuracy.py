"""Assertions of accuracy: they hold what scores tell against limits, and say everything when one is broken."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from PIL import Image

import scenetruth as st
from scenetruth.scoring import QUANTITIES, STATISTICS
from scenetruth.testing.accuracy import assert_accuracy
from scenetruth.testing.assertion_context import OutcomeRow, use_context
from scenetruth.testing.tolerances import KEYS, LimitError
from tests.helpers.synthetic_case import Case, make_case, make_growing_case, with_error_bars, with_regions

MARGIN_PX = 4.0


def alone(*args: Any, **given: Any) -> st.Score:
    """Assert accuracy as outside of a test run: nobody wants pictures."""
    with use_context():
        return assert_accuracy(*args, **given)


@pytest.fixture(scope="module")
def case() -> Case:
    """A small case that has regions and error bars."""
    return with_regions(with_error_bars(make_case(80, 60, 600.0)))


@pytest.fixture
def check(case: Case) -> Callable[..., st.Score]:
    """The assertion about the case, which looks for no slips."""

    def assert_case(**given: Any) -> st.Score:
        options = {"margin_px": MARGIN_PX, "check_conventions": False, **given}
        return alone(case.estimate, case.truth, case.recording, **options)

    return assert_case


def broken(check: Callable[..., st.Score], **given: Any) -> str:
    with pytest.raises(AssertionError) as caught:
        check(**given)
    return str(caught.value)


@pytest.mark.parametrize("statistic", STATISTICS)
def test_limits_around_what_the_score_tells_are_kept_and_broken(
    case: Case, check: Callable[..., st.Score], statistic: str
) -> None:
    values = st.score(case.estimate, case.truth, case.recording, settings={"interior_margin_px": MARGIN_PX}).regions[
        "interior"
    ]
    # Far more than rounding, far less than any error.
    looser = 1 - 1e-9 if statistic in ("density", "count", "coverage_2_std") else 1 + 1e-9
    known = {
        name: (key.quantities[0], abs(value))
        for name, key in KEYS.items()
        if len(key.quantities) == 1 and "growth" not in name
        if (value := values.get(key.quantities[0], {}).get(statistic)) is not None
    }
    # Depth, disparity and velocity; flow has no error bars, and nothing moves along X and Y.
    assert len(known) >= 5
    check(**{name: {statistic: value * looser} for name, (_, value) in known.items()})
    text = broken(check, **{name: {statistic: value / looser} for name, (_, value) in known.items()})
    lines = [line.split()[:3] for line in text.splitlines()]
    assert all(["BROKEN", quantity, statistic] in lines for quantity, _ in known.values())


def test_growth_is_limited_in_either_unit() -> None:
    case = make_growing_case(80, 60, 600.0, velocity_noise=0.001)
    error = st.score(case.estimate, case.truth, settings={"interior_margin_px": MARGIN_PX}).regions["interior"][
        "growth_rate"
    ]["rmse"]
    assert error is not None
    for limit in ({"growth_percent_per_hour": 1.01 * error}, {"growth_per_hour": 0.0101 * error}):
        alone(case.estimate, case.truth, margin_px=MARGIN_PX, **limit)
    for limit in ({"growth_rate_percent_per_hour": 0.99 * error}, {"growth_per_hour": 0.0099 * error}):
        with pytest.raises(AssertionError, match=r"growth_rate +rmse"):
            alone(case.estimate, case.truth, margin_px=MARGIN_PX, check_conventions=False, **limit)


def test_all_that_is_broken_is_told_and_what_is_kept_too(check: Callable[..., st.Score]) -> None:
    text = broken(check, depth_mm={"rmse": 1e-6, "median_abs_error": 1e3}, flow_px=1e-6, min_density=0.01)
    lines = text.splitlines()
    assert lines[0].startswith("3 of 7 limits broken by the estimate of 'unknown' in the region 'interior' of ")
    rows = [line.split() for line in lines if line.split()[0] in ("kept", "BROKEN")]
    assert [row[:3] for row in rows if row[0] == "BROKEN"] == [
        ["BROKEN", "depth", "rmse"],
        ["BROKEN", "flow_x", "rmse"],
        ["BROKEN", "flow_y", "rmse"],
    ]
    assert len(rows) == 7
    assert "scenetruth.write_report" in lines[-1]


def test_the_pixels_of_the_region_are_counted(case: Case, check: Callable[..., st.Score]) -> None:
    for region in ("all", "interior", "nonoccluded", "contrast_high"):
        text = broken(check, region=region, depth_mm=0.0)
        values = st.score(
            case.estimate, case.truth, case.recording, settings={"interior_margin_px": MARGIN_PX}
        ).regions[region]["depth"]
        count, density = values["count"], values["density"]
        assert count is not None
        assert density is not None
        assert f"in the region '{region}' of {count / density:.0f} pixels:" in text


def test_what_is_not_estimated_is_never_accurate(case: Case) -> None:
    nothing = case.estimate.assign({name: np.nan * case.estimate[name] for name in ("depth", "velocity")})
    for estimate, options, why in (
        (nothing, {}, "no scored pixels"),
        (case.estimate.drop_vars(["depth", "depth_std"]), {}, "not in the estimate"),
        (case.estimate, {"margin_px": 1e3}, "no truth in the region"),
    ):
        with pytest.raises(AssertionError, match=why):
            alone(estimate, case.truth, check_conventions=False, depth_mm=1e9, **{"margin_px": MARGIN_PX, **options})


def test_a_statistic_that_is_not_defined_breaks_its_limit(case: Case) -> None:
    without = case.estimate.drop_vars([name for name in case.estimate if str(name).endswith("_std")])
    with pytest.raises(AssertionError, match="no standard deviations"):
        alone(without, case.truth, margin_px=MARGIN_PX, check_conventions=False, depth_mm={"rms_z": 1e9})


def test_what_cannot_be_checked_is_told_all_at_once(case: Case, check: Callable[..., st.Score]) -> None:
    for kind in (TypeError, ValueError, st.ScoreError):
        with pytest.raises(kind) as caught:
            check(depht_mm=1, depth_mm={"rmes": 1}, region="interor", rotation_rate_x_rad=1.0)
    assert isinstance(caught.value, LimitError)
    assert [problem.path for problem in caught.value.problems] == [
        "depht_mm",
        "depth_mm.rmes",
        "region",
        "rotation_rate_x",
    ]
    assert "did you mean 'interior'?" in str(caught.value)
    assert not issubclass(LimitError, AssertionError)
    # Limits are told even where the data sets do not belong together.
    with pytest.raises(LimitError):
        alone(case.estimate, case.truth.isel(x=slice(0, 5)), depht_mm=1)
    with pytest.raises(LimitError, match="requires recording="):
        alone(case.estimate, case.truth, region="contrast_low", depth_mm=1)
    with pytest.raises(LimitError, match="must be the name of a region"):
        check(region=None, depth_mm=1)


def test_parts_of_different_runs_are_not_compared(case: Case) -> None:
    with pytest.raises(st.MismatchError):
        alone(
            case.estimate.assign_attrs(recording_hash="one"), case.truth.assign_attrs(recording_hash="two"), depth_mm=1
        )


@pytest.fixture
def bound(case: Case) -> xr.Dataset:
    """Standard deviations that vary over the whole image; the left columns have none."""
    size = [case.truth.sizes[name] for name in ("t", "y", "x")]
    std = 0.1 + 0.05 * np.random.default_rng(4).random(size)
    std[..., :10] = np.nan
    maps = {"depth_std": (("t", "y", "x"), std), "velocity_std": (("component", "t", "y", "x"), np.stack([std] * 3))}
    return xr.Dataset(maps, coords={name: case.truth[name].values for name in ("t", "y", "x")})


@pytest.mark.parametrize("part", [slice(15, 60), slice(0, None, 2)])
def test_multiples_of_a_bound_are_taken_where_the_estimate_is_scored(
    case: Case, bound: xr.Dataset, part: slice
) -> None:
    estimate = case.estimate.isel(x=part, y=slice(None, None, part.step))
    truth = case.truth.sel(x=estimate.x, y=estimate.y)
    # Worked out anew: where the region, the estimate and the bound are known.
    distance = xr.ones_like(case.truth.depth) * np.nan
    edges = np.argwhere(case.truth.mixed.values[0])
    rows, columns = np.indices(distance.shape[1:])
    distance.values[0] = np.min([np.hypot(rows - y, columns - x) for y, x in edges], axis=0)
    inside = (distance.sel(x=estimate.x, y=estimate.y) >= MARGIN_PX) & np.isfinite(truth.depth)
    known = inside & np.isfinite(estimate.depth) & (estimate.status_disparity == 2)
    # Disparity and velocity are known where both kinds are full.
    moving = known & (estimate.status_motion == 2)
    std = bound.depth_std.sel(x=estimate.x, y=estimate.y)

    def rms(values: xr.DataArray) -> float:
        return float(np.sqrt((values**2).mean()))

    ratios = {
        "depth_mm": rms((estimate.depth - truth.depth).where(known)) / rms(std.where(known)),
        "velocity_z_mm": rms((estimate.velocity - truth.velocity).sel(component="Z").where(moving))
        / rms(std.where(moving)),
    }
    for name, ratio in ratios.items():
        alone(
            estimate,
            case.truth,
            bound=bound,
            margin_px=MARGIN_PX,
            check_conventions=False,
            **{name: f"{1.0001 * ratio} x bound"},
        )
        with pytest.raises(AssertionError, match=r"x bound\)"):
            alone(
                estimate,
                case.truth,
                bound=bound,
                margin_px=MARGIN_PX,
                check_conventions=False,
                **{name: f"{0.9999 * ratio} x bound"},
            )


def test_a_bound_that_is_not_there_is_told(case: Case, bound: xr.Dataset, check: Callable[..., st.Score]) -> None:
    with pytest.raises(LimitError, match=r"bound.disparity_std: is missing; the bound has depth_std, velocity_std"):
        check(bound=bound, disparity_px="2 x bound")
    with pytest.raises(LimitError, match="recording: is required for the bound"):
        alone(case.estimate, case.truth, depth_mm="bound")
    with pytest.raises(LimitError, match="must have the dimensions"):
        check(bound=bound.rename(t="u"), depth_mm="2 x bound")
    assert "no bound in the region" in broken(check, bound=bound * np.nan, depth_mm="2 x bound")


def test_what_follows_from_other_quantities_has_no_bound() -> None:
    case = make_growing_case(80, 60, 600.0)
    std = xr.Dataset({"growth_rate_std": (("t", "y", "x"), np.full(case.truth.depth.shape, 1e9))})
    with pytest.raises(AssertionError, match="no bound in the region"):
        alone(
            case.estimate, case.truth, bound=std, margin_px=MARGIN_PX, check_conventions=False, growth_per_hour="bound"
        )
    # What the estimate itself holds has one: here its errors are just the bound, 0.001 per frame of a minute.
    own = case.estimate.assign(growth_rate=case.truth.growth_rate + 0.001)
    for stated, kept in ((0.00101, True), (0.00099, False)):
        check = partial(alone, own, case.truth, bound=0 * std + stated, margin_px=MARGIN_PX, check_conventions=False)
        if kept:
            check(growth_per_hour="bound")
        else:
            assert "<= 0.0594 1/h (1 x bound)" in broken(check, growth_per_hour="bound")


def test_the_bound_of_truth_and_recording_is_taken_by_default(
    case: Case, bound: xr.Dataset, check: Callable[..., st.Score], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[xr.Dataset, xr.Dataset]] = []

    def cramer_rao_bound(truth: xr.Dataset, recording: xr.Dataset) -> xr.Dataset:
        asked.append((truth, recording))
        return bound

    monkeypatch.setitem(sys.modules, "scenetruth.bound", SimpleNamespace(cramer_rao_bound=cramer_rao_bound))
    check(depth_mm="100 x bound")
    assert len(asked) == 1
    assert asked[0][0] is case.truth
    assert asked[0][1] is case.recording


def test_pictures_are_drawn_of_what_is_broken_only(case: Case, check: Callable[..., st.Score], tmp_path: Path) -> None:
    folder = tmp_path / "new" / "pictures"
    check(pictures=folder, depth_mm=1e3)
    assert not folder.exists()
    text = broken(check, pictures=folder, depth_mm=1e-9, disparity_px=1e3, normal_deg=1e9)
    assert {file.name for file in folder.iterdir()} == {"depth.png"}
    for file in folder.iterdir():
        assert f"  {file}" in text.splitlines()
        with Image.open(file) as picture:
            assert min(picture.size) > 300
    # Of another assertion, beside the first; there need not be a recording.
    with pytest.raises(AssertionError):
        alone(case.estimate, case.truth, depth_mm=0, margin_px=MARGIN_PX, check_conventions=False, pictures=folder)
    assert {file.name for file in folder.iterdir()} == {"depth.png", "depth_2.png"}


def test_a_failure_without_pictures_is_still_the_failure(check: Callable[..., st.Score], tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    text = broken(check, pictures=file, depth_mm=1e-9)
    assert text.startswith("1 of 1 limit broken")
    assert "figures could not be drawn: " in text


def test_slips_are_looked_for_where_something_is_broken(
    case: Case, check: Callable[..., st.Score], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[xr.Dataset] = []

    def find_slips(estimate: xr.Dataset, truth: xr.Dataset) -> list[SimpleNamespace]:
        asked.append(estimate)
        return [SimpleNamespace(message="disparity has the other sign")]

    monkeypatch.setitem(
        sys.modules, "scenetruth.scoring.convention_check", SimpleNamespace(detect_convention_mismatches=find_slips)
    )
    check(check_conventions=True, depth_mm=1e3)
    broken(check, check_conventions=False, depth_mm=1e-9)
    assert asked == []
    text = broken(check, check_conventions=True, depth_mm=1e-9)
    assert text.splitlines()[-3:-1] == ["possible convention errors:", "  - disparity has the other sign"]

    def fail(estimate: xr.Dataset, truth: xr.Dataset) -> None:
        raise RuntimeError("deeper trouble")

    monkeypatch.setitem(
        sys.modules, "scenetruth.scoring.convention_check", SimpleNamespace(detect_convention_mismatches=fail)
    )
    assert "RuntimeError: deeper trouble" in broken(check, check_conventions=True, depth_mm=1e-9)


def test_what_is_around_takes_note_and_offers_a_folder(
    case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Path] = []

    def draw(*given: Any) -> list[Path]:
        drawn.append(given[-1])
        return []

    monkeypatch.setattr("scenetruth.testing.accuracy.draw_differences", draw)
    check = partial(assert_accuracy, case.estimate, case.truth, margin_px=MARGIN_PX, check_conventions=False)
    notes: list[OutcomeRow] = []
    asked: list[Path] = []

    def pictures() -> Path:
        asked.append(tmp_path)
        return tmp_path

    with use_context(pictures=pictures, note=notes.extend):
        check(depth_mm=1e3)
        assert asked == []
        broken(check, depth_mm=1e-9, flow_x_px=1e3)
        assert asked == [tmp_path]
        # A folder of one's own goes first.
        broken(check, depth_mm=1e-9, pictures=tmp_path / "own")
    assert [(row["quantity"], row["kept"]) for row in notes] == [
        ("depth", True),
        ("depth", False),
        ("flow_x", True),
        ("depth", False),
    ]
    assert asked == [tmp_path]
    assert drawn == [tmp_path, tmp_path / "own"]
    with use_context():
        broken(check, depth_mm=1e-9)
    assert len(notes) == 4


def test_the_score_is_returned(case: Case, check: Callable[..., st.Score]) -> None:
    found = check(depth_mm=1e3)
    assert found == st.score(case.estimate, case.truth, case.recording, settings={"interior_margin_px": MARGIN_PX})
    assert set(found.regions["interior"]) & set(QUANTITIES)
