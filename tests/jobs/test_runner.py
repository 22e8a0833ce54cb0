"""Jobs are kept, resumed and told apart; workers that die cost their job; Ray and Dask give the bits of one process."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import pytest

from cmbrl import UserError
from cmbrl.files import read_record, write_record
from cmbrl.jobs import Job, JobError, Runner
from cmbrl.jobs.job import plain

MODULE = """
import os, signal, time
from pathlib import Path
import numpy as np
from cmbrl.errors import UserError

def noise(seed, log):
    with open(log, "a") as file:
        file.write(f"{seed}\\n")
    return {"seed": seed, "sum": float(np.random.default_rng(seed).normal(size=1000).sum()), "bad": float("inf")}

def dies_once(seed, log):
    marker = Path(log).with_name(f"died_{seed}")
    if seed == 2 and not marker.exists():
        marker.touch()
        time.sleep(0.5)
        os.kill(os.getpid(), signal.SIGKILL)
    return noise(seed, log)

def dies(seed):
    os.kill(os.getpid(), signal.SIGKILL)

def sleeps(seed, log):
    Path(log).with_name(f"pid_{seed}").write_text(str(os.getpid()))
    time.sleep(120)

def returns_early(seed, log):
    try:  # as a fit, which returns its best so far
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(60)
    except KeyboardInterrupt:
        return noise(seed, log)

def fails(seed, log):
    if seed == 1:
        raise ZeroDivisionError("no such number")
    if seed == 3:
        raise UserError("seed 3: choose another")
    return noise(seed, log)
