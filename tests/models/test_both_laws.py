"""A model under both laws of sliding: each row moves, and has the derivative, of its own law."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

import cmbrl
from cmbrl.contact.smoothing import Exact, Relaxed
from cmbrl.errors import UserError
from cmbrl.mdp import MDP, never
from cmbrl.models.both_laws import under_both_laws
from cmbrl.models.native_step.stepper import SplitStepper
from cmbrl.models.protocol import failures
from cmbrl.train.shac import SHAC, SHACConfig

from ..train import slider

PUCK = """<mujoco><option timestep=".004" cone="elliptic"/><worldbody><geom type="plane" size="9 9 .1"/>
<body pos="0 0 .0499"><freejoint/><geom type="box" size=".2 .2 .05" mass="2"/><site name="s"/></body></worldbody>
<actuator><motor site="s" gear="40 0 0 0 0 0"/></actuator></mujoco>"""


@pytest.fixture
def puck() -> cmbrl.ComplementarityModel:
    return cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(PUCK), sliding="coulomb")


@pytest.mark.parametrize("share", [0.25, 1.0])
@pytest.mark.parametrize("given", [False, True])
def test_each_row_moves_under_its_law(puck: cmbrl.ComplementarityModel, share: float, given: bool) -> None:
    both = under_both_laws(puck, share)
    convex = puck.under_other_law()
    assert convex is not None
    q = torch.tensor([[0.0, 0, 0.0499, 1, 0, 0, 0]], dtype=torch.float64).repeat(4, 1)
    v = torch.tensor([[2.0, 0, 0, 0, 0, 0]], dtype=torch.float64).repeat(4, 1).requires_grad_()
    u = torch.ones(4, 1, dtype=torch.float64)
    theta = (torch.from_numpy(puck.parameters).repeat(4, 1),) if given else ()
    own = 4 - round(4 * share)
    found, alone = both.step(q, v, u, *theta)[1], [model.step(q, v, u, *theta)[1] for model in (puck, convex)]
    expected = torch.cat([alone[0][:own], alone[1][own:]])
    assert torch.equal(found, expected)
    assert not torch.equal(alone[0][0], alone[1][0])
    derivatives = [torch.autograd.grad(x[:, 2].sum(), v, retain_graph=True)[0] for x in (found, expected)]
    assert torch.equal(*derivatives)
    assert failures(both) == 0


def test_the_other_law_may_be_mujocos(puck: cmbrl.ComplementarityModel) -> None:
    """What looks ahead meets rows that act once they are closed; what does so already, the other law of sliding."""
    theirs = puck.under_other_law("mujoco")
    assert theirs is not None
    assert (puck.look_ahead, theirs.sliding, theirs.look_ahead) == (True, "convex", False)
    back = theirs.under_other_law("mujoco")
    assert back is not None
    assert (back.sliding, back.look_ahead) == ("coulomb", False)
    falls = torch.tensor([[0.0, 0, 0.0503, 1, 0, 0, 0]], dtype=torch.float64)
    v = torch.tensor([[0.0, 0, -0.1, 0, 0, 0]], dtype=torch.float64).repeat(2, 1)
    found = under_both_laws(puck, 0.5, "mujoco").step(falls.repeat(2, 1), v, torch.zeros(2, 1, dtype=torch.float64))[1]
    free = -0.1 - 9.81 * 0.004
    assert found[1, 2].item() == pytest.approx(free)  # it would close within this step
    assert found[0, 2].item() > free + 1e-3
    with pytest.raises(UserError, match=r"unknown law .mojoco.: did you mean .mujoco."):
        under_both_laws(puck, 0.5, "mojoco")  # type: ignore[arg-type]


def test_the_other_law_may_be_the_step_of_the_file(puck: cmbrl.ComplementarityModel) -> None:
    """MuJoCo's, in as many of its steps as a longer one takes, with the derivative of the model that is trained on."""
    long = puck.with_settings(substeps=1, time_step=0.02, smoothing=Relaxed(1e-3))
    theirs = long.under_other_law("file")
    assert theirs is not None
    assert (theirs.smoothing, theirs.backward_smoothing) == (Exact(), Relaxed(1e-3))
    robot = mujoco.MjModel.from_xml_string(PUCK)
    data = mujoco.MjData(robot)
    data.qvel[:2], data.ctrl[0] = (0.5, 0.2), 0.7
    q = theirs.predict(data.qpos[None].copy(), data.qvel[None].copy(), data.ctrl[None].copy()).q_next
    for _ in range(5):
        mujoco.mj_step(robot, data)
    np.testing.assert_allclose(q[0], data.qpos, atol=1e-6)
    exact = long.in_steps_of_file()
    assert exact is not None
    assert exact.in_steps_of_file() is None  # it takes them already, and is left the other law of sliding
    back = exact.under_other_law("file")
    assert back is not None
    assert (back.sliding, back.substeps) == ("coulomb", 5)
    uneven = puck.with_settings(substeps=1, time_step=0.021).under_other_law("file")  # no whole number of the file's
    assert uneven is not None
    assert (uneven.sliding, uneven.look_ahead) == ("convex", False)


