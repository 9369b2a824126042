"""What patterns are worth: against closed forms, sums over dots, rendered images and photographs of themselves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest
from scipy.special import j1

import scenetruth as st
from scenetruth.benchmark.design_point import add_noise
from scenetruth.bound import closed_form_bound
from scenetruth.bound.image_gradients import gradient_along
from scenetruth.camera import Defocus, GaussianPsf
from scenetruth.design.patterns import (
    InkDots,
    Pattern,
    assess_pattern,
    assessments_to_dataframe,
    compute_contrast_transfer,
    compute_pattern_statistics,
    compute_size_table,
    compute_spectrum,
    compute_theoretical_statistics,
    describe_assessments,
    format_scene_lines,
    generate_pattern,
    write_texture_image,
)
from scenetruth.errors import ArgumentError
from tests.helpers.nightly import by_night, nightly
from tests.helpers.pattern_rigs import FOCAL_PX, Z_MM, plain_rig

SIZE = (60.0, 44.0)
BLUR: dict[str, Any] = {
    "psf": {"kind": "gaussian", "sigma_px": 0.7},
    "defocus": {"aperture_mm": 10, "focus_distance_mm": 420, "samples": 12},
}


def test_waves_lose_what_lens_and_pixels_take() -> None:
    rig = plain_rig(psf=GaussianPsf(kind="gaussian", sigma_px=0.8))
    x = (np.arange(1600) + 0.5) / 4
    wave = np.tile(0.5 + 0.2 * np.cos(2 * np.pi * x / 8), (400, 1))
    found = compute_pattern_statistics(compute_spectrum(wave, 0.25), rig)
    left = np.sinc(1 / 8) * np.exp(-2 * (np.pi * 0.8 / 8) ** 2)
    assert found.contrast == pytest.approx(0.2 / np.sqrt(2) * left, rel=1e-3)
    assert found.gradient_x == pytest.approx(2 * np.pi / 8 * found.contrast, rel=1e-3)
    # What the window adds along y, over 100 px, would be 5 %: it is taken back.
    assert found.gradient_y < 0.01 * found.gradient_x
    # Waves of 1.6 px are seen, but not as what they are.
    fine = np.tile(0.5 + 0.2 * np.cos(2 * np.pi * x / 1.6), (400, 1))
    assert compute_pattern_statistics(compute_spectrum(fine, 0.25), rig).aliased_share > 0.99


def test_a_blur_disc_reverses_what_is_finer_than_it() -> None:
    defocus = Defocus(aperture_mm=20, focus_distance_mm=500)
    rig = plain_rig(defocus=defocus)
    blur = FOCAL_PX * 20 * (1 / Z_MM - 1 / 500)
    f = np.array([0.0, 0.5 / blur, 1.5 / blur])
    z = np.pi * blur * f[1:]
    expected = np.concatenate([[1.0], 2 * j1(z) / z]) * np.sinc(f)
    np.testing.assert_allclose(compute_contrast_transfer(rig, f, np.zeros(3)), expected, rtol=1e-9)
    assert expected[-1] < 0


@pytest.mark.parametrize(
    ("kind", "settings", "blur"),
    [
        *by_night(("speckle", {"spacing": 0.0}, {})),
        ("speckle", {"spacing": 0.0, "coverage": 0.3, "dot_px": 6.0}, BLUR),
        *by_night(("noise", {}, {})),
        ("noise", {"coverage": 0.3, "spectrum_exponent": -1.0}, BLUR),
        ("grey_noise", {}, BLUR),
    ],
)
def test_patterns_are_worth_what_theory_says(kind: str, settings: dict[str, Any], blur: dict[str, Any]) -> None:
    """Some 3500 dots, or waves, in the window: a mean square is known to 2 to 3 %, its root to half of that."""
    pattern = generate_pattern(plain_rig(**blur), kind, size_mm=SIZE, seed=3, **settings)
    worth, theory = assess_pattern(pattern), compute_theoretical_statistics(pattern, pattern.rig)
    assert theory is not None
    assert worth.theory_gradient == theory.gradient_x
    assert worth.gradient == pytest.approx(theory.gradient_x, rel=0.03)
    assert worth.contrast == pytest.approx(theory.contrast, rel=0.03)
    assert worth.size_px == pytest.approx(theory.size_px, rel=0.05)
    assert worth.aliased_share == pytest.approx(theory.aliased_share, abs=0.003)


def test_dots_that_keep_apart_are_a_sum_over_dots() -> None:
    """Their spectrum is that of one disc times that of their centres, summed one by one: no raster of ink at all."""
    rig = plain_rig(**BLUR)
    pattern = generate_pattern(rig, size_mm=(24.0, 24.0), seed=5, dot_px=5.0)
    marks = pattern.marks((0.0, 0.0, 24.0, 24.0))
    assert isinstance(marks, InkDots)
    worth = assess_pattern(pattern)
    # The same window over 120 px, but over dots instead of their ink: dots are small beside it.
    centres, count = marks.centres_mm / rig.mm_per_px, 120
    f = np.arange(-60, 61) / count
    fade = np.prod(np.sin(np.pi * np.clip(centres / count, 0, 1)) ** 2, axis=1)
    waves = (np.exp(-2j * np.pi * np.outer(f, c)) for c in centres.T)
    x, y = waves
    summed = np.einsum("n,kn,ln->lk", fade, x, y)
    radial = np.maximum(np.hypot(f[:, None], f), 1e-9)
    disc = 5.0 * j1(np.pi * 5.0 * radial) / (2 * radial)
    left = compute_contrast_transfer(rig, np.broadcast_to(f, summed.shape), f[:, None])
    # Less than all waves: near 0 is the mean.
    power = np.where(radial > 3 / count, np.abs(summed * disc * left * 0.8) ** 2, 0.0)
    norm = (3 / 8 * count) ** 2 * count**2
    gradient = np.sqrt(((2 * np.pi * f) ** 2 * power).sum() / norm)
    # What the window adds, (2 π / √3 120)² per variance, is 0.1 %. Waves of less than 4 px, where the derivative of the
    # spline differs, are blurred away but for a few per cent.
    assert worth.gradient_x == pytest.approx(gradient, rel=0.03)


def scene_of(pattern: Pattern, folder: Path, optics: dict[str, Any]) -> st.Scene:
    import yaml

    write_texture_image(folder / "pattern.png", pattern)
    plain = yaml.safe_load(format_scene_lines(pattern, str(folder / "pattern.png")))
    plain |= {
        "camera": {"width": 144, "height": 108, "focal_length_px": FOCAL_PX},
        "stage": {"positions": 3, "baseline_mm": 2.0},
        "frames": {"count": 3},
        "optics": optics,
        # Pixels are divided before a point spread function is applied: more samples would be too many.
        "render": {"backend": "raycast", "supersampling": 1 if optics else 4},
    }
    return st.Scene.from_dict(plain)


@pytest.mark.parametrize(
    ("kind", "blur"), [("noise", {}), *by_night(("speckle", BLUR), ("speckle", {}), ("grey_noise", {}))]
)
def test_rendered_images_have_the_gradients_that_are_told(kind: str, blur: dict[str, Any], tmp_path: Path) -> None:
    """The lines for scene files are what is used; images of 144 x 108 px hold 900 dots of the 5000: 3 %."""
    pattern = generate_pattern(plain_rig(**blur), kind, size_mm=SIZE, seed=1)
    scene = scene_of(pattern, tmp_path, blur)
    scene = scene.model_copy(update={"frames": scene.frames.model_copy(update={"count": 1})})
    recording, _ = st.simulate(scene)
    image = recording["image"].sel(s=0, t=0).values.astype(float)
    found = [np.sqrt(np.mean(gradient_along(image, axis)[8:-8, 8:-8] ** 2)) for axis in (1, 0)]
    worth = assess_pattern(pattern)
    np.testing.assert_allclose(found, [worth.gradient_x, worth.gradient_y], rtol=0.04)
    # The rig's own photograph, noise and all, tells the same, without being told of lens and pixels.
    noise = np.random.default_rng(2).normal(0, 0.01, image.shape)
    taken = assess_pattern(image + noise, pattern.rig, encoding="linear")
    clean = assess_pattern(image, pattern.rig, encoding="linear", picture_noise_std=0.0)
    # Noise of 1 % has a gradient of 1.2 % per px: without taking it away, grey noise would have gained 0.7 %.
    assert taken.gradient == pytest.approx(clean.gradient, rel=2e-3)
    assert taken.gradient == pytest.approx(worth.gradient, rel=0.04)
    assert taken.size_px == pytest.approx(worth.size_px, rel=0.2)


def test_a_photograph_at_scale_is_worth_what_the_pattern_is(tmp_path: Path) -> None:
    pattern = generate_pattern(plain_rig(), size_mm=SIZE, seed=1)
    write_texture_image(tmp_path / "pattern.png", pattern)
    own = assess_pattern(pattern)
    image = imageio.imread(tmp_path / "pattern.png")
    scale = SIZE[0] / image.shape[1]
    assert scale == pytest.approx(0.05)
    found = assess_pattern(tmp_path / "pattern.png", pattern.rig, mm_per_px=scale, encoding="linear")
    # Texels of a quarter px blur a little: 1 % of the contrast of waves of 2 px.
    for name in ("gradient_x", "contrast", "mean", "size_px", "depth_mm"):
        assert getattr(found, name) == pytest.approx(getattr(own, name), rel=0.02), name
    # Uneven light, and a screen's encoding, are taken back.
    shade = np.linspace(0.7, 1.0, image.shape[1])
    linear = image / 255 * shade
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    shaded = assess_pattern(np.round(255 * srgb).astype(np.uint8), pattern.rig, mm_per_px=scale, label="shaded")
    # Where there is less light, gradients are smaller: they are as in the mean of the light.
    assert shaded.gradient / shaded.mean == pytest.approx(own.gradient / own.mean, rel=0.02)
    assert (found.label, shaded.label) == ("pattern.png", "shaded")


def test_precision_is_that_of_the_envelope() -> None:
    rig = plain_rig()
    worth = assess_pattern(generate_pattern(rig, size_mm=SIZE), window_sigma_px=4.0)
    told = closed_form_bound(
        focal_length_px=FOCAL_PX,
        baseline_mm=2.0,
        positions=3,
        frames=3,
        depth_mm=Z_MM,
        gradient=worth.gradient_x,
        noise_std=0.01,
        window_sigma_px=4.0,
    )
    assert (worth.disparity_px, worth.depth_mm) == (told.disparity_px, told.depth_mm)
    assert worth.noise_std == pytest.approx(0.01)
    # Twice the light, twice the gradient; a camera of which no baseline is known tells px alone.
    bright = assess_pattern(generate_pattern(plain_rig(light=0.5), size_mm=SIZE))
    assert bright.gradient == pytest.approx(worth.gradient / 2)
    blind = assess_pattern(generate_pattern(plain_rig(baseline_mm=None, frames=1), size_mm=SIZE), window_sigma_px=4.0)
    assert (blind.depth_mm, blind.flow_px) == (None, None)
    assert blind.disparity_px == pytest.approx(told.disparity_px * np.sqrt(3))
    quiet = assess_pattern(generate_pattern(plain_rig(sensor="ideal"), size_mm=SIZE))
    assert (quiet.noise_std, quiet.disparity_px) == (0.0, None)
    assert quiet.gradient == pytest.approx(worth.gradient)


def test_shot_noise_counts_at_the_patterns_own_level() -> None:
    rig = plain_rig(sensor={"kind": "emva1288", "preset": "industrial_cmos"}, light=0.5)
    noise = [assess_pattern(generate_pattern(rig, size_mm=SIZE, coverage=share)).noise_std for share in (0.1, 0.5)]
    assert noise[0] > noise[1] > 0


def test_words_and_tables() -> None:
    rig = plain_rig()
    worths = [
        assess_pattern(generate_pattern(rig, kind, size_mm=SIZE), label=kind) for kind in ("speckle", "grey_noise")
    ]
    words = describe_assessments(worths)
    ratio = worths[0].gradient / worths[1].gradient
    assert f"grey_noise: {ratio:.2g} times the noise of depth and motion (reference: speckle)" in words
    frame = assessments_to_dataframe(worths).set_index(["pattern", "quantity"])
    assert frame.loc[("speckle", "gradient_x"), "value"] == worths[0].gradient_x
    assert frame.loc[("speckle", "depth_mm"), "unit"] == "mm"
    rows = {size: noise for size, _, noise, _ in compute_size_table(rig)}
    assert rows[4.0] == 1.0
    # Edges per area go with 1 / D: large dots lose at least as 1 / √D.
    assert rows[8.0] == pytest.approx(np.sqrt(2), rel=0.1)
    assert rows[12.0] > rows[8.0] > rows[4.0] > rows[2.0]


def test_what_cannot_be_judged_is_told(tmp_path: Path) -> None:
    rig = plain_rig()
    picture = np.random.default_rng(0).random((64, 64))
    with pytest.raises(ArgumentError, match=r"(?s)mm_per_px.*picture_noise_std"):
        assess_pattern(picture, rig, mm_per_px=-1, picture_noise_std=2)
    with pytest.raises(ArgumentError, match=r"coarser than the pixels of the rig, 0\.2 mm per px"):
        assess_pattern(picture, rig, mm_per_px=0.5)
    with pytest.raises(ArgumentError, match="shows less than 24 px"):
        assess_pattern(picture, rig, mm_per_px=0.01)
    with pytest.raises(ArgumentError, match="is black"):
        assess_pattern(0 * picture, rig)
    with pytest.raises(ArgumentError, match="rig: is missing"):
        assess_pattern(picture)
    with pytest.raises(ArgumentError, match="encoding: must be linear or srgb"):
        assess_pattern(picture, rig, encoding="log")
    with pytest.raises(ArgumentError, match="single grey or colour picture"):
        assess_pattern(picture[0], rig)
    with pytest.raises(ArgumentError, match="no such image file"):
        assess_pattern(tmp_path / "none.png", rig)
    (tmp_path / "bad.png").write_text("no picture")
    with pytest.raises(ArgumentError, match="cannot be read as an image"):
        assess_pattern(tmp_path / "bad.png", rig)
    with pytest.raises(ArgumentError, match="paper would be at 170 % of full scale"):
        assess_pattern(generate_pattern(plain_rig(light=2.0), size_mm=SIZE))
    with pytest.raises(ArgumentError, match="less than 24 px"):
        assess_pattern(generate_pattern(rig, size_mm=(4.6, 30), dot_px=2))


@nightly
@pytest.mark.parametrize(
    ("kind", "blur"), [("noise", {}), ("speckle", BLUR), *by_night(("speckle", {}), ("grey_noise", {}))], ids=str
)
def test_the_refined_method_scatters_as_predicted(kind: str, blur: dict[str, Any], tmp_path: Path) -> None:
    """Scatter of depth over six noises, rms over the image, over what is told; printed.

    The image holds some 30 windows that share no noise: with six noises, it is known to 6 %, and the gradients of this
    part of the pattern differ by 3 % from those of all.
    """
    pattern = generate_pattern(plain_rig(**blur), kind, size_mm=SIZE, seed=1)
    ideal, _ = st.simulate(scene_of(pattern, tmp_path, blur))
    told = assess_pattern(pattern, window_sigma_px=4.0)
    settings: dict[str, Any] = {
        "surface": "plane",
        "motion": "rigid",
        "acceleration": False,
        "discontinuity_refit": False,
        "photometric_model": "none",
    }
    inside = {"t": 0, "y": slice(20, -20), "x": slice(24, -24)}
    found = [
        st.estimate(add_noise(ideal, 0.01, seed), "refined", window_sigma_px=4.0, **settings).isel(t=[0])
        for seed in range(6)
    ]
    depth = np.array([each["depth"].isel(inside).values for each in found], dtype=float)
    assert told.depth_mm is not None
    ratio = np.sqrt(np.mean(depth.var(axis=0, ddof=1))) / told.depth_mm
    print(f"{kind}, {'blurred' if blur else 'sharp'}: scatter of depth over what is told {ratio:.3f}")
    assert ratio == pytest.approx(1.0, abs=0.2)
