"""Lenses: points of distorted pixels, against OpenCV's model."""

from __future__ import annotations

import cv2
import numpy as np

from scenetruth.exporters.camera_geometry import _undistort, distort

LENS = {"k1": -0.25, "k2": 0.08, "p1": 0.003, "p2": -0.002, "k3": -0.01, "k4": 0.02, "k5": 0.001, "k6": -0.003}


def test_distortion_is_opencvs() -> None:
    points = np.random.default_rng(2).uniform(-0.6, 0.6, (2, 200))
    rays = np.concatenate([points, np.ones((1, 200))]).T
    seen = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), np.array(list(LENS.values())))[0][:, 0]
    np.testing.assert_allclose(distort(points, LENS).T, seen, atol=1e-14)
    np.testing.assert_allclose(_undistort(distort(points, LENS), LENS), points, atol=1e-11)


def test_where_a_lens_folds_the_image_there_is_no_ray() -> None:
    lens = {"k1": -0.5}
    # x (1 - x²/2) is never more than 0.545.
    found = _undistort(np.array([[0.3, 0.6], [0.0, 0.0]]), lens)
    assert np.isfinite(found[:, 0]).all()
    assert np.isnan(found[:, 1]).all()
