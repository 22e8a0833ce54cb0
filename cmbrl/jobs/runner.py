"""Runs the jobs that are not done yet. A killed run goes on, a killed worker costs its job, an error stops no other."""

from __future__ import annotations

import signal
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed
from joblib.externals.loky.process_executor import BrokenProcessPool

from cmbrl.errors import UserError
from cmbrl.files import make_folder, remove_leftovers
from cmbrl.jobs.backends import backend
from cmbrl.jobs.job import Job
from cmbrl.jobs.store import MISSING, Accept, Store
from cmbrl.runs import environment

Progress = Callable[[float, str], object]  #: called with the share that is done, 0 to 1, and what is being done
ATTEMPTS = 3  #: times in a row that workers may die without a job being done


class JobError(Exception):
    """A job raised an exception. The message names the job; ``details`` is its traceback."""

    def __init__(self, message: str, details: str) -> None:
        super().__init__(message)
        self.details = details


@dataclass(frozen=True)
class Outcome:
    """A result and where it was ``made``, or what went wrong; ``user``: the error is one that the user can fix."""

    value: Any = None
    made: Mapping[str, Any] = field(default_factory=dict)
    error: str | None = None
    details: str = ""
    user: bool = False


@dataclass
class Runner:
    """Jobs whose results are kept in ``folder``.

    n_jobs: workers, of one thread each. With one worker on this machine, jobs run in this process.
    backend: "loky" (processes of this machine), "ray" or "dask".
    accept: which kept results count, see :data:`cmbrl.jobs.store.Accept`.
    progress: called after every job.
    seeds_a_job: how many seeds one job computes side by side.
    """

    folder: Path
    n_jobs: int = 1
    backend: str = "loky"
    accept: Accept = "exact"
    progress: Progress = field(default=lambda share, text: None)
    seeds_a_job: int = 1
    _seeds: set[Any] = field(default_factory=set)

    @property
    def seeds(self) -> int:
        """How many seeds the jobs had so far, counting those without one as one."""
        return max(1, len(self._seeds)) * self.seeds_a_job

    def run(
        self, jobs: Sequence[Job], what: str = "job", share: tuple[float, float] = (0.0, 1.0), alone: bool = False
    ) -> list[Any]:
        """The results in the order of ``jobs``; what is kept already is not computed again.

        what: a word for progress. share: the part of all work that these jobs are. alone: one at a time in this
        process, for jobs that take times.
        Raises UserError or JobError for the first job that failed, after all others are done and kept.
        """
        store, kept = Store(self.folder, self.accept), Store(self.folder, "code")
        self._seeds |= {job.inputs["seed"] for job in jobs if "seed" in job.inputs}
        results = {job.file: store.get(job) for job in jobs}
        if len(results) < len(jobs):
            raise ValueError(f"two jobs share a name among {sorted(job.name for job in jobs)}")
        waiting = [job for job in jobs if results[job.file] is MISSING]

        def done(job: Job, outcome: Outcome) -> None:
            if outcome.error is None and kept.get(job) is MISSING:  # made where this folder is out of sight
                kept.put(job, outcome.value, outcome.made)
            count = sum(value is not MISSING for value in results.values())
            self.progress(share[0] + (share[1] - share[0]) * count / len(jobs), f"{what} {count} of {len(jobs)}")

        remove_leftovers(make_folder(self.folder))
        failed: list[tuple[Job, Outcome]] = []
        for job, outcome in self._outcomes(waiting, alone):
            results[job.file] = outcome.value
            if outcome.error is not None:
                failed.append((job, outcome))
            done(job, outcome)
        if failed:
            job, outcome = min(failed, key=lambda pair: jobs.index(pair[0]))
            if outcome.user:
                raise UserError(outcome.error or "")
            raise JobError(f"{job.name}: {outcome.error}", outcome.details)
        if lost := [job.name for job in jobs if results[job.file] is MISSING]:
            raise JobError(f"{lost[0]}: the back end returned nothing for it", "")
        return [results[job.file] for job in jobs]

    def _outcomes(self, jobs: Sequence[Job], alone: bool) -> Any:
        """Pairs of job and outcome, as they end."""
        if alone or (self.n_jobs == 1 and self.backend == "loky"):
            yield from ((job, compute(job, self.folder)) for job in jobs)
            return
        waiting, fruitless = list(jobs), 0
        while waiting:
            before = len(waiting)
            try:
                for name, outcome in self._parallel(tuple(waiting)):  # joblib takes from it as jobs end
                    job = next(job for job in waiting if job.name == name)
                    waiting.remove(job)
                    yield job, outcome
            except BrokenProcessPool:  # a worker died; what the others have kept is done
                kept = Store(self.folder)
                for job in [job for job in waiting if kept.get(job) is not MISSING]:
                    waiting.remove(job)
                    yield job, Outcome(kept.get(job))
            fruitless = fruitless + 1 if len(waiting) == before else 0
            if fruitless == ATTEMPTS:
                raise JobError(f"{waiting[0].name}: its worker died {ATTEMPTS} times", "")

    def _parallel(self, jobs: Sequence[Job]) -> Any:
        if not jobs:
            return
        workers = min(self.n_jobs, max(2, len(jobs)))  # a single one would be this process, and no job may end that
        with backend(self.backend, workers):
            # Ray and Dask have no generators: results come back together, but each worker keeps its own at once.
            how = {"return_as": "generator_unordered"} if self.backend == "loky" else {}
            yield from Parallel(n_jobs=workers, batch_size=1, **how)(delayed(_named)(job, self.folder) for job in jobs)


def _named(job: Job, folder: Path) -> tuple[str, Outcome]:
    return job.name, compute(job, folder)


@contextmanager
def _all_of_it() -> Iterator[None]:
    """Raises KeyboardInterrupt after a body that Ctrl-C has cut short, even where it returned what it had so far.

    A fit and the training of an ensemble do so, and their half of a result must not be kept.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    caught: list[int] = []

    def note(number: int, frame: Any) -> None:
        caught.append(number)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if caught:
        raise KeyboardInterrupt


def compute(job: Job, folder: Path) -> Outcome:
    """Runs one job with one thread for torch, and keeps its result where this process sees the folder."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with _all_of_it():
            value = job.run()
    except UserError as error:
        return Outcome(error=str(error), user=True)
    except Exception as error:
        return Outcome(error=f"{type(error).__name__}: {error}", details=traceback.format_exc())
    finally:
        torch.set_num_threads(threads)
    store, made = Store(folder), environment()
    if store.reachable():
        store.put(job, value, made)
    return Outcome(value, made)
