"""Tracks as lines on a map: GeoJSON and KML texts."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

import attrs
import numpy as np

from imm_tdoa.contract import Array

KML = "http://www.opengis.net/kml/2.2"


@attrs.frozen(eq=False)
class Path:
    """A target's way over the Earth.

    Attributes
    ----------
    name : str
        The target.
    times : (T,)
        Times, s.
    place : (T, 3)
        Latitude and longitude, degrees, and height above the WGS84 ellipsoid, m.
    solid : bool
        Whether the heights were estimated.
    """

    name: str
    times: Array
    place: Array
    solid: bool


def geojson(paths: Sequence[Path]) -> str:
    """Return a GeoJSON FeatureCollection with a Feature per path."""
    features = [
        {
            "type": "Feature",
            "geometry": _geometry(path),
            "properties": {"target": path.name, "times_s": path.times.tolist()},
        }
        for path in paths
    ]
    collection = {"type": "FeatureCollection", "features": features}
    return json.dumps(collection, allow_nan=False, ensure_ascii=False) + "\n"


def _geometry(path: Path) -> dict[str, Any] | None:
    lines = [line.tolist() for line in cut(path.place)]
    if not lines:
        return None
    if len(lines) > 1:
        return {"type": "MultiLineString", "coordinates": lines}
    if len(lines[0]) == 1:
        return {"type": "Point", "coordinates": lines[0][0]}
    return {"type": "LineString", "coordinates": lines[0]}


def cut(place: Array) -> list[Array]:
    """Return the lines (K, 3) of longitude, latitude, height, cut at the 180th meridian.

    Where two points are on its two sides, both lines end at the meridian (RFC 7946 §3.1.9).
    """
    if not len(place):
        return []
    points = np.stack([place[:, 1], place[:, 0], place[:, 2]], axis=-1)
    lines, start = [], 0
    head: list[Array] = []
    for k in np.flatnonzero(np.abs(np.diff(points[:, 0])) > 180.0).tolist():
        a, b = points[k], points[k + 1].copy()
        side = np.copysign(180.0, a[0])
        b[0] += 2.0 * side
        share = (side - a[0]) / (b[0] - a[0]) if b[0] != a[0] else 0.0
        edge = a + share * (b - a)
        lines.append(np.array([*head, *points[start : k + 1], edge]))
        head, start = [np.array([-side, *edge[1:]])], k + 1
    return [*lines, np.array([*head, *points[start:]])]


def kml(paths: Sequence[Path]) -> str:
    """Return a KML document with a Placemark per path."""
    ElementTree.register_namespace("", KML)
    root = ElementTree.Element(f"{{{KML}}}kml")
    document = _below(root, "Document")
    for path in paths:
        mark = _below(document, "Placemark")
        _below(mark, "name", path.name)
        line = _below(mark, "LineString" if len(path.place) > 1 else "Point")
        _below(line, "altitudeMode", "absolute" if path.solid else "clampToGround")
        places = (f"{lon!r},{lat!r},{height!r}" for lat, lon, height in path.place.tolist())
        _below(line, "coordinates", " ".join(places))
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _below(parent: ElementTree.Element, tag: str, text: str | None = None) -> ElementTree.Element:
    child = ElementTree.SubElement(parent, f"{{{KML}}}{tag}")
    child.text = text
    return child
