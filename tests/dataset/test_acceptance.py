"""What bounds measure on few pixels is what the truth of all pixels says, to what few pixels can tell."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import scenetruth as st
from scenetruth.dataset.acceptance import (
    AcceptanceCriterion,
    DepthRangeCriterion,
    GeometryPreview,
    ImageMotionCriterion,
    OccludedFractionCriterion,
    ResidualDisparityCriterion,
    TextureWavelengthCriterion,
    VisibleFractionCriterion,
)
from scenetruth.scene import Scene
from tests.helpers.small_recipes import SCENE

TILE_PX = 20 / 100 * 800
"""Side of the tile in the image."""


def scene_at(x_mm: float = 0.0, **camera: float) -> Scene:
    plain = Scene.from_dict(SCENE).to_dict()
    plain["camera"] |= {"width": 480, "height": 360, "focal_length_px": 800, **camera}
    plain["objects"][1]["pose"]["position_mm"][0] = x_mm
    return Scene.from_dict(plain)


def values(bound: AcceptanceCriterion, look: GeometryPreview) -> list[float]:
    return [value for _, value in bound.measured(look)]


@pytest.mark.parametrize(
    ("x_mm", "share"), [(0, 1), (30, 0.5), (35, 0.25), (38, 0.1), (60, 0)], ids=lambda value: str(value)
)
def test_the_visible_share_of_a_tile_that_leaves_the_image(x_mm: float, share: float) -> None:
    """The image ends at 240 / 800 x 100 mm = 30 mm; one small pixel is 3 of the tile's 160."""
    bound = VisibleFractionCriterion(object="tile", min=0.5)
    if share == 0:
        with pytest.raises(st.SceneError, match="outside every image"):
            GeometryPreview(scene_at(x_mm))
        return
    (found,) = values(bound, GeometryPreview(scene_at(x_mm)))
    assert found == pytest.approx(share, abs=3 / TILE_PX)
    assert bool(bound.refusal(GeometryPreview(scene_at(x_mm)))) == (found < 0.5)


def test_what_hides_an_object_counts() -> None:
    plain = scene_at().to_dict()
    # Half as far away as the tile, and over its left half as the camera sees it.
    cover = {"name": "cover", "mesh": {"kind": "plane", "size_mm": [20, 40]}, "texture": {"kind": "uniform"}}
    plain["objects"].append({**cover, "pose": {"position_mm": [-10, 0, 50]}})
    (found,) = values(VisibleFractionCriterion(object="tile", min=0), GeometryPreview(Scene.from_dict(plain)))
    assert found == pytest.approx(0.5, abs=3 / TILE_PX)


@pytest.fixture(scope="module")
def whole() -> tuple[GeometryPreview, dict[str, np.ndarray]]:
    scene = scene_at(3.0)
    truth = st.make_truth(scene).sel(t=0)
    return GeometryPreview(scene), {str(name): truth[name].values for name in truth}


@pytest.mark.parametrize(
    ("bound", "of_truth", "tolerance"),
    [
        (DepthRangeCriterion(object="tile", max=1), lambda t: [100, 100], 1e-9),
        (DepthRangeCriterion(object="wall", max=1), lambda t: [120, 120], 1e-9),
        (
            ResidualDisparityCriterion(max=1),
            lambda t: [np.abs(t["disparity"] - np.round(t["disparity"].mean())).max()],
            0.05,
        ),
        # The fastest pixel is a corner of the tile, half a small pixel, 1.5 px, farther out: 1 % per frame of that.
        (ImageMotionCriterion(object="tile", max=1), lambda t: [np.hypot(*t["flow"]).max()], 0.03),
        (OccludedFractionCriterion(max=1), lambda t: [t["occluded_across_cameras"].mean()], 3 / TILE_PX),
        (TextureWavelengthCriterion(object="tile", max=1), lambda t: [6 * 8, 20 * 8], 1e-9),
    ],
    ids=lambda one: getattr(one, "kind", ""),
)
def test_few_pixels_tell_what_all_tell(
    whole: tuple[GeometryPreview, dict[str, np.ndarray]],
    bound: AcceptanceCriterion,
    of_truth: Callable[[dict[str, np.ndarray]], list[float]],
    tolerance: float,
) -> None:
    look, truth = whole
    assert values(bound, look) == pytest.approx(of_truth(truth), abs=tolerance)


def test_a_refusal_names_the_object_and_the_bound() -> None:
    look = GeometryPreview(scene_at())
    assert DepthRangeCriterion(object="t*", min=101).refusal(look) == "depth of tile under 101 mm"
    assert DepthRangeCriterion(object="t*", max=110).refusal(look) == ""
    assert DepthRangeCriterion(max=110).refusal(look) == "depth of wall over 110 mm"
