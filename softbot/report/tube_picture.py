"""The rolling tube as flat quads that matplotlib can fill: its surface with stripes, a camera, and a lamp.

Projected and sorted here, because matplotlib's own 3-D axes do not sort several surfaces against each other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softbot.report.recording import CHAMBER_COUNT, Floats, Recording

AROUND = 32
"""Quads around the tube; a chamber's stripe covers four of the eight in its quarter."""

BACKGROUND = (0.955, 0.965, 0.968)
BODY = (0.914, 0.886, 0.839)
DEAD = (0.09, 0.10, 0.106)
END = (0.31, 0.35, 0.38)
CHAMBERS = ((0.122, 0.471, 0.820), (0.910, 0.537, 0.047), (0.039, 0.608, 0.424), (0.761, 0.251, 0.604))


@dataclass(frozen=True, slots=True)
class Camera:
    """A parallel projection: `right` and `up` span the picture, `towards` points to the camera."""

    right: Floats
    up: Floats
    towards: Floats

    @classmethod
    def looking(cls, azimuth_rad: float, elevation_rad: float) -> Camera:
        """A camera in this direction from what it looks at: azimuth from +x towards +y, elevation above the floor."""
        ca, sa, ce, se = math.cos(azimuth_rad), math.sin(azimuth_rad), math.cos(elevation_rad), math.sin(elevation_rad)
        return cls(np.array([-sa, ca, 0.0]), np.array([-se * ca, -se * sa, ce]), np.array([ce * ca, ce * sa, se]))

    def flat(self, points_m: Floats) -> Floats:
        """Points (..., 3) in the picture's plane (..., 2) [m]."""
        return np.stack([points_m @ self.right, points_m @ self.up], axis=-1)


def surface(recording: Recording, t_s: float) -> tuple[Floats, Floats]:
    """The tube's surface at the frame nearest to a time: quad corners (quads, 4, 3) [m] and colours (quads, 3)."""
    from scipy.interpolate import make_interp_spline

    shapes = recording.shapes
    frame = int(np.abs(shapes.t_s - t_s).argmin())
    nodes = shapes.centreline_m.shape[1]
    places = np.linspace(0, nodes - 1, 61)
    degree = min(3, nodes - 1)
    line_m = make_interp_spline(np.arange(nodes), shapes.centreline_m[frame], k=degree)
    centre_m, tangent = line_m(places), _unit(line_m.derivative()(places))
    e1 = make_interp_spline(np.arange(nodes), shapes.director[frame], k=degree)(places)
    e1 = _unit(e1 - (e1 * tangent).sum(axis=1, keepdims=True) * tangent)
    e2 = np.cross(tangent, e1)

    # Rounded ends: rings that shrink and move outwards, half a radius long.
    radius = np.concatenate([[0.01, 0.4, 0.72, 0.92], np.ones(places.size), [0.92, 0.72, 0.4, 0.01]])
    along = 0.5 * np.sqrt(1.0 - radius**2) * np.where(np.arange(radius.size) < radius.size / 2, -1.0, 1.0)
    node = np.concatenate([np.zeros(4, dtype=int), np.arange(places.size), np.full(4, places.size - 1)])
    angle = 2.0 * math.pi * np.arange(AROUND) / AROUND
    out = np.cos(angle)[None, :, None] * e1[node][:, None, :] + np.sin(angle)[None, :, None] * e2[node][:, None, :]
    rings_m = centre_m[node][:, None, :] + shapes.radius_m * (
        radius[:, None, None] * out + along[:, None, None] * tangent[node][:, None, :]
    )
    turned_m = np.roll(rings_m, -1, axis=1)
    corners_m = np.stack([rings_m[:-1], turned_m[:-1], turned_m[1:], rings_m[1:]], axis=2)

    colours = np.empty((*corners_m.shape[:2], 3))
    colours[:] = BODY
    colours[1::2] = np.array(BODY) * 0.965
    dead_from_s = recording.dead_from_s()
    for chamber in range(CHAMBER_COUNT):
        dead_s = dead_from_s[chamber]
        stripe = np.arange(8 * chamber - 2, 8 * chamber + 2) % AROUND
        colours[:, stripe] = DEAD if dead_s is not None and t_s >= dead_s else CHAMBERS[chamber]
    colours[:4] = colours[-4:] = END
    return corners_m.reshape(-1, 4, 3), colours.reshape(-1, 3)


def shade(corners_m: Floats, base: Floats, camera: Camera) -> tuple[Floats, NDArray[np.bool_]]:
    """Colours (quads, 3) under a lamp above the camera's shoulder, and which quads face the camera."""
    normal = _unit(np.cross(corners_m[:, 2] - corners_m[:, 0], corners_m[:, 3] - corners_m[:, 1]))
    normal *= -1.0 if _inside_out(corners_m, normal) else 1.0
    lamp = 0.35 * camera.right + 0.28 * camera.towards + np.array([0.0, 0.0, 0.85])
    lamp /= np.linalg.norm(lamp)
    half = (lamp + camera.towards) / np.linalg.norm(lamp + camera.towards)
    light = 0.44 + 0.64 * np.maximum(normal @ lamp, 0.0)
    shine = 0.24 * np.maximum(normal @ half, 0.0) ** 26
    return base * light[:, None] + shine[:, None], normal @ camera.towards > 0.0


def _inside_out(corners_m: Floats, normal: Floats) -> bool:
    """Whether these normals point into the surface: the flux of position through it is three times its volume."""
    return bool((corners_m.mean(axis=1) * normal).sum(axis=1) @ _areas(corners_m) < 0.0)


def _areas(corners_m: Floats) -> Floats:
    across = np.cross(corners_m[:, 2] - corners_m[:, 0], corners_m[:, 3] - corners_m[:, 1])
    return 0.5 * np.linalg.norm(across, axis=1)


def _unit(vectors: Floats) -> Floats:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def fill(axes: Any, camera: Camera, tubes: list[tuple[Floats, Floats]], paler: list[float], zorder: float = 4) -> None:
    """Draw tubes (`surface`) in a camera's picture, the nearer parts over the farther; `paler` 0 (full colour) … 1."""
    from matplotlib.collections import PolyCollection

    quads, colours, depths = [], [], []
    for (corners_m, base), pale in zip(tubes, paler, strict=True):
        shaded, facing = shade(corners_m, base, camera)
        colours.append(((1.0 - pale) * shaded + pale * np.array(BACKGROUND))[facing])
        quads.append(camera.flat(corners_m)[facing])
        depths.append((corners_m.mean(axis=1) @ camera.towards)[facing])
    order = np.argsort(np.concatenate(depths))
    faces = np.concatenate(colours)[order].clip(0.0, 1.0)
    axes.add_collection(
        PolyCollection(
            [*np.concatenate(quads)[order]], facecolors=faces, edgecolors=faces, linewidths=0.35, zorder=zorder
        )
    )
