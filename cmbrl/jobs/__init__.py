"""Many independent computations: each is kept when it is done, on one core, many cores or many machines."""

from cmbrl.jobs.job import Job
from cmbrl.jobs.runner import JobError, Runner

__all__ = ["Job", "JobError", "Runner"]
