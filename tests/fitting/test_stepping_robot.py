"""A robot on four feet, whose contacts make and break: searches that single windows stop, and one that goes on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.data.transitions import Transitions
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.survey import Surveyor
from cmbrl.fitting.search.gauss_newton import reweighed
from cmbrl.fitting.search.loss import PredictionLoss
from cmbrl.fitting.state import Journal
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

LEG = """<body name="leg{k}" pos="{x} {y} -.05">
<joint name="lift{k}" type="slide" axis="0 0 1" range="-.05 .05" damping="2" armature=".1"/>
<joint name="swing{k}" axis="0 1 0" damping=".2" armature=".01"/>
<geom type="capsule" fromto="0 0 0 0 0 -.1" size=".01" mass=".2" contype="0" conaffinity="0"/>
<geom name="foot{k}" type="sphere" pos="0 0 -.1" size=".02" mass=".1" friction=".7"/></body>"""
SERVOS = """<position joint="lift{k}" kp="800" kv="20"/><position joint="swing{k}" kp="20" kv="1"/>"""
PLACES = [(0.12, 0.1), (0.12, -0.1), (-0.12, 0.1), (-0.12, -0.1)]
ROBOT = f"""<mujoco><option timestep=".005"/><worldbody><geom type="plane" size="5 5 1"/>
<body name="trunk" pos="0 0 .2"><freejoint/>
<geom type="box" size=".15 .1 .05" mass="3" contype="0" conaffinity="0"/>
{"".join(LEG.format(k=k, x=x, y=y) for k, (x, y) in enumerate(PLACES))}</body></worldbody>
<actuator>{"".join(SERVOS.format(k=k) for k in range(4))}</actuator></mujoco>"""
CHANGED = ("mass", "kp", "kd", "damping", "armature", "friction")


@pytest.fixture(scope="module")
def stepping(tmp_path_factory: pytest.TempPathFactory) -> tuple[Evidence, np.ndarray]:
    """Evidence under MuJoCo's step, from a log of another robot that steps so; and that robot's parameters."""
    file: Path = tmp_path_factory.mktemp("stepping") / "robot.xml"
    file.write_text(ROBOT)
    model = ComplementarityModel(Scene.from_mjcf(file), substeps=4).rivals()["mujoco"]
    draw = np.random.default_rng(0)
    theta = model.scene.parameter_vector().copy()
    for k, parameter in enumerate(model.scene.parameters):
        if parameter.group in CHANGED:
            theta[k] *= np.exp(0.4 * draw.standard_normal())
    count, steps = 8, 60
    standing = np.array([0.0, 0.0, 0.2, 1.0, *np.zeros(11)])
    q, v = np.tile(standing, (count, 1)), np.zeros((count, model.scene.nv))
    phase, rate = draw.uniform(0, 2 * np.pi, (count, 8)), draw.uniform(4, 12, (count, 8))
    rows: dict[str, list[np.ndarray]] = {name: [] for name in ("q", "v", "u", "q_next", "v_next")}
    for k in range(steps):
        u = np.tile([0.04, 0.35], 4) * np.sin(rate * k * model.dt + phase)
        step = model.predict(q, v, u, theta)
        for name, value in zip(rows, (q, v, u, step.q_next, step.v_next), strict=True):
            rows[name].append(value)
        q, v = step.q_next, step.v_next
    log = {name: np.stack(parts, axis=1).reshape(count * steps, -1) for name, parts in rows.items()}
    transitions = Transitions(**log, dt=model.dt, episode=np.repeat(np.arange(count), steps))
    evidence = Evidence.of(model, transitions)
    return evidence, np.append(theta, evidence.space.nominal[len(theta) :])


def loss_of(evidence: Evidence) -> PredictionLoss:
    starts = evidence.log.windows(1)
    return evidence.loss(starts, 1, *evidence.scales(1, 3.0))


def test_windows_whose_contacts_change_stop_a_plain_search_and_not_a_survey(
    stepping: tuple[Evidence, np.ndarray],
) -> None:
    """By the tolerant loss, a survey goes on to where all windows come right."""
    evidence, truth = stepping
    loss, space = loss_of(evidence), evidence.space
    assert loss.errors(truth).mean < 1e-20
    start, journal = np.zeros(len(space)), Journal(None, "")
    plain = reweighed(loss, space, space.default, start, 8, journal, passes=12)
    assert loss.errors(space.theta(plain)).mean > 0.01
    found = Surveyor(evidence, space.default, start, 3.0, 4, 0, 400, 8, journal).fitted_to(1)
    assert loss.errors(space.theta(found)).mean < 1e-6
    feet = np.isin(space.groups, ["friction"])
    np.testing.assert_allclose(space.theta(found)[feet], truth[feet], rtol=0.05)
