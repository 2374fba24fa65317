"""Other bodies of a scene: the `[[body]]` tables, their checks, where they stand, and how far a point is from each.

A body is a box, a sphere or a cylinder, free to move or fixed. Its frame: origin at the centre, axes along the edges of
a box, z along the axis of a cylinder. Whoever computes their motion is told of them here; nothing here needs an engine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, Protocol, Self

import pydantic
from pydantic import Field

from softbot.toml_file import STRICT

LONGEST_STEP_S = {"fast": 0.005, "standard": 0.0025, "reference": 0.001}
"""Of a twin among bodies, by accuracy: what two engines exchange is held for a step, and the longer the step, the
softer the contact has to be (docs/decisions/0010-other-bodies.md)."""

BOX, SPHERE, CYLINDER = 0, 1, 2
_CODE = {"box": BOX, "sphere": SPHERE, "cylinder": CYLINDER}

_LEAST_DENSITY_KG_M3, _GREATEST_DENSITY_KG_M3 = 1.0, 25e3
_LEAST_SIZE_M, _GREATEST_SIZE_M = 1e-3, 100.0
_PLACE_LIMIT_M = 1e3
_SPEED_LIMIT_M_S = 10.0
_SIZE_KEYS = {"box": ("size_m",), "sphere": ("radius_m",), "cylinder": ("radius_m", "length_m")}
_TOUCHING_M = 1e-6

Vector = tuple[float, float, float]


class Ground(Protocol):
    """What the bodies stand on: a `[world]` table or a `sim.body.World`."""

    @property
    def ground(self) -> str:
        """ "plane", "step", "pipe" or "none"."""

    @property
    def step_height_m(self) -> float:
        """Height of a step."""

    @property
    def step_distance_m(self) -> float:
        """y of its riser; it rises outwards."""


class OtherBody(pydantic.BaseModel):
    """A `[[body]]` table: one thing that the robot can run into, push, or climb on."""

    model_config = STRICT

    kind: Literal["box", "sphere", "cylinder"]
    name: str | None = Field(None, min_length=1, max_length=60, description='default: its kind and number, as "box-0"')
    size_m: tuple[float, float, float] | None = Field(None, description="box: its edges along x, y, z, in metres")
    radius_m: float | None = Field(None, description="sphere, cylinder: in metres")
    length_m: float | None = Field(None, description="cylinder: along its axis, in metres")
    axis: Literal["x", "y", "z"] = Field("z", description="cylinder: where its axis points, before heading_rad")
    mass_kg: float | None = Field(None, ge=0, le=1e5, description="in kilograms; 0: a fixed obstacle")
    fixed: bool = Field(False, description="true: an obstacle that nothing moves")
    position_m: tuple[float, ...] = Field(
        description="centre [x, y, z] in metres; [x, y]: standing on the floor there", min_length=2, max_length=3
    )
    heading_rad: float = Field(0.0, ge=-math.pi, le=math.pi, description="turned about the vertical, in radians")
    velocity_m_s: tuple[float, float, float] = Field((0.0, 0.0, 0.0), description="at the start, in metres per second")
    friction: float = Field(
        0.3, ge=0, le=10, description="Coulomb coefficient of the body on the floor and on the robot"
    )

    @pydantic.model_validator(mode="after")
    def _has_its_size(self) -> Self:
        needed = _SIZE_KEYS[self.kind]
        for key in ("size_m", "radius_m", "length_m"):
            value = getattr(self, key)
            if (value is None) == (key in needed):
                mend = "missing; add it" if value is None else f"remove it; a {self.kind} has {' and '.join(needed)}"
                raise ValueError(f"{key}: {mend}")
            for edge in () if value is None else value if isinstance(value, tuple) else (value,):
                if not _LEAST_SIZE_M <= edge <= _GREATEST_SIZE_M:
                    raise ValueError(
                        f"{key} = {edge:g}: a body measures {_LEAST_SIZE_M:g} … {_GREATEST_SIZE_M:g} m each way"
                    )
        if self.kind != "cylinder" and self.axis != "z":
            raise ValueError(f"axis: remove it; only a cylinder has one, this is a {self.kind}")
        return self

    @pydantic.model_validator(mode="after")
    def _has_a_plausible_mass(self) -> Self:
        if self.mass_kg is None and not self.fixed:
            raise ValueError("mass_kg: missing; add it, or fixed = true for an obstacle that nothing moves")
        if self.is_fixed:
            if any(self.velocity_m_s):
                raise ValueError("velocity_m_s: remove it, or give the body a mass; a fixed body does not move")
            return self
        density = self.kilograms / self.volume_m3
        if not _LEAST_DENSITY_KG_M3 <= density <= _GREATEST_DENSITY_KG_M3:
            raise ValueError(
                f"mass_kg = {self.kilograms:g}: {density:.3g} kg/m³ for its size, and things have "
                f"{_LEAST_DENSITY_KG_M3:g} … {_GREATEST_DENSITY_KG_M3:g}; check mass and size"
            )
        return self

    @pydantic.model_validator(mode="after")
    def _within_reach(self) -> Self:
        if any(abs(x) > _PLACE_LIMIT_M for x in self.position_m):
            raise ValueError(f"position_m = {list(self.position_m)}: each within ±{_PLACE_LIMIT_M:g} m")
        if math.hypot(*self.velocity_m_s) > _SPEED_LIMIT_M_S:
            raise ValueError(f"velocity_m_s = {list(self.velocity_m_s)}: at most {_SPEED_LIMIT_M_S:g} m/s")
        return self

    @property
    def is_fixed(self) -> bool:
        """Whether nothing moves it."""
        return self.fixed or self.mass_kg == 0.0

    @property
    def kilograms(self) -> float:
        """Its mass [kg]; 0 for a fixed one."""
        return 0.0 if self.is_fixed or self.mass_kg is None else self.mass_kg

    @property
    def code(self) -> int:
        """BOX, SPHERE or CYLINDER."""
        return _CODE[self.kind]

    @property
    def half_size_m(self) -> Vector:
        """Box: half its edges. Sphere: its radius, thrice. Cylinder: radius, radius, half its length."""
        if self.size_m is not None:
            return (0.5 * self.size_m[0], 0.5 * self.size_m[1], 0.5 * self.size_m[2])
        radius = self.radius_m or 0.0
        return (radius, radius, radius if self.length_m is None else 0.5 * self.length_m)

    @property
    def volume_m3(self) -> float:
        """Its volume."""
        a, b, c = self.half_size_m
        return {"box": 8.0, "sphere": 4.0 / 3.0 * math.pi, "cylinder": 2.0 * math.pi}[self.kind] * a * b * c

    @property
    def inertia_kg_m2(self) -> Vector:
        """Principal moments about the centre, body axes; of a uniform solid, zero for a fixed one."""
        a, b, c = self.half_size_m
        if self.kind == "box":
            third = self.kilograms / 3.0
            return (third * (b * b + c * c), third * (a * a + c * c), third * (a * a + b * b))
        if self.kind == "sphere":
            ball = 0.4 * self.kilograms * a * a
            return (ball, ball, ball)
        across = self.kilograms * (a * a / 4.0 + c * c / 3.0)
        return (across, across, 0.5 * self.kilograms * a * a)

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Orientation at the start (x, y, z, w)."""
        s = math.sqrt(0.5)
        x, y, w = {"z": (0.0, 0.0, 1.0), "x": (0.0, s, s), "y": (-s, 0.0, s)}[self.axis]
        sine, cosine = math.sin(0.5 * self.heading_rad), math.cos(0.5 * self.heading_rad)
        return (cosine * x - sine * y, cosine * y + sine * x, sine * w, cosine * w)

    @property
    def reach_m(self) -> Vector:
        """Half of the upright box about it, along x, y, z of the floor."""
        a, _, c = self.half_size_m
        if self.kind == "sphere":
            return (a, a, a)
        axes = [_turned(self.quaternion, unit) for unit in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
        if self.kind == "box":
            x, y, z = (sum(abs(e[k]) * h for e, h in zip(axes, self.half_size_m, strict=True)) for k in range(3))
            return (x, y, z)
        x, y, z = (abs(e) * c + a * math.sqrt(max(0.0, 1.0 - e * e)) for e in axes[2])
        return (x, y, z)

    def centre_m(self, ground: Ground) -> Vector:
        """Where its centre is at the start. Raises ValueError where [x, y] does not say how high."""
        x, y = self.position_m[:2]
        if len(self.position_m) == 3:
            return (x, y, self.position_m[2])
        if ground.ground in ("pipe", "none"):
            raise ValueError(f'write [x, y, z]; with world.ground = "{ground.ground}" there is no floor to stand on')
        return (x, y, self._highest_floor_m(ground) + self.reach_m[2])

    def distance_m(self, centre: Vector, point: Vector) -> float:
        """Distance of a point from its surface, negative inside, when its centre is there."""
        x, y, z, w = self.quaternion
        local = _turned((-x, -y, -z, w), (point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]))
        return signed_distance(self.code, *self.half_size_m, *local)[0]

    def _highest_floor_m(self, ground: Ground) -> float:
        """Of the floor under its outline; −inf where there is none."""
        if ground.ground == "plane":
            return 0.0
        if ground.ground != "step":
            return -math.inf  # a pipe is round: its engine knows
        outwards = math.copysign(1.0, ground.step_distance_m)
        beyond_m = outwards * (self.position_m[1] - ground.step_distance_m) + self.reach_m[1]
        return ground.step_height_m if beyond_m > _TOUCHING_M else 0.0


