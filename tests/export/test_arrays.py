"""Labelled arrays of xarray, and tables of polars."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import factorgraph_adj as fga
from tests.networks.mapped import in_plane
from tests.networks.small_block import images_only


def test_a_data_set_has_points_photos_and_observations():
    pytest.importorskip("xarray")
    s = in_plane()
    found = fga.to_xarray(s)
    at = found["coordinates"].sel(point="P7")
    assert at.sel(axis="z").item() == s.point("P7")[2]
    covariance = found["covariance"].sel(point="P7").values
    assert np.allclose(covariance, s.covariance("P7"), rtol=1e-9, atol=1e-18)
    assert np.array_equal(found["rotation"].sel(photo="F2").values, s.pose("F2").rotation)
    assert np.array_equal(found["pose_covariance"].sel(photo="F2").values, s.pose_covariance("F2"))
    images = found.where(found["kind"] == "image", drop=True)
    assert images.sizes["row"] == 96
    assert np.array_equal(found["residual"].values, s.observations.residuals)
    assert found.attrs["sigma0"] == s.sigma0


def test_a_data_set_goes_through_a_file(tmp_path):
    xarray = pytest.importorskip("xarray")
    found = fga.to_xarray(in_plane())
    pytest.importorskip("scipy")
    found.to_netcdf(tmp_path / "a.nc", engine="scipy")
    with xarray.open_dataset(tmp_path / "a.nc", engine="scipy") as back:
        assert np.array_equal(back["covariance"].values, found["covariance"].values)


@pytest.mark.parametrize("free", [False, True])
def test_the_joint_covariance_is_that_of_the_solution(free):
    pytest.importorskip("xarray")
    network = images_only()
    if not free:
        network = in_plane().network
    network.datum = "free" if free else "given"
    s = fga.adjust(network, variance="a-posteriori")
    names = ["P3", "P1", "P12"] if free else ["P3", "S1", "S2", "P12"]
    found = fga.covariance_array(s, names)
    expected = s.covariance(names)
    joint = found.values.reshape(3 * len(names), -1)
    assert np.abs(joint - expected).max() < 1e-9 * np.abs(expected).max()
    every = fga.covariance_array(s)
    part = every.sel(point=names, point2=names).values.reshape(3 * len(names), -1)
    assert np.abs(part - expected).max() < 1e-9 * np.abs(expected).max()
    assert np.linalg.eigvalsh(joint).min() > -1e-9 * np.abs(joint).max()


def test_a_transformed_datum_has_its_own_covariance():
    pytest.importorskip("xarray")
    network = images_only()
    network.datum = "free"
    s = fga.s_transform(fga.adjust(network), ["P1", "P2", "P7"])
    found = fga.covariance_array(s, ["P1", "P9"]).values.reshape(6, 6)
    assert np.allclose(found, s.covariance(["P1", "P9"]), rtol=1e-12)


def test_unknown_points_and_points_named_twice_are_refused():
    pytest.importorskip("xarray")
    with pytest.raises(fga.InputError, match="unknown points 'X', 'Y'; known: "):
        fga.covariance_array(in_plane(), ["X", "P1", "Y"])
    with pytest.raises(fga.InputError, match="points are named twice: P1"):
        fga.covariance_array(in_plane(), ["P1", "P2", "P1"])


def test_without_xarray_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(fga.InputError, match=r"pip install 'factorgraph_adj\[xarray\]'"):
        fga.to_xarray(in_plane())
