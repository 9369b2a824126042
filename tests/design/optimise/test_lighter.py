"""What is simulated of a rig: a part that all positions see, and no effects that do nothing."""

from __future__ import annotations

import numpy as np
import pytest

import scenetruth as st
from scenetruth.design.optimisation.confirmation import reduce_scene
from scenetruth.scene import Scene
from tests.design.optimise.small import scene


def wide(**changes: object) -> Scene:
    plain = scene()
    plain["camera"] = {"width": 160, "height": 120, "focal_length_px": 500}
    plain["frames"] = {"count": 1}
    plain["sensor"] = "ideal"
    plain["objects"][0]["pose"]["position_mm"] = [10, -6, 500]
    return Scene.from_dict({**plain, **changes})


def test_a_part_is_what_the_whole_shows_there() -> None:
    whole = wide()
    part = reduce_scene(whole, "object_wall", 48)
    # 48 px, and a disparity of 4 px at each side of the reference's; ten standard deviations of the window are no less
    # than the 36 rows that 48 px would have.
    assert part.changes == ("images cropped from 160 x 120 to 56 x 36 px",)
    narrow = wide(estimate={"method": "structure_tensor", "window_sigma_px": 3.0, "window_taps_px": 13})
    assert reduce_scene(narrow, "object_wall", 48).changes == ("images cropped from 160 x 120 to 56 x 32 px",)
    left, top = np.subtract(whole.camera.principal_point, part.plain["camera"]["principal_point_px"])
    images, _ = st.simulate(whole)
    some, _ = st.simulate(Scene.from_dict(dict(part.plain)))
    rows, columns = (slice(int(a), int(a) + n) for a, n in zip((top, left), some["image"].shape[-2:], strict=True))
    # The same rays through the same places, to the rounding of the principal point.
    np.testing.assert_allclose(some["image"].values, images["image"].values[..., rows, columns], atol=2e-6)


def test_small_images_stay_whole() -> None:
    assert reduce_scene(wide(), "all", 160) == reduce_scene(wide(), "all", None)
    assert reduce_scene(wide(), "all", None).plain["camera"] == wide().to_dict()["camera"]


def test_what_does_nothing_is_left_out_and_told() -> None:
    focused = {"defocus": {"aperture_mm": 4.0, "focus_distance_mm": 500.0}}
    found = reduce_scene(wide(optics=focused, shutter={"exposure_time_s": 0.1}), "all", None)
    assert found.plain["optics"]["defocus"] is None
    assert found.plain["shutter"]["exposure_time_s"] == 0.0
    assert len(found.changes) == 2
    # 500 px 10 mm (1/500 - 1/550) = 0.91 px, and a quarter of that as standard deviation.
    psf = {"kind": "gaussian", "sigma_px": 0.6}
    near = {"psf": psf, "defocus": {"aperture_mm": 10.0, "focus_distance_mm": 550.0}}
    found = reduce_scene(wide(optics=near), "all", None)
    assert found.plain["optics"]["defocus"] is None
    disc = 500 * 10 * (1 / 500 - 1 / 550)
    assert found.plain["optics"]["psf"]["sigma_px"] == pytest.approx(np.hypot(0.6, disc / 4), rel=1e-3)
    # Four times that is no small disc; 0.1 mm per frame over two frames is 0.2 px.
    blurred = {"defocus": {"aperture_mm": 40.0, "focus_distance_mm": 550.0}}
    found = reduce_scene(wide(optics=blurred, shutter={"exposure_time_s": 2.0}), "all", None)
    assert found.plain["optics"]["defocus"]["samples"] == 12
    assert found.plain["shutter"]["exposure_time_s"] == 2.0
    assert found.changes == (f"12 aperture samples instead of {wide(optics=blurred).optics.defocus.samples}",)  # type: ignore[union-attr]