def test_steps_that_soften_the_files_contacts_meet_its_own() -> None:
    """Time constants stay above two steps: 2 ms is 2 ms in steps of the file, and 8 ms in steps of 4 ms."""

    def other(solref: str, step: float = 0.004, file: str = PUCK) -> tuple[float, str, bool]:
        text = file.replace('timestep=".004"', 'timestep=".001"').replace("<geom ", f'<geom solref="{solref}" ')
        scene = cmbrl.Scene.from_mjcf(text)
        model = cmbrl.ComplementarityModel(scene, sliding="coulomb", time_step=step, substeps=round(0.02 / step))
        found = model.under_other_law("auto")
        assert found is not None
        return found.time_step, found.sliding, found.look_ahead

    assert other(".002 1") == other(".0005 1") == (0.001, "convex", False)
    assert other(".008 1") == (0.004, "convex", True)
    assert other(".0005 1", 0.001) == (0.001, "convex", True)  # as soft as in the file
    assert other("-1e5 -1e2") == (0.004, "convex", True)  # a stiffness, which no step changes
    unsafe = PUCK.replace('"elliptic"/>', '"elliptic"><flag refsafe="disable"/></option>')
    assert other(".002 1", file=unsafe) == (0.004, "convex", True)


def test_a_model_without_sliding_or_without_a_law_stays(puck: cmbrl.ComplementarityModel, tmp_path: Path) -> None:
    smooth = cmbrl.ComplementarityModel(slider.scene(tmp_path))
    assert under_both_laws(smooth, 0.5) is smooth
    assert under_both_laws(puck, 0.0) is puck

    class Learned:
        name, dt = "learned", 0.02

        def step(self, q: torch.Tensor, v: torch.Tensor, u: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
            return q, v

    learned = Learned()
    assert under_both_laws(learned, 0.5) is learned


def test_training_runs_under_both_and_trials_under_the_model_alone(puck: cmbrl.ComplementarityModel) -> None:
    config = SHACConfig(iterations=2, environments=4, horizon=2, other_law=0.5, actor_hidden=(4,), critic_hidden=(4,))
    trainer = SHAC(puck_process(), puck, config)
    assert isinstance(trainer.simulation.model, cmbrl.ComplementarityModel)
    assert isinstance(trainer.simulation.model.stepper, SplitStepper)
    assert trainer.model is puck
    assert trainer.update()["failures"] == 0


def puck_process() -> MDP:
    at_rest = torch.tensor([[0.0, 0, 0.0499, 1, 0, 0, 0]], dtype=torch.float64)
    return MDP(
        observations=6, actions=1, observe=lambda q, v: v, terminated=never, dt=0.004, episode_steps=25,
        reward=lambda q, v, action, q_next, v_next: v_next[:, 0],
        reset=lambda count, generator: (at_rest.repeat(count, 1), torch.zeros(count, 6, dtype=torch.float64)),
    )  # fmt: skip
