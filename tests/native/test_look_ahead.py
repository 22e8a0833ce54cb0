"""Rows that do not look ahead act as MuJoCo's do: once closed, and meshes with the corners of a side."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from cmbrl.bench.check_steps import visit
from cmbrl.bench.states import WILD, Ranges, random_states
from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier, Exact, Gaussian
from cmbrl.contact.smoothing import Smoothing
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

from .test_adjoint import mismatch_at

OPTION = (
    '<option timestep=".002" integrator="implicitfast" cone="elliptic" tolerance="1e-14" iterations="300" '
    'ls_tolerance="1e-14" ls_iterations="100"/>'
)
FLOOR = '<geom name="floor" type="plane" size="3 3 .1"/>'
# Motors drive joints through their limits in a step, and servos overshoot 200 times.
HAND = f"""<mujoco>{OPTION}<worldbody>{FLOOR}<body name="palm" pos="0 0 .3"><joint name="palm" axis="0 1 0" damping="20"
range="-20 20"/><geom type="capsule" size=".02" fromto="0 0 0 .1 0 0" mass=".1"/>
<body name="finger" pos=".1 0 0"><joint name="finger" axis="0 1 0" range="-10 10" frictionloss=".002" armature="1e-3"/>
<geom type="capsule" size=".01" fromto="0 0 0 .06 0 0" mass=".02" contype="0" conaffinity="0"/></body></body>
<body name="ball" pos="0 .5 .05"><freejoint/><geom size=".04" mass=".1"/></body></worldbody>
<tendon><fixed name="t" range="-.3 .3"><joint joint="palm" coef="1"/><joint joint="finger" coef="1"/></fixed></tendon>
<actuator><position joint="palm" kp="40" kv="4"/><motor joint="finger" gear="2"/></actuator></mujoco>"""


def polygon(corners: int, height: float = 0.05) -> str:
    """Vertices of a prism on an irregular polygon, which no rounding decides on."""
    angles = 2 * np.pi * (np.arange(corners) + 0.3 * np.sin(3.0 * np.arange(corners))) / corners
    around = 0.06 * np.column_stack([np.cos(angles), 0.7 * np.sin(angles)])
    points = [[*point, z] for z in (0, height) for point in around]
    return " ".join(f"{x:.6f}" for point in points for x in point)


def stone(corners: int) -> str:
    option = OPTION.replace("implicitfast", "Euler")  # the other one takes gyroscopic forces of a free body implicitly
    return f"""<mujoco>{option}<asset><mesh name="stone" vertex="{polygon(corners)}"/></asset><worldbody>{FLOOR}
<body name="stone" pos="0 0 .05"><freejoint/><geom name="stone" type="mesh" mesh="stone"/></body>
</worldbody></mujoco>"""


def thrown(text: str, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, v and the next v of a stone that MuJoCo throws on the floor, again and again, where it touches."""
    model, rng, rows = mujoco.MjModel.from_xml_string(text), np.random.default_rng(0), []
    data = mujoco.MjData(model)
    while len(rows) < count:
        mujoco.mj_resetData(model, data)
        data.qpos[3:7] = rng.normal(size=4)
        data.qvel[:] = rng.normal(size=6) * np.repeat([0.5, 5.0], 3)
        for k in range(300):
            before = data.qpos.copy(), data.qvel.copy()
            mujoco.mj_step(model, data)
            if data.ncon and k % 10 == 0:
                rows.append((*before, data.qvel.copy()))
    q, v, expected = (np.array(column[:count]) for column in zip(*rows, strict=True))
    return q, v, expected


