"""Hyperparameters, policies of smoothing and algorithms as they are typed behind `cmbrl train`, and its help."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Literal

import pytest

from cmbrl.cli.main import main
from cmbrl.cli.train import _early
from cmbrl.contact import Barrier, Exact, Gaussian
from cmbrl.contact.smoothing import parse_smoothing
from cmbrl.errors import UserError
from cmbrl.gradients.kinds import parse_derivative
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.registry import load_task
from cmbrl.scene import Scene
from cmbrl.settings import setting
from cmbrl.text import parse_fields
from cmbrl.train.algorithms import ALGORITHMS
from cmbrl.train.setup import recommended, set_up


@dataclasses.dataclass(frozen=True)
class Settings:
    """For the parser of hyperparameters."""

    count: int = setting(3, "number of things", least=1)
    size: float = setting(0.5, "of each", least=0, most=math.inf)
    signed: float = -1.0
    widths: tuple[int, ...] = setting((8, 4), "of layers", least=1)
    name: Literal["elu", "tanh"] = "elu"
    limit: int | None = None
    on: bool = False


def test_hyperparameters_have_the_types_of_their_fields() -> None:
    given = {
        "count": "1e1",
        "size": "inf",
        "signed": "-2",
        "widths": "16,8",
        "name": "tanh",
        "limit": "5",
        "on": "true",
    }
    values = {"count": 10, "size": float("inf"), "signed": -2.0, "widths": (16, 8), "name": "tanh", "limit": 5}
    assert parse_fields(Settings, given, "toy") == {**values, "on": True}
    assert parse_fields(Settings, {"widths": "(16, 8)", "limit": "none"}, "toy") == {"widths": (16, 8), "limit": None}
    assert type(parse_fields(Settings, {"count": "1e1"}, "toy")["count"]) is int


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [("count", "0", "at least 1"), ("count", "1.5", "whole"), ("count", "inf", "whole"), ("count", "many", "number"),
     ("count", "1e300", "2147483648"), ("count", "9" * 5000, "whole"), ("size", "nan", "number"),
     ("size", "-1", "negative"), ("widths", "8,0", "at least 1"), ("name", "eluu", "did you mean 'elu'"),
     ("on", "yes", "true or false"), ("coutn", "1", "did you mean 'count'"), ("limit", "-3.2", "whole")],
)  # fmt: skip
def test_a_bad_hyperparameter_is_one_short_line(name: str, text: str, why: str) -> None:
    with pytest.raises(UserError, match=why) as caught:
        parse_fields(Settings, {name: text}, "toy")
    assert str(caught.value).startswith("toy: ")
    assert name in str(caught.value)
    assert len(str(caught.value)) < 150


def test_one_notation_for_smoothing_and_derivative() -> None:
    assert parse_smoothing("exact") == Exact()
    assert parse_smoothing("barrier:kappa=1e-4") == Barrier(kappa=1e-4)
    assert parse_smoothing("barrier:length=1e-3") == Barrier(length=1e-3)
    assert parse_smoothing("gaussian:length=0.01,derivative=stop") == Gaussian(0.01, derivative="stop")
    assert parse_derivative("barrier:kappa=1e-4") == ("barrier", {"kappa": 1e-4})


def test_help_lists_hyperparameters_with_their_help(capsys: pytest.CaptureFixture[str]) -> None:
    """Each algorithm's own fields with default and help text; those that the loop takes over from SHAC only once."""
    with pytest.raises(SystemExit):
        main(["train", "--help"])
    shown = capsys.readouterr().out
    for algorithm in ALGORITHMS.values():
        for field in dataclasses.fields(algorithm.load()[1]):
            assert f"\n    {field.name}=" in shown
            assert field.metadata.get("help", "").split(" ")[0] in shown
    assert shown.count("actor_rate=") == 1


@pytest.mark.parametrize("name", sorted(ALGORITHMS))
def test_every_algorithm_has_a_configuration_that_can_be_set(name: str) -> None:
    trainer, config = ALGORITHMS[name].load()
    assert callable(trainer)
    for field in dataclasses.fields(config):
        if isinstance(field.default, int | float | str) and not isinstance(field.default, bool):
            assert parse_fields(config, {field.name: str(field.default)}, name) == {field.name: field.default}


def test_the_default_algorithm(capsys: pytest.CaptureFixture[str]) -> None:
    """The loop where there is a real system to learn from, SHAC on a model that is named, and help that says so."""
    assert set_up("hopper").algorithm == "loop"
    assert set_up("hopper", model="nominal").algorithm == "shac"
    assert set_up("hopper", "fopg").algorithm == "fopg"
    without = dataclasses.replace(load_task("hopper"), name="without_system", system=None)
    assert recommended(without) == "shac"


@pytest.mark.parametrize(("option", "told"), [("", ""), ('<option iterations="1"/>', "stops after 1 iteration")])
def test_a_run_tells_where_mujoco_stops_early(option: str, told: str, tmp_path: Path) -> None:
    """A policy of solved contacts fell in 5 of 5 in a file that allows one iteration, and in none with a hundred."""
    file = tmp_path / "ball.xml"
    file.write_text(
        f'<mujoco>{option}<worldbody><geom type="plane" size="9 9 1"/><body pos="0 0 .2"><freejoint/>'
        '<geom size=".1"/></body></worldbody></mujoco>'
    )
    found = _early(ComplementarityModel(Scene.from_mjcf(file)))
    assert told in found
    assert bool(found) == bool(told)
