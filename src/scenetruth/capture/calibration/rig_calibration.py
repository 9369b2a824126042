"""Calibration of a rig from images of boards, or from detected points."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenetruth.camera import Camera
from scenetruth.capture.calibration.boards import Board, DotGrid
from scenetruth.capture.calibration.bundle_adjustment import SCALED_ABOVE, RigFit, adjust, not_converged, robust_cost
from scenetruth.capture.calibration.calibration_result import RigCalibration
from scenetruth.capture.calibration.corner_detection import Detection, detect_board
from scenetruth.capture.calibration.corner_refinement import disc_bias, estimate_noise, refine_points
from scenetruth.capture.calibration.diagnostics import (
    apparent_steps,
    check_models,
    diagnose,
    displaced_images,
    field_of_residuals,
    identify_combinations,
    step_problems,
)
from scenetruth.capture.calibration.lens_continuation import (
    RADIAL,
    continue_lens,
    folding,
    is_extrapolated,
    is_undetermined,
    shortened,
)
from scenetruth.capture.calibration.rig_model import (
    INTRINSICS,
    CalibrationError,
    CalibrationTarget,
    Observations,
    RigGuess,
    RigLayout,
    RigPriors,
    RigState,
    TargetView,
    project,
    rotation_matrix,
)
from scenetruth.capture.calibration.start_values import complete_guess, fit_homography, start_state, with_other_tilts
from scenetruth.capture.calibration.variance_components import (
    carry_start,
    carry_state,
    estimate_components,
    fit_places,
    places_of_points,
    scatter_of_poses,
)
from scenetruth.errors import EstimateWarning, Problem
from scenetruth.number_format import format_two_digits
from scenetruth.threads import with_one_blas_thread

__all__ = ["BoardImage", "RigSolution", "calibrate", "describe_fit", "fit_rig", "observe_boards"]

Array = NDArray[np.float64]

_REJECTED_ABOVE = 2.0
"""Chi-squared per degree of freedom above which the calibration is rejected."""
_WEAKEST_FOCAL = 0.05
_LEAST_NOISE = 1e-4  # of the contrast, the rounding of 12 bits
_LARGEST_MISFIT = 0.25  # squares, more than any usable lens distorts
_LARGEST_BIAS_CHANGE = 1e-4  # px
_SHARE_OF_IMAGES = 0.25
_LARGEST_NOISE_PX = 0.3
"""Noise of the corners beyond which images contradict each other: that of a poor phone camera."""
_COEFFICIENTS = {"aspect": ("aspect",), "k3": ("k3",), "k4..k6": ("k3", "k4", "k5", "k6")}
_NEXT = ("k3", "aspect")
"""Coefficients that are tried where the usual model does not fit."""
_BETTER = 100.0
"""Decrease of the robust cost for which they are estimated: 1 is expected by chance for each, and five times as much
where all points of an image have common errors.
"""
_MOST_CHOICES = 4
_TIGHTER = (1, 2, 4, 8)
"""Divisors of the prior of the lens beyond the points, the first for which it does not fold the image."""
_SHOWN = 3.5
"""Ratio to its standard deviation below which an additional coefficient is fixed again."""
_BEYOND_DOUBT = 1e-6
"""Probability of an exact lens model below which the next one is used: no chance in any number of calibrations."""


@dataclass(frozen=True, eq=False)
class BoardImage:
    """An image of a board.

    Parameters
    ----------
    image
        Grey values proportional to the light, shape (rows, columns); or a function that returns them.
    position
        Index of the stage position.
    pose
        Number of the pose of the board.
    visit
        Number of the stage move that reached the position; default: a visit of its own.
    direction
        Direction of that move: 1 towards +X, -1 towards -X.
    name
        Name in messages.
    variance
        Variance of the noise of every pixel, of the shape of the image or one value; or a function that returns them,
        called after ``image``. Default: estimated from the image.

    See Also
    --------
    calibrate : Calibrates a rig from images.

    Examples
    --------
    >>> import numpy as np
    >>> from scenetruth.capture.calibration import BoardImage
    >>> image = BoardImage(np.zeros((480, 640)), position=2, pose=0, name="p0_s2.png")
    >>> image.position, image.visit
    (2, None)
    """

    image: Array | Callable[[], Array]
    position: int
    pose: int
    visit: int | None = None
    direction: int = 1
    name: str = ""
    variance: Array | float | Callable[[], Array] | None = None


def observe_boards(
    images: Sequence[BoardImage], board: Board, positions_mm: ArrayLike, *, reference: int | None = None
) -> Observations:
    """Detect a board in images and return its refined points with their covariance.

    Parameters
    ----------
    images
        Images of the board, in the order in which they were recorded.
    board
        The board.
    positions_mm
        Nominal X of every stage position in mm.
    reference
        Index of the reference position; default: the middle one.

    Returns
    -------
    Observations
        Detected points of all images.

    Raises
    ------
    ValueError
        A `CalibrationError` if images differ in size, or more than a quarter of them show no board.

    See Also
    --------
    calibrate : Includes the detection.

    Examples
    --------
    An image without a board is named with the reason:

    >>> import numpy as np
    >>> from scenetruth.capture.calibration import BoardImage, CalibrationError, Checkerboard, observe_boards
    >>> board = Checkerboard(kind="checkerboard", squares=(8, 6), square_mm=7.0)
    >>> try:
    ...     observe_boards([BoardImage(np.zeros((120, 160)), 0, 0, name="p0_s0.png")], board, [0.0])
    ... except CalibrationError as error:
    ...     print(error.problems[0].path, error.problems[0].message[:14])
    p0_s0.png shows no board
    """
    positions = np.asarray(positions_mm, dtype=np.float64)
    views, problems = [], []
    size: tuple[int, ...] | None = None
    for number, given in enumerate(images):
        name = given.name or f"image {number}"
        image = np.asarray(given.image() if callable(given.image) else given.image, dtype=np.float64)
        size = image.shape if size is None else size
        if image.ndim != 2 or image.shape != size:
            problems.append(Problem(name, f"must have the shape {size} of the first image", image.shape))
            continue
        detection = detect_board(image, board)
        if detection.reason:
            problems.append(Problem(name, f"shows no board: {detection.reason}"))
            continue
        misfit = _misfit(board, detection)
        if misfit > _LARGEST_MISFIT:
            message = f"has points {misfit:.1f} squares from a plane; show one board, and check its number of squares"
            problems.append(Problem(name, message))
            continue
        noise = given.variance() if callable(given.variance) else given.variance
        variance = _noise_variance(image) if noise is None else noise
        points = refine_points(image, variance, board, detection)
        if len(points.ids) < 6:
            message = f"has {len(points.ids)} corners that fit the edge model, of at least 6; check light and sharpness"
            problems.append(Problem(name, message))
            continue
        visit = number if given.visit is None else given.visit
        views.append(
            TargetView(
                name,
                given.position,
                visit,
                given.pose,
                board.points_mm[points.ids],
                points.pixels,
                points.covariance_px2,
                0,
                given.direction,
            )
        )
    if size is None or not views or len(problems) > _SHARE_OF_IMAGES * len(images):
        raise CalibrationError(problems or [Problem("images", "are missing")])
    for problem in problems:
        if "shape" in problem.message:
            raise CalibrationError(problems)
        warnings.warn(str(problem), EstimateWarning, stacklevel=2)
    middle = (len(positions) - 1) // 2 if reference is None else reference
    return Observations(size[1], size[0], positions, (board.target,), tuple(views), middle)


def _noise_variance(image: Array) -> float:
    """Return the variance of the noise of an image, with that of rounding where the grey values are whole."""
    whole = bool((image == np.rint(image)).all())
    least = 1 / 12 if whole else (_LEAST_NOISE * float(np.nanmax(image) - np.nanmin(image))) ** 2
    return max(estimate_noise(image) ** 2, least)


def _misfit(board: Board, detection: Detection) -> float:
    """Return the 90th percentile of the distances of points from a plane, in the distance of neighbouring points."""
    points = board.points_mm[detection.ids, :2]
    homography = fit_homography(points, detection.pixels)
    shown = np.column_stack([points, np.ones(len(points))]) @ homography.T
    away = np.hypot(*(shown[:, :2] / shown[:, 2:] - detection.pixels).T)
    spread = np.hypot(*np.std(detection.pixels, axis=0)) / np.hypot(*np.std(points, axis=0))
    spacing = board.spacing_mm if isinstance(board, DotGrid) else board.square_mm
    return float(np.percentile(away, 90) / (spread * spacing))


@with_one_blas_thread
def calibrate(
    observations: Observations | Sequence[BoardImage],
    board: Board | None = None,
    *,
    positions_mm: ArrayLike | None = None,
    reference: int | None = None,
    guess: RigGuess | Camera | RigCalibration | float | None = None,
    priors: RigPriors | None = None,
    strip: CalibrationTarget | None = None,
    strip_views: Sequence[TargetView] = (),
) -> RigCalibration:
    """Calibrate a camera on its stage from images of a board in several poses.

    A robust bundle adjustment estimates focal length, principal point, distortion, stage axis, step length, the pose of
    the camera at every position and visit, and scale, warp and poses of the board, together with their covariance.

    Parameters
    ----------
    observations
        Images of the board, or points detected before. At least three poses; eight poses, tilted by 35 to 40°, are
        advised.
    board
        The board; required for images, and for detected dots, whose centroids are corrected for perspective.
    positions_mm
        Nominal X of every stage position in mm; required for images.
    reference
        Index of the reference position; default: the middle one.
    guess
        Start of the intrinsic parameters: focal length in px, a camera, another calibration, or a `RigGuess`; default:
        from the images.
    priors
        Tolerances of the stage; default: a screw stage with a step length of 1e-4.
    strip
        Tolerances of a fiducial strip that is visible in images of the measurement.
    strip_views
        Points of the strip in these images, with ``target=1`` and a pose of their own. Their visits are estimated, and
        `RigCalibration.point_errors` accepts them as ``visits``.

    Returns
    -------
    RigCalibration
        Parameters and covariance. Its ``warnings`` list everything that speaks against it.

    Raises
    ------
    ValueError
        A `CalibrationError` if the images contradict each other (chi-squared above 2 per degree of freedom), or do not
        determine the focal length to 5 %.

    See Also
    --------
    RigCalibration : The result.
    observe_boards : Detects the points only.
    scenetruth.capture.calibration.import_calibration : Reads cameras of other programs.

    Notes
    -----
    The covariance includes the tolerances. It is scaled by chi-squared per degree of freedom where that exceeds 1.1,
    and never reduced. Where the residuals show it, the board may bend from pose to pose and its points deviate from
    their places, with standard deviations that are estimated from the images, and the corners have more noise than
    that of the pixels explains; results of single poses that still scatter more than stated widen the covariance. The
    coefficients k3 and k4 to k6 are estimated where the residuals ask for them, unless ``free_distortion`` is set.
    Depth and velocity have a common error from it, see `RigCalibration.point_errors`.

    Examples
    --------
    Corners of a board in four poses, seen from three positions of a stage:

    >>> import numpy as np
    >>> from scenetruth.camera import Camera, Viewpoint
    >>> from scenetruth.capture.calibration import CalibrationTarget, Observations, TargetView, calibrate
    >>> from scenetruth.capture.calibration import rotation_matrix
    >>> camera = Camera(width=640, height=480, focal_length_px=5000)
    >>> grid = np.stack(np.meshgrid(np.arange(-25, 26, 10.0), np.arange(-20, 21, 10.0), [0.0]), axis=-1).reshape(-1, 3)
    >>> noise, views = np.random.default_rng(1), []
    >>> for pose, (a, b) in enumerate([(0.6, 0.1), (-0.6, 0.2), (0.1, 0.6), (0.2, -0.6)]):
    ...     turn = rotation_matrix(np.array([a, b, 0.0]))
    ...     for s, x in enumerate([-5.0, 0.0, 5.0]):
    ...         points = grid @ turn.T + [0, 0, 660]
    ...         pixels = camera.project(Viewpoint.on_axis(x).to_camera(points)) + 0.01 * noise.standard_normal((30, 2))
    ...         covariance = np.tile(1e-4 * np.eye(2), (30, 1, 1))
    ...         views.append(TargetView(f"{pose} {s}", s, 3 * pose + s, pose, grid, pixels, covariance))
    >>> seen = Observations(640, 480, np.array([-5.0, 0.0, 5.0]), (CalibrationTarget(),), tuple(views), 1)
    >>> found = calibrate(seen, guess=4950.0)
    >>> abs(found.value("f") - 5000) < 4 * found.std("f") < 20
    True
    """
    tolerances = RigPriors() if priors is None else priors
    if isinstance(observations, Observations):
        given = observations
    else:
        missing = [name for name, each in (("board", board), ("positions_mm", positions_mm)) if each is None]
        if board is None or positions_mm is None:
            raise CalibrationError([Problem(name, "is required for images") for name in missing])
        given = observe_boards(observations, board, positions_mm, reference=reference)
    if strip is not None:
        named = strip if strip.name != "board" else strip.model_copy(update={"name": "strip"})
        given = replace(given, targets=(*given.targets, named), views=(*given.views, *strip_views))
    return describe_fit(fit_rig(given, guess, tolerances, board if isinstance(board, DotGrid) else None))


@dataclass(frozen=True, eq=False)
class RigSolution:
    """A fit with everything that led to it.

    ``fit``: The fit.
    ``priors``: Tolerances, with the coefficients of the lens that the residuals ask for.
    ``notes``: What was added to the model, in words.
    ``observed``: All observations, as detected.
    """

    fit: RigFit
    priors: RigPriors
    notes: tuple[str, ...]
    observed: Observations


def fit_rig(
    given: Observations,
    guess: RigGuess | Camera | RigCalibration | float | None,
    priors: RigPriors,
    dots: DotGrid | None = None,
) -> RigSolution:
    """Return the fit of observations; raises `CalibrationError` if they contradict each other or are too few.

    ``dots``: Board with dots, whose centroids are corrected for perspective; None for corners.
    """
    whole = complete_guess(given, _as_guess(guess))
    _check_steps(given, whole, priors)
    fit, chosen, notes = _fit_model(given, start_state(given, priors, whole), priors, dots)
    return RigSolution(fit, chosen, tuple(notes), given)


def describe_fit(solution: RigSolution) -> RigCalibration:
    """Return the calibration of a fit, with everything that speaks against it."""
    fit, given = solution.fit, solution.observed
    return RigCalibration.from_state(
        fit.state, fit.stated_covariance, (given.width, given.height), given.positions_mm, given.reference,
        tuple(target.name for target in given.targets), chi2=fit.chi2, dof=fit.dof, images=fit.views,
        warnings=(*solution.notes, *diagnose(fit.given, fit, solution.priors)),
        combinations=tuple(identify_combinations(fit)),
    )  # fmt: skip


def _as_guess(guess: RigGuess | Camera | RigCalibration | float | None) -> RigGuess:
    if isinstance(guess, RigGuess):
        return guess
    if isinstance(guess, RigCalibration):
        guess = guess.camera
    if isinstance(guess, Camera):
        return RigGuess(
            focal_length_px=guess.focal_px, principal_point_px=guess.principal_point, distortion=guess.distortion
        )
    return RigGuess(focal_length_px=guess)


def _fit_model(
    given: Observations, state: RigState, priors: RigPriors, dots: DotGrid | None
) -> tuple[RigFit, RigPriors, list[str]]:
    """Return the fit, the priors with the coefficients of the lens that the images ask for, and notes."""
    if "free_distortion" in priors.model_fields_set:
        fit, words = _fit_board(_fit(given, state, dots), priors)
        _reject_folded(fit)
        return fit, priors, words
    first, tried = _fit(given, state, dots), set(priors.free_distortion)
    if first[0].variance_factor > SCALED_ABOVE:
        richer = _with(priors, *_NEXT)
        second = _fit_again(given, first[0], richer, dots)
        if _cost_of(first) - _cost_of(second) > _BETTER:
            first, priors = second, richer
    fit, words = _fit_board(first, priors)
    # Coefficients that are fixed again stay so: each is tried once.
    for _ in range(_MOST_CHOICES):
        chosen = _without_insignificant(fit, priors) or _wanted_coefficients(fit, priors, tried)
        if chosen is None:
            break
        tried |= set(priors.free_distortion) | set(chosen.free_distortion)
        priors = chosen
        fit, words = _fit_board(_fit_again(given, fit, priors, dots), priors)
    added = [name for name in priors.free_distortion if name not in RigPriors().free_distortion]
    if added:
        words.append(f"the residuals ask for {', '.join(added)}: estimated as well")
    if is_extrapolated(fit) or folding(fit.state, given.width, given.height):
        fit, priors, words = _continued(given, fit, priors, words, dots)
    return fit, priors, words


def _continued(
    given: Observations, fit: RigFit, priors: RigPriors, words: list[str], dots: DotGrid | None
) -> tuple[RigFit, RigPriors, list[str]]:
    """Return the fit with the longest lens that the images determine, and one term more that continues it outside."""
    listed = [name for name in RADIAL if name in priors.free_distortion]
    if any(name in priors.intrinsics for name in RADIAL):
        _reject_folded(fit)
        return fit, priors, words
    kept = ["the residuals ask for aspect: estimated as well"] if "aspect" in priors.free_distortion else []
    for count in range(len(listed), -1, -1):
        shorter = shortened(priors, count)
        if set(shorter.free_distortion) == set(priors.free_distortion):
            part = fit
        else:
            part, _ = _fit_board(_fit_again(given, fit, shorter, dots), shorter)
        if count and is_undetermined(part, RADIAL[count - 1]):
            continue
        term = continue_lens(part, count)
        if term is None:
            continue
        for divisor in _TIGHTER:
            narrow = replace(term, std=term.std / divisor)
            longer = narrow.priors(shorter)
            found, notes = _fit_board(_fit_again(given, part, longer, dots, {term.name: term.mean}), longer)
            if not folding(found.state, given.width, given.height):
                std = np.sqrt(np.diag(found.stated_covariance))[INTRINSICS.index(term.name)]
                text = narrow.words(found.state, float(std))
                return found, longer, [*notes, *kept, *([text] if text else [])]
    _reject_folded(fit)
    return fit, priors, words


def _with(priors: RigPriors, *names: str) -> RigPriors:
    """Return priors with more estimated coefficients."""
    return priors.model_copy(update={"free_distortion": (*priors.free_distortion, *names)})


def _cost_of(result: tuple[RigFit, Observations]) -> float:
    """Return the robust cost of all points, also of excluded points, with residuals of the usual size."""
    fit, given = result
    residual = given.pixels - project(given, fit.state, derivatives=False)[0]
    distance = np.hypot(*np.einsum("nij,nj->ni", given.whitening, residual).T)
    return robust_cost(distance) / max(fit.variance_factor, 1.0)


def _without_insignificant(fit: RigFit, priors: RigPriors) -> RigPriors | None:
    """Return priors without the additional coefficients that the images do not show; None if they show all."""
    optional = [name for name in _NEXT if name in priors.free_distortion]
    if "k4" in priors.free_distortion:
        optional.remove("k3")
    std = dict(zip(fit.state.layout.names, np.sqrt(np.diag(fit.widened(fit.covariance))), strict=True))
    lost = [name for name in optional if abs(fit.state.value(name)) < _SHOWN * std[name]]
    if not lost:
        return None
    kept = tuple(name for name in priors.free_distortion if name not in lost)
    return priors.model_copy(update={"free_distortion": kept})


def _wanted_coefficients(fit: RigFit, priors: RigPriors, tried: set[str]) -> RigPriors | None:
    """Return priors with the coefficients of the next lens model if the residuals ask for it beyond doubt."""
    for test in check_models(fit):
        names = [name for name in _COEFFICIENTS.get(test.name, ()) if name not in priors.free_distortion]
        if not tried.issuperset(names) and test.probability < _BEYOND_DOUBT:
            return _with(priors, *names)
    return None


def _fit_board(first: tuple[RigFit, Observations], priors: RigPriors) -> tuple[RigFit, list[str]]:
    """Return a fit with the variance components and the scatter of its poses where the residuals need them."""
    fit, words = _with_components(*first, priors)
    _reject(fit)
    fit = replace(fit, scatter=scatter_of_poses(fit))
    if fit.scatter is not None:
        words.append(
            f"results of single poses scatter up to {np.sqrt(fit.scatter.factors[-1]):.1f} times as much as the noise "
            "of the corners explains; the stated uncertainty includes it"
        )
    return fit, words


def _with_components(plain: RigFit, corrected: Observations, priors: RigPriors) -> tuple[RigFit, list[str]]:
    """Return a fit with variance components of the board and the corners where the residuals need them."""
    lost = [view for view in plain.views if not view.consistent]
    if len(lost) > _SHARE_OF_IMAGES * len(plain.views):
        return plain, []
    names = {view.name for view in lost}
    usable = corrected.selected([view for view in corrected.views if view.name not in names])
    if plain.variance_factor <= SCALED_ABOVE:
        # Overstated noise of the points hides deviations from chi-squared that all poses have in common.
        point_mm = places_of_points(plain)
        if point_mm == 0:
            return plain, []
        fit = fit_places(usable, plain, priors, point_mm)
        text = (
            f"the points of the board deviate by {format_two_digits(1e3 * point_mm)} µm from their places in its plane"
        )
        return replace(fit, views=(*fit.views, *lost)), [f"{text} in all poses; the stated uncertainty includes it"]
    parts, _, fit = estimate_components(usable, plain, priors)
    if not parts.structured and plain.variance_factor <= _REJECTED_ABOVE:
        return plain, []
    if parts.usual_noise_px > _LARGEST_NOISE_PX or field_of_residuals(fit) > _REJECTED_ABOVE:
        _reject(plain)
    return replace(fit, views=(*fit.views, *lost)), parts.words(usable.views)


def _fit_again(
    given: Observations, fit: RigFit, priors: RigPriors, dots: DotGrid | None, means: Mapping[str, float] | None = None
) -> tuple[RigFit, Observations]:
    """Return a fit with other tolerances, from the values of a fit; ``means``: prior means of intrinsic parameters."""
    layout = RigLayout.from_observations(given, priors)
    state = carry_state(fit.state, layout)
    start = carry_start(fit, layout)
    for number, name in enumerate(INTRINSICS):
        if name in (means or {}):
            state.values[number] = start[number] = (means or {})[name]
        elif layout.std[number] == 0:
            state.values[number] = start[number]
    return _fit(given, state, dots, start)


def _fit(
    given: Observations, state: RigState, dots: DotGrid | None, start: Array | None = None
) -> tuple[RigFit, Observations]:
    """Return the fit, and the observations without the perspective bias of dots; ``start``: prior means."""
    # A pose with the wrong of two tilts can also prevent that the iterations end.
    fit = adjust(given, state, start, must_converge=False)
    if not fit.converged or not all(view.consistent for view in fit.views):
        turned = with_other_tilts(given, fit.state, fit.start)
        if not fit.converged:
            # The wrong tilt has led far into a long valley: start again with the right tilts.
            turned = RigState(turned.layout, state.values, turned.turns)
        other = adjust(given, turned, fit.start, must_converge=False)
        fit = max(fit, other, key=lambda each: (each.converged, sum(view.points for view in each.views)))
    if not fit.converged:
        raise not_converged()
    if dots is None:
        return fit, given
    corrected = given
    for _ in range(4):
        before = np.concatenate([view.pixels for view in corrected.views])
        corrected = _without_bias(given, fit.state, dots)
        fit = adjust(corrected, fit.state, fit.start)
        if np.abs(np.concatenate([view.pixels for view in corrected.views]) - before).max() < _LARGEST_BIAS_CHANGE:
            break
    return fit, corrected


def _without_bias(given: Observations, state: RigState, dots: DotGrid) -> Observations:
    """Return observations whose centroids are replaced by images of the centres."""
    # The bias does not depend on the principal point, and no fold in the corners concerns the dots.
    values, views = state.values.copy(), []
    values[1:3] = 0.0
    camera = RigState(state.layout, values, state.turns).camera(1, 1)
    numbers = {pose: number for number, pose in enumerate(state.layout.poses)}
    offsets = state.layout.offsets(given.views)
    for view, (position, visit, _, pose) in zip(given.views, offsets, strict=True):
        if view.target != 0:
            views.append(view)
            continue
        turn = rotation_matrix(state.values[position : position + 3] + state.values[visit : visit + 3])
        along = given.positions_mm[view.position] + state.values[position + 3]
        centre = np.array([along, *state.values[position + 4 : position + 6]])
        rotation = turn.T @ state.turns[numbers[view.pose]]
        translation = turn.T @ (state.values[pose + 3 : pose + 6] - centre)
        bias = disc_bias(camera, rotation, translation, view.points_mm, dots.diameter_mm / 2)
        views.append(replace(view, pixels=view.pixels - bias))
    return given.selected(views)


def _check_steps(given: Observations, guess: RigGuess, priors: RigPriors) -> None:
    """Raise if single images show another motion than that of the stage, before all images are adjusted together."""
    if len(given.positions_mm) < 2:
        return
    steps, depth_mm = apparent_steps(given, guess)
    yaw_rad = 1e-6 * float(np.hypot(priors.errors.yaw_urad, priors.visit_errors.yaw_urad))
    texts = step_problems(steps, given.positions_mm, yaw_rad, depth_mm)
    if texts:
        raise CalibrationError([Problem("positions_mm", text) for text in texts])


def _reject(fit: RigFit) -> None:
    """Raise if the observations contradict each other or do not determine the camera."""
    lost = [view for view in fit.views if not view.consistent]
    if fit.variance_factor > _REJECTED_ABOVE or len(lost) > _SHARE_OF_IMAGES * len(fit.views):
        chi2 = f"chi-squared per degree of freedom is {fit.variance_factor:.3g}"
        message = f"contradict each other: {chi2}, {len(lost)} of {len(fit.views)} images do not fit"
        problems = [Problem("images", message)]
        problems += [Problem(*text.split(": ", 1)) for text in displaced_images(fit)]
        worst = sorted(fit.views, key=lambda view: -view.mean_square)[:5]
        problems += [Problem(view.name, f"has a residual of {format_two_digits(view.rms_px)} px") for view in worst]
        raise CalibrationError(problems)
    weak = fit.std("f") / fit.state.value("f")
    if weak > _WEAKEST_FOCAL:
        poses = len({view.pose for view in fit.given.views})
        message = (
            f"determine the focal length to {100 * weak:.0f} % only ({poses} poses): add poses with a tilt of 35 to 40°"
        )
        raise CalibrationError([Problem("images", message)])


def _reject_folded(fit: RigFit) -> None:
    """Raise if the distortion folds the image."""
    message = folding(fit.state, fit.given.width, fit.given.height)
    if message:
        message = f"determine no usable lens: {message}; show boards in the corners of the image, or fix coefficients"
        raise CalibrationError([Problem("images", message)])
