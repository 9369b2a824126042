"""Coordinates have the indexes that xarray creates."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import xarray as xr

from scenetruth.schema import with_indexes

COORDINATES = {
    "t": (("t",), np.array([-1, 0, 2])),
    "time_s": (("t",), np.array([-0.5, 0.0, 1.0])),
    "component": (("component",), np.array(["x", "y"])),
    "channel": (("channel",), np.array(["green"], dtype=str)),
    "x": (("x",), np.arange(20.0, 24.0)),
    "planned_time_s": (("t", "x"), np.zeros((3, 4))),
    "n": (("n",), np.array([], dtype=np.int64)),
}


def test_coordinates_are_those_of_xarray() -> None:
    given = {name: xr.Variable(dims, values, {"units": name}) for name, (dims, values) in COORDINATES.items()}
    maps = {"depth": xr.Variable(("t", "x"), np.ones((3, 4)))}
    made, usual = xr.Dataset(maps, with_indexes(given), {"a": 1}), xr.Dataset(maps, given, {"a": 1})
    xr.testing.assert_identical(made, usual)
    assert list(made.coords) == list(usual.coords)
    for name in usual.coords:
        assert made[name].dtype == usual[name].dtype
        assert type(made.variables[name]) is type(usual.variables[name])
    assert {name: (index.dtype, index.name) for name, index in made.indexes.items()} == {
        name: (index.dtype, index.name) for name, index in usual.indexes.items()
    }
    xr.testing.assert_identical(pickle.loads(pickle.dumps(made)), usual)
    xr.testing.assert_identical(made.sel(t=0, component="y"), usual.sel(t=0, component="y"))


def test_coordinates_must_fit_the_maps() -> None:
    with pytest.raises(ValueError, match="conflicting sizes"):
        xr.Dataset({"depth": ("t", [1.0, 2.0])}, with_indexes({"t": xr.Variable("t", [0])}))
