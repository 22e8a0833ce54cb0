"""Every contact solver that is installed here on problems whose answers are known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cmbrl.bench.studies.solvers.hard_cases import problem, stack
from cmbrl.bench.studies.solvers.problems import random_problem
from cmbrl.contact.certificates import residuals
from cmbrl.contact.problem import ContactProblem
from cmbrl.contact.solvers import available, get, registry
from cmbrl.errors import UserError

G, H, MU = 9.81, 1e-3, 0.4
EXACT = available("exact")
CONVEX = available("convex")
PYRAMID = {"desaxce", "desaxce proxsuite"}  # exact in the plane only
LIES = "pinocchio pgs"  # claims to have converged where it has not (stacks, redundant contacts)
LOOSE = {"qpsolvers highs": 1e-5}  # its least tolerance is 1e-7 of an objective


def point(v: tuple[float, ...], mu: float = MU) -> ContactProblem:
    """A unit mass on the ground, last coordinate up, with free velocity v."""
    rows = np.roll(np.eye(len(v)), 1, axis=0)  # normal first
    return problem("point", np.eye(len(v)), rows[None], np.array(v), np.array([mu]))


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("v", [(1.0, -G * H), (0.0, 1.0, -G * H)], ids=["plane", "space"])
def test_sliding_block_exact(name: str, v: tuple[float, ...]) -> None:
    """gamma = m g h, friction mu gamma against the slip, nothing leaves the ground."""
    found = get(name).solve(point(v), 1e-10)
    truth = np.zeros(len(v))
    truth[-2] = 1.0 - MU * G * H
    assert found.v == pytest.approx(truth, abs=1e-7)
    assert found.impulse[0, 0] == pytest.approx(G * H, abs=1e-7)


@pytest.mark.parametrize("name", CONVEX)
@pytest.mark.parametrize("v", [(1.0, -G * H), (0.0, 1.0, -G * H)], ids=["plane", "space"])
def test_relaxation_launches_the_sliding_block(name: str, v: tuple[float, ...]) -> None:
    """gamma = (mu v_t + g h)/(1 + mu^2), launch speed gamma - g h: 0.343 m/s."""
    found = get(name).solve(point(v), 1e-10)
    normal = (MU + G * H) / (1 + MU**2)
    truth = np.zeros(len(v))
    truth[-2:] = 1 - MU * normal, normal - G * H
    assert found.v == pytest.approx(truth, abs=LOOSE.get(name, 1e-7))
    assert found.impulse[0, 0] == pytest.approx(normal, abs=LOOSE.get(name, 1e-7))


@pytest.mark.parametrize("name", [n for n in EXACT + CONVEX if n != LIES])
def test_stack_carries_what_is_above(name: str) -> None:
    """Impulse of contact k: g h times the mass above it; at rest the relaxation has the same answer."""
    p = stack(3, 5.0)
    found = get(name).solve(p, 1e-11)
    assert found.impulse[:, 0] == pytest.approx(G * H * np.array([7.0, 6.0, 5.0]), rel=1e3 * LOOSE.get(name, 1e-9))
    assert np.abs(found.v).max() <= LOOSE.get(name, 1e-7)


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("slope", [0.9, 1.1])
def test_incline_sticks_below_and_slides_above_the_threshold(name: str, slope: float) -> None:
    """tan theta = slope mu: at rest below 1, else v = h g (sin - mu cos)."""
    angle = np.arctan(slope * MU)
    pull = G * H * np.array([np.sin(angle), -np.cos(angle)])
    found = get(name).solve(point((pull[0], pull[1])), 1e-11)
    assert found.v == pytest.approx([max(pull[0] + MU * pull[1], 0.0), 0.0], abs=1e-8)


@pytest.mark.parametrize("name", [n for n in EXACT if n != LIES])
@pytest.mark.parametrize("planar", [True, False])
def test_exact_solvers_reach_their_law(name: str, planar: bool) -> None:
    if name in PYRAMID and not planar:
        pytest.skip("a friction pyramid is not the exact cone in space")
    p = random_problem(2, 6, 10.0, np.random.default_rng(3), planar)
    found = get(name, **({"sweeps": 20_000} if name == "pgs" else {})).solve(p, 1e-12)
    score = residuals(p, found.v, found.impulse)
    assert max(score.natural_map, score.dynamics, score.penetration) < (1e-6 if name == "desaxce clarabel" else 1e-8)


@pytest.mark.parametrize("name", [n for n in EXACT + CONVEX if n != LIES])
def test_compliant_slot_presses_by_its_compliance(name: str) -> None:
    """Two overlapping walls with compliance R: v = 0 and 1/R on each."""
    J = np.array([[[1.0, 0.0], [0.0, 1.0]], [[-1.0, 0.0], [0.0, 1.0]]])
    p = problem("slot", np.eye(2), J, np.array([0.0, -1.0]), np.zeros(2), np.array([[-1.0, 0.0]] * 2), R=0.5)
    found = get(name).solve(p, 1e-10)
    assert found.impulse[:, 0] == pytest.approx([2.0, 2.0], rel=max(1e-6, LOOSE.get(name, 0.0)))
    assert found.v == pytest.approx([0.0, -1.0], abs=max(1e-6, LOOSE.get(name, 0.0)))


@pytest.mark.parametrize("name", available())
def test_no_contact_is_free_motion(name: str) -> None:
    p = point((1.0, -G * H))
    none = replace(p, J=p.J[:0], b=p.b[:0], mu=p.mu[:0], R=p.R[:0], convex=p.convex[:0])
    assert (get(name).solve(none).v == p.v_free).all()


def test_solver_that_is_not_there_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "find_spec", lambda module: None)
    assert available() == ["ours", "ours softened", "pgs", "admm"]
    with pytest.raises(UserError, match="pip install daqp"):
        get("convex")
    with pytest.raises(UserError, match="did you mean 'pgs'"):
        get("pg")
