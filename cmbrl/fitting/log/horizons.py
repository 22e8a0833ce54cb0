"""Over how many steps the predictions of a log are compared, before the noise of a start tells as much as its model.

Nothing pulls an arm under torques back to where it should be. Over half a second at full speed the noise of an encoder
may then grow as large as the motion: such errors tell of the start, not of masses and friction, and where they explode
no derivative leads anywhere. Nor does one where the file itself ends farther off than the robot has moved. A body on
wheels drifts as well, evenly: its starts are free (``start_noise``), and only what parts faster than that is too much.
"""

from __future__ import annotations

import numpy as np

from cmbrl.data.position_log import free_joint
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.fitting.search.folds import windows_in_blocks
from cmbrl.models.windows import noise_of_positions
from cmbrl.numbers import whole
from cmbrl.scene.records import JointKind

HORIZONS = (1, 4, 10, 20)  # 1 step is what noise-free logs are best judged at; beyond 20, impacts have happened
LEAST_WINDOWS = 40  # of a horizon, to fit and to judge
_LONGER, _NOISY_AHEAD = (50, 100, 200), 0.3  # of noisy logs besides; [s]: what is fast is over, and noise is small
_POSITIONS_AHEAD = 0.5  # [s]: several time constants of a position servo
_FLOATING_AHEAD, _ROLLING_AHEAD = 0.2, 0.4  # [s]
_CHECKED_AHEAD, _CHECKED_STEPS = 0.1, 10  # [s]: shorter steps of states are noise; and steps, at least
_STEADY = 1.5  # times as far as a drift would part them, or less
_SHARES = (1, 2, 4)  # of the steps: all, a half, a quarter
_LITTLE = 0.1  # of the change, that noise may grow to
_FAR = 1.0  # the same, by which the file may miss the log
_WINDOWS = 24
_OF_SPEED = 0.3  # of the noise by the time step: that of speeds, told by a few neighbouring samples


def horizons_of(evidence: Evidence, asked: int | str) -> tuple[int, ...]:
    """Numbers of steps that predictions may be compared over: the one ``asked``, several to choose from if "auto".

    Of positions, half a second: at one step, their changes are noise. Less of a body that floats, since nothing pulls
    it back to where it should be, and of an arm whose torques do not; and as much less as a short log needs. Of noisy
    states in short steps, up to 0.3 s: 20 steps of 2 ms are noise, too. And of velocities that are slopes of positions,
    more than these have seen.
    """
    if asked != "auto":
        return (whole(asked, "horizon"),)
    if not evidence.positions_only:
        longer = (h for h in _LONGER if evidence.noisy and h * evidence.log.dt <= _NOISY_AHEAD)
        return tuple(h for h in (*HORIZONS, *longer) if h > evidence.sloped.max())
    floats = free_joint(evidence.model.scene) is not None
    on_wheels = floats and rolls(evidence)
    ahead = _ROLLING_AHEAD if on_wheels else _FLOATING_AHEAD if floats else _POSITIONS_AHEAD
    steps = range(round(ahead / evidence.log.dt), 1, -1)
    told = (h for h in steps if len(windows_in_blocks(evidence.log, h)) >= LEAST_WINDOWS)
    longest = next(told, 1)
    if on_wheels:
        return (told_of_rolling(evidence, longest),)
    return (longest if floats else told_by_model(evidence, longest),)


def checked_over(evidence: Evidence) -> int | None:
    """How many steps ahead a log is predicted to tell whether it is right; None of a log that is too short."""
    if evidence.positions_only:
        return horizons_of(evidence, "auto")[0]
    most = max(_CHECKED_STEPS, round(_CHECKED_AHEAD / evidence.log.dt))
    return next((h for h in range(most, 1, -1) if len(windows_in_blocks(evidence.log, h)) >= LEAST_WINDOWS), None)


def judged_over(evidence: Evidence) -> tuple[int, ...]:
    """Numbers of steps over which fits of some parameters or others are compared."""
    return HORIZONS if evidence.positions_only else horizons_of(evidence, "auto")


def told_by_model(evidence: Evidence, steps: int) -> int:
    """``steps``, or a half or a quarter where the noise of starts would grow too large in more, by the file.

    At most a half where the file itself ends too far off.
    """
    tried = sorted({max(1, steps // share) for share in _SHARES})
    parted = _parted(evidence, tried)
    astray, off = ({h: _rms(parted[h][k] / evidence.scales(h, 1.0)[0].q) for h in tried} for k in (0, 1))
    if off[steps] > _FAR and len(tried) > 1:
        tried = tried[:-1]
    return max((h for h in tried[1:] if astray[h] <= _LITTLE), default=tried[0])


def rolls(evidence: Evidence) -> bool:
    """Whether some hinge turns without end, and no position servo holds it: a wheel, of a body that floats."""
    scene, holds = evidence.model.scene, evidence.observation.holds
    held = {*scene.core.act_line[: len(holds)][holds].tolist(), *scene.core.lim_line.tolist()}
    return any(joint.kind == JointKind.HINGE and joint.vadr not in held for joint in scene.joints)


def told_of_rolling(evidence: Evidence, steps: int) -> int:
    """``steps`` of a body on wheels, or half where starts that are off part faster than they drift, by the file.

    Such starts are free: a drift says nothing against more steps, but chaos after impacts does.
    """
    half, unit = max(1, steps // 2), evidence.scales(steps, 1.0)[0].q
    parted = _parted(evidence, [half, steps])
    before, after = (_rms(parted[h][0] / unit) for h in (half, steps))
    return steps if np.isfinite(after) and after <= _STEADY * steps / half * before else half


def _parted(evidence: Evidence, tried: list[int]) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """By number of steps: how far (s, nv) starts off by noise lead from others, and the others from the log."""
    physical, log = evidence.seen(evidence.space.nominal)
    scene, model, longest = evidence.model.scene, evidence.model, tried[-1]
    starts = log.windows(longest)
    starts = starts[np.linspace(0, len(starts) - 1, min(_WINDOWS, len(starts))).astype(np.int64)]
    noise, draw = noise_of_positions(scene, evidence.log), np.random.default_rng(0)
    off, faster = (noise * draw.choice([-1.0, 1.0], size=(len(starts), scene.nv)) for _ in range(2))
    q = np.concatenate([log.q[starts], scene.integrate(log.q[starts], off)])
    v = np.concatenate([log.v[starts], log.v[starts] + _OF_SPEED / log.dt * faster])
    found = {}
    for j in range(longest):
        step = model.predict(q, v, np.tile(log.u[starts + j], (2, 1)), theta=physical)
        q, v = step.q_next, step.v_next
        if j + 1 in tried:
            off_log = scene.difference(log.q_next[starts + j], q[: len(starts)])
            found[j + 1] = scene.difference(*np.split(q, 2)), off_log
    return found


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.nan_to_num(x**2, nan=np.inf).mean()))
