"""Memory: results are whole, blocks are reused and let go, and a lack of memory is an error."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from cmbrl.bench.states import Ranges, random_states
from cmbrl.contact import Barrier
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import kept_buffers
from cmbrl.scene import Scene

from ..scene.conftest import GYMNASIUM

HOPPER = next(file for file in GYMNASIUM if file.stem == "hopper")


@pytest.fixture
def model() -> ComplementarityModel:
    return ComplementarityModel(Scene.from_mjcf(HOPPER), 2, smoothing=Barrier(1e-3), backward_smoothing=Barrier(1e-2))


def test_tape_jacobian_and_impulse_of_one_call(model: ComplementarityModel) -> None:
    q, v, u = random_states(model.scene, 13, np.random.default_rng(0), Ranges())
    forward = model.stepper.forward
    wanted = ("tape", "jacobian", "impulse")
    alone = {name: forward(q, v, u, model.parameters, **{name: True})[name] for name in wanted}
    together = forward(q, v, u, model.parameters, tape=True, jacobian=True, impulse=True)
    for name in wanted[1:]:
        np.testing.assert_array_equal(together[name], alone[name], err_msg=name)
    g = np.random.default_rng(1).normal(size=(2, len(q), model.scene.nv))
    one, other = (model.stepper.backward(u, model.parameters, x["tape"], *g, True) for x in (together, alone))
    for name, x in one.items():
        np.testing.assert_array_equal(x, other[name], err_msg=name)


def test_a_tape_follows_what_touches(tmp_path: Path) -> None:
    """Of 40 spheres in the air it holds no contact; on the floor it holds 40 runs of 8 numbers more, not much else."""
    body = '<body pos="{} 0 1"><freejoint/><geom type="sphere" size=".1"/></body>'
    bodies = "".join(body.format(k) for k in range(40))
    file = tmp_path / "scene.xml"
    file.write_text(f'<mujoco><worldbody><geom type="plane" size="9 9 1"/>{bodies}</worldbody></mujoco>')
    scene = Scene.from_mjcf(file)
    model = ComplementarityModel(scene)
    v, u = np.zeros((100, scene.nv)), np.zeros((100, 0))

    def size(height: float) -> int:
        q = scene.q0.copy()
        q[2::7] = height
        return int(model.stepper.forward(q[None].repeat(100, 0), v, u, model.parameters, tape=True)["tape"].nbytes)

    air, floor = size(1.0), size(0.1)
    assert air == 100 * 8 * (scene.nq + 4 * scene.nv + 3 * scene.nv + 3)
    assert 100 * 40 * 64 <= floor - air < 4 * 100 * 40 * 64


def test_a_tape_of_other_steps_is_refused(model: ComplementarityModel) -> None:
    q, v, u = random_states(model.scene, 3, np.random.default_rng(0), Ranges())
    tape = model.stepper.forward(q, v, u, model.parameters, tape=True)["tape"]
    with pytest.raises(UserError, match="the tape is of 3 other steps; give that of the forward pass over these 2"):
        model.stepper.backward(u[:2], model.parameters, tape, v[:2], v[:2])
    with pytest.raises(UserError, match="the tape is of 3 other steps"):
        model.with_settings(substeps=4).stepper.backward(u, model.parameters, tape, v, v)


def test_blocks_that_are_not_asked_for_again_make_room_for_others(model: ComplementarityModel) -> None:
    q, v, _ = random_states(model.scene, 1, np.random.default_rng(0), Ranges())
    most, size = 256 * 2**20, 0
    for rows in range(20_000, 20_020):  # more than fits, every size once
        out = model.smooth_dynamics(q.repeat(rows, 0), v.repeat(rows, 0))
        sizes = [array.nbytes for array in out.values()]
        size += sum(sizes)
        del out
        assert set(sizes) <= set(kept_buffers())  # the last are there
        assert sum(kept_buffers()) <= most
    assert size > most


SPHERES = """
    import resource, sys
    import numpy as np
    import cmbrl

    file = sys.argv[1]
    body = '<body pos="{} 0 1"><freejoint/><geom type="sphere" size=".1" mass="1"/></body>'
    bodies = "".join(body.format(3 * k) for k in range(60))
    with open(file, "w") as out:
        out.write('<mujoco><worldbody><geom type="plane" size="1 1 1"/>' + bodies + "</worldbody></mujoco>")
    scene = cmbrl.Scene.from_mjcf(file)
    model = cmbrl.ComplementarityModel(scene)
    now = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + (128 << 20), now + (128 << 20)))
    try:
        model.predict(scene.q0[None], np.zeros((1, scene.nv)), np.zeros((1, 0)), jacobian=True)
    except MemoryError as error:
        print(error)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits the memory as Linux does")
def test_a_lack_of_memory_is_an_error(tmp_path: Path) -> None:
    script = [sys.executable, "-c", textwrap.dedent(SPHERES), str(tmp_path / "spheres.xml")]
    run = subprocess.run(script, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert run.stdout.startswith("no memory for a workspace (a smaller scene needs less) of ")
    assert run.stdout.endswith(" bytes\n")


def test_results_too_large_to_count_are_an_error() -> None:
    model = ComplementarityModel(Scene.from_mjcf(HOPPER), 2**31 - 1)
    states = random_states(model.scene, 1, np.random.default_rng(0), Ranges())
    with pytest.raises(MemoryError, match="no memory for a result"):
        model.stepper.forward(*(x.repeat(1000, 0) for x in states), model.parameters, tape=True)
