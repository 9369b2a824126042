"""Photon transfer of images whose statistics are known, and what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from scenetruth.camera import photon_transfer

SHAPE = (120, 160)


def images(**changes: Any) -> dict[str, Any]:
    """Return images from plain Gaussian numbers, no sensor of ours: K = 0.5, σ_d = 8 e-, DSNU = 4 e-, PRNU = 2 %."""
    generator = np.random.default_rng(5)
    offset, response = 4.0 * generator.standard_normal(SHAPE), 1 + 0.02 * generator.standard_normal(SHAPE)

    def stack(electrons: float, count: int) -> Any:
        mean = electrons * response
        noise = np.sqrt(np.maximum(mean, 0) + 8.0**2) * generator.standard_normal((count, *SHAPE))
        return np.rint(np.minimum(0.5 * (np.minimum(mean + noise, 20000.0) + offset) + 100, 65535))

    photons = np.linspace(500, 30000, 15)
    made = {
        "photons": photons,
        "pairs": np.stack([stack(0.6 * light, 2) for light in photons]),
        "dark": stack(0.0, 20),
        "bias": stack(0.0, 20),
        "flat": stack(9000.0, 20),
        "saturated": stack(1e5, 2),
    }
    return made | changes


def test_known_images_give_back_their_figures() -> None:
    found = photon_transfer(**images())
    # Standard errors with 19,200 pixels: 0.3 % of the gain from nine levels, 0.5 % of a standard deviation of the
    # pixels' pattern; three of them.
    assert found.gain_dn_per_e == pytest.approx(0.5, rel=0.01)
    assert found.temporal_dark_noise_e == pytest.approx(8.0, rel=0.012)
    assert found.dsnu_e == pytest.approx(4.0, rel=0.02)
    assert found.prnu == pytest.approx(0.02, rel=0.02)
    assert found.quantum_efficiency == pytest.approx(0.6, rel=0.01)
    assert found.saturation_e == pytest.approx(20000, rel=0.01)
    assert abs(found.dark_e) < 0.2
    assert found.linearity_error < 1e-3


def test_rounding_is_taken_from_the_dark_noise() -> None:
    generator = np.random.default_rng(1)
    # 1/12 DN² are an eighth of this variance: without the correction the noise would be 6 % too large.
    noise = generator.normal(100, 0.8, (40, *SHAPE))
    exact = photon_transfer(**images(bias=noise)).temporal_dark_noise_e
    rounded = photon_transfer(**images(bias=np.rint(noise))).temporal_dark_noise_e
    gain = photon_transfer(**images()).gain_dn_per_e
    assert exact == pytest.approx(np.sqrt(0.8**2 - 1 / 12) / gain, rel=0.01)
    assert rounded == pytest.approx(0.8 / gain, rel=0.01)


def test_a_bent_response_is_seen() -> None:
    straight = images()
    pairs = straight["pairs"] - 100
    bent = photon_transfer(**straight | {"pairs": pairs - 0.02 * pairs**2 / 10000 + 100})
    # A parabola with 2 % of curvature at full scale leaves a line by more than 0.1 % and less than the 2 %.
    assert 1e-3 < bent.linearity_error < 0.02


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"photons": np.arange(3.0)}, "pairs must have the shape"),
        ({"dark": np.zeros((1, *SHAPE))}, "dark must contain at least two images"),
        ({"flat": np.zeros((5, 3, 4))}, "flat must contain at least two images"),
        ({"saturated": np.zeros(SHAPE)}, "digital numbers do not increase with light"),
        ({"photons": np.arange(2.0), "pairs": np.zeros((2, 2, *SHAPE))}, "at least 3 levels"),
    ],
)
def test_images_that_do_not_fit(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        photon_transfer(**images(**changes))
