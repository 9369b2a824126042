"""Transfer functions, apertures and vignetting against closed forms and numerical integrals."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.special import j1

from scenetruth.camera import AiryPsf, Camera, Defocus, GaussianPsf, Shutter, Vignetting

CAMERA = Camera(width=640, height=480, focal_length_px=500)


def test_gaussian_transfer_is_the_spectrum_of_the_gaussian() -> None:
    psf = GaussianPsf(kind="gaussian", sigma_px=0.7)
    x = np.linspace(-8, 8, 4001)
    line = np.exp(-0.5 * (x / 0.7) ** 2) / (0.7 * np.sqrt(2 * np.pi))
    for frequency in (0.0, 0.2, 0.5, 1.0):
        # The trapezoidal rule is exact to rounding for smooth functions that vanish at both ends.
        expected = np.trapezoid(line * np.cos(2 * np.pi * frequency * x), x)
        assert psf.transfer(np.array(frequency)) == pytest.approx(expected, abs=1e-12)


def test_airy_transfer_is_the_spectrum_of_airys_disc() -> None:
    psf = AiryPsf(kind="airy", wavelength_um=0.55, f_number=8, pixel_pitch_um=3.45)
    assert psf.cutoff_per_px == pytest.approx(3.45 / (0.55 * 8))
    # Back from the transfer function to the disc (2 J1(v) / v)², v = π r / (λ N), by a Hankel transform.
    frequency = np.linspace(0, psf.cutoff_per_px, 20001)
    from scipy.special import j0

    for radius in (0.0, 0.5, 1.0, 2.0):
        intensity = (
            2
            * np.pi
            * np.trapezoid(psf.transfer(frequency) * j0(2 * np.pi * frequency * radius) * frequency, frequency)
        )
        v = np.pi * radius * psf.cutoff_per_px
        peak = np.pi * psf.cutoff_per_px**2 / 4
        expected = peak * (1.0 if v == 0 else (2 * j1(v) / v) ** 2)
        assert intensity == pytest.approx(expected, abs=1e-6 * peak)
    assert j1(np.pi * psf.radius_px * psf.cutoff_per_px) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("count", [3, 16, 48, 333])
def test_points_on_the_aperture_have_the_moments_of_a_disc(count: int) -> None:
    lens = Defocus(aperture_mm=8, focus_distance_mm=600)
    points = lens.points_mm(count)
    np.testing.assert_allclose(points.mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(points.T @ points / count, np.eye(2) * 8**2 / 16, atol=1e-12)
    if count >= 16:
        assert np.hypot(*points.T).max() < 4 * 1.1


def test_vignetting_is_the_cos4_law_times_a_polynomial() -> None:
    shade = Vignetting(natural=True, coefficients=(-0.2, 0.05, 0.01)).factor(CAMERA)
    x, y = 639 - CAMERA.principal_point[0], 479 - CAMERA.principal_point[1]
    angle = np.arctan(np.hypot(x, y) / 500)
    r = np.hypot(x, y) / np.hypot(320, 240)
    assert shade[479, 639] == pytest.approx(
        np.cos(angle) ** 4 * (1 - 0.2 * r**2 + 0.05 * r**4 + 0.01 * r**6), rel=1e-12
    )
    assert Vignetting(natural=False, coefficients=(-9, 0, 0)).factor(CAMERA).min() == 0


def test_rows_and_moments_of_a_shutter() -> None:
    shutter = Shutter(exposure_time_s=0.01, readout_time_s=0.02)
    offsets = shutter.row_offsets_s(np.arange(480.0), 480)
    assert offsets[-1] - offsets[0] == pytest.approx(0.02)
    assert offsets.mean() == pytest.approx(0, abs=1e-15)
    moments = shutter.exposure_offsets_s(4)
    np.testing.assert_allclose(moments, [-0.00375, -0.00125, 0.00125, 0.00375])


@pytest.mark.parametrize(
    ("model", "values"),
    [
        (GaussianPsf, {"kind": "gaussian", "sigma_px": 0}),
        (AiryPsf, {"kind": "airy", "wavelength_um": -0.5, "f_number": 8, "pixel_pitch_um": 5}),
        (Defocus, {"aperture_mm": 5, "focus_distance_mm": 0}),
        (Shutter, {"exposure_time_s": -1}),
    ],
)
def test_impossible_optics_are_refused(model: type, values: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        model(**values)
