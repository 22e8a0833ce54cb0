"""Cells of a study in worker processes of one thread each, so that a cell's processor time is its own."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import Any

import torch


def compute(
    function: Callable[..., Any], jobs: Sequence[tuple[Any, ...]], workers: int, told: Callable[[int], object]
) -> list[Any]:
    """``function(*job)`` of every job, in order; ``told`` is called with how many are done. One worker: in here.

    Function and jobs travel to other processes, so both have to be picklable. The first error ends it all.
    """
    if workers == 1 or len(jobs) < 2:
        torch.set_num_threads(1)
        results = []
        for k, job in enumerate(jobs):
            told(k)
            results.append(function(*job))
        return results
    with ProcessPoolExecutor(min(workers, len(jobs)), get_context("spawn"), _prepare) as pool:
        futures = [pool.submit(function, *job) for job in jobs]
        try:
            for k, future in enumerate(as_completed(futures)):
                future.result()
                told(k + 1)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        return [future.result() for future in futures]


def _prepare() -> None:
    torch.set_num_threads(1)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A study that was killed must not leave its workers behind, which its pool would."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
