"""Ours on every scene of the bank, one step size each, at default settings; and what is known to miss."""

from __future__ import annotations

import pytest

from cmbrl.bench.peers.ours import Ours
from cmbrl.bench.peers.simulator import NotExpressibleError, World
from cmbrl.bench.studies.stability import bias
from cmbrl.bench.studies.stability.bank import HARD, MIDPOINT, SCENES
from cmbrl.bench.studies.stability.case import SWEEP, BankScene
from cmbrl.bench.studies.stability.cells import FAIL, NEAR, PASS, measure, simulate
from cmbrl.bench.studies.stability.worlds import GROUND, body, world

MISSED = {"F22b", "F25b", "F25c", "F37"}  # first order in h without contact: velocity-dependent forces are explicit
LONG = {"F10"}


def params() -> list:
    return [
        pytest.param(s, id=s.label, marks=[pytest.mark.slow] if s.label in LONG else [])
        for s in SCENES.values()
        if s.label not in MISSED
    ]


@pytest.mark.parametrize("scene", params())
def test_ours_passes(scene: BankScene) -> None:
    cell = measure(scene, HARD, scene.shown_step(scene.steps))
    assert not cell.why
    assert cell.verdict == PASS, f"{cell.worst_case}: {cell.error:.2e} > {cell.tolerance:.2e}"


@pytest.mark.parametrize("label", ["F1c", "F5", "F13", "F18", "F21", "F27"])
def test_ours_passes_from_20_to_2000_hz(label: str) -> None:
    scene = SCENES[label]
    assert scene.steps == SWEEP
    verdicts = {h: measure(scene, HARD, h).verdict for h in SWEEP}
    assert set(verdicts.values()) == {PASS}, verdicts


@pytest.mark.parametrize("label", sorted(MISSED))
def test_known_misses_are_mujocos_too(label: str) -> None:
    """Energy and momentum without contact drift at first order; MuJoCo's Euler gives the same numbers."""
    scene = SCENES[label]
    ours, peer = (measure(scene, arm, 1e-3) for arm in (HARD, "MuJoCo"))
    assert ours.verdict in (NEAR, FAIL)
    assert ours.error == pytest.approx(peer.error, rel=1e-2)
    assert scene.words("note")


def test_drift_without_contact_is_first_order() -> None:
    case = SCENES["F25b"].cases[0]
    coarse, fine = (case.error(simulate(Ours(case.world), case, h)) for h in (0.004, 0.002))
    assert coarse / fine == pytest.approx(2, rel=0.1)


def test_trajectories_converge_at_first_order() -> None:
    for label in ("F4", "F8"):
        case = SCENES[label].cases[0]
        coarse, fine = (case.error(simulate(Ours(case.world), case, h)) for h in (0.004, 0.002))
        assert coarse / fine == pytest.approx(2, rel=0.1), label


@pytest.mark.parametrize("label", sorted(MISSED | {"F38"}))
def test_midpoint_steps_keep_energy_and_momentum_to_second_order(label: str) -> None:
    cells = [measure(SCENES[label], MIDPOINT, h) for h in (0.002, 0.001)]
    assert all(cell.verdict == PASS for cell in cells)
    coarse, fine = (cell.error or 0.0 for cell in cells)
    assert coarse / fine == pytest.approx(4, rel=0.1)


@pytest.mark.parametrize("name", bias.EFFECTS, ids=lambda name: name.split(",")[0])
def test_bias_law(name: str) -> None:
    """F30: measured against closed form within one per cent."""
    effect = bias.EFFECTS[name]
    for kappa in (1e-9, 1e-5):
        assert effect.measured(kappa) == pytest.approx(effect.formula(kappa), rel=0.01)


def test_what_cannot_be_expressed_says_why() -> None:
    """F23 with mass 0."""
    nothing = body("link", (0, 0, 0.1), "z", '<geom size="0.1" mass="0"/>')
    with pytest.raises(NotExpressibleError, match="mass"):
        Ours(World(world(GROUND, nothing)))
