"""A fit whose links are all too heavy while gains were held: the report says that its unit of force may be wrong."""

from __future__ import annotations

import re

import pytest

from cmbrl.fitting.fitted_parameter import FittedParameter
from cmbrl.fitting.outcome.unit import unit_told


def parameters(masses: list[float], kp: float = 30.0, status: str = "fitted") -> dict[str, FittedParameter]:
    found = {f"mass.link{k}": FittedParameter(x, x, x, 1.0, status) for k, x in enumerate(masses)}
    return found | {"kp.servo": FittedParameter(kp, kp, kp, 30.0, "nominal" if kp == 30.0 else "fitted")}


@pytest.mark.parametrize(
    ("masses", "says"),
    [
        ([1.4, 1.3, 1.5, 1.45, 1.6], r"1.45 times the file's masses.*push 0.69 times.*smaller"),
        ([0.7, 0.75, 0.6, 0.72], r"0.71 times the file's masses.*push 1.4 times.*larger"),
    ],
)
def test_links_that_are_all_too_heavy_or_too_light(masses: list[float], says: str) -> None:
    assert re.search(says, unit_told(parameters(masses)) or "")


def test_nothing_is_said_where_masses_scatter_or_gains_moved() -> None:
    heavy = [1.4, 1.3, 1.5, 1.45, 1.6]
    assert unit_told(parameters([1.4, 0.8, 1.3, 0.9, 1.5])) is None  # to both sides
    assert unit_told(parameters([1.1, 1.05, 1.12, 1.08])) is None  # little
    assert unit_told(parameters(heavy[:3])) is None  # few: a payload
    assert unit_told(parameters(heavy, kp=25.0)) is None  # the prior sets the unit
    assert unit_told(parameters(heavy, status="flat")) is None  # not told by the log


def test_nothing_is_said_where_links_together_weigh_what_the_file_says() -> None:
    """A log tells the masses of calves; thighs, which it hardly tells, make up for them."""
    light = parameters([0.7, 0.75, 0.6, 0.72])

    def report(*times: float) -> dict[str, object]:
        rows = [{"name": f"gravity's torque at j{k}", "value": 2.0 * x, "nominal": 2.0} for k, x in enumerate(times)]
        return {"combinations": {"rows": [*rows, {"name": "inertia felt by j0", "value": 9.0, "nominal": 1.0}]}}

    assert unit_told(light, report(1.06, 1.09, 0.8)) is None
    assert "0.71 times" in (unit_told(light, report(0.72, 0.7, 0.8)) or "")
    assert "0.71 times" in (unit_told(light, report()) or "")  # nothing is told together
    balanced = {"name": "gravity's torque at j", "value": 0.01, "nominal": 0.0}
    assert "0.71 times" in (unit_told(light, {"combinations": {"rows": [balanced]}}) or "")
