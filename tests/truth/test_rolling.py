"""Truth row by row against the truth of whole images at every row's time."""

from __future__ import annotations

import numpy as np

from scenetruth.camera import Viewpoint
from scenetruth.raycast import Topology
from scenetruth.scene.built_scene import build_scene
from scenetruth.truth import GeometryPass, truth_by_rows, truth_maps
from tests.scenes import cube


def test_each_row_is_that_of_an_image_at_its_time() -> None:
    scene = cube(camera={"width": 80, "height": 24, "focal_length_px": 600, "distortion": {"k1": -2.0}})
    world = build_scene(scene)
    topology = Topology.of(world.at(0).vertices_mm, world.faces)
    times = np.linspace(-0.4, 0.4, 24)
    places = [Viewpoint.on_axis(float(3 * t)) for t in times]
    found = truth_by_rows(world, topology, scene.camera, times, places, 5.0)
    for row, (time, place) in enumerate(zip(times, places, strict=True)):
        whole = truth_maps(GeometryPass(world, topology, float(time)), scene.camera, place, 5.0)
        # Distances are measured in the image's own boundaries, whose rows have times of their own.
        del whole["boundary_distance"]
        for name, values in whole.items():
            # The cut camera's principal point differs by a whole number of rows: roundings of it.
            np.testing.assert_allclose(
                found[name][..., row, :].astype(float), values[..., row, :].astype(float), rtol=1e-11, atol=1e-11
            )


def test_rows_of_one_time_are_the_ordinary_truth() -> None:
    scene = cube(camera={"width": 80, "height": 24, "focal_length_px": 600})
    world = build_scene(scene)
    topology = Topology.of(world.at(0).vertices_mm, world.faces)
    place = Viewpoint.on_axis(5.0)
    found = truth_by_rows(world, topology, scene.camera, np.zeros(24), [place] * 24, 5.0)
    whole = truth_maps(GeometryPass(world, topology, 0.0), scene.camera, place, 5.0)
    for name, values in whole.items():
        np.testing.assert_allclose(found[name].astype(float), values.astype(float), rtol=1e-11, atol=1e-11)
