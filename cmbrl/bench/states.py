"""Scenes of the studies by label, and random states: near contact, penetrating, at joint limits, fast."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from cmbrl.bench.on_fields import lower, on_fields
from cmbrl.bench.peers.ours import scene_of
from cmbrl.registry import load_task
from cmbrl.scene import Scene
from cmbrl.scene.kinematics import addresses
from cmbrl.scene.records import JointKind

SCENES = ("hopper", "cheetah", "cube_toss", "g1")
_ROUNDS = 20  # of drawing configurations
_WIDE = 10.0  # rad, m: limits farther from the start are meant as none, and differences drown in round-off there
_LEVEL = 1e-3  # m of gap per m of a slide: less is a slide along the plane
# Of the G1's limbs [m]. Neighbours differ: equal capsules that meet in a joint have a ball in common, and two rigid
# contacts at one point are solved softer than asked for in 8 % of wild states.
_RADII = {
    "hip_pitch": 0.05, "hip_roll": 0.06, "hip_yaw": 0.055, "knee": 0.045,
    "shoulder_roll": 0.045, "shoulder_yaw": 0.04, "elbow": 0.035, "wrist_yaw": 0.03,
}  # fmt: skip
_SOLE = "0.035 0 -0.023"  # middle of a foot's box [m]: as low as the spheres, so that a foot stands on eight points


@dataclass(frozen=True)
class Ranges:
    """How far the random states spread."""

    gap: tuple[float, float] = (-0.005, 0.005)  #: of the lowest contact [m]
    speed: float = 1.0  #: largest [m/s, rad/s]
    at_limit: float = 0.2  #: share of joints at a limit
    spread: float = 0.3  #: of joints without limits, and of floating bases about the initial pose [m, rad]
    turn: float = 3.0  #: of free rotations of a scene without joint limits [rad]


WILD = Ranges(gap=(-0.05, 0.02), speed=20.0)


def bench_scene(label: str, contact_law: str = "mujoco") -> Scene:
    """One of ``SCENES``, as its MJCF describes it but for the contact law; "g1" is :func:`whole_body`."""
    return scene_of(whole_body() if label == "g1" else Path(load_task(label).scene_path), contact_law)


def whole_body() -> str:
    """The MJCF text of the task g1 whose floor is touched by all that the file only shows: limbs, trunk, head and feet.

    All of it has friction, since condim is the larger one of a pair's two and the floor's is 3.
    """
    robot = ElementTree.parse(load_task("g1").scene_path)
    for geom in robot.iterfind(".//default[@class='look']/geom"):
        geom.set("conaffinity", "1")
    for side, (link, radius) in product(("left", "right"), _RADII.items()):
        for geom in robot.iterfind(f".//body[@name='{side}_{link}_link']/geom[@type='capsule']"):
            geom.set("size", str(radius))
    for sole in robot.iterfind(".//geom[@type='box']"):
        sole.set("pos", _SOLE)
    return ElementTree.tostring(robot.getroot(), encoding="unicode")


def random_states(
    scene: Scene, count: int, rng: np.random.Generator, ranges: Ranges | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random q (count, nq), v (count, nv) and u (count, nu), with activations after it, in ``ranges``.

    Joints are uniform within their limits, as far as those are within 10 m or rad of the start, and some lie on a limit
    or up to 0.05 rad or m beyond it. Controls fill 1.5 times their range, so some are clamped. States differ in how
    fast they are. Links overlap as little as can be found.
    """
    ranges = ranges or Ranges()
    core = scene.core
    between_links = (core.con_plane < 0) & ~on_fields(scene)
    q, deeper, depth = np.empty((0, scene.nq)), np.empty((0, scene.nq)), np.empty(0)
    for _ in range(_ROUNDS):  # links may overlap no deeper than the robot may sink into the ground
        more = _configurations(scene, count, rng, ranges)
        between = scene.gaps(more)[:, between_links].min(axis=1, initial=np.inf)
        fine = between >= ranges.gap[0]
        q, deeper = np.concatenate([q, more[fine]]), np.concatenate([deeper, more[~fine]])
        depth = np.concatenate([depth, between[~fine]])
        if len(q) >= count:
            break
    q = np.concatenate([q, deeper[np.argsort(-depth)]])  # of a robot some of whose links always overlap
    v = ranges.speed * rng.random((count, 1)) * rng.uniform(-1, 1, (count, scene.nv))
    control = np.reshape(core.act_ctrl, (-1, 2))
    low, high = np.where(np.isfinite(control), control, [-1.0, 1.0]).T
    u = (low + high) / 2 + 0.75 * (high - low) * rng.uniform(-1, 1, (count, scene.nu))
    return q[:count], v, with_activations(scene, u, rng)


