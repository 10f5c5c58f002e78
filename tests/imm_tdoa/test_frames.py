"""East-north-up frames against pymap3d, the ellipsoid's own equations and finite differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imm_tdoa.frames import EastNorthUp

A, F = 6378137.0, 1.0 / 298.257223563  # WGS84
E2 = F * (2.0 - F)

LATITUDES = st.floats(-90.0, 90.0)
LONGITUDES = st.floats(-180.0, 180.0)
FRAME = EastNorthUp(47.9266, 9.2579, 400.0)


def earth_fixed(lat: Any, lon: Any, h: Any) -> Any:
    """Earth-fixed coordinates from the ellipsoid's equations (§ "geodetic datum", any text)."""
    lat, lon = np.radians(lat), np.radians(lon)
    N = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    return np.stack(
        [
            (N + h) * np.cos(lat) * np.cos(lon),
            (N + h) * np.cos(lat) * np.sin(lon),
            (N * (1.0 - E2) + h) * np.sin(lat),
        ],
        axis=-1,
    )


def axes(lat: float, lon: float) -> Any:
    """East, north and up at a place, as rows."""
    p, t = np.radians(lat), np.radians(lon)
    return np.array(
        [
            [-np.sin(t), np.cos(t), 0.0],
            [-np.sin(p) * np.cos(t), -np.sin(p) * np.sin(t), np.cos(p)],
            [np.cos(p) * np.cos(t), np.cos(p) * np.sin(t), np.sin(p)],
        ]
    )


@settings(max_examples=100, deadline=None)
@given(LATITUDES, LONGITUDES, LATITUDES, LONGITUDES, st.floats(-1e4, 4e7))
def test_points_from_first_principles(
    lat0: float, lon0: float, lat: float, lon: float, h: float
) -> None:
    frame = EastNorthUp(lat0, lon0, 300.0)
    point = frame.from_geodetic(np.array(lat), np.array(lon), np.array(h))
    difference = earth_fixed(lat, lon, h) - earth_fixed(lat0, lon0, 300.0)
    np.testing.assert_allclose(point, axes(lat0, lon0) @ difference, atol=1e-7)


@settings(max_examples=100, deadline=None)
@given(LATITUDES, LONGITUDES, LATITUDES, LONGITUDES, st.floats(-1e6, 4e7))
def test_round_trip(lat0: float, lon0: float, lat: float, lon: float, h: float) -> None:
    """To a micrometre from the deep ground to beyond the navigation satellites."""
    frame = EastNorthUp(lat0, lon0, -20.0)
    point = frame.from_geodetic(np.array(lat), np.array(lon), np.array(h))
    found = frame.to_geodetic(point)
    again = frame.from_geodetic(*found)
    np.testing.assert_allclose(again, point, atol=1e-6)
    np.testing.assert_allclose(found[2], h, atol=1e-6)
    np.testing.assert_allclose(found[0], lat, atol=1e-11)


def test_near_the_ellipsoid_it_agrees_with_pymap3d() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-1.0, 1.0, (500, 3)) * [5e4, 5e4, 5e3]
    ours = FRAME.to_geodetic(points)
    theirs = pymap3d.enu2geodetic(*points.T, FRAME.lat_deg, FRAME.lon_deg, FRAME.height_m)
    for a, b, tolerance in zip(ours, theirs, (1e-11, 1e-11, 1e-7), strict=True):
        np.testing.assert_allclose(a, b, atol=tolerance)
    back = pymap3d.geodetic2enu(*ours, FRAME.lat_deg, FRAME.lon_deg, FRAME.height_m)
    np.testing.assert_allclose(np.stack(back, axis=-1), points, atol=1e-6)


def test_z_is_not_height() -> None:
    """The Earth falls away by about s²/2R: 8 m at 10 km, 3.1 km at 200 km."""
    east = np.array([[1e4, 0.0, 0.0], [2e5, 0.0, 0.0]])
    fall = EastNorthUp(47.9266, 9.2579, 0.0).height(east)[0]
    np.testing.assert_allclose(fall, [7.8, 3130.0], rtol=0.01)


@pytest.mark.parametrize("scale", [1e3, 3e5, 2e7])
@pytest.mark.parametrize("lat", [-90.0, -33.0, 0.0, 60.0, 90.0])
def test_the_gradient_of_height_is_its_derivative(lat: float, scale: float) -> None:
    frame = EastNorthUp(lat, 151.0, 50.0)
    rng = np.random.default_rng(7)
    points = rng.normal(size=(50, 3)) * scale
    points[:, 2] = np.abs(points[:, 2])
    height, gradient = frame.height(points)
    np.testing.assert_array_equal(height, frame.to_geodetic(points)[2])
    step = 30.0
    for i, e in enumerate(np.eye(3)):
        slope = (frame.height(points + step * e)[0] - frame.height(points - step * e)[0]) / 60.0
        # Central differences err by rounding, 1e-8 m / step, and step²/6R² of the slope.
        np.testing.assert_allclose(gradient[:, i], slope, atol=2e-9)
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=-1), 1.0, rtol=1e-14)


