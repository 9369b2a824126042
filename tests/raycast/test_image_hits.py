"""Results that images and ground truth have in common: bits of the hits, silhouettes without other lines, memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import scenetruth as st
from scenetruth.camera import Camera, Viewpoint
from scenetruth.raycast import FirstFaces, ImageHits, RayCaster, Topology, image_hits
from tests.helpers.boxes_and_rays import boxes

CAMERA = Camera(width=4, height=3, focal_length_px=5.0)
SMALL = [
    *("camera.width=64", "camera.height=48", "camera.focal_length_px=320", "frames.count=2", "stage.positions=2"),
    *(f"objects.{number}.texture={{kind: uniform}}" for number in range(2)),
]
"""Textures, which take longest to make, change no hit."""


def found(size: int = 12) -> FirstFaces:
    return FirstFaces(np.zeros(size, dtype=np.int32), np.zeros(size, dtype=np.bool_))


def test_only_expected_images_are_kept_and_each_is_taken_once() -> None:
    hits, here, there = ImageHits(), Viewpoint.on_axis(0.0), Viewpoint.on_axis(1.0)
    hits.expect(CAMERA, [(0.0, here)])
    assert hits.expects(0.0, CAMERA, Viewpoint.on_axis(0.0))
    for t, camera, viewpoint in ((1.0, CAMERA, here), (0.0, CAMERA, there), (0.0, CAMERA.rows(0, 2), here)):
        assert not hits.expects(t, camera, viewpoint)
        hits.keep(t, camera, viewpoint, found())
        assert hits.take(t, camera, viewpoint) is None
    first = found()
    hits.keep(0.0, CAMERA, here, first)
    assert not hits.expects(0.0, CAMERA, here)
    assert hits.take(0.0, CAMERA, here) is first
    assert hits.take(0.0, CAMERA, here) is None
    hits.keep(0.0, CAMERA, here, first)
    assert hits.take(0.0, CAMERA, here) is None


def test_memory_is_limited() -> None:
    hits, viewpoint = ImageHits(), Viewpoint.on_axis(0.0)
    times = [float(n) for n in range(6)]
    hits.expect(CAMERA, [(t, viewpoint) for t in times])
    # Five bytes a pixel, 16 MiB in all.
    for t in times:
        hits.keep(t, CAMERA, viewpoint, found(1 << 20))
    assert [hits.take(t, CAMERA, viewpoint) is not None for t in times] == [True, True, True, False, False, False]


def test_hits_on_first_faces_have_the_bits_of_the_search() -> None:
    generator = np.random.default_rng(2)
    points, triangles = boxes(generator, 9, 300.0)
    caster = RayCaster(points, Topology.of(points, triangles))
    x, y = np.meshgrid(np.arange(60) - 30.0, np.arange(40) - 20.0)
    directions = np.column_stack([x.ravel() / 60, y.ravel() / 60, np.ones(x.size)])
    expected = caster.cast(np.zeros(3), directions, grid_width=60)
    again = RayCaster(points, Topology.of(points, triangles)).hit_faces(np.zeros(3), directions, expected.face)
    assert 0 < np.count_nonzero(expected.face >= 0) < x.size
    np.testing.assert_array_equal(again.depth, expected.depth)
    np.testing.assert_array_equal(again.weights, expected.weights)


@pytest.mark.filterwarnings("ignore:objects")
@pytest.mark.parametrize("changes", [{}, {"camera.distortion.k1": -0.1}])
def test_truth_with_images_is_that_without(changes: dict[str, Any]) -> None:
    """Shadows make further pixels of the image mixed, but not of the truth."""
    given = [*SMALL, *(f"{name}={value}" for name, value in changes.items())]
    together, alone = st.simulate("leaf", overrides=given).truth, st.make_truth("leaf", overrides=given)
    assert alone.mixed.values.any()
    for name in alone.data_vars:
        np.testing.assert_array_equal(together[name].values, alone[name].values, err_msg=str(name))


@pytest.mark.filterwarnings("ignore:objects")
def test_truth_needs_no_search_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    casts: list[int] = []
    search = RayCaster.cast

    def cast(self: RayCaster, *arguments: Any, **named: Any) -> Any:
        casts.append(named.get("grid_width", 0))
        return search(self, *arguments, **named)

    monkeypatch.setattr(RayCaster, "cast", cast)
    st.simulate("leaf", overrides=SMALL)
    assert casts == [64] * 4
    casts.clear()
    st.make_truth("leaf", overrides=SMALL)
    assert casts == [64] * 2


def test_a_scene_has_one_store() -> None:
    class World:
        pass

    one, other = World(), World()
    assert image_hits(one) is image_hits(one)
    assert image_hits(one) is not image_hits(other)
