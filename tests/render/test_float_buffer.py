"""OpenGL images keep 32 bits from the texture to the pixel, in any number of tiles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.camera import Viewpoint
from scenetruth.errors import BackendUnavailableError
from scenetruth.render import choose_renderer, float_buffer, pyrender_backend
from scenetruth.render.pyrender_backend import PyrenderRenderer, _tile_size
from scenetruth.render.raycast_backend import RaycastRenderer
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import build_scene
from tests.helpers.nightly import by_night, nightly
from tests.helpers.scenes import cube


def facing_plane(texture: dict[str, Any], **changes: Any) -> Scene:
    """Return a plane that fills a view of 64 x 48 px, one texture unit of 64 x 48 mm on the image."""
    plain: dict[str, Any] = {
        "camera": {"width": 64, "height": 48, "focal_length_px": 100},
        "objects": [
            {
                "name": "plane",
                "mesh": {"kind": "plane", "size_mm": [64, 48]},
                "pose": {"position_mm": [0, 0, 100]},
                "texture": texture,
            }
        ],
        "render": {"backend": "pyrender", "supersampling": 1},
    }
    return cube(**(plain | changes))


def rendered(scene: Scene, n: int, t: float = 0.0, x_mm: float = 0.0) -> NDArray[np.float32]:
    try:
        renderer = PyrenderRenderer(build_scene(scene), scene.camera, scene.background, n)
    except BackendUnavailableError as error:
        pytest.skip(str(error))
    with renderer:
        return renderer.render(t, Viewpoint.on_axis(x_mm))


def raycast(scene: Scene, n: int, t: float = 0.0, x_mm: float = 0.0) -> NDArray[np.float32]:
    return RaycastRenderer(build_scene(scene), scene.camera, scene.background, n).render(t, Viewpoint.on_axis(x_mm))


@pytest.mark.parametrize("n", [3, *by_night(1, 4)])
def test_uniform_radiance_and_background_come_back_as_32_bit_floats(n: int) -> None:
    scene = facing_plane(
        {"kind": "uniform", "radiance": 0.123456},
        camera={"width": 64, "height": 48, "focal_length_px": 50},
        background=0.7654321,
    )
    image = rendered(scene, n)
    assert set(np.unique(image)) == {np.float32(0.123456), np.float32(0.7654321)}


def test_steps_far_below_8_bits_survive(tmp_path: Path) -> None:
    # Columns of a 16-bit image, 1/65535 apart, each on a pixel of its own.
    values = np.tile(20050 - 32 + np.arange(64, dtype=np.uint16), (48, 1))
    imageio.imwrite(tmp_path / "ramp.png", values)
    image = rendered(facing_plane({"kind": "image", "file": str(tmp_path / "ramp.png")}), 1)
    assert len(np.unique(np.rint(values / 257))) == 1  # one level of 8 bits
    # Between texels a ramp is linear, so that errors of 1e-5 texel in the coordinates do not matter either.
    np.testing.assert_allclose(image, values / 65535, atol=1e-7)


@pytest.mark.parametrize("kind", ["noise", *by_night("plaid", "image")])
def test_textures_are_those_of_the_ray_caster(kind: str, tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 65536, (31, 45)).astype(np.uint16)
    imageio.imwrite(tmp_path / "picture.png", picture)
    textures: dict[str, dict[str, Any]] = {
        "noise": {"kind": "noise", "wavelength_mm": [5, 20]},
        "plaid": {"kind": "plaid", "wavelength_mm": [7, 9], "phase_deg": [20, 50]},
        "image": {"kind": "image", "file": str(tmp_path / "picture.png")},
    }
    scene = facing_plane(textures[kind])
    # One sample a pixel, so that no quadrature differs; slopes reach 1 per texel, coordinates are good to 1e-5 texel.
    np.testing.assert_allclose(rendered(scene, 1), raycast(scene, 1), atol=2e-5)


def test_border_of_an_image_extends(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 65536, (3, 4)).astype(np.uint16)
    imageio.imwrite(tmp_path / "picture.png", picture)
    scene = facing_plane({"kind": "image", "file": str(tmp_path / "picture.png")})
    image = rendered(scene, 1)
    np.testing.assert_allclose(image, raycast(scene, 1), atol=2e-6)
    # Half a texel is 8 px wide and 8 px high.
    assert image[:7, :7] == pytest.approx(picture[0, 0] / 65535, abs=1e-6)
    assert image[-7:, -7:] == pytest.approx(picture[-1, -1] / 65535, abs=1e-6)


@nightly
@pytest.mark.parametrize(("samples", "limit"), [(20_000, 16384), (1 << 23, 200), (1, 16)])
def test_tiles_join_without_a_seam(samples: int, limit: int, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = cube(camera={"width": 61, "height": 47, "focal_length_px": 480, "principal_point_px": [33.3, 20.1]})
    whole = rendered(scene, 4, 1.0, 2.0)
    assert whole.min() < 0.1 < 0.9 < whole.max() + 0.3
    monkeypatch.setattr(pyrender_backend, "_SAMPLES_PER_TILE", samples)
    monkeypatch.setattr("scenetruth.render.float_buffer.largest_side", lambda: limit)
    tiled = rendered(scene, 4, 1.0, 2.0)
    # A sample on a silhouette may fall to the other side; every other differs by rounding.
    different = np.abs(tiled - whole) > 2e-5
    assert different.sum() <= 3


@pytest.mark.parametrize(("width", "height", "n", "limit"), [(640, 480, 16, 16384), (32768, 3, 1, 16384), (7, 9, 4, 8)])
def test_tiles_cover_the_image_within_the_limits(width: int, height: int, n: int, limit: int) -> None:
    across, down = _tile_size(width, height, n, limit)
    assert across * n <= limit
    assert down * n <= limit
    assert across * down * n * n <= pyrender_backend._SAMPLES_PER_TILE
    assert 1 <= across <= width
    assert 1 <= down <= height


@nightly
def test_sixteen_by_sixteen_samples_of_a_full_image() -> None:
    texture = {"kind": "plaid", "wavelength_mm": [80, 60]}
    scene = facing_plane(texture, camera={"width": 640, "height": 480, "focal_length_px": 1000})
    np.testing.assert_allclose(rendered(scene, 16), raycast(scene, 3), atol=1e-5)


def test_a_shader_that_does_not_compile_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = facing_plane({"kind": "uniform"})
    rendered(scene, 1)  # skips where OpenGL does not run at all
    for file in float_buffer._SHADERS.iterdir():
        (tmp_path / file.name).write_text(file.read_text().replace("GL_ARB_texture_gather", "GL_ARB_nowhere"))
    monkeypatch.setattr(float_buffer, "_SHADERS", tmp_path)
    with pytest.raises(BackendUnavailableError, match="does not compile the shader"):
        PyrenderRenderer(build_scene(scene), scene.camera, scene.background, 1)


@nightly
def test_a_texture_that_opengl_cannot_hold_is_named(tmp_path: Path) -> None:
    imageio.imwrite(tmp_path / "wide.png", np.zeros((2, 40_000), dtype=np.uint8))
    scene = facing_plane({"kind": "image", "file": str(tmp_path / "wide.png")})
    rendered(facing_plane({"kind": "uniform"}), 1)  # skips where OpenGL does not run at all
    with pytest.raises(
        BackendUnavailableError, match=r"textures of up to \d+ x \d+ texels, this texture has 40000 x 2"
    ):
        choose_renderer(scene, build_scene(scene))
    automatic = facing_plane({"kind": "image", "file": str(tmp_path / "wide.png")}, render={"backend": "auto"})
    choice = choose_renderer(automatic, build_scene(automatic))
    assert choice.renderer.name == "raycast"
    assert "40000 x 2" in choice.fallback_reason
