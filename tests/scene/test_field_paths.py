"""Paths of fields: what is told where they lead to nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from scenetruth.scene.field_paths import PathError, assign, expand, value_at

PLAIN: dict[str, Any] = {"optics": {"psf": None}, "sensor": "ideal", "camera": {"width": 320}, "shadows": True}
SET = "set all of '{}' to a mapping first, under 'set'"


@pytest.mark.parametrize(
    ("path", "told"),
    [
        ("optics.psf.sigma_px", rf"'optics\.psf' is null in the scene, and has no field 'sigma_px': {SET}$"),
        ("sensor.noise_std", rf"'sensor' is \"ideal\" in .* no field 'noise_std': {SET}, or end the path at 'sensor'$"),
        ("camera.width.more", r"'camera\.width' is 320 in .* no field 'more': end the path at 'camera\.width'$"),
        ("shadows.soft", r"'shadows' is true in the scene, and has no field 'soft': end the path at 'shadows'$"),
    ],
)
@pytest.mark.parametrize("use", [expand, value_at, lambda plain, path: assign(plain, path, 3)])
def test_what_has_no_fields_is_spelled_as_in_files_with_what_to_do(
    use: Callable[[Any, str], Any], path: str, told: str
) -> None:
    above = path.rpartition(".")[0].replace(".", r"\.")
    with pytest.raises(PathError, match=told.format(above)):
        use(PLAIN, path)