def relative(found: np.ndarray, expected: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Errors (B,) by the change of velocity, or by 1 cm/s where it is less: some stones rest."""
    change = np.linalg.norm(expected - v, axis=1)
    return np.asarray(np.linalg.norm(found - expected, axis=1) / np.maximum(change, 0.01))


def test_limits_and_contacts_act_once_closed_as_mujocos() -> None:
    scene, theirs = Scene.from_mjcf(HAND), mujoco.MjModel.from_xml_string(HAND)
    states = visit(scene, theirs, theirs.qpos0, 200, np.random.default_rng(0))
    data, expected = mujoco.MjData(theirs), np.empty_like(states.v)
    for k, (q, v, u) in enumerate(zip(states.q, states.v, states.u, strict=True)):
        mujoco.mj_resetData(theirs, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, u
        mujoco.mj_step(theirs, data)
        expected[k] = data.qvel
    errors = {}
    for ahead in (False, True):
        model = ComplementarityModel(scene, sliding="convex", look_ahead=ahead, damping="split", smoothing=Exact(1e-9))
        found = model.predict(states.q, states.v, states.u).v_next
        errors[ahead] = float(relative(found, expected, states.v).max())
    assert errors[False] < 1e-5, errors
    assert errors[True] > 0.1, errors


@pytest.mark.parametrize("corners", [3, 4, 5, 6, 9, 14])
def test_a_mesh_touches_a_plane_with_mujocos_corners(corners: int) -> None:
    """On its sides, on its rim and flat, where a side has more corners than touch."""
    text = stone(corners)
    q, v, expected = thrown(text, 150)
    model = ComplementarityModel(Scene.from_mjcf(text), sliding="convex", smoothing=Exact(1e-9))
    errors = relative(model.predict(q, v, np.zeros((len(q), 0))).v_next, expected, v)
    assert np.mean(errors < 1e-3) > 0.97, np.sort(errors)[-10:]
    assert np.median(errors) < 1e-4


@pytest.mark.parametrize("smoothing", [Barrier(1e-4), Gaussian(length=0.01, floor=1e-6)])
@pytest.mark.parametrize("text", [HAND, stone(5), stone(9)], ids=["hand", "5", "9"])
def test_derivatives_are_those_of_the_step(text: str, smoothing: Smoothing) -> None:
    """Columns of state, control and parameters against differences, over three substeps too; and their transpose."""
    scene = Scene.from_mjcf(text)
    for substeps, sliding in ((1, "convex"), (3, "coulomb")):
        model = ComplementarityModel(
            scene, substeps, smoothing=smoothing, path_tolerance=1e-12, sliding=sliding, look_ahead=False
        )
        q, v, u = random_states(scene, 6, np.random.default_rng(1), Ranges(gap=(-0.006, -0.001), speed=1.0))
        row = compare(model, q, v, u, 60)
        assert row["median"] <= 1e-6, row
        assert row["worst"] <= 1e-4, row
        assert row["across_kinks"] + row["vague"] <= 0.2 * row["columns"], row
        assert mismatch_at(model, q, v, u, np.random.default_rng(2)) < 1e-9


def test_wild_states_are_solved_under_damping_that_overshoots() -> None:
    scene = Scene.from_mjcf(HAND)
    model = ComplementarityModel(scene)
    assert (model.damping, model.look_ahead) == ("split", False)
    result = model.predict(*random_states(scene, 2000, np.random.default_rng(3), WILD))
    assert np.isfinite(result.v_next).all()
    assert not np.any(result.status == SolverStatus.FAILED)


def test_what_is_near_and_open_is_no_row() -> None:
    """Neither in the solve nor among the rows that a caller sees; closed rows are the same as those that look ahead."""
    scene = Scene.from_mjcf(stone(4))
    q = np.array([[0, 0, 5e-4, 1, 0, 0, 0], [0, 0, -5e-4, 1, 0, 0, 0]], dtype=float)
    v, u = np.tile([0, 0, -2.0, 0, 0, 0], (2, 1)), np.zeros((2, 0))
    rows = {ahead: ComplementarityModel(scene, look_ahead=ahead).contact_problems(q, v, u) for ahead in (True, False)}
    assert [len(problem.mu) for problem in rows[True]] == [4, 4]
    assert [len(problem.mu) for problem in rows[False]] == [0, 4]


def test_the_default_follows_the_law_and_the_damping(tmp_path: Path) -> None:
    """A saved model keeps its choice, and one of an older version looks ahead."""
    hand, weak = Scene.from_mjcf(HAND), Scene.from_mjcf(stone(4))
    chosen = {
        (name, sliding): ComplementarityModel(scene, sliding=sliding).look_ahead
        for name, scene in (("hand", hand), ("weak", weak))
        for sliding in ("coulomb", "convex")
    }
    assert chosen == {
        ("hand", "coulomb"): False, ("hand", "convex"): False, ("weak", "coulomb"): True, ("weak", "convex"): False,
    }  # fmt: skip
    model = ComplementarityModel(hand)
    assert ComplementarityModel(hand, look_ahead=True).damping == "coupled"
    assert ComplementarityModel(hand, damping="coupled").look_ahead
    assert model.with_settings(time_step=0.01).look_ahead
    assert not ComplementarityModel.from_config(hand, model.to_config()).look_ahead
    old = {name: value for name, value in model.to_config().items() if name != "look_ahead"}
    assert ComplementarityModel.from_config(hand, old).look_ahead
    rivals = ComplementarityModel(weak).rivals()
    assert rivals["convex"].look_ahead  # of a fit: the law of sliding alone, and MuJoCo's step as a whole
    assert not rivals["mujoco"].look_ahead
    with pytest.raises(UserError, match="look_ahead"):
        ComplementarityModel(Scene.from_mjcf(HAND, contact_law="rigid"), look_ahead=False)
