"""A file of thousands of joints is refused before MuJoCo reserves memory by the square of their number."""

from __future__ import annotations

import pytest

from cmbrl.errors import UserError
from cmbrl.scene.source.precheck import FREEDOM, check_xml

BODY = "<body><freejoint/><geom size='.1'/></body>"


def test_freedom_is_counted_with_copies_and_not_where_joints_are_named() -> None:
    count = FREEDOM // 6
    robot = "<mujoco><worldbody><replicate count='{}'>" + BODY + "</replicate></worldbody>{}</mujoco>"
    named = "<tendon><fixed>" + "<joint joint='a' coef='1'/>" * 50 + "</fixed></tendon>"
    assert check_xml(robot.format(count, named)) == "mujoco"
    with pytest.raises(UserError, match=f"more than {FREEDOM} degrees of freedom, counting every copy of a joint"):
        check_xml(robot.format(count + 1, ""))


def test_fixed_joints_of_a_urdf_count_nothing() -> None:
    joint = "<joint type='{}' name='j'/>"
    assert check_xml("<robot>" + joint.format("fixed") * (FREEDOM + 1) + "</robot>") == "robot"
    with pytest.raises(UserError, match="degrees of freedom"):
        check_xml("<robot>" + joint.format("floating") * (FREEDOM // 6 + 1) + "</robot>")
