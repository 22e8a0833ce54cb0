"""A solref that is half a time constant and half a stiffness: MuJoCo takes its default in its place, and so do we."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from cmbrl.scene.info.report import describe

from .conftest import Load, worst_step

ARM = '<body><joint name="j" axis="0 1 0" {}/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/></body>'
TENDON = '<tendon><fixed name="t" {}><joint joint="j" coef="1"/></fixed></tendon>'
BALL = (
    '<geom name="f" type="plane" size="1 1 .1" {}/>'
    '<body pos="0 0 .099"><freejoint/><geom name="g" size=".1" mass="1" {}/></body>'
)
OVERRIDE = '<option o_solref="{}"><flag override="enable"/></option>'
FILES = {  # worldbody and rest, of a solref
    "joint limit": lambda ref: (ARM.format(f'range="-1 1" solreflimit="{ref}"'), ""),
    "tendon limit": lambda ref: (ARM.format(""), TENDON.format(f'range="-.02 .02" solreflimit="{ref}"')),
    "joint friction": lambda ref: (ARM.format(f'frictionloss=".5" solreffriction="{ref}"'), ""),
    "tendon friction": lambda ref: (ARM.format(""), TENDON.format(f'frictionloss=".5" solreffriction="{ref}"')),
    "equality": lambda ref: (
        ARM.format(""),
        f'<equality><joint joint1="j" polycoef=".1 0 0 0 0" solref="{ref}"/></equality>',
    ),
    "contact": lambda ref: (BALL.format(f'solref="{ref}"', f'solref="{ref}"'), ""),
    "contact, mixed": lambda ref: (BALL.format(f'solref="{ref}"', 'solmix=".3"'), ""),
    "contact, by priority": lambda ref: (BALL.format(f'solref="{ref}" priority="1"', 'solref="-90 -9"'), ""),
    "contact, direct": lambda ref: (BALL.format(f'solref="{ref}"', 'solref="-90 -9"'), ""),
    "contact, overridden": lambda ref: (BALL.format("", ""), OVERRIDE.format(ref)),
    "contact of a pair": lambda ref: (
        BALL.format("", ""),
        f'<contact><pair geom1="f" geom2="g" solref="{ref}"/></contact>',
    ),
}
SOLREFS = [f"{first} {second}" for first, second in product((".05", "0", "-30"), ("2", "0", "-30"))]
MIXED = [".05 0", ".05 -30", "0 2", "-30 2"]
DEFAULT = "MuJoCo's default, .02 1, acts"


@pytest.mark.parametrize("solref", SOLREFS)
@pytest.mark.parametrize("file", FILES)
def test_it_acts_as_mujocos(file: str, solref: str, load: Load) -> None:
    scene, model = load(*FILES[file](solref))
    assert worst_step(scene, model, spread=0.0 if "contact" in file else 0.1) < 1e-4


@pytest.mark.parametrize("file", FILES)
def test_info_names_it(file: str, load: Load) -> None:
    """Of geoms by what they mix to, of which one number may be above 0 where both of theirs are."""
    for solref in SOLREFS:
        scene, _ = load(*FILES[file](solref))
        first, second = scene.core.P[scene.layout.contact(0, "solref0") :][:2] if "contact" in file else (0, 0)
        told = [x.kind for x in scene.left_out if DEFAULT in x.why]
        if file in ("contact, mixed", "contact, direct"):
            assert bool(told) == ((first, second) == (0.02, 1.0))
        else:
            assert told == [file.split(",")[0].removesuffix(" of a pair")] * (solref in MIXED)
    assert DEFAULT in describe(load(*FILES["contact"]("0 2"))[0])


def test_what_does_not_act_is_not_told(load: Load) -> None:
    off = ARM.format('range="-1 1" limited="false" solreflimit="0 1" solreffriction="0 1"')
    assert not load(off)[0].left_out
    flags = '<option><flag limit="disable" frictionloss="disable" equality="disable"/></option>'
    on = ARM.format('range="-1 1" frictionloss="1" solreflimit="0 1" solreffriction="0 1"')
    tie = '<equality><joint joint1="j" solref="0 1"/></equality>'
    assert [x.why for x in load(on, flags + tie)[0].left_out] == ["not active"]


def test_a_half_solref_of_the_tangents_is_that_of_the_normal(load: Load) -> None:
    pair = '<option cone="elliptic"/><contact><pair geom1="f" geom2="g" solref=".05 1" solreffriction="{}"/></contact>'
    scene, model = load(BALL.format("", ""), pair.format("0 1"))
    assert not scene.left_out
    assert worst_step(scene, model) < 1e-4
    assert [x.kind for x in load(BALL.format("", ""), pair.format("-5 0"))[0].left_out] == ["solreffriction"]


def test_all_laws_of_contact_bear_it(load: Load) -> None:
    for law in ("mujoco", "rigid", "spring-damper"):
        scene, _ = load(*FILES["contact"](".05 0"), contact_law=law)
        plain, _ = load(*FILES["contact"](".02 1"), contact_law=law)
        np.testing.assert_array_equal(scene.core.P, plain.core.P)
