"""Derivatives of the whole step in q, v, u and every kind of parameter equal finite differences of the same step."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from cmbrl.bench.states import SCENES, bench_scene
from cmbrl.bench.studies.derivatives.differences import SMOOTHINGS, measure
from cmbrl.bench.studies.derivatives.study import table as table_of
from cmbrl.scene import Scene

pytest.importorskip("gymnasium", reason="the MJCFs of hopper and cheetah are Gymnasium's")

DRY = """<mujoco><worldbody><geom type="plane" size="5 5 .1"/><body pos="0 0 .5">
<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<joint name="turn" type="hinge" axis="0 1 0"/><geom size=".1"/><body pos="0 0 -.2">
<joint name="knee" type="hinge" axis="0 1 0" frictionloss=".3" stiffness="2" damping=".1"
range="-60 60" limited="true"/>
<geom size=".05" pos="0 0 -.2"/></body></body></worldbody><actuator><position name="knee" joint="knee" kp="20" kv="1"/>
</actuator></mujoco>"""


def assert_exact(
    scene: Scene, states: int, restitution: float = 0.0, smoothings: Iterable[str] = SMOOTHINGS, **settings: Any
) -> None:
    rows = [
        {"scene": scene.name, **measure(scene, name, states, restitution=restitution, **settings)}
        for name in smoothings
    ]
    table = table_of(rows, states).text()
    for row in rows:
        assert row["median"] <= 1e-6, table
        assert row["worst"] <= 1e-4, table
        # On the G1, with joints put exactly on their limits, 2.3 % of the stencils straddle one.
        assert row["across_kinks"] + row["vague"] <= 0.03 * row["columns"], table
        assert row["unsolved"] <= 0.01 * states, table


@pytest.mark.parametrize(("name", "states"), [("hopper", 40), ("cheetah", 30), ("cube_toss", 40), ("g1", 3)])
def test_soft_contact(name: str, states: int) -> None:
    assert_exact(bench_scene(name, "mujoco"), states, smoothings=SMOOTHINGS if name != "g1" else ["kappa 1e-4"])


@pytest.mark.parametrize("name", ["hopper", "cube_toss"])
@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_rigid_contact_and_restitution(name: str, restitution: float) -> None:
    assert_exact(bench_scene(name, "rigid"), 30, restitution, set(SMOOTHINGS) - {"exact"})


@pytest.mark.parametrize(
    ("name", "law", "states"),
    [("hopper", "mujoco", 20), ("hopper", "rigid", 20), ("cube_toss", "rigid", 20), ("g1", "mujoco", 2)],
)
def test_midpoint_steps(name: str, law: str, states: int) -> None:
    """Of exact contact too, the Gaussian schedule and bounces, which look at the free velocity."""
    restitution = 0.5 if law == "rigid" else 0.0
    assert_exact(bench_scene(name, law), states, restitution, ["kappa 1e-4", "gaussian"], integrator="midpoint")


def test_dry_friction_springs_and_position_gains(tmp_path: Path) -> None:
    file = tmp_path / "scene.xml"
    file.write_text(DRY, encoding="utf-8")
    scene = Scene.from_mjcf(file)
    kinds = {p.group for p in scene.parameters}
    assert {"frictionloss", "stiffness", "damping", "armature", "kp", "kd", "mass", "com_x", "radius"} <= kinds
    assert_exact(scene, 30)


def test_kinks_are_counted_not_dropped() -> None:
    """A joint exactly at its limit margin: its column cannot be judged, and the table says so."""
    row = {"scene": "hopper", **measure(bench_scene("hopper", "mujoco"), "kappa 1e-4", 20)}
    judged = sum(kind["count"] for kind in row["kinds"].values())
    assert judged + row["across_kinks"] + row["vague"] == row["columns"]
    shown = table_of([row], 20)
    assert shown.rows[0][shown.columns.index("across kinks")] == row["across_kinks"]


@pytest.mark.slow
@pytest.mark.parametrize("law", ["mujoco", "rigid"])
@pytest.mark.parametrize("name", SCENES)
def test_thousand_states(name: str, law: str) -> None:
    # hyperstatic states of a rigid scene have derivatives of about 1/kappa, so exact contact is left out there
    smoothings = set(SMOOTHINGS) - {"exact"} if law == "rigid" else SMOOTHINGS
    assert_exact(bench_scene(name, law), 1000, 0.5 if law == "rigid" else 0.0, smoothings, parameters=30)