def with_activations(scene: Scene, u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Controls (count, nu) and random activations within their limits, or, where they have none, in [-1, 1]."""
    low, high = np.clip(np.reshape(scene.core.state_range, (-1, 2)), -1.0, 1.0).T
    return np.concatenate([u, rng.uniform(low, high, (len(u), len(low)))], axis=1)


def with_friction(scene: Scene, count: int, rng: np.random.Generator, highest: float = 10.0) -> np.ndarray:
    """Nominal parameters (count, np), but friction coefficients uniform in [0, highest], a tenth of them zero."""
    theta = np.tile(scene.parameter_vector(), (count, 1))
    columns = [k for k, p in enumerate(scene.parameters) if p.group == "friction"]
    friction = rng.uniform(0, highest, (count, len(columns)))
    theta[:, columns] = np.where(rng.random(friction.shape) < 0.1, 0.0, friction)
    return theta


def _configurations(scene: Scene, count: int, rng: np.random.Generator, ranges: Ranges) -> np.ndarray:
    core = scene.core
    loose = not core.nlimit and "rotation" in scene.coordinate_kinds
    width = np.where([kind == "rotation" and loose for kind in scene.coordinate_kinds], ranges.turn, ranges.spread)
    q = scene.integrate(np.tile(scene.q0, (count, 1)), width * rng.normal(size=(count, scene.nv)))
    places = addresses(core)
    for line, ball, low, high in zip(core.lim_line, core.lim_ball, core.lim_lo, core.lim_hi, strict=True):
        if line >= scene.nv or ball >= 0:
            continue  # a tendon: its length follows from its joints; or the angle of a ball joint
        start = scene.q0[places[line]]
        low, high = np.clip([low, high], min(high, start - _WIDE), max(low, start + _WIDE))
        inside, side = rng.uniform(low, high, count), rng.random(count) < 0.5
        beyond = rng.choice([0.0, 1.0], count) * rng.uniform(0, 0.05, count)
        at = np.where(side, low - beyond, high + beyond)
        q[:, places[line]] = np.where(rng.random(count) < ranges.at_limit, at, inside)
    _lower(scene, q, rng.uniform(*ranges.gap, count))
    return q


def _lower(scene: Scene, q: np.ndarray, gap: np.ndarray) -> None:
    """Moves the root, in place, along the slide that changes the gaps to planes most, to the lowest gap ``gap``.

    Where one changes them at all; of a scene with height fields, onto these.
    """
    planes = np.flatnonzero(scene.core.con_plane >= 0)
    roots = [j for j in scene.joints if j.kind == JointKind.SLIDE and scene.core.body_parent[j.body] < 0]
    if roots and on_fields(scene).any():
        steepest = max(roots, key=lambda joint: abs(joint.axis[-1]))
        lower(scene, q, steepest.qadr, gap)
        return
    if not len(planes) or not roots:
        return
    step, here = 1e-3, scene.gaps(scene.q0)[planes]
    slopes = []
    for joint in roots:
        moved = np.array(scene.q0)
        moved[joint.qadr] += step
        slopes.append(np.mean(scene.gaps(moved)[planes] - here) / step)
    best = int(np.argmax(np.abs(slopes)))
    if abs(slopes[best]) < _LEVEL:
        return  # none of them leads away from a plane: rails, a window
    q[:, roots[best].qadr] += (gap - scene.gaps(q)[:, planes].min(axis=1)) / slopes[best]
