"""Contact problems of torsional and rolling friction: rows of their own, in one round cone with those of sliding."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl.contact import Barrier, Exact
from cmbrl.contact.certificates import residuals
from cmbrl.contact.problem import ContactProblem
from cmbrl.contact.solvers import available, get
from cmbrl.contact.solvers.native import solve
from cmbrl.errors import UserError
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.native import SolverStatus
from cmbrl.scene import Scene

from .test_convex_sliding import OPTION, touching
from .test_turning_friction import BALL, DIMS, FLOOR, write

ROLLING_DISC = """<default><geom condim="6" friction=".5 .01 .02"/></default><worldbody>
<geom type="plane" size="5 5 .1"/><body pos="0 0 .0999">
<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>
<geom size=".1" mass="1"/></body></worldbody>"""
MIXED = FLOOR + BALL + '<body pos=".5 0 .1"><freejoint/><geom size=".1" condim="{}" mass="2" priority="1"/></body>'


def problem_scenes(folder: Path) -> dict[str, tuple[Scene, int]]:
    """Scenes by name, with the rows of their contacts."""
    file = folder / "disc.xml"
    file.write_text(f"<mujoco>{OPTION.format(impratio=1, cone='elliptic')}{ROLLING_DISC}</mujoco>", encoding="utf-8")
    scenes = {"disc": (Scene.from_mjcf(file), 3)}
    for dim in DIMS:
        file = write(folder, "a ball on a box", dim, "elliptic", 4.0)
        scenes[f"stack {dim}"] = (Scene.from_mjcf(file), dim)
        text = (
            f"<mujoco>{OPTION.format(impratio=1, cone='elliptic')}<worldbody>{MIXED.format(dim)}</worldbody></mujoco>"
        )
        scenes[f"some slide only {dim}"] = (Scene.from_mjcf(text), dim)
    return scenes


@pytest.mark.parametrize("sliding", ["coulomb", "convex"])
def test_contact_problems_have_such_rows(sliding: str, tmp_path: Path) -> None:
    """The step's velocity is the problem's, softened alike; solvers of round cones agree on the exact one."""
    for name, (scene, rows) in problem_scenes(tmp_path).items():
        q, v, u = touching(scene, 6)
        kappa = 1e-7
        model = ComplementarityModel(
            scene, smoothing=Barrier(kappa), path_tolerance=1e-10, damping="coupled", sliding=sliding
        )
        step, problems = model.predict(q, v, u), model.contact_problems(q, v, u)
        for k, problem in enumerate(problems):
            assert problem.J.shape[1] == rows, name
            softened = solve([problem], kappa=kappa)
            np.testing.assert_allclose(softened.v[0], step.v_next[k], atol=1e-6 * problem.speed, err_msg=name)
            exact = solve([problem], derivative=True)
            assert exact.status[0] == SolverStatus.CONVERGED
            assert residuals(problem, exact.v[0], exact.impulse[0]).worst() < 1e-8
            if k == 0:
                slopes = differences_of_velocity(problem)
                assert np.abs(exact.derivative[0] - slopes).max() < 1e-5 * np.abs(slopes).max()
            for solver in {"coulomb": ("pgs", "admm"), "convex": ("clarabel",)}[sliding]:
                other = get(solver).solve(problem, 1e-11)
                assert np.abs(other.v - exact.v[0]).max() < 1e-5 * np.abs(exact.v[0]).max(), (name, solver)


def differences_of_velocity(problem: ContactProblem, size: float = 1e-7) -> np.ndarray:
    """dv'/dv_free (nv, nv) of the exact law."""
    columns = []
    for unit in np.eye(len(problem.v_free)):
        ends = [replace(problem, v_free=problem.v_free + sign * size * unit) for sign in (1, -1)]
        ahead, behind = (solve([end], tolerance=1e-13).v[0] for end in ends)
        columns.append((ahead - behind) / (2 * size))
    return np.array(columns).T


def test_solvers_of_sliding_alone_refuse_such_rows(tmp_path: Path) -> None:
    scene = Scene.from_mjcf(write(tmp_path, "ball", 6, "elliptic"))
    problem = ComplementarityModel(scene).contact_problems(*touching(scene, 1))[0]
    for name in ("desaxce", "pinocchio admm"):
        if name in available("exact"):
            with pytest.raises(UserError, match="not torsional"):
                get(name).solve(problem, 1e-8)
    with pytest.raises(UserError, match="4 or 6 with torsional"):
        replace(problem, J=problem.J[:, :5], b=problem.b[:, :5], R=problem.R[:, :5])


def test_edges_of_pyramids_turn_in_problems_too(tmp_path: Path) -> None:
    """Under the convex law they are contacts of one row."""
    scene = Scene.from_mjcf(write(tmp_path, "ball", 6, "pyramidal"))
    q, v, u = touching(scene, 4)
    model = ComplementarityModel(scene, smoothing=Exact(1e-12), sliding="convex", damping="coupled")
    for k, problem in enumerate(model.contact_problems(q, v, u)):
        assert problem.J.shape[:2] == (10, 3)
        found = solve([problem]).v[0]
        np.testing.assert_allclose(found, model.predict(q, v, u).v_next[k], atol=1e-5 * problem.speed)
