"""The noise cube from end to end, without noise and quantisation: the figures that the method is known for."""

from __future__ import annotations

import pytest

import scenetruth as st
from tests.scenes import SCENES

# What an independent implementation of the paper's estimator reached on a cube of this kind, with some room.
BOUNDS = {
    ("disparity", "rms"): 0.011,
    ("depth", "rms"): 0.20,
    ("depth", "median_abs"): 0.10,
    ("velocity_z", "relative_rms"): 0.09,
    ("velocity_x", "rms"): 0.004,
    ("velocity_y", "rms"): 0.004,
}

Scores = dict[str, dict[tuple[str, str], float]]


def cube_scores(backend: str) -> Scores:
    scene = st.load_scene(SCENES / "cube.yaml", ["sensor=ideal", f"render.backend={backend}"])
    recording, truth = st.simulate(scene)
    scores: Scores = {}
    for divergence in ("paper", "consistent"):
        result = st.score(st.estimate(recording, divergence=divergence), truth).regions["interior"]
        scores[divergence] = {}
        for quantity, statistic in BOUNDS:
            value = result[quantity][statistic]
            assert value is not None
            scores[divergence][quantity, statistic] = value
    return scores


@pytest.fixture(scope="module")
def reference() -> Scores:
    return cube_scores("raycast")


@pytest.mark.parametrize("divergence", ["paper", "consistent"])
@pytest.mark.parametrize("figure", BOUNDS, ids="-".join)
def test_cube_without_noise(reference: Scores, divergence: str, figure: tuple[str, str]) -> None:
    assert reference[divergence][figure] <= BOUNDS[figure]


@pytest.mark.parametrize("component", "xyz")
def test_consistent_divergence_halves_the_errors_of_velocity(reference: Scores, component: str) -> None:
    figure = (f"velocity_{component}", "relative_rms" if component == "z" else "rms")
    assert reference["consistent"][figure] <= 0.5 * reference["paper"][figure]


def test_pyrender_is_within_ten_percent_of_raycast(reference: Scores) -> None:
    try:
        scores = cube_scores("pyrender")
    except st.BackendUnavailableError as error:
        pytest.skip(str(error))
    for figure, value in reference["paper"].items():
        assert scores["paper"][figure] == pytest.approx(value, rel=0.1), figure
