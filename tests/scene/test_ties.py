"""What a scene reads of equality constraints and tendons, and what it says of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cmbrl.fitting.search.gauge import common_factors
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.manifold import invariant_translations
from cmbrl.scene import Scene
from cmbrl.scene.info.inventory import to_dict
from cmbrl.scene.info.report import describe

from .conftest import Load

BODY = (
    '<body name="{0}" pos="{1}"><joint name="{0}" axis="0 1 0"/><geom name="{0}" size=".1"/><site name="{0}"/></body>'
)
TWO = BODY.format("a", "0 0 0") + BODY.format("b", "1 0 0")
QUIET = TWO.replace("<geom ", '<geom contype="0" conaffinity="0" ')
FIXED = '<fixed name="{}" {}><joint joint="b" coef="-2"/><joint joint="a" coef="3"/></fixed>'
FREE = '<body name="f" pos="0 0 2"><freejoint/><geom size=".1"/></body>'


def tendon(attributes: str) -> str:
    return f"<tendon>{FIXED.format('t', attributes)}</tendon>"


def lengths(scene: Scene, q: Any) -> list[float]:
    """Lengths of the lines of ``scene`` at one configuration."""
    smooth = ComplementarityModel(scene).smooth_dynamics(np.array([q]), np.zeros((1, scene.nv)))
    return list(smooth["length"][0])


def test_a_tendon_is_a_line(load: Load) -> None:
    rest = tendon('limited="true" range="-1 2" stiffness="4" springlength=".5" damping=".1"')
    scene, _ = load(TWO, rest + '<actuator><motor name="pull" tendon="t"/></actuator>')
    core = scene.core
    assert scene.line_names == ("a", "b", "t")
    assert (core.tendon_dof.tolist(), core.tendon_coef.tolist()) == ([0, 1], [3, -2])
    assert (core.lim_line.tolist(), core.act_line.tolist()) == ([2], [2])
    assert lengths(scene, [0.5, 0.25]) == [0.5, 0.25, 1.0]
    P, place = core.P, scene.layout.dof
    fields = [P[place(2, field)] for field in ("armature", "damping", "stiffness", "springref", "frictionloss")]
    assert fields == [0.0, 0.1, 4.0, 0.5, 0.0]
    assert {"tendon_damping.t", "tendon_stiffness.t"} <= {p.name for p in scene.parameters}


def test_ties_are_listed(load: Load) -> None:
    rest = (
        tendon("")
        + '<equality><joint name="mimic" joint1="a" joint2="b" polycoef="0 2 0 0 0"/><weld name="weld" body1="f"/>'
        '<connect name="pin" body1="a" body2="b" anchor="0 0 0"/><tendon name="hold" tendon1="t"/>'
        '<joint name="off" joint1="a" active="false"/></equality>'
    )
    scene, _ = load(TWO + FREE, rest)
    assert scene.tie_names == ("mimic", "weld", "pin", "hold")
    assert [(x.kind, x.name) for x in scene.left_out] == [("equality", "off")]
    told = to_dict(scene)
    assert told["tendons"] == [{"name": "t", "coordinates": {"a": 3.0, "b": -2.0}, "segments": 0}]
    ends = [(tie["type"], tie["between"]) for tie in told["equalities"]]
    assert ends == [
        ("polynomial", ["a", "b"]),
        ("weld", ["f", "world"]),
        ("connect", ["a", "b"]),
        ("polynomial", ["t"]),
    ]
    text = describe(scene)
    assert "t = +3 a -2 b" in text
    assert "pin (connect of a and b)" in text


def test_flags_switch_ties_off(load: Load) -> None:
    rest = '<equality><joint name="e" joint1="a"/></equality><option><flag equality="disable"/></option>'
    scene, _ = load(TWO, rest)
    assert (scene.core.ntie, scene.left_out[0].why) == (0, "not active")


@pytest.mark.parametrize(
    ("tie", "why"),
    [
        ('<connect body1="a" body2="b" anchor=".1 .2 .3"/>', None),
        ('<weld body1="a" body2="b"/>', None),
        ('<weld name="w" body1="a" relpose="0 0 0 1 .2 0 0"/>', "w turns a body out of the plane of motion"),
        ('<weld name="w" body1="a" relpose="0 .1 0 1 0 0 0"/>', "w ties points that lie in different planes"),
    ],
)
def test_only_ties_within_the_plane_are_planar(load: Load, tie: str, why: str | None) -> None:
    scene, _ = load(TWO, f"<equality>{tie}</equality>")
    assert scene.planar == (why is None)
    if why:
        assert scene.planar_why == why


def test_ties_within_one_body_do_nothing(load: Load) -> None:
    world = '<body name="a"><joint/><geom size=".1"/><body name="b" pos=".1 0 0"><geom size=".1"/></body></body>'
    scene, _ = load(world, '<equality><weld name="w" body1="a" body2="b"/></equality>')
    assert [(x.name, x.why) for x in scene.left_out] == [("w", "it ties two parts of one body")]


def test_a_tendon_through_sites_is_a_line_of_segments(load: Load) -> None:
    path = '<site site="a"/><site site="b"/><pulley divisor="2"/><site site="b"/><site site="c"/>'
    sites = '<site name="c" pos="2 0 1"/>'
    rest = f'<tendon><spatial name="s" stiffness="1">{path}</spatial></tendon>'
    scene, _ = load(sites + TWO, rest)
    core = scene.core
    assert scene.planar
    assert (core.seg_ptr.tolist(), core.seg_scale.tolist(), core.tendon_dof.tolist()) == ([0, 2], [1.0, 0.5], [0, 1])
    assert lengths(scene, scene.q0)[2] == pytest.approx(1 + 0.5 * 2**0.5)
    assert "s = 2 straight segments, moved by a b" in describe(scene)
    away = load(
        sites.replace("0 1", ".3 1") + TWO, f'<tendon><spatial name="s" stiffness="1">{path}</spatial></tendon>'
    )
    assert away[0].planar_why == "s leaves the plane of motion"


def test_a_tendon_around_a_geom_is_no_planar_scene(load: Load) -> None:
    path = '<site site="a"/><geom geom="ball"/><site site="b"/>'
    world = TWO + '<geom name="ball" size=".1" pos=".5 0 0"/>'
    scene, _ = load(world, f'<tendon><spatial name="s" stiffness="1">{path}</spatial></tendon>')
    assert scene.planar_why == "s goes around something"
    assert "s = 1 segment, 1 around a geom" in describe(scene)


def test_terms_between_branches_are_named(load: Load) -> None:
    """MuJoCo's mass matrix has no place for them."""
    scene, _ = load(TWO, tendon('armature=".1"'))
    assert [(x.kind, x.name) for x in scene.differences] == [("tendon", "t")]
    assert not load(TWO, tendon('stiffness=".1"'))[0].differences


def test_tied_robots_are_not_free_to_move(load: Load) -> None:
    def free(rest: str) -> list[int]:
        return invariant_translations(load(FREE + QUIET, rest)[0])

    assert free("") == [0, 1, 2]
    assert free('<equality><connect body1="f" body2="b" anchor="0 0 0"/></equality>') == []
    assert free('<equality><joint joint1="a" joint2="b"/></equality>') == [0, 1, 2]


def test_tied_trees_share_the_unit_of_force(load: Load) -> None:
    """Two bodies have two masses that motion does not tell, until they exchange impulses."""

    def held(rest: str) -> int:
        scene: Scene = load(QUIET, rest)[0]
        moves = [p.group in ("mass", "damping", "armature") for p in scene.parameters]
        return len(common_factors(scene.core, np.array(moves)))

    off = '<option gravity="0 0 0"/>'
    assert held(off) == 2
    assert held(off + '<equality><joint joint1="a" joint2="b"/></equality>') == 1
    assert held(off + tendon('limited="true" range="-1 1"')) == 1
