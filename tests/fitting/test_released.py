"""Joints of which a fit has left a parameter on its bound begin again as the others of their kind."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cmbrl.fitting.choice.trials import Trials
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.search.released import released


@pytest.fixture
def space(carts):
    return Evidence.of(carts.model(2), carts.record(carts.truth(2), episodes=4, steps=40)).space


def test_all_parameters_of_a_joint_go_where_those_of_others_are_and_no_others(space) -> None:
    names, active = list(space.names), np.ones(len(space), dtype=bool)
    z, begin = np.full(len(space), 0.3), np.full(len(space), 0.1)
    assert released(space, z, active, begin) is None
    k = names.index("damping.0")
    z[k], z[names.index("damping.1")], z[names.index("gear.0")] = space.z_high[k], 0.7, 0.2
    back = dict(zip(names, released(space, z, active, begin).tolist(), strict=True))
    assert {name: x for name, x, y in zip(names, back.values(), z, strict=True) if x != y} == {
        "damping.0": pytest.approx(0.7), "gear.0": pytest.approx(0.3)
    }  # fmt: skip
    of_joints = np.array([name.split(".")[0] in ("damping", "gear") for name in names])
    alone = of_joints & np.array([name.endswith(".0") for name in names])
    assert released(space, z, alone, begin)[k] == 0.1
    active[k] = False
    assert released(space, z, active, begin) is None


@pytest.mark.parametrize(("gain", "taken"), [(0.5, False), (1.5, True), (np.nan, False)])
def test_what_predicts_held_out_parts_better_is_taken(space, gain: float, taken: bool) -> None:
    active, z = np.ones(len(space), dtype=bool), np.zeros(len(space))
    k = list(space.names).index("damping.0")
    z[k] = space.z_high[k]
    first, second = SimpleNamespace(z=z, active=active, gain=1.0), SimpleNamespace(gain=gain)
    trials = SimpleNamespace(space=space, _tell=lambda *a: None, _trial=lambda *a: second)
    found = Trials._released(trials, "all", first, SimpleNamespace(begin=0.0 * z), None, 3)
    assert found is (second if taken else first)
