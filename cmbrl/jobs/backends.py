"""Where jobs run: worker processes of this machine (loky), a Ray cluster or a Dask cluster, all through joblib.

Ray and Dask connect to the cluster that RAY_ADDRESS or DASK_SCHEDULER_ADDRESS names; without that, they start one here.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread
from typing import Any

from joblib import parallel_config

from cmbrl.errors import UserError, did_you_mean

BACKENDS = ("loky", "ray", "dask")


@contextmanager
def backend(name: str, n_jobs: int) -> Iterator[None]:
    """Makes ``name`` the back end of joblib inside ``with``, for ``n_jobs`` workers of one thread each.

    Raises UserError for an unknown name and for a library that is not installed.
    """
    if name not in BACKENDS:
        raise UserError(f"unknown back end {name!r}: {did_you_mean(name, BACKENDS)}")
    starts: Any = {"loky": _loky, "ray": _ray, "dask": _dask}[name]
    with starts(n_jobs):
        yield


@contextmanager
def _loky(n_jobs: int) -> Iterator[None]:
    ends: Any = {"initializer": _end_with, "initargs": (os.getpid(),)}
    with parallel_config(backend="loky", n_jobs=n_jobs, inner_max_num_threads=1, **ends):
        yield


def _end_with(driver: int) -> None:
    """Ends this worker when its driver is gone, for a killed driver ends no workers, which would compute on."""

    def watch() -> None:
        while os.getppid() == driver:
            time.sleep(1)
        os._exit(1)

    Thread(target=watch, daemon=True).start()


@contextmanager
def _ray(n_jobs: int) -> Iterator[None]:
    try:
        import ray
        from ray.util.joblib import register_ray
    except ImportError:
        raise UserError("ray is not installed: pip install 'cmbrl[ray]'") from None
    started = not ray.is_initialized()
    if started and "RAY_ADDRESS" in os.environ:
        ray.init(log_to_driver=False)
    elif started:
        ray.init(num_cpus=n_jobs, include_dashboard=False, log_to_driver=False)
    register_ray()
    # A worker that dies is restarted, and what it was doing is done again; Ray's default is to give up.
    survive = {"max_restarts": -1, "max_task_retries": -1}
    try:
        with parallel_config(backend="ray", n_jobs=n_jobs, ray_remote_args=survive):
            yield
    finally:
        if started:
            ray.shutdown()


@contextmanager
def _dask(n_jobs: int) -> Iterator[None]:
    try:
        from distributed import Client
    except ImportError:
        raise UserError("dask.distributed is not installed: pip install 'cmbrl[dask]'") from None
    address = os.environ.get("DASK_SCHEDULER_ADDRESS")
    local = {"n_workers": n_jobs, "threads_per_worker": 1, "dashboard_address": None}
    with Client(address) if address else Client(**local) as client, parallel_config(backend="dask", n_jobs=n_jobs):
        assert client is not None
        yield