def names_of(bodies: Sequence[OtherBody]) -> list[str]:
    """A name for each: its own, or its kind and number."""
    return [body.name or f"{body.kind}-{index}" for index, body in enumerate(bodies)]


def check_bodies(bodies: Sequence[OtherBody], ground: Ground, length_m: float, radius_m: float) -> None:
    """Raise ValueError for bodies that share a name, sink into the floor, or start inside the robot.

    The robot starts straight along x, its middle over the origin, lying on the floor; `length_m` and `radius_m` are its
    own. (Bodies inside each other, or inside a pipe, are found by the engine.)
    """
    names = names_of(bodies)
    for index, body in enumerate(bodies):
        key = f"body.{index}.position_m = {list(body.position_m)}"
        if names.index(names[index]) != index:
            raise ValueError(f'body.{index}.name = "{names[index]}": body.{names.index(names[index])} has that name')
        try:
            centre = body.centre_m(ground)
        except ValueError as error:
            raise ValueError(f"{key}: {error}") from None
        floor_m, reach_m = body._highest_floor_m(ground), body.reach_m[2]
        if body.is_fixed and centre[2] + reach_m <= floor_m:
            raise ValueError(f"{key}: wholly below the floor, where nothing meets it; raise or remove it")
        if not body.is_fixed and centre[2] - reach_m < floor_m - _TOUCHING_M:
            raise ValueError(
                f"{key}: reaches {floor_m - centre[2] + reach_m:.3g} m below the floor; raise its centre to "
                f"{floor_m + reach_m:.6g}, or give [x, y] to stand it on the floor"
            )
        height_m = radius_m if ground.ground != "none" else 0.0
        gap_m = _least_distance_m(body, centre, 0.5 * length_m, height_m) - radius_m
        if gap_m < -_TOUCHING_M:
            raise ValueError(
                f"{key}: {names[index]} overlaps the robot, which starts straight along x over the origin; "
                f"move it away by {-gap_m:.3g} m or more"
            )


