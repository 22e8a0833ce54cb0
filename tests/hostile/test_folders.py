"""A damaged folder is right or refused in one line: never wrong without a word, no traceback, crash or hang."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cmbrl.errors import UserError
from cmbrl.files import read_record, write_record
from cmbrl.fitting import FitResult
from cmbrl.registry import load_task

from . import folders_victims as victims
from .folders_cases import cases, faults
from .folders_victims import VICTIMS
from .judge import REFUSED, command

NEEDS = {"minari, load": ("minari", "h5py"), "train, resume": ("gymnasium",), "policy, play": ("gymnasium",)}
QUICK = ("fit, load", "policy, export", "ensemble, error", "minari, load")


def _check(name: str, seeds: range, place: Path) -> None:
    for package in NEEDS.get(name, ()):
        pytest.importorskip(package)
    found = list(cases(name, seeds, place))
    counts = Counter(case.outcome.kind for case in found)
    print(name, dict(counts))
    assert not faults(found), "\n".join(faults(found))
    assert counts[REFUSED]


@pytest.mark.parametrize("name", QUICK)
def test_a_few_of_everything(name: str, tmp_path: Path) -> None:
    _check(name, range(6), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", VICTIMS)
def test_hundreds_of_everything(name: str, tmp_path: Path) -> None:
    _check(name, range(1000, 1300), tmp_path)


@pytest.fixture(scope="module")
def fit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a log and, in victim, a fit."""
    place = tmp_path_factory.mktemp("fit")
    victims.make_fit(place, 0)
    return place


def _copy(fit: Path, to: Path) -> Path:
    for file in (fit / "victim").iterdir():
        (to / file.name).write_bytes(file.read_bytes())
    return to


def _compare(fit: Path, folder: Path, *more: str) -> str:
    return command("error", "--data", fit / "log.npz", folder, "--horizons", 1, "--threads", 1, *more)


@pytest.mark.parametrize("with_checksum", [False, True])
def test_a_model_without_one_of_its_parameters_is_refused(fit: Path, tmp_path: Path, with_checksum: bool) -> None:
    file = _copy(fit, tmp_path) / "model.json"
    held = read_record(file, "")
    del held["settings"]["parameters"]["gear.leg_joint"]
    if with_checksum:  # made so, in both files
        fitted = read_record(tmp_path / "fit.json", "")
        del fitted["parameters"]["gear.leg_joint"]
        write_record(file, held)
        write_record(tmp_path / "fit.json", fitted)
    else:
        file.write_text(json.dumps(held))
    with pytest.raises(UserError, match=r"model\.json.*(gear\.leg_joint|damaged).*fit again"):
        _compare(fit, tmp_path)


def test_a_fit_that_was_not_finished_is_refused(fit: Path, tmp_path: Path) -> None:
    (_copy(fit, tmp_path) / "fit.json").unlink()
    with pytest.raises(UserError, match=r"not finished \(fit\.json is missing\).*--resume"):
        _compare(fit, tmp_path)


def test_files_of_two_fits_are_refused(fit: Path, tmp_path: Path) -> None:
    held = read_record(_copy(fit, tmp_path) / "model.json", "")
    held["settings"]["parameters"]["gear.leg_joint"] *= 1.01
    write_record(tmp_path / "model.json", held)
    with pytest.raises(UserError, match="not of the same fit"):
        _compare(fit, tmp_path)


def test_the_task_of_a_fit_does_not_hang_on_its_configuration(fit: Path, tmp_path: Path) -> None:
    (_copy(fit, tmp_path) / "config.json").unlink()
    told = [json.loads(_compare(fit, folder, "--json"))["contact_gap"] for folder in (fit / "victim", tmp_path)]
    assert told[0] == told[1] == load_task("hopper").contact_gap


def test_a_checkpoint_with_an_optimiser_of_another_shape_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("gymnasium")
    from cmbrl.train.running.checkpoint import load_state, save_state

    victims.make_train(tmp_path, 0)
    file = tmp_path / "victim" / "checkpoint.safetensors"
    state = load_state(file)
    moments = state["trainer"]["optimiser"][0]["state"][0]
    moments["exp_avg"] = moments["exp_avg"][:-1].clone()
    save_state(file, state)
    capsys.readouterr()
    with pytest.raises(
        UserError, match=r"checkpoint\.safetensors: does not belong to this run \(exp_avg of the optimiser"
    ):
        victims.resume_train(tmp_path)


def test_metrics_that_were_lost_come_back_from_the_checkpoint(tmp_path: Path) -> None:
    pytest.importorskip("gymnasium")
    victims.make_train(tmp_path, 0)
    whole = (tmp_path / "victim" / "metrics.csv").read_text()
    (tmp_path / "victim" / "metrics.csv").unlink()
    victims.resume_train(tmp_path)
    assert (tmp_path / "victim" / "metrics.csv").read_text().startswith(whole)


def test_a_log_whose_fit_is_singular_is_refused(tmp_path: Path) -> None:
    held = dict(np.load(victims.log(tmp_path)))
    held["v"][[4, 40], [2, 4]] = 1.5e4, -1.5e4  # a single step is still that of a robot, eight are not
    np.savez(tmp_path / "wild.npz", **held)
    words = ["--method", "random", "--horizon", 8, "--groups", "gear", "--threads", 1]
    with pytest.raises(UserError, match="the fit is not finite: check the log"):
        command("fit", "hopper", "--data", tmp_path / "wild.npz", *words, "--out", tmp_path / "out")
    with pytest.raises(UserError, match="contains neither a fit"):
        _compare(tmp_path, tmp_path / "out")


def test_a_result_that_is_not_finite_leaves_no_fit(fit: Path, tmp_path: Path) -> None:
    found = FitResult.load(fit / "victim")
    with pytest.raises(UserError, match="the fit is not finite: check the log"):
        replace(found, report={**found.report, "huber": float("inf")}).save(tmp_path / "out")
    assert not list((tmp_path / "out").iterdir())
