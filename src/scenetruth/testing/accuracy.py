"""Assertions on the accuracy of an estimate, with reference scores, figures and messages."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import Problem, ScenetruthError
from scenetruth.schema import blank_map, label, read_intrinsics
from scenetruth.scoring import QUANTITIES, Quantity, Score, score
from scenetruth.scoring.alignment import align
from scenetruth.scoring.error_pairs import has_quantity, percent_per_hour, read_quantity
from scenetruth.testing.assertion_context import align_columns, format_multiple, get_context
from scenetruth.testing.tolerances import Limit, LimitError, LimitOutcome, evaluate_limit, read_limits, suggest_names

__all__ = ["assert_accuracy", "draw_differences"]


Map = NDArray[np.float64]


def count_pixels_in_region(
    estimate: xr.Dataset, truth: xr.Dataset, recording: xr.Dataset | None, region: str, settings: Mapping[str, Any]
) -> int:
    """Return the number of pixels of a region over all frames at which a complete estimate would be scored."""
    found, exact = align(estimate, truth)
    x, y = (found[name].values if name in found.coords else None for name in ("x", "y"))
    perfect = label("estimate", {"depth": exact["depth"].values}, read_intrinsics(found), t=found["t"].values, x=x, y=y)
    count = score(perfect, truth, recording, allow_mismatch=True, settings=settings).regions[region]["depth"]["count"]
    return int(count or 0)


def compute_bound_in_region(
    bound: xr.Dataset,
    names: Collection[str],
    estimate: xr.Dataset,
    truth: xr.Dataset,
    recording: xr.Dataset | None,
    region: str,
    settings: Mapping[str, Any],
) -> dict[str, float | None]:
    """Return the RMS of a bound over the scored pixels of a region."""
    found, exact = align(estimate, truth)
    # The RMSE of an estimate with an error of one standard deviation everywhere is the RMS of the bound.
    wrong = found.copy()
    problems = []
    for name in names:
        entry = QUANTITIES[name]
        if entry.variable not in found:
            # Growth computed from depth and velocity has no variable and therefore no bound.
            continue
        try:
            std = _read_std(bound, entry, found)
        except ValueError as error:
            problems.append(Problem(f"bound.{entry.variable}_std", str(error)))
            continue
        factor = percent_per_hour(read_intrinsics(found)) if entry.units == "%/h" else 1.0
        values = np.array(wrong[entry.variable].values, dtype=np.float64)
        place = values if entry.component is None else values[entry.component]
        place[...] = np.where(np.isfinite(place), read_quantity(exact, name) / factor + std, np.nan)
        wrong[entry.variable] = wrong[entry.variable].copy(data=values)
    if problems:
        raise LimitError(list(dict.fromkeys(problems)))
    regions = score(wrong, truth, recording, allow_mismatch=True, settings=settings).regions[region]
    return {name: regions[name]["rmse"] if QUANTITIES[name].variable in found else None for name in names}


def _read_std(bound: xr.Dataset, entry: Quantity, found: xr.Dataset) -> Map:
    """Return the standard deviations at the pixels of an estimate, NaN where undefined."""
    variable = f"{entry.variable}_std"
    if variable not in bound:
        msg = f"is missing; the bound has {', '.join(sorted(map(str, bound.data_vars)))}"
        raise ValueError(msg)
    array = bound[variable]
    vector = [dim for dim in array.dims if dim not in ("t", "y", "x")]
    if entry.component is not None and vector:
        array = array.isel({vector[0]: entry.component})
    if not set(array.dims) <= {"t", "y", "x"}:
        dims = ", ".join(map(str, bound[variable].dims))
        msg = f"must have the dimensions (t, y, x), preceded by the components of a vector; it has ({dims})"
        raise ValueError(msg)
    for dim in ("t", "y", "x"):
        if dim in array.dims and dim in array.coords and dim in found.coords:
            array = array.reindex({dim: found[dim].values})
    shape = tuple(found.sizes[dim] for dim in ("t", "y", "x"))
    values = array.transpose(*(dim for dim in ("t", "y", "x") if dim in array.dims)).values
    return np.asarray(np.broadcast_to(np.asarray(values, dtype=np.float64), shape))


def draw_differences(
    estimate: xr.Dataset, truth: xr.Dataset, recording: xr.Dataset | None, names: Collection[str], folder: Path
) -> list[Path]:
    """Draw quantities of the frame t = 0 or the middle frame; a distance is drawn as the components of its vector."""
    # Importing matplotlib takes 1 s and is not necessary if all limits are met.
    from scenetruth.scoring.figures.figure_arrays import collect_figure_arrays
    from scenetruth.scoring.figures.figure_style import style
    from scenetruth.scoring.figures.map_figures import draw_comparison

    views = collect_figure_arrays(_blank_like(estimate) if recording is None else recording, estimate, truth)
    wanted = {part for name in names for part in _scalars(name)}
    # In the order of the table, with the components of a vector in one figure.
    known = [name for name in QUANTITIES if name in wanted and name in views.truth and views.knows(name)]
    files = []
    for variable in dict.fromkeys(QUANTITIES[name].variable for name in known):
        shown = tuple(name for name in known if QUANTITIES[name].variable == variable)
        folder.mkdir(parents=True, exist_ok=True)
        file = _free(folder, variable if len(shown) > 1 else shown[0])
        with style():
            draw_comparison(views, shown, file, signed=variable not in ("depth", "disparity"))
        files.append(file)
    return files


def _scalars(name: str) -> tuple[str, ...]:
    entry = QUANTITIES[name]
    if entry.error == "difference":
        return (name,)
    return tuple(
        other
        for other, one in QUANTITIES.items()
        if entry.error == "distance" and one.variable == entry.variable and one.error == "difference"
    )


def _free(folder: Path, stem: str) -> Path:
    names = (folder / f"{stem}{'' if number == 1 else f'_{number}'}.png" for number in count(1))
    return next(file for file in names if not file.exists())


def _blank_like(estimate: xr.Dataset) -> xr.Dataset:
    """Return a recording with a blank image at the pixels of an estimate."""
    x, y = (estimate[name].values if name in estimate.coords else None for name in ("x", "y"))
    image = blank_map(np.float32, (1, 1, estimate.sizes["y"], estimate.sizes["x"]))
    intrinsics = read_intrinsics(estimate)
    return label("recording", {"image": image}, intrinsics, t=[0], s=[0], x=x, y=y, attrs={"full_scale": 1.0})


_HEADS = ("", "quantity", "statistic", "found", "limit", "times", "density", "pixels")


def failure_message(
    outcomes: Sequence[LimitOutcome],
    *,
    method: str,
    region: str,
    pixels: int,
    pictures: Sequence[Path] | str,
    mismatches: Sequence[str],
) -> str:
    """Return the message of a failure."""
    broken = sum(not outcome.kept for outcome in outcomes)
    head = f"{broken} of {len(outcomes)} limit{'s' * (len(outcomes) != 1)} broken by the estimate of '{method}'"
    lines = [f"{head} in the region '{region}' of {pixels} pixels:", *_table(outcomes)]
    if mismatches:
        lines += ["possible convention errors:", *(f"  - {mismatch}" for mismatch in mismatches)]
    if pictures:
        shown = [pictures] if isinstance(pictures, str) else [f"  {file}" for file in pictures]
        lines += shown if isinstance(pictures, str) else ["estimate, truth and error:", *shown]
    look = "scenetruth.write_report(estimate, truth, recording, output=...) draws all maps; "
    lines.append(f"more detail: {look}scenetruth.score(estimate, truth, recording).to_dataframe() lists all regions")
    return "\n".join(lines)


def _table(outcomes: Sequence[LimitOutcome]) -> list[str]:
    rows = [_HEADS]
    for outcome in outcomes:
        limit = outcome.limit
        density = "-" if outcome.density is None else f"{100 * outcome.density:.3g} %"
        rows.append(
            (
                "kept" if outcome.kept else "BROKEN",
                limit.quantity,
                limit.statistic,
                outcome.shown_found,
                outcome.shown_limit,
                format_multiple(outcome.times),
                density,
                str(outcome.count),
            )
        )
    return [f"  {line}" for line in align_columns(rows)]


def assert_accuracy(
    estimate: xr.Dataset,
    truth: xr.Dataset,
    recording: xr.Dataset | None = None,
    *,
    region: str = "interior",
    min_density: float | None = None,
    margin_px: float | None = None,
    settings: Mapping[str, Any] | None = None,
    bound: xr.Dataset | None = None,
    pictures: str | Path | None = None,
    check_conventions: bool = True,
    **limits: Any,
) -> Score:
    r"""Assert that an estimate meets accuracy limits, and report all violations together.

    A limit is named by its quantity and unit, ``depth_mm``, ``disparity_px``, ``flow_px``, ``velocity_z_mm`` (per
    frame), ``growth_per_hour`` (1/h), ``growth_percent_per_hour``, ``normal_deg`` and so on: the quantities of
    `scenetruth.scoring.QUANTITIES`, and ``flow``, ``velocity``, ``slope``, ``rotation_rate`` for each of their
    components. Its value is

    - a number: the maximum RMSE;
    - a mapping of statistics (`scenetruth.scoring.STATISTICS`) to numbers: the maximum value, for ``bias`` of its
      magnitude; for ``density``, ``count`` and ``coverage_2_std`` the minimum;
    - in either, two numbers: minimum and maximum;
    - a text, ``"1.5 x bound"``: a multiple of the Cramér-Rao bound, as RMS over the scored pixels.

    An undefined statistic violates every limit.

    Parameters
    ----------
    estimate, truth, recording
        As in `scenetruth.score`.
    region
        The evaluated region of the score.
    min_density
        Minimum density in the region, for every limited quantity.
    margin_px
        Distance of the interior from silhouettes and creases, in px.
    settings
        Additional settings of the score, see `scenetruth.settings.ScoreSettings`.
    bound
        Standard deviations for multiples of the bound: a data set with ``depth_std``, ``velocity_std`` and so on, in
        the units and dimensions of the estimate's variables. Default: `scenetruth.bound.cramer_rao_bound` of truth and
        recording.
    pictures
        Directory for figures of violated limits. Default: that of the test under the pytest plugin, otherwise none.
    check_conventions
        Whether to detect convention mismatches (signs, units, axes) when a limit is violated.
    **limits
        The limits.

    Returns
    -------
    Score
        The complete score, for other assertions.

    Raises
    ------
    AssertionError
        If a limit is violated; lists the values, their ratios to the limits, densities, likely convention mismatches
        and figures.
    LimitError
        If a quantity, unit, statistic, region or value is invalid; lists every problem. It is a `TypeError` and a
        `ValueError`.
    ScoreError
        If estimate and truth cannot be compared.
    MismatchError
        If they belong to different recordings.

    See Also
    --------
    scenetruth.score : Statistics without limits.
    scenetruth.bound.cramer_rao_bound : The bound for relative limits.
    scenetruth.testing.check_estimator : Conformance of a method with the contract, independent of its accuracy.

    Examples
    --------
    >>> import numpy as np
    >>> from scenetruth.schema import Intrinsics, label
    >>> camera = Intrinsics(focal_length_px=1000.0, principal_point_px=(15.5, 11.5), baseline_mm=5.0)
    >>> still, one = np.zeros((3, 1, 24, 32)), np.ones((1, 24, 32))
    >>> maps = {"depth": 500 * one, "disparity": 10 * one, "velocity": still, "flow": still[:2], "mixed": one == 0}
    >>> truth = label("truth", maps, camera, t=[0])
    >>> estimate = label("estimate", {"depth": 500.1 * one}, camera, t=[0])
    >>> score = assert_accuracy(estimate, truth, depth_mm={"rmse": 0.2, "median_abs_error": 0.15}, min_density=0.9)
    >>> try:
    ...     assert_accuracy(estimate, truth, depth_mm=0.05, check_conventions=False)
    ... except AssertionError as error:
    ...     print("\n".join(str(error).splitlines()[:3]))
    1 of 1 limit broken by the estimate of 'unknown' in the region 'interior' of 768 pixels:
              quantity  statistic  found   limit       times  density  pixels
      BROKEN  depth     rmse       0.1 mm  <= 0.05 mm  2 x    100 %    768
    """
    __tracebackhide__ = True
    wanted, problems = read_limits(limits, min_density)
    chosen = {**(settings or {}), **({} if margin_px is None else {"interior_margin_px": margin_px})}
    try:
        found = score(estimate, truth, recording, settings=chosen)
    except ScenetruthError:
        if problems:
            raise LimitError(problems) from None
        raise
    problems += _region_problems(region, found, recording)
    problems += _truth_problems(wanted, truth)
    relative = [limit.quantity for limit in wanted if limit.of_bound is not None]
    if relative and bound is None and recording is None:
        problems.append(Problem("recording", "is required for the bound; specify it, or bound="))
    if problems:
        raise LimitError(problems)
    least: Mapping[str, float | None] = {}
    if relative:
        if bound is None:
            assert recording is not None
            bound = _cramer_rao(truth, recording)
        least = compute_bound_in_region(bound, dict.fromkeys(relative), estimate, truth, recording, region, chosen)
    values = found.regions[region]
    outcomes = [evaluate_limit(limit, values.get(limit.quantity), least.get(limit.quantity)) for limit in wanted]
    note = get_context().note
    if note is not None:
        note([outcome.row(region) for outcome in outcomes])
    if not all(outcome.kept for outcome in outcomes):
        raise AssertionError(
            failure_message(
                outcomes,
                method=str(estimate.attrs.get("method", "unknown")),
                region=region,
                pixels=count_pixels_in_region(estimate, truth, recording, region, chosen),
                pictures=_pictures(estimate, truth, recording, outcomes, pictures),
                mismatches=_convention_mismatches(estimate, truth) if check_conventions else (),
            )
        )
    return found


def _region_problems(region: object, found: Score, recording: xr.Dataset | None) -> list[Problem]:
    if isinstance(region, str) and region in found.regions:
        return []
    if not isinstance(region, str):
        return [Problem("region", "must be the name of a region", region)]
    if region.startswith("contrast_") and recording is None:
        return [Problem("region", f"'{region}' requires recording=")]
    return [Problem("region", f"'{region}' is not a region of this score{suggest_names(region, tuple(found.regions))}")]


def _truth_problems(wanted: Sequence[Limit], truth: xr.Dataset) -> list[Problem]:
    problems = []
    for name in dict.fromkeys(limit.quantity for limit in wanted):
        # Growth computed from depth and velocity has no variable.
        entries = has_quantity(truth, name) if QUANTITIES[name].variable else "growth_rate" in truth
        if not entries:
            problems.append(Problem(name, "is missing from this truth; some maps require the complete truth"))
    return problems


def _cramer_rao(truth: xr.Dataset, recording: xr.Dataset) -> xr.Dataset:
    from scenetruth.bound import cramer_rao_bound

    return cramer_rao_bound(truth, recording)


def _convention_mismatches(estimate: xr.Dataset, truth: xr.Dataset) -> list[str]:
    # An error in the diagnosis must not hide the violation.
    try:
        from scenetruth.scoring.convention_check import detect_convention_mismatches

        return [mismatch_.message for mismatch_ in detect_convention_mismatches(estimate, truth)]
    except Exception as error:
        return [f"detection failed: {type(error).__name__}: {error}"]


def _pictures(
    estimate: xr.Dataset,
    truth: xr.Dataset,
    recording: xr.Dataset | None,
    outcomes: Sequence[LimitOutcome],
    folder: str | Path | None,
) -> list[Path] | str:
    """Draw violated quantities if a directory is available; return the files, or the reason for their absence."""
    names = dict.fromkeys(outcome.limit.quantity for outcome in outcomes if not outcome.kept)
    try:
        offered = get_context().pictures
        target = Path(folder) if folder is not None else offered() if offered is not None else None
        return [] if target is None else draw_differences(estimate, truth, recording, names, target)
    except Exception as error:
        return f"figures could not be drawn: {type(error).__name__}: {error}"
