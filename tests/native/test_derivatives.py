"""Derivatives of the whole step in q, v, u and every kind of parameter equal finite differences of the same step."""

from __future__ import annotations

from pathlib import Path

import pytest

from cmbrl.bench.studies.derivatives import differences
from cmbrl.bench.studies.derivatives.study import table as table_of
from cmbrl.contact import Barrier
from cmbrl.scene import Scene

from ..scene.conftest import G1, GYMNASIUM

CUBE = Path(__file__).parents[2] / "tasks/cube_toss/scene.xml"
FILES = {
    "hopper": next(file for file in GYMNASIUM if file.stem == "hopper"),
    "cheetah": next(file for file in GYMNASIUM if file.stem == "half_cheetah"),
    "cube": CUBE,
    "g1": G1,
}
DRY = """<mujoco><worldbody><geom type="plane" size="5 5 .1"/><body pos="0 0 .5">
<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<joint name="turn" type="hinge" axis="0 1 0"/><geom size=".1"/><body pos="0 0 -.2">
<joint name="knee" type="hinge" axis="0 1 0" frictionloss=".3" stiffness="2" damping=".1"
range="-60 60" limited="true"/>
<geom size=".05" pos="0 0 -.2"/></body></body></worldbody><actuator><position name="knee" joint="knee" kp="20" kv="1"/>
</actuator></mujoco>"""


def scene_of(name: str, law: str) -> Scene:
    if not FILES[name].exists():
        pytest.skip(f"{FILES[name]} is not there")
    return Scene.from_mjcf(FILES[name], contact_law=law)


def assert_exact(scene: Scene, states: int, restitution: float = 0.0, **settings: object) -> None:
    result = differences.run({scene.name: scene}, states, restitution=restitution, threads=1, **settings)  # type: ignore[arg-type]
    table = table_of(result).text()
    for row in result["rows"]:
        assert row["median"] <= 1e-6, table
        assert row["worst"] <= 1e-4, table
        # On the G1, with joints put exactly on their limits, 2.3 % of the stencils straddle one.
        assert row["across_kinks"] + row["vague"] <= 0.03 * row["columns"], table
        assert row["unsolved"] <= 0.01 * states, table


@pytest.mark.parametrize(("name", "states"), [("hopper", 40), ("cheetah", 30), ("cube", 40), ("g1", 3)])
def test_soft_contact(name: str, states: int) -> None:
    smoothings = None if name != "g1" else {"kappa 1e-4": Barrier(1e-4)}
    assert_exact(scene_of(name, "mujoco"), states, smoothings=smoothings)


@pytest.mark.parametrize("name", ["hopper", "cube"])
@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_rigid_contact_and_restitution(name: str, restitution: float) -> None:
    smoothings = {k: s for k, s in differences.SMOOTHINGS.items() if k != "exact"}
    assert_exact(scene_of(name, "rigid"), 30, restitution, smoothings=smoothings)


@pytest.mark.parametrize(
    ("name", "law", "states"),
    [("hopper", "mujoco", 20), ("hopper", "rigid", 20), ("cube", "rigid", 20), ("g1", "mujoco", 2)],
)
def test_midpoint_steps(name: str, law: str, states: int) -> None:
    """Of exact contact too, adaptive smoothing and bounces, which look at the free velocity."""
    smoothings = {k: s for k, s in differences.SMOOTHINGS.items() if k in ("kappa 1e-4", "adaptive")}
    restitution = 0.5 if law == "rigid" else 0.0
    assert_exact(scene_of(name, law), states, restitution, smoothings=smoothings, integrator="midpoint")


def test_dry_friction_springs_and_position_gains(tmp_path: Path) -> None:
    file = tmp_path / "scene.xml"
    file.write_text(DRY, encoding="utf-8")
    scene = Scene.from_mjcf(file)
    kinds = {p.group for p in scene.parameters}
    assert {"frictionloss", "stiffness", "damping", "armature", "gear", "mass", "com_x", "radius"} <= kinds
    assert_exact(scene, 30)


def test_kinks_are_counted_not_dropped() -> None:
    """A joint exactly at its limit margin: its column cannot be judged, and the table says so."""
    scene = scene_of("hopper", "mujoco")
    result = differences.run({"hopper": scene}, 20, smoothings={"kappa 1e-4": Barrier(1e-4)}, threads=1)
    row = result["rows"][0]
    judged = sum(kind["count"] for kind in row["kinds"].values())
    assert judged + row["across_kinks"] + row["vague"] == row["columns"]
    assert "kinks" in table_of(result).text()


@pytest.mark.slow
@pytest.mark.parametrize("law", ["mujoco", "rigid"])
@pytest.mark.parametrize("name", list(FILES))
def test_thousand_states(name: str, law: str) -> None:
    smoothings = dict(differences.SMOOTHINGS)
    if law == "rigid":
        del smoothings["exact"]  # hyperstatic states have derivatives like 1/kappa there
    assert_exact(scene_of(name, law), 1000, 0.5 if law == "rigid" else 0.0, smoothings=smoothings, parameters=30)
