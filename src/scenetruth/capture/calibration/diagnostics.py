"""Diagnostics of a calibration: identifiability, cross-validation, scale test, model tests and inconsistent images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.calibration.added_poses import advise_pose
from scenetruth.capture.calibration.bundle_adjustment import RigFit, adjust, robust_weights
from scenetruth.capture.calibration.rig_model import (
    INTRINSICS,
    MOTION,
    STAGE,
    CalibrationError,
    Observations,
    RigGuess,
    RigLayout,
    RigPriors,
    RigState,
    TargetView,
    project,
)
from scenetruth.capture.calibration.start_values import start_state
from scenetruth.capture.calibration.variance_components import scatter_of_poses
from scenetruth.number_format import format_two_digits
from scenetruth.threads import with_one_blas_thread

__all__ = [
    "Combination",
    "HalvesTest",
    "ModelTest",
    "ScaleTest",
    "apparent_steps",
    "check_models",
    "check_scale",
    "compare_halves",
    "diagnose",
    "displaced_images",
    "field_of_residuals",
    "identify_combinations",
    "inconsistent_images",
    "pose_of_change",
    "refit",
]  # fmt: skip

Array = NDArray[np.float64]

_SIGNIFICANT = 1e-3
_EXPLAINED = 0.25  # remaining share of the scatter of single poses that a change of the camera explains
"""Probability of an exact calibration below which a test is reported: with some ten tests per calibration, one of a
hundred exact calibrations has a report.
"""
_LARGER_THAN_MEDIAN = 1.5**2
"""Ratio of mean squared residuals to the median beyond which an image is named: residuals 1.5 times the others."""
_CELLS, _FEWEST_IN_CELL = (8, 6), 10
_FAR = 8.0
"""Standard deviations of the tolerances beyond which an image was not taken where it is stated."""
_LEAST_POSES = 2  # on either side of a change of the camera
_NAMED = 4  # parameters of a combination
_LEAST_SHARE = 0.15  # of the largest component
_WEAK_TILT = 0.01
_LOOSE_SCALE = 1e-2
_SEPARATE_MARK = 1.0
_ASPECT = len(INTRINSICS) + STAGE.index("aspect")
_ABSORBED = 1e-7
"""Share of the information of a lacking parameter below which the rounding of the covariance hides it."""


@dataclass(frozen=True)
class Combination:
    """A combination of parameters and the ratio of the information of the images to that of the priors.

    ``ratio``: Prior variance over the variance from the images alone; above 1 the images are more precise.
    ``words``: The combination in units of the prior standard deviations, for example ``0.71 step_scale``.
    """

    ratio: float
    words: str

    @property
    def from_images(self) -> bool:
        """Whether the images determine the combination better than the priors."""
        return self.ratio > _SEPARATE_MARK


@dataclass(frozen=True)
class HalvesTest:
    """Difference of the intrinsic parameters of two halves of the poses.

    ``name``: ``first against last`` or ``even against odd``.
    ``chi2``, ``dof``: Squared difference in units of its covariance, and the number of parameters.
    ``probability``: Probability of a larger value for an exact model.
    """

    name: str
    chi2: float
    dof: int
    probability: float


@dataclass(frozen=True)
class ScaleTest:
    """Step scale less board scale, from the images alone.

    ``difference``: Relative difference; not zero if the board or the steps have another size than stated.
    ``std``: Its standard deviation, that of the stated tolerances included.
    ``from_images_std``: Its standard deviation by the images alone.
    """

    difference: float
    std: float
    from_images_std: float

    @property
    def z(self) -> float:
        """Difference in units of its standard deviation."""
        return self.difference / self.std


@dataclass(frozen=True)
class ModelTest:
    """Score test of a parameter that the model lacks.

    ``name``: ``k3``, ``k4..k6``, ``aspect`` or ``refocus``.
    ``chi2``, ``dof``, ``probability``: Statistic, its degrees of freedom, and the probability of a larger value.
    ``estimate``: Estimated value of the parameter for a test with one degree of freedom, else NaN.
    """

    name: str
    chi2: float
    dof: int
    probability: float
    estimate: float


@with_one_blas_thread
def identify_combinations(fit: RigFit) -> list[Combination]:
    """Return the combinations of the parameters with a prior, the best determined by the images first.

    Generalised eigenvalues of the information of the images, after the elimination of all parameters without a prior,
    relative to that of the priors.
    """
    std = fit.state.layout.std[fit.free]
    names = [name for name, free in zip(fit.state.layout.names, fit.free, strict=True) if free]
    # Bends and points of a board are no parameters of the rig: eliminated with their tolerances.
    ours = np.flatnonzero(fit.free) < fit.state.layout.first_pose
    bound = np.isfinite(std) & ours
    information = fit.data_information + np.diag(np.where(ours, 0.0, 1 / std**2))
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    free_part = information[np.ix_(~bound, ~bound)] * scale[~bound][:, None] * scale[~bound]
    cross = information[np.ix_(bound, ~bound)] * scale[~bound]
    reduced = information[np.ix_(bound, bound)] - _eliminate(free_part, cross)
    relative = reduced * std[bound][:, None] * std[bound]
    values, vectors = np.linalg.eigh((relative + relative.T) / 2)
    chosen = [name for name, has_prior in zip(names, bound, strict=True) if has_prior]
    return [
        Combination(max(float(values[index]), 0.0), _words(vectors[:, index], chosen)) for index in np.argsort(-values)
    ]


def _eliminate(free_part: Array, cross: Array) -> Array:
    """Return what the elimination of the parameters without a prior takes from the information on the others."""
    from scipy.linalg import solve_triangular

    try:
        # An explicit inverse loses half of the digits.
        half = solve_triangular(np.linalg.cholesky(free_part), cross.T, lower=True)
    except np.linalg.LinAlgError:  # the images leave a combination of these parameters undetermined
        return np.asarray(cross @ np.linalg.pinv(free_part, rcond=1e-12, hermitian=True) @ cross.T)
    return np.asarray(half.T @ half)


def _words(vector: Array, names: Sequence[str]) -> str:
    """Return the largest components of a combination, the first with a positive sign."""
    order = np.argsort(-np.abs(vector))
    chosen = [int(index) for index in order[:_NAMED] if abs(vector[index]) >= _LEAST_SHARE * abs(vector[order[0]])]
    sign = np.sign(vector[order[0]])
    text = ""
    for index in chosen:
        value = sign * vector[index]
        text += f"{' + ' if value > 0 else ' - '}{abs(value):.2f} {names[index]}"
    return text.removeprefix(" + ")


def compare_halves(given: Observations, fit: RigFit, priors: RigPriors, by: str) -> HalvesTest | None:
    """Return the difference of the intrinsic parameters of two halves; None if one half alone is too little.

    ``by``: ``first against last`` halves of the recording, which shows a refocus or a drift, or ``even against odd``
      poses.
    """
    halves = _fit_halves(given, fit, priors, by)
    if halves is None:
        return None
    chosen = [index for index in range(len(INTRINSICS)) if fit.free[index]]
    values = [part.state.values[chosen] for part in halves]
    covariances = [fit.widened(part.covariance)[np.ix_(chosen, chosen)] for part in halves]
    difference = values[0] - values[1]
    total = covariances[0] + covariances[1]
    scale = np.sqrt(np.diag(total))
    chi2 = float((difference / scale) @ np.linalg.solve(total / scale[:, None] / scale, difference / scale))
    return HalvesTest(by, chi2, len(chosen), _survival(chi2, len(chosen)))


def _fit_halves(given: Observations, fit: RigFit, priors: RigPriors, by: str) -> tuple[RigFit, RigFit] | None:
    poses = _board_poses(fit)
    first = set(poses[: len(poses) // 2]) if by == "first against last" else set(poses[::2])
    found = []
    for chosen in (first, set(poses) - first):
        # The time of a strip relative to the boards is unknown.
        half = [view for view in fit.given.views if view.pose in chosen]
        part = refit(given.selected(half), fit, priors) if len(chosen) > 1 else None
        if part is None:
            return None
        found.append(part)
    return found[0], found[1]


def _board_poses(fit: RigFit) -> list[int]:
    """Return the poses of the board in order of time, without that of a strip."""
    return list(dict.fromkeys(view.pose for view in fit.given.views if view.target == 0))


def pose_of_change(fit: RigFit) -> int | None:
    """Return the pose from which on another camera explains why results of single poses scatter; None if none does.

    The change also widens the uncertainty in which a refocus is tested. Without it, the poses scatter much less. The
    images of a strip were taken before or after the change.
    """
    if fit.scatter is None:
        return None
    _, slopes = project(fit.given, fit.state, derivatives=True)
    whitened, z = _weighted(fit, slopes)
    lens = np.flatnonzero(fit.free[: len(INTRINSICS)])
    poses = _board_poses(fit)
    sides = (0.5, -0.5) if any(view.target != 0 for view in fit.given.views) else (0.0,)
    best: tuple[float, int, Array] | None = None
    for onset in range(_LEAST_POSES, len(poses) - _LEAST_POSES + 1):
        for side in sides:
            later = _later(fit, poses[onset:], strip=side)
            chi2, _, change = _score(fit, whitened, whitened[:, :, lens] * later[:, None, None], z)
            if best is None or chi2 > best[0]:
                best = chi2, poses[onset], (slopes[:, :, lens] @ change) * later[:, None]
    if best is None:
        return None
    views = [
        replace(view, pixels=view.pixels - move)
        for view, move in zip(fit.given.views, np.split(best[2], fit.given.first[1:-1]), strict=True)
    ]
    left = scatter_of_poses(adjust(fit.given.selected(views), fit.state, fit.start, must_converge=False))
    return best[1] if left is None or left.mean < _EXPLAINED * fit.scatter.mean else None


def _later(fit: RigFit, poses: Sequence[int], *, strip: float = 0.0) -> Array:
    """Return 0.5 for the points of later poses, -0.5 for the others, and a value for those of a strip, shape (n,)."""
    chosen, counts = set(poses), np.diff(fit.given.first)
    signs = [strip if view.target != 0 else 0.5 if view.pose in chosen else -0.5 for view in fit.given.views]
    return np.repeat(signs, counts)


def refit(given: Observations, fit: RigFit, priors: RigPriors) -> RigFit | None:
    """Return the fit of other observations or priors, from the values of a fit; None if they do not determine it."""
    layout = RigLayout.from_observations(given, priors)
    places = {name: index for index, name in enumerate(fit.state.layout.names)}
    values = np.array([fit.state.values[places[name]] for name in layout.names])
    numbers = {pose: number for number, pose in enumerate(fit.state.layout.poses)}
    turns = fit.state.turns[[numbers[pose] for pose in layout.poses]]
    start = np.zeros(layout.size)
    start[: layout.first_position] = fit.start[: layout.first_position]
    try:
        return adjust(given, RigState(layout, values, turns), start)
    except CalibrationError:
        return None


def _survival(chi2: float, dof: int) -> float:
    from scipy.stats import chi2 as distribution

    return float(distribution.sf(chi2, dof))


def check_scale(fit: RigFit, priors: RigPriors) -> ScaleTest | None:
    """Return the step scale less the board scale with loose tolerances of both; None without a stage or a board.

    The chi-squared of a calibration does not show a wrong square size: the priors absorb it. With tolerances of 1 % the
    difference is free, and shows it.
    """
    if fit.state.layout.positions < 2:
        return None
    loose = priors.model_copy(update={"step_std": _LOOSE_SCALE})
    targets = tuple(
        target.model_copy(update={"scale_std": _LOOSE_SCALE}) if number == 0 else target
        for number, target in enumerate(fit.given.targets)
    )
    given = Observations(
        fit.given.width, fit.given.height, fit.given.positions_mm, targets, fit.given.views, fit.given.reference
    )
    found = refit(given, fit, loose)
    if found is None:
        return None
    # Excluded images have taken their visits along.
    layout = found.state.layout
    weights = np.zeros(layout.size)
    step, scale = layout.names.index("step_scale"), layout.first_target
    weights[step], weights[scale] = 1.0, -1.0
    difference = float(weights @ found.state.values)
    square = float(weights @ fit.widened(found.covariance) @ weights)
    tolerances = priors.step_std**2 + fit.given.targets[0].scale_std ** 2
    return ScaleTest(difference, float(np.sqrt(square + tolerances)), float(np.sqrt(square)))


def check_models(fit: RigFit) -> list[ModelTest]:
    """Return score tests of parameters that the model lacks: k3, k4..k6, aspect, and a refocus half-way."""
    whitened, z = _weighted(fit, project(fit.given, fit.state, derivatives=True)[1])
    poses, tests = _board_poses(fit), list[ModelTest]()
    half = _later(fit, poses[len(poses) // 2 :])
    candidates: list[tuple[str, list[Callable[[], Array]]]] = []
    if not fit.free[7]:
        candidates.append(("k3", [lambda: whitened[:, :, 7]]))
    if not fit.free[8]:
        candidates.append(("k4..k6", [lambda k=k: whitened[:, :, k] for k in (8, 9, 10)]))  # type: ignore[misc]
    if not fit.free[_ASPECT]:
        candidates.append(("aspect", [lambda: whitened[:, :, _ASPECT]]))
    if len(poses) >= 2 * _LEAST_POSES:
        candidates.append(("refocus", [lambda: whitened[:, :, 0] * half[:, None]]))
    for name, columns in candidates:
        tests.append(_score_test(name, fit, whitened, np.stack([column() for column in columns], axis=-1), z))
    return tests


def _weighted(fit: RigFit, slopes: Array) -> tuple[Array, Array]:
    """Return slopes and residuals in units of the noise, with the weights of the covariance.

    The poses absorb all but 1e-5 of a refocus, which a difference of 1 % in the weights would hide.
    """
    root = np.sqrt(robust_weights(np.hypot(fit.z[:, 0], fit.z[:, 1])))[:, None]
    return root[:, :, None] * (fit.given.whitening @ slopes), root * fit.z


def _score_test(name: str, fit: RigFit, whitened: Array, extra: Array, z: Array) -> ModelTest:
    """Return the score test of columns (n, 2, m) in addition to all estimated parameters."""
    square, dof, estimates = _score(fit, whitened, extra, z)
    factor = max(fit.variance_factor, 1.0) if fit.scatter is None else fit.scale * fit.scatter.mean
    chi2 = square / factor
    estimate = float(estimates[0]) if len(estimates) == 1 else np.nan
    return ModelTest(name, chi2, dof, _survival(chi2, dof) if dof else 1.0, estimate)


def _score(fit: RigFit, whitened: Array, extra: Array, z: Array) -> tuple[float, int, Array]:
    """Return the statistic of a score test, its degrees of freedom, and the estimates of the m parameters."""
    count = extra.shape[2]
    cross = fit.state.layout.gather(fit.given, whitened, extra)
    flat = extra.reshape(-1, count)
    score = flat.T @ z.ravel()
    whole = flat.T @ flat
    information = whole - cross.T @ fit.covariance @ cross
    scale = 1 / np.sqrt(np.maximum(np.diag(whole), 1e-300))
    values, vectors = np.linalg.eigh(information * scale[:, None] * scale)
    # Combinations that the estimated parameters absorb are excluded.
    kept = values > _ABSORBED
    projected = vectors[:, kept].T @ (score * scale)
    estimates = scale * (vectors[:, kept] @ (projected / values[kept]))
    return float((projected**2 / values[kept]).sum()), int(kept.sum()), estimates


def inconsistent_images(fit: RigFit) -> list[str]:
    """Return a description of every image that contradicts the others, or has much larger residuals."""
    found = []
    squares = np.array([view.mean_square for view in fit.views if view.consistent])
    median = float(np.median(squares))
    for view in fit.views:
        # The mean of 2 n squared normal values scatters by the root of 1 / n; five deviations of it are no chance. A
        # median below 1 is that of overstated noise: residuals as large as stated are no fault of an image.
        limit = max(_LARGER_THAN_MEDIAN * median, (1 + 5 / np.sqrt(max(view.points, 1))) * max(median, 1.0))
        if not view.consistent:
            text = (
                f"{view.name}: contradicts the other images (residual "
                f"{format_two_digits(view.rms_px)} px); check its position"
            )
            found.append(f"{text}, its visit, and that it shows one board")
        elif view.mean_square > limit:
            ratio = float(np.sqrt(view.mean_square / median))
            found.append(f"{view.name}: residuals are {ratio:.1f} times those of the other images; check its sharpness")
    return found


def displaced_images(fit: RigFit) -> list[str]:
    """Return a description of every image whose visit lies far beyond the tolerances of the stage."""
    layout, names = fit.state.layout, dict[int, str]()
    for view in fit.given.views:
        names.setdefault(view.visit, view.name)
    found = []
    places = {name: index for index, name in enumerate(layout.names)}
    for visit, name in names.items():
        pulls = {}
        for motion in MOTION:
            index = places.get(f"visit[{visit}].{motion}")
            if index is not None and fit.free[index] and np.isfinite(layout.std[index]):
                pulls[motion] = (fit.state.values[index], layout.std[index])
        if not pulls:
            continue
        worst = max(pulls, key=lambda motion: abs(pulls[motion][0]) / pulls[motion][1])
        value, std = pulls[worst]
        if abs(value) < _FAR * std:
            continue
        place = f"{value:+.3g} mm ({worst})" if worst in "xyz" else f"{1e3 * value:+.3g} mrad ({worst})"
        found.append(
            f"{name}: is {place} from its position, {abs(value) / std:.0f} times the tolerance of the stage; check its "
            "position and its number, and whether the camera was knocked"
        )
    return found


def field_of_residuals(fit: RigFit) -> float:
    """Return the mean square of the mean residuals over cells of the image, in units of their standard deviation.

    Noise leaves 1 or a little less; residuals that depend on the place in the image are an error of the lens model.
    """
    cells = np.floor(fit.given.pixels / [fit.given.width, fit.given.height] * _CELLS).astype(np.int64)
    numbers = np.clip(cells[:, 0], 0, _CELLS[0] - 1) + _CELLS[0] * np.clip(cells[:, 1], 0, _CELLS[1] - 1)
    counts = np.bincount(numbers)
    sums = np.stack([np.bincount(numbers, fit.z[:, axis]) for axis in (0, 1)], axis=-1)
    used = counts >= _FEWEST_IN_CELL
    if used.sum() < _CELLS[0]:
        return 1.0
    return float((sums[used] ** 2 / counts[used][:, None]).mean())


def apparent_steps(given: Observations, guess: RigGuess) -> tuple[Array, float]:
    """Return the displacement of each position from the first by single images, and the median distance of the boards.

    Each image is a camera of its own, so that no model of the stage is used: median over the poses, in mm, shape
    (S, 3); NaN for positions without a common pose with the first. Yaw changes them by its angle times the distance.
    An error of the focal length has no effect, because distances have the same error.
    """
    solo = RigPriors(free_distortion=(), intrinsics={}, step_std=0, axis_rad=0, position_um=0)
    places: dict[tuple[int, int], Array] = {}
    for view in given.views:
        if view.target != 0:
            continue
        single = Observations(
            given.width, given.height, np.zeros(1), given.targets, (_at_origin(view),), 0,
        )  # fmt: skip
        layout = RigLayout.from_observations(single, solo)
        pose = start_state(single, solo, guess)
        centre = pose.values[layout.first_pose + 3 : layout.first_pose + 6]
        # The displacement of the camera is opposite to that of the board.
        places[view.pose, view.position] = -centre
    steps = np.full((len(given.positions_mm), 3), np.nan)
    base = min((position for _, position in places), default=0)
    for position in range(len(given.positions_mm)):
        poses = [pose for pose, other in places if other == position and (pose, base) in places]
        if poses:
            steps[position] = np.median([places[pose, position] - places[pose, base] for pose in poses], axis=0)
    distance = float(np.median([abs(place[2]) for place in places.values()])) if places else np.nan
    return steps, distance


def _at_origin(view: TargetView) -> TargetView:
    return TargetView(view.name, 0, 0, 0, view.points_mm, view.pixels, view.covariance_px2, view.target)


def step_problems(steps: Array, positions_mm: Array, yaw_rad: float, distance_mm: float) -> list[str]:
    """Return mistakes of the stage that the apparent steps show: units, order, axis and square size."""
    seen = np.isfinite(steps[:, 0])
    nominal = positions_mm[seen] - positions_mm[seen][0]
    if seen.sum() < 2 or not np.abs(nominal).max() > 0:
        return []
    slopes = nominal @ steps[seen] / (nominal @ nominal)
    along, across = float(slopes[0]), float(np.hypot(slopes[1], slopes[2]))
    length = float(np.linalg.norm(slopes))
    tolerance = 5 * yaw_rad * distance_mm / float(np.abs(nominal).max()) + 0.01
    problems = []
    if abs(length / 1000 - 1) < 0.05 or abs(length * 1000 - 1) < 0.05:
        problems.append(f"the steps appear {length:.4g} times as long as stated: check mm and m")
    elif across > 3 * abs(along) and across > 5 * tolerance:
        axis = "Y" if abs(slopes[1]) > abs(slopes[2]) else "Z"
        problems.append(f"the camera moves along {axis}, not X: check the axis of the stage and the turn of the images")
    elif along < 0:
        problems.append(
            "the camera moves against the stated direction: reverse the positions, or turn images that are turned or "
            "mirrored"
        )
    elif abs(length - 1) > tolerance:
        problems.append(
            f"the steps appear {length:.4f} times as long as stated: check the square size and the positions"
        )
    return problems


@with_one_blas_thread
def diagnose(given: Observations, fit: RigFit, priors: RigPriors) -> list[str]:
    """Return everything that speaks against a calibration, in words; empty for a clean one."""
    words = [*inconsistent_images(fit), *displaced_images(fit)]
    if fit.variance_factor > 1.1:
        words.append(
            f"chi-squared per degree of freedom is {fit.variance_factor:.2f}: "
            "the stated uncertainty is scaled by its root"
        )
    scale = check_scale(fit, priors)
    if scale is not None and abs(scale.z) > _normal_limit():
        words.append(
            f"step scale less board scale is {1e6 * scale.difference:.0f} ppm, {abs(scale.z):.1f} standard deviations: "
            "check the size of the squares and the steps of the stage"
        )
    remedies = {
        "k3": "add k3 to free_distortion",
        "k4..k6": "add k3, k4, k5 and k6 to free_distortion",
        "aspect": "add aspect to free_distortion",
        "refocus": "calibrate again with a fixed focus; the focal length differs between the halves",
    }
    pose = pose_of_change(fit)
    if pose is not None:
        words.append(
            f"the poses scatter because the camera changed before pose {pose}, by a refocus or a lens that moved: "
            "calibrate again with a fixed focus and a fixed lens"
        )
    words += [
        f"the residuals ask for {test.name} (chi-squared {test.chi2:.0f} for {test.dof}): {remedies[test.name]}"
        for test in check_models(fit)
        if test.probability < _SIGNIFICANT and not (pose is not None and test.name == "refocus")
    ]
    for by in ("first against last", "even against odd") if pose is None else ():
        halves = compare_halves(given, fit, priors, by)
        if halves is not None and halves.probability < _SIGNIFICANT:
            words.append(
                f"the halves differ ({by}: chi-squared {halves.chi2:.0f} for {halves.dof}): "
                "the camera changed, or the noise of the corners is understated"
            )
    advice = advise_pose(fit, priors)
    if advice:
        words.append(advice)
    elif fit.std("f") > _WEAK_TILT * fit.state.value("f"):
        words.append(
            f"the focal length is uncertain by {100 * fit.std('f') / fit.state.value('f'):.1f} %: "
            "add poses with a tilt of 35 to 40°"
        )
    return words


def _normal_limit() -> float:
    from scipy.stats import norm

    return float(norm.isf(_SIGNIFICANT / 2))
