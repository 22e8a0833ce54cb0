"""kill -9 at random moments: what is run again ends with the same bits, and no reader takes a part for the whole."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest

from .disk_writers import inputs
from .kill_runs import RUNS, finish, kill

KILLS = {"record": 8, "record minari": 6, "fit": 10, "train": 10, "sweep": 8, "bench": 6}  # 48 in all


def _check(name: str, kills: int, seed: int, place: Path) -> None:
    pytest.importorskip("gymnasium")
    run, rng = RUNS[name], random.Random(seed)
    whole, work = place / "whole", place / "work"
    inputs(whole)
    shutil.copytree(whole, work)
    usual = finish(run, whole)
    expected = run.result(whole)
    done = 0
    for _ in range(3 * kills):
        if done == kills:
            break
        if kill(run, work, rng, usual):
            done += 1
        else:  # it had ended
            assert run.result(work) == expected
            shutil.rmtree(work)
            work.mkdir()
            shutil.copytree(whole / "in", work / "in")
    if not (name.startswith("record") and any((work / out).exists() for out in ("log.npz", "minari"))):
        finish(run, work)
    assert run.result(work) == expected
    assert done == kills
    left = [file.name for file in work.rglob(".*.tmp*")]
    assert name.startswith("record") or not left, left


@pytest.mark.slow
def test_a_killed_run_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    _check("fit quick", 1, 1, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", KILLS)
def test_many_kills(name: str, tmp_path: Path) -> None:
    _check(name, KILLS[name], 0, tmp_path)