"""


@pytest.fixture
def work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A module of functions that workers can import, too."""
    (tmp_path / "job_functions.py").write_text(MODULE, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    monkeypatch.delitem(sys.modules, "job_functions", raising=False)
    import job_functions

    return job_functions


def jobs(function, count: int, tmp_path: Path) -> list[Job]:
    return [Job(f"seed {k}", function, {"seed": k, "log": str(tmp_path / "log")}) for k in range(count)]


def calls(tmp_path: Path) -> list[int]:
    return sorted(map(int, (tmp_path / "log").read_text().split()))


def test_results_are_kept_and_say_where_they_are_from(work, tmp_path: Path) -> None:
    runner = Runner(tmp_path / "kept")
    first = runner.run(jobs(work.noise, 3, tmp_path))
    assert [x["seed"] for x in first] == [0, 1, 2]
    assert first[0]["bad"] == "inf"
    assert runner.run(jobs(work.noise, 4, tmp_path))[:3] == first
    assert calls(tmp_path) == [0, 1, 2, 3]  # only the new one was computed
    held = json.loads((tmp_path / "kept" / "seed_1.json").read_text())
    assert held["value"] == first[1]
    assert held["key"]["inputs"]["seed"] == 1
    assert {"commit", "hardware", "versions", "started"} <= held["made"].keys()


def test_other_inputs_code_or_machine_are_other_results(work, tmp_path: Path) -> None:
    kept, job = tmp_path / "kept", jobs(work.noise, 1, tmp_path)[0]
    Runner(kept).run([job])
    file = kept / job.file
    whole = read_record(file, "")

    def again(change, accept: str = "exact") -> bool:
        """Whether the job runs again after its file was changed."""
        held = json.loads(json.dumps(whole))
        change(held)
        write_record(file, held)
        before = len(calls(tmp_path))
        Runner(kept, accept=accept).run([job])
        return len(calls(tmp_path)) > before

    assert not again(lambda held: None)
    assert again(lambda held: held["key"]["inputs"].update(seed=7), "any")
    assert again(lambda held: held["key"].update(code="other"))
    assert again(lambda held: held["key"].update(code="other"), "code")
    assert not again(lambda held: held["key"].update(code="other"), "any")
    assert again(lambda held: held["made"]["hardware"].update(processor="other"))
    assert not again(lambda held: held["made"]["hardware"].update(processor="other"), "code")
    assert again(lambda held: held["made"]["versions"].update(numpy="other"))
    assert not again(lambda held: held["made"]["versions"].update(numpy="other"), "code")
    file.write_text("{")
    Runner(kept).run([job])
    assert json.loads(file.read_text())["value"] == whole["value"]


@pytest.mark.parametrize("n_jobs", [1, 2])
def test_a_failing_job_stops_no_other(work, tmp_path: Path, n_jobs: int) -> None:
    runner = Runner(tmp_path / "kept", n_jobs)
    with pytest.raises(JobError, match="seed 1: ZeroDivisionError: no such number") as error:
        runner.run(jobs(work.fails, 3, tmp_path))
    assert "Traceback" in error.value.details
    assert calls(tmp_path) == [0, 2]
    with pytest.raises(UserError, match="seed 3: choose another"):
        runner.run(jobs(work.fails, 4, tmp_path)[2:])


def test_half_a_result_is_not_kept(work, tmp_path: Path) -> None:
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        Runner(tmp_path / "kept").run(jobs(work.returns_early, 1, tmp_path))
    assert calls(tmp_path) == [0]
    assert list((tmp_path / "kept").iterdir()) == []
    assert signal.getsignal(signal.SIGINT) is handler


def test_the_first_failure_in_the_order_of_jobs_is_reported(work, tmp_path: Path) -> None:
    runner = Runner(tmp_path / "kept", 2)
    for _ in range(3):
        with pytest.raises(JobError, match="seed 1:"):
            runner.run(jobs(work.fails, 4, tmp_path))


def test_two_workers_do_every_job(work, tmp_path: Path) -> None:
    """More jobs than joblib hands out at first: those that end early must not displace those that wait."""
    alone = Runner(tmp_path / "alone").run(jobs(work.noise, 40, tmp_path))
    (tmp_path / "log").unlink()
    assert Runner(tmp_path / "together", n_jobs=2).run(jobs(work.noise, 40, tmp_path)) == alone
    assert calls(tmp_path) == list(range(40))


def test_a_killed_worker_costs_only_time(work, tmp_path: Path) -> None:
    alone = Runner(tmp_path / "alone").run(jobs(work.noise, 5, tmp_path))
    (tmp_path / "log").unlink()
    together = Runner(tmp_path / "together", n_jobs=2).run(jobs(work.dies_once, 5, tmp_path))
    assert together == alone
    with pytest.raises(JobError, match="seed: its worker died 3 times"):
        Runner(tmp_path / "dead", n_jobs=2).run([Job("seed", work.dies, {"seed": k}) for k in (0,)])


def test_workers_end_with_a_killed_driver(work, tmp_path: Path) -> None:
    program = (
        "import job_functions; from pathlib import Path; from cmbrl.jobs import Job, Runner; "
        f"jobs = [Job(f'seed {{k}}', job_functions.sleeps, {{'seed': k, 'log': {str(tmp_path / 'log')!r}}}) "
        f"for k in (0, 1)]; Runner(Path({str(tmp_path / 'kept')!r}), 2).run(jobs)"
    )
    driver = subprocess.Popen([sys.executable, "-c", program])
    files = [tmp_path / f"pid_{k}" for k in (0, 1)]
    assert within(60, lambda: all(file.exists() and file.read_text() for file in files))
    driver.kill()
    driver.wait()
    assert within(30, lambda: not any(alive(int(file.read_text())) for file in files))


def within(seconds: float, true) -> bool:
    """Whether ``true()`` comes true in time."""
    end = time.monotonic() + seconds
    while not true() and time.monotonic() < end:
        time.sleep(0.1)
    return bool(true())


def alive(pid: int) -> bool:
    state = Path(f"/proc/{pid}/stat")
    return state.exists() and state.read_text().split(")")[-1].split()[0] != "Z"


@pytest.mark.parametrize(
    ("backend", "package"), [pytest.param("ray", "ray", marks=pytest.mark.slow), ("dask", "distributed")]
)
def test_a_cluster_gives_the_bits_of_one_process(work, tmp_path: Path, backend: str, package: str) -> None:
    if find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    alone = Runner(tmp_path / "alone").run(jobs(work.noise, 5, tmp_path))
    (tmp_path / "log").unlink()
    cluster = Runner(tmp_path / "cluster", n_jobs=2, backend=backend).run(jobs(work.dies_once, 5, tmp_path))
    assert cluster == alone
    assert (tmp_path / "died_2").exists()


def test_what_jobs_refuse(work, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="share a name"):
        Runner(tmp_path).run([*jobs(work.noise, 1, tmp_path)] * 2)
    with pytest.raises(UserError, match="unknown back end 'rays': did you mean 'ray'"):
        Runner(tmp_path / "kept", 2, "rays").run(jobs(work.noise, 2, tmp_path))
    with pytest.raises(TypeError, match="a path is no input of a job"):
        plain({"file": tmp_path})
