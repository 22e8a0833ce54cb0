"""Two bodies that touch: every kind of pair that the core models, and states in which a chosen feature touches."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cmbrl.scene import Scene
from cmbrl.scene.manifold import quaternion_matrix

SPHERE = 'type="sphere" size=".1"'
BALL = 'type="sphere" size=".04"'
CAPSULE = 'type="capsule" size=".06 .2"'
LONG = 'type="capsule" size=".05 .5"'
BOX = 'type="box" size=".3 .2 .25"'
BRICK = 'type="box" size=".1 .12 .15"'
ROUNDED = '<custom><numeric name="rounding:b" data=".05"/></custom>'
FREE = "<freejoint/>"
PLANAR = (
    '<joint type="slide" axis="1 0 0" damping=".5"/><joint type="slide" axis="0 0 1"/>'
    '<joint name="turn_{}" type="hinge" axis="0 1 0"/>'
)
MOTORS = '<actuator><motor joint="turn_a" gear="3"/><motor joint="turn_b" gear="2"/></actuator>'


@dataclass(frozen=True)
class Pair:
    """Geoms A and B, and where A's centre lies as seen from B's: box (3,) half sizes of the region it is drawn from.

    From there A is moved ``along`` a line of B's frame until the gap is right; without one, along the line between the
    centres, in any direction. ``align``: A's z axis in B's frame; without it A turns at random. ``inside``: A's centre
    stays where it was drawn. ``rest``: more MJCF.
    """

    a: str
    b: str
    where: tuple[float, float, float] = (1.0, 1.0, 1.0)
    along: tuple[float, float, float] | None = None
    align: tuple[float, float, float] | None = None
    inside: bool = False
    rest: str = ""


SPATIAL = {
    "sphere-sphere": Pair(SPHERE, SPHERE),
    "sphere-capsule side": Pair(SPHERE, CAPSULE, (0, 0, 0.15), along=(0.8, 0.6, 0.0)),
    "sphere-capsule end": Pair(SPHERE, CAPSULE, (0.02, 0.02, 0.0), along=(0.1, 0.1, 1.0)),
    "capsule-capsule crossing": Pair(LONG, LONG, (0, 0.1, 0.1), along=(1.0, 0.0, 0.0), align=(0.1, 1.0, 0.3)),
    "capsule-capsule end on side": Pair(CAPSULE, LONG, (0, 0.0, 0.1), along=(1.0, 0.2, 0.0), align=(1.0, 0.3, 0.2)),
    "capsule-capsule ends": Pair(CAPSULE, CAPSULE, (0.02, 0.02, 0.0), along=(0.1, 0.2, 1.0), align=(0.3, 0.2, 1.0)),
    "capsule-capsule any": Pair(CAPSULE, CAPSULE),
    "sphere-box face": Pair(SPHERE, BOX, (0.2, 0.1, 0.0), along=(0.0, 0.0, 1.0)),
    "sphere-box edge": Pair(SPHERE, BOX, (0.0, 0.1, 0.0), along=(0.77, 0.0, 0.64)),
    "sphere-box corner": Pair(SPHERE, BOX, (0.02, 0.02, 0.02), along=(0.68, 0.45, 0.57)),
    "sphere-box any": Pair(SPHERE, BOX),
    "sphere-box inside": Pair(BALL, BOX, (0.28, 0.19, 0.23), inside=True),
    "sphere-rounded box": Pair(SPHERE, BOX, rest=ROUNDED),
    "corner-box": Pair(BRICK, BOX, (0.1, 0.05, 0.0), along=(0.0, 0.0, 1.0), align=(0.6, 0.5, 0.7)),
    "corner-rounded box": Pair(
        BRICK, BOX, (0.1, 0.05, 0.0), along=(0.0, 0.0, 1.0), align=(0.6, 0.5, 0.7), rest=ROUNDED
    ),
    "capsule end-box": Pair(CAPSULE, BOX, (0.1, 0.05, 0.0), along=(0.0, 0.0, 1.0), align=(0.3, 0.2, 1.0)),
    "capsule side-box edge": Pair(LONG, BOX, (0.0, 0.05, 0.0), along=(0.77, 0.0, 0.64), align=(0.3, 1.0, -0.3)),
}
PLANE = {
    "disc-disc": Pair(SPHERE, SPHERE),
    "disc-bar": Pair(SPHERE, CAPSULE),
    "bar-bar": Pair(CAPSULE, CAPSULE),
    "disc-block": Pair(SPHERE, BOX),
    "corner-block": Pair(BRICK, BOX),
    "bar-block": Pair(CAPSULE, BOX),
    "disc-block inside": Pair(BALL, BOX, (0.28, 0.0, 0.23), inside=True),
}


def scene_of(pair: Pair, folder: Path, law: str, planar: bool = False, fixed: bool = False) -> Scene:
    """Both bodies float without gravity's help; ``fixed``: B is part of the world."""

    def body(name: str, geom: str, where: str, free: bool) -> str:
        turned = 'zaxis="1 0 0.2"' if planar and "capsule" in geom else ""
        joints = PLANAR.format(name) if planar else FREE
        look = f'<geom name="{name}" {geom} {turned} mass="1.3" friction=".6" solimp=".8 .95 .003 .4 3"/>'
        inertia = f'<geom {geom} {turned} mass=".7" pos=".03 .0 .02" contype="0" conaffinity="0"/>'
        return f'<body name="{name}" pos="{where}">{joints if free else ""}{look}{inertia}</body>'

    file, motors = folder / "pair.xml", MOTORS if planar else ""
    bodies = body("b", pair.b, "0 0 0", not fixed) + body("a", pair.a, "2 0 0", True)
    file.write_text(f"<mujoco>{pair.rest}<worldbody>{bodies}</worldbody>{motors}</mujoco>", encoding="utf-8")
    scene = Scene.from_mjcf(file, contact_law=law)
    assert scene.planar == planar
    return scene