def test_gradient_at_the_origin_is_up() -> None:
    height, gradient = FRAME.height(np.zeros(3))
    np.testing.assert_allclose(height, 400.0, atol=1e-8)
    np.testing.assert_allclose(gradient, [0.0, 0.0, 1.0], atol=1e-15)


def test_batches_and_missing_points() -> None:
    points = np.zeros((2, 4, 3))
    points[1, 2] = np.nan
    height, gradient = FRAME.height(points)
    assert height.shape == (2, 4)
    assert gradient.shape == (2, 4, 3)
    assert np.isnan(height).sum() == 1
    assert np.isnan(gradient[1, 2]).all()
    assert FRAME.from_geodetic(np.array([47.0, 48.0]), np.array(9.0), np.array(0.0)).shape == (2, 3)


def test_at_the_poles_and_at_the_centre_there_are_numbers() -> None:
    frame = EastNorthUp(0.0, 0.0, 0.0)
    b = A * (1.0 - F)
    pole = np.array([0.0, b + 100.0, -A])
    lat, _, height = frame.to_geodetic(pole)
    np.testing.assert_allclose(lat, 90.0)
    np.testing.assert_allclose(height, 100.0, atol=1e-8)
    assert np.isfinite(frame.height(np.array([0.0, 0.0, -A]))[0])


def test_what_is_refused() -> None:
    wrong: list[tuple[Any, str]] = [
        ((91.0, 0.0), "lat_deg: expected a number within ±90, got 91.0"),
        ((0.0, -361.0), "lon_deg: expected a number within ±360, got -361.0"),
        ((0.0, 0.0, np.inf), "height_m: expected finite numbers"),
        (("48N", 0.0), "lat_deg: expected numbers, got '48N'"),
        ((None, 0.0), "lat_deg: expected finite numbers"),
        ((True, 0.0), "lat_deg: expected one number, got True"),
        (([1.0, 2.0], 0.0), "lat_deg: expected one number, got"),
    ]
    for arguments, message in wrong:
        with pytest.raises(ValueError, match=message):
            EastNorthUp(*arguments)
    with pytest.raises(ValueError, match=r"position: expected shape \(\.\.\., 3,?\), got \(2,\)"):
        FRAME.to_geodetic(np.zeros(2))
    with pytest.raises(ValueError, match=r"lat_deg: expected latitudes within ±90, got 95\.0"):
        FRAME.from_geodetic(np.array([0.0, 95.0]), np.zeros(2), np.zeros(2))


def test_frames_of_equal_origins_are_equal() -> None:
    assert EastNorthUp(48, 9) == EastNorthUp(48.0, 9.0, 0.0)
    assert len({EastNorthUp(48, 9), EastNorthUp(48.0, 9.0)}) == 1


def test_heights_and_their_gradients_are_those_of_pymap3d() -> None:
    """Wherever aircraft fly; pymap3d's own closed form is good to 1e-8 m there."""
    rng = np.random.default_rng(11)
    for lat, lon in ((-89.9, 0.0), (-33.0, 151.0), (0.0, -179.0), (47.9, 9.3), (90.0, 10.0)):
        frame = EastNorthUp(lat, lon, 120.0)
        points = rng.uniform(-1.0, 1.0, (300, 3)) * [5e5, 5e5, 2e4]
        height, gradient = frame.height(points)
        phi, lam, expected = pymap3d.enu2geodetic(*points.T, lat, lon, 120.0)
        np.testing.assert_allclose(height, expected, rtol=0.0, atol=1e-7)
        p, t = np.radians(phi), np.radians(lam)
        normal = np.cos(p) * np.cos(t), np.cos(p) * np.sin(t), np.sin(p)
        up = np.stack(pymap3d.ecef2enuv(*normal, lat, lon), axis=-1)
        np.testing.assert_allclose(gradient, up, rtol=0.0, atol=1e-13)


def test_near_the_centre_pymap3d_serves_and_the_others_are_not_touched() -> None:
    frame = EastNorthUp(10.0, 20.0, 0.0)
    points = np.array([[1e3, 2e3, 5e3], [1e5, -2e5, -4.5e6], [np.nan, 0.0, 0.0]])
    with np.errstate(all="raise"):
        lat, lon, height = frame.to_geodetic(points)
        alone = frame.to_geodetic(points[:1])
    expected = np.array(pymap3d.enu2geodetic(*points[1], 10.0, 20.0, 0.0))
    np.testing.assert_allclose([lat[1], lon[1], height[1]], expected, rtol=1e-12)
    np.testing.assert_array_equal([lat[0], lon[0], height[0]], [v[0] for v in alone])
    assert np.isnan([lat[2], lon[2], height[2]]).all()
