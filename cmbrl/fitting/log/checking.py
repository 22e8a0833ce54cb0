"""Whether a log is what it says, by what its file predicts of it: checked before a fit begins.

Of a robot that steps slowly, checks take longer than some fits may: their time is a share of the fit's. What a killed
fit has checked is not checked again.
"""

from __future__ import annotations

from dataclasses import asdict

from cmbrl.data.plausible.finding import Finding
from cmbrl.errors import UserError
from cmbrl.fitting.log.columns import ColumnsCheck
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.log.mount import MountCheck
from cmbrl.fitting.log.rate import RateCheck
from cmbrl.fitting.state import Journal, OutOfTime

_SHARE, _LEAST = 0.2, 3.0  # of the time of a fit; [s] for each check


def checked(
    evidence: Evidence, horizon: int, huber: float, seed: int, journal: Journal, limit: float
) -> tuple[str, ...]:
    """Tells of what is wrong with the log, and returns what could not be checked in a share of ``limit`` [s].

    ``horizon``: of the fit. Raises UserError for what is surely wrong; then the folder of the ``journal`` is as it was.
    """
    checks: dict[str, RateCheck | MountCheck | ColumnsCheck] = {}
    if evidence.positions_only:
        checks["rate"] = RateCheck(evidence, horizon, huber, seed, journal)
    checks["mount"] = MountCheck(evidence, huber, seed, journal)
    checks["columns"] = ColumnsCheck(evidence, huber, seed, journal)
    left = []
    for name, check in checks.items():
        journal.report(0.0, f"checking the log: {name}")
        with journal.until(journal.spent + max(_SHARE * limit / len(checks), _LEAST)):
            try:
                found = _found(check, journal, name)
            except OutOfTime:
                left.append(name)
                continue
        try:
            if found is not None:
                found.tell()
        except UserError:
            journal.discard()
            raise
    journal.cuts = 0  # of the fit, none
    return tuple(left)


def _found(check: RateCheck | MountCheck | ColumnsCheck, journal: Journal, name: str) -> Finding | None:
    def compute() -> dict[str, object]:
        found = check.finding()
        return {"found": None if found is None else asdict(found)}

    found = journal.unit(f"check of {name}", compute)["found"]
    return None if found is None else Finding(**found)


def unchecked_told(left: tuple[str, ...] | list[str]) -> str:
    """One line on what was ``left`` unchecked; empty if nothing was."""
    return f"not checked for lack of time: the log's {', '.join(left)}; give more by --time-limit" if left else ""