def states(
    scene: Scene, pair: Pair, count: int, rng: np.random.Generator, gap: tuple[float, float] = (-2e-3, 1e-3)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q (count, nq), v (count, nv), u (count, nu) with the gap of the pair in the range, or A's centre inside B."""
    q = np.tile(scene.q0, (count, 1))
    for row in q:
        place = (rng.uniform(-1, 1, 3) * pair.where) if pair.along else _direction(rng)
        along = np.array(pair.along) if pair.along else place
        if pair.inside:
            place, along = rng.uniform(-1, 1, 3) * pair.where, np.zeros(3)
        _place(scene, row, pair, place, along, rng, rng.uniform(*gap))
    return q, rng.uniform(-1, 1, (count, scene.nv)), rng.uniform(-1, 1, (count, scene.nu))


def _direction(rng: np.random.Generator) -> np.ndarray:
    x = rng.normal(size=3)
    return x / np.linalg.norm(x)


def _place(
    scene: Scene, q: np.ndarray, pair: Pair, place: np.ndarray, along: np.ndarray, rng: np.random.Generator, gap: float
) -> None:
    """Turns both bodies at random, A perhaps as told, and moves A away along a line until the gap is right."""
    if scene.planar:
        _place_in_plane(scene, q, pair, place, along, rng, gap)
        return
    fixed = scene.nv == 6
    turn_b = np.array([1.0, 0, 0, 0]) if fixed else _unit(rng.normal(size=4))
    turn_a = _unit(rng.normal(size=4))
    if pair.align:
        turn_a = _product(turn_b, _onto(np.array(pair.align)))
    origin = np.zeros(3)
    if not fixed:
        origin = rng.uniform(-1, 1, 3)
        q[:7] = [*origin, *turn_b]
    a = q[-7:]
    a[3:] = turn_a
    R = quaternion_matrix(turn_b)

    def moved(distance: float) -> float:
        a[:3] = origin + R @ (place * (pair.along is not None or pair.inside) + distance * along)
        return float(scene.gaps(q).min())

    moved(0.0 if pair.inside else _bisect(moved, gap))


def _place_in_plane(
    scene: Scene, q: np.ndarray, pair: Pair, place: np.ndarray, along: np.ndarray, rng: np.random.Generator, gap: float
) -> None:
    if scene.nv == 6:
        q[:3] = rng.uniform(-1, 1, 3)
    angle = -q[2] if scene.nv == 6 else 0.0  # a hinge about y turns x towards -z
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    origin = q[:2].copy() if scene.nv == 6 else np.zeros(2)
    a, first = q[-3:], np.array([2.0, 0.0])  # of A's frame at q = 0
    a[2] = rng.uniform(-3, 3)
    flat, line = place[[0, 2]], along[[0, 2]] / max(1e-9, float(np.linalg.norm(along[[0, 2]])))

    def moved(distance: float) -> float:
        a[:2] = origin + R @ (flat * pair.inside + distance * line) - first
        return float(scene.gaps(q).min())

    moved(0.0 if pair.inside else _bisect(moved, gap))


def _bisect(moved: object, gap: float) -> float:
    low, high = 0.0, 3.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if moved(middle) < gap else (low, middle)  # type: ignore[operator]
    return 0.5 * (low + high)


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.linalg.norm(x)


def _product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    w, x = p[0], p[1:]
    return np.array([w * q[0] - x @ q[1:], *(w * q[1:] + q[0] * x + np.cross(x, q[1:]))])


def _onto(axis: np.ndarray) -> np.ndarray:
    """A quaternion that turns z onto a direction."""
    axis = _unit(axis)
    return _unit(np.array([1 + axis[2], -axis[1], axis[0], 0.0]))