def _least_distance_m(body: OtherBody, centre: Vector, half_length_m: float, height_m: float) -> float:
    """From the robot's centre line; the distance from a convex body is convex along a line, so thirds find it."""
    low, high = -half_length_m, half_length_m
    for _ in range(60):
        third = (high - low) / 3.0
        first = body.distance_m(centre, (low + third, 0.0, height_m))
        second = body.distance_m(centre, (high - third, 0.0, height_m))
        low, high = (low, high - third) if first <= second else (low + third, high)
    return min(body.distance_m(centre, (x, 0.0, height_m)) for x in (low, high))


def signed_distance(
    code: int, a: float, b: float, c: float, x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    """Distance of a point (body axes) from the surface, negative inside, and the outward unit normal there.

    a, b, c: the body's half sizes. Written in plain numbers, so that it can be compiled as it stands.
    """
    if code == SPHERE:
        r = math.sqrt(x * x + y * y + z * z)
        if r == 0.0:
            return -a, 0.0, 0.0, 1.0
        return r - a, x / r, y / r, z / r
    if code == CYLINDER:
        r = math.sqrt(x * x + y * y)
        ux, uy = (x / r, y / r) if r > 0.0 else (1.0, 0.0)
        uz = 1.0 if z >= 0.0 else -1.0
        side, end = r - a, abs(z) - c
        if side <= 0.0 and end <= 0.0:
            if side > end:
                return side, ux, uy, 0.0
            return end, 0.0, 0.0, uz
        out, up = max(side, 0.0), max(end, 0.0)
        d = math.sqrt(out * out + up * up)
        return d, out / d * ux, out / d * uy, up / d * uz
    sx = 1.0 if x >= 0.0 else -1.0
    sy = 1.0 if y >= 0.0 else -1.0
    sz = 1.0 if z >= 0.0 else -1.0
    dx, dy, dz = abs(x) - a, abs(y) - b, abs(z) - c
    if dx <= 0.0 and dy <= 0.0 and dz <= 0.0:
        if dx >= dy and dx >= dz:
            return dx, sx, 0.0, 0.0
        if dy >= dz:
            return dy, 0.0, sy, 0.0
        return dz, 0.0, 0.0, sz
    ox, oy, oz = max(dx, 0.0), max(dy, 0.0), max(dz, 0.0)
    d = math.sqrt(ox * ox + oy * oy + oz * oz)
    return d, sx * ox / d, sy * oy / d, sz * oz / d


def _turned(quaternion: tuple[float, float, float, float], vector: Vector) -> Vector:
    """The vector turned by a unit quaternion (x, y, z, w): v + 2w(u × v) + 2u × (u × v)."""
    x, y, z, w = quaternion
    a, b, c = vector
    px, py, pz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return (a + w * px + y * pz - z * py, b + w * py + z * px - x * pz, c + w * pz + x * py - y * px)
