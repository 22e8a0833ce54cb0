"""Scenes from short MJCF texts, MuJoCo's own model of the same text, and random trees."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.bench.check_steps import mujocos
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.source.mjcf import act_addresses
from cmbrl.scene.source.robot_source import quiet

GYMNASIUM = sorted((Path(pytest.importorskip("gymnasium").__file__).parent / "envs/mujoco/assets").glob("*.xml"))
Load = Callable[..., tuple[Scene, mujoco.MjModel]]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """``load("<body>...</body>", rest="<actuator/>")``: the scene and MuJoCo's model of that worldbody."""

    def make(
        world: str, rest: str = "", ignore: Iterable[str] = (), contact_law: str = "mujoco"
    ) -> tuple[Scene, mujoco.MjModel]:
        file = tmp_path / "scene.xml"
        file.write_text(f"<mujoco><worldbody>{world}</worldbody>{rest}</mujoco>", encoding="utf-8")
        return Scene.from_mjcf(file, ignore, contact_law), mujoco.MjModel.from_xml_path(str(file))

    return make


def worst_step(scene: Scene, model: mujoco.MjModel, spread: float = 0.0, states: int = 12) -> float:
    """The largest error of a velocity after one step of MuJoCo's law, relative to the largest change of one.

    At the pose of the file, give or take ``spread`` [m, rad], with random velocities and controls.
    """
    model.opt.tolerance, model.opt.iterations = 0.0, 200
    rng, data = np.random.default_rng(0), mujoco.MjData(model)
    v, u = rng.normal(size=(states, scene.nv)), rng.uniform(-1, 1, (states, scene.inputs))
    q = scene.integrate(np.tile(scene.q0, (states, 1)), spread * rng.normal(size=v.shape))
    theirs = np.zeros_like(v)
    for k in range(states):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q[k], v[k], u[k, : scene.nu]
        data.act[act_addresses(model, scene.core.state_act)] = u[k, scene.nu :]
        with quiet():
            mujoco.mj_step(model, data)
        theirs[k] = data.qvel
    ours = ComplementarityModel(scene, **mujocos(scene)).predict(q, v, u).v_next
    return float(np.abs(ours - theirs).max() / np.abs(theirs - v).max())


@pytest.fixture(params=["hopper", "half_cheetah", "walker2d_v5", "humanoid"])
def robot(request: pytest.FixtureRequest) -> tuple[Scene, mujoco.MjModel]:
    """A robot of gymnasium and MuJoCo's model of it."""
    file = next(file for file in GYMNASIUM if file.stem == request.param)
    return Scene.from_mjcf(file, self_contact="all"), mujoco.MjModel.from_xml_path(str(file))


def random_tree(seed: int, bodies: int = 8, turn: str = "", planar: bool = False) -> str:
    """A worldbody with random joints, offsets and inertias; some bodies have no joint, some have two.

    ``planar``: only slides and hinges that move in one plane, x-y of a frame that ``turn`` (a quaternion) rotates.
    """
    rng = np.random.default_rng(seed)

    def words(values: Iterable[float]) -> str:
        return " ".join(f"{x:.17g}" for x in values)

    def joints(body: int, root: bool) -> str:
        kinds = ["hinge", "slide"] if planar else ["hinge", "slide", "ball"]
        if root and not planar:
            kinds.append("free")
        out = ""
        for number in range(1 if root else int(rng.integers(0, 3))):
            kind = str(rng.choice(kinds))
            if kind == "free":
                return f'<freejoint name="j{body}"/>'
            axis = rng.normal(size=3)
            if planar:
                axis = [0, 0, rng.choice([-1, 1])] if kind == "hinge" else [*axis[:2], 0]
            where = rng.normal(size=3) * 0.1 if kind != "slide" else np.zeros(3)
            extra = "" if kind == "ball" else f'ref="{rng.normal() * 0.3:.3f}" axis="{words(axis)}"'
            out += f'<joint name="j{body}_{number}" type="{kind}" pos="{words(where)}" armature="0.01" {extra}/>'
            if kind == "ball":
                break
        return out

    def body(number: int) -> str:
        children = [k for k in range(number + 1, bodies) if parents[k] == number]
        quat = rng.normal(size=4)
        if planar:
            quat[1:3] = 0
        inner = rng.normal(size=4)
        return (
            f'<body name="b{number}" pos="{words(rng.normal(size=3) * 0.3)}" quat="{words(quat)}">'
            f'<inertial pos="{words(rng.normal(size=3) * 0.1)}" quat="{words(inner)}" mass="{rng.uniform(0.2, 2)}" '
            f'diaginertia="{words(rng.uniform(0.02, 0.03, 3))}"/>'
            f"{joints(number, parents[number] < 0)}{''.join(body(k) for k in children)}</body>"
        )

    parents = [-1] + [int(rng.integers(-1, k)) for k in range(1, bodies)]
    trees = "".join(body(k) for k in range(bodies) if parents[k] < 0)
    return f'<body name="base" quat="{turn}">{trees}</body>' if turn else trees
