"""The assertion that an estimate is as accurate as it must be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from scenetruth.errors import Problem, ScenetruthError
from scenetruth.scoring import QUANTITIES, Score, score
from scenetruth.scoring.reading import tells
from scenetruth.testing.accuracy.limits import Limit, LimitError, meant, read_limits
from scenetruth.testing.accuracy.message import failure_message
from scenetruth.testing.accuracy.outcomes import Outcome, judge
from scenetruth.testing.accuracy.pictures import draw_differences
from scenetruth.testing.accuracy.pseudo import bound_in_region, pixels_in_region
from scenetruth.testing.surroundings import around

__all__ = ["assert_accuracy"]


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
    slips: bool = True,
    **limits: Any,
) -> Score:
    r"""Assert that an estimate keeps limits of accuracy, and tell all that are broken at once.

    A limit is named by its quantity and unit, ``depth_mm``, ``disparity_px``, ``flow_px``, ``velocity_z_mm`` (per
    frame), ``growth_per_hour`` (1/h), ``growth_percent_per_hour``, ``normal_deg`` and so on: the quantities of
    `scenetruth.scoring.QUANTITIES`, and ``flow``, ``velocity``, ``slope``, ``rotation_rate`` for each of their
    components. Its value is

    - a number: the largest rms of the error;
    - a mapping of statistics (`scenetruth.scoring.STATISTICS`; ``median`` and ``p95`` are those of absolute errors) to
      numbers: the largest value, of ``bias`` either way; of ``density``, ``count`` and ``within_2_std`` the least one;
    - in either, two numbers: the least and the largest value;
    - a text, ``"1.5 x bound"``: that multiple of the Cramér-Rao bound, as rms over the pixels that are scored.

    What is undefined, because nothing is scored or the estimate lacks it, is never kept.

    Parameters
    ----------
    estimate, truth, recording
        As of `scenetruth.score`.
    region
        Where errors count, a region of the score.
    min_density
        The least share of the region's pixels that must be estimated, of every quantity that is limited.
    margin_px
        Distance of the interior from silhouettes and face edges, in px.
    settings
        More settings of the score, see `scenetruth.settings.ScoreSettings`.
    bound
        Standard deviations to take multiples of: a data set with ``depth_std``, ``velocity_std`` and so on, in the
        units and dimensions of the estimate's variables. If not given, `scenetruth.bound.cramer_rao` of truth and
        recording.
    pictures
        Folder for pictures of what breaks its limit. If not given, that of the test under the pytest plugin, else none.
    slips
        Whether to look for slips of convention (signs, units, axes) when a limit is broken.
    **limits
        The limits.

    Returns
    -------
    Score
        The whole score, for assertions of other kinds.

    Raises
    ------
    AssertionError
        If a limit is broken: what was found of each, how many times over, how much was scored, likely slips, pictures.
    LimitError
        With every quantity, unit, statistic and region that does not exist, and every value that is no limit; a
        `TypeError` and a `ValueError`.
    ScoreError
        If estimate and truth cannot be compared.
    MismatchError
        If they belong to different recordings.

    See Also
    --------
    scenetruth.score : The figures alone, without limits.
    scenetruth.bound.cramer_rao : The bound that limits may be multiples of.
    scenetruth.testing.check_estimator : Whether a method keeps to the contract, however accurate it is.

    Examples
    --------
    >>> import numpy as np
    >>> from scenetruth.schema import Intrinsics, label
    >>> camera = Intrinsics(focal_length_px=1000.0, principal_point_px=(15.5, 11.5), baseline_mm=5.0)
    >>> still, one = np.zeros((3, 1, 24, 32)), np.ones((1, 24, 32))
    >>> maps = {"depth": 500 * one, "disparity": 10 * one, "velocity": still, "flow": still[:2], "mixed": one == 0}
    >>> truth = label("truth", maps, camera, t=[0])
    >>> estimate = label("estimate", {"depth": 500.1 * one}, camera, t=[0])
    >>> score = assert_accuracy(estimate, truth, depth_mm={"rms": 0.2, "median": 0.15}, min_density=0.9)
    >>> try:
    ...     assert_accuracy(estimate, truth, depth_mm=0.05, slips=False)
    ... except AssertionError as error:
    ...     print("\n".join(str(error).splitlines()[:3]))
    1 of 1 limit broken by the estimate of 'unknown' in the region 'interior' of 768 pixels:
              quantity  statistic  found   limit       times  density  pixels
      BROKEN  depth     rms        0.1 mm  <= 0.05 mm  2 x    100 %    768
    """
    __tracebackhide__ = True
    wanted, problems = read_limits(limits, min_density)
    chosen = {**(settings or {}), **({} if margin_px is None else {"margin_px": margin_px})}
    try:
        found = score(estimate, truth, recording, **chosen)
    except ScenetruthError:
        if problems:
            raise LimitError(problems) from None
        raise
    problems += _region_problems(region, found, recording)
    problems += _truth_problems(wanted, truth)
    relative = [limit.quantity for limit in wanted if limit.of_bound is not None]
    if relative and bound is None and recording is None:
        problems.append(Problem("recording", "is needed for the bound; give it, or bound="))
    if problems:
        raise LimitError(problems)
    least: Mapping[str, float | None] = {}
    if relative:
        if bound is None:
            assert recording is not None
            bound = _cramer_rao(truth, recording)
        least = bound_in_region(bound, dict.fromkeys(relative), estimate, truth, recording, region, chosen)
    values = found.regions[region]
    outcomes = [judge(limit, values.get(limit.quantity), least.get(limit.quantity)) for limit in wanted]
    note = around().note
    if note is not None:
        note([outcome.row(region) for outcome in outcomes])
    if not all(outcome.kept for outcome in outcomes):
        raise AssertionError(
            failure_message(
                outcomes,
                method=str(estimate.attrs.get("method", "unknown")),
                region=region,
                pixels=pixels_in_region(estimate, truth, recording, region, chosen),
                pictures=_pictures(estimate, truth, recording, outcomes, pictures),
                slips=_slips(estimate, truth) if slips else (),
            )
        )
    return found


def _region_problems(region: object, found: Score, recording: xr.Dataset | None) -> list[Problem]:
    if isinstance(region, str) and region in found.regions:
        return []
    if not isinstance(region, str):
        return [Problem("region", "must be the name of a region", region)]
    if region.startswith("contrast_") and recording is None:
        return [Problem("region", f"'{region}' is known with recording= only")]
    return [Problem("region", f"'{region}' is none of this score{meant(region, tuple(found.regions))}")]


def _truth_problems(wanted: Sequence[Limit], truth: xr.Dataset) -> list[Problem]:
    problems = []
    for name in dict.fromkeys(limit.quantity for limit in wanted):
        # Growth that follows from depth and velocity has no variable of its own.
        told = tells(truth, name) if QUANTITIES[name].variable else "growth_rate" in truth
        if not told:
            problems.append(Problem(name, "is not in this truth; some maps are in complete truths only"))
    return problems


def _cramer_rao(truth: xr.Dataset, recording: xr.Dataset) -> xr.Dataset:
    from scenetruth.bound import cramer_rao

    return cramer_rao(truth, recording)


def _slips(estimate: xr.Dataset, truth: xr.Dataset) -> list[str]:
    # Whatever goes wrong in looking further must not hide what was broken.
    try:
        from scenetruth.scoring.slips import find_slips

        return [slip.message for slip in find_slips(estimate, truth)]
    except Exception as error:
        return [f"none could be looked for: {type(error).__name__}: {error}"]


def _pictures(
    estimate: xr.Dataset,
    truth: xr.Dataset,
    recording: xr.Dataset | None,
    outcomes: Sequence[Outcome],
    folder: str | Path | None,
) -> list[Path] | str:
    """Draw what is broken where somebody wants to have it; return the files, or why there are none."""
    names = dict.fromkeys(outcome.limit.quantity for outcome in outcomes if not outcome.kept)
    try:
        offered = around().pictures
        target = Path(folder) if folder is not None else offered() if offered is not None else None
        return [] if target is None else draw_differences(estimate, truth, recording, names, target)
    except Exception as error:
        return f"no pictures could be drawn: {type(error).__name__}: {error}"
