"""Mutated npz, MJCF, YAML, command lines and calls: each case is right, or refused in one line."""

from __future__ import annotations

import random
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from . import api_calls, argument_lists, judge, mjcf_files, npz_files, yaml_files

KINDS = {"npz": npz_files, "mjcf": mjcf_files, "yaml": yaml_files, "arguments": argument_lists, "api": api_calls}
CASES = 1000


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> ModuleType:
    """A kind of input, with what every case imports already imported: cases run in forks."""
    import cmbrl.accuracy.compare
    import cmbrl.cli.train
    import cmbrl.train.setup  # noqa: F401

    module = KINDS[request.param]
    for prepare in ("logs", "sound"):
        getattr(module, prepare, list)()
    return module


@settings(
    max_examples=20,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(rng=st.randoms(use_true_random=False))
def test_some_hostile_cases(kind: ModuleType, tmp_path: Path, rng: random.Random) -> None:
    judge.check(kind.draw, rng, tmp_path)


@pytest.mark.slow
def test_thousands_of_hostile_cases(kind: ModuleType, tmp_path: Path) -> None:
    counts, faults = judge.count(kind.draw, CASES, tmp_path, seed=1)
    print(f"{kind.__name__}: {dict(counts)}")
    assert not faults, f"{dict(counts)}\n" + "\n--\n".join(faults)


@pytest.mark.parametrize(
    ("run", "found"),
    [
        (lambda: judge.RIGHT, judge.RIGHT),
        (lambda: judge.command("info"), judge.REFUSED),
        (lambda: 1 // 0, judge.TRACEBACK),
        (lambda: judge.require(False, "wrong"), judge.WRONG),
        (lambda: __import__("os").kill(__import__("os").getpid(), 11), judge.CRASH),
        (lambda: __import__("time").sleep(60), judge.HANG),
    ],
)
def test_the_judge_tells_faults_apart(run, found):
    assert judge.outcome(run, seconds=3.0)[0] == found
