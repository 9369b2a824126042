"""Parameters and tables of materials."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.render.reflection import pack_materials
from scenetruth.scene.material import Material


def test_matt_materials_have_no_tables() -> None:
    optics = pack_materials([Material(), Material(refractive_index=1.5)])
    assert not optics.tables[0].any()
    assert optics.tables[1, 0].min() > 0


def test_means_are_those_of_the_interpolated_tables() -> None:
    material = Material(refractive_index=1.5, roughness=0.5, roughness_along=0.3)
    optics = pack_materials([material])
    table = optics.tables[0, 0]
    # The mean over the hemisphere, weighted by the cosine, with a fine grid of both angles.
    cosines = (np.arange(4000) + 0.5) / 4000
    azimuths = (np.arange(400) + 0.5) / 400 * (table.shape[1] - 1)
    low = azimuths.astype(int)
    columns = table[:, low] * (1 - azimuths % 1) + table[:, low + 1] * (azimuths % 1)
    nodes = np.linspace(0, 1, len(table))
    albedo = [np.interp(np.sqrt(cosines), nodes, column) for column in columns.T]
    assert 2 * np.mean(np.mean(albedo, axis=0) * cosines) == pytest.approx(optics.values[0, 5], rel=1e-5)
