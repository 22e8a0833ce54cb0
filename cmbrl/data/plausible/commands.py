"""Commands against motion: swapped joints, a wrong sign, saturation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.motion import Motion

ROWS = 200  #: fewer do not show which command moves which joint
SATURATED = 0.2  #: share of samples at a limit that is worth a warning
FOLLOWS = 0.5  #: correlation of a position with its target
SIGNIFICANT = 10.0  #: standard errors
MOST = 20000  #: rows of a regression
AT_STOP = 0.02  #: share of a joint's range on either side of a limit where the stop may push it
STRIDE = 4  #: samples over which accelerations are taken from positions alone


def servos(motion: Motion, answers: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Iterator[Finding]:
    """Positions that follow another target than their own, or follow it backwards."""
    best, worst, slope = answers
    if len(motion.now) < ROWS:
        return
    own, count = np.nan_to_num(np.diagonal(best)), len(motion.drivers)
    for a in range(count):
        for b in range(a + 1, count):
            across = np.nan_to_num(min(best[a, b], best[b, a]))
            if across > 0.5 and max(own[a], own[b]) < across - 0.3:
                yield _pair(motion, a, b)
    for m in range(count):
        if -worst[m, m] > 0.5 and best[m, m] < 0.4 * -worst[m, m] and -2.0 < slope[m, m] < -0.4:
            yield Finding(
                f"{motion.position_of(motion.drivers[m].coordinate)} moves against {motion.command_of(m)} (correlation "
                f"{worst[m, m]:.2f}): a sign error; negate one of the two columns"
            )


def _pair(motion: Motion, a: int, b: int) -> Finding:
    first, second = (motion.coordinates[motion.drivers[m].coordinate].name for m in (a, b))
    return Finding(
        f"{motion.command_of(a)} explains the motion of joint {second!r}, and {motion.command_of(b)} that of joint "
        f"{first!r}, better than their own: {motion.kind} or {motion.command} of the two are swapped"
    )


def forces(motion: Motion, answers: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Iterator[Finding]:
    """Joints that accelerate against their force, or by that of another joint.

    Accelerations answer to forces by the inverse of the inertia, averaged over poses and contacts. That is positive
    definite whatever the masses are. So its diagonal is positive, and the product of what two joints answer to each
    other's forces is smaller than that of what they answer to their own. A light joint under a stiff servo is where it
    was told to be within a step, and its acceleration shows the other joints' forces instead of its own: two servos are
    swapped only if each joint also follows the other's target more than its own.
    """
    chosen = [m for m, driver in enumerate(motion.drivers) if not driver.position or motion.v_now is not None]
    best = np.nan_to_num(answers[0])
    follows = np.diagonal(best) > FOLLOWS  # a servo that does so is told by ``servos``
    fitted = _responses(motion, chosen) if chosen else None
    if fitted is None:
        return
    gain, error, spread, rest = fitted  # (joint, command); (joint, command); (command,); (joint,)

    def servos_alone(a: int, b: int) -> bool:
        return motion.drivers[a].position and motion.drivers[b].position

    def prefer_each_other(a: int, b: int) -> bool:
        return bool(min(best[a, b] - best[b, b], best[b, a] - best[a, a]) > 0.0)

    size = gain * spread  # change that a usual command makes
    sure = np.abs(gain) > SIGNIFICANT * error
    swapped = [
        (i, j)
        for i in range(len(chosen))
        for j in range(i + 1, len(chosen))
        if sure[i, j] and sure[j, i] and min(gain[i, j], gain[j, i]) > 0
        and gain[i, j] * gain[j, i] > 1.1 * abs(gain[i, i] * gain[j, j])
        and (not servos_alone(chosen[i], chosen[j]) or prefer_each_other(chosen[i], chosen[j]))
    ]  # fmt: skip
    yield from (_pair(motion, chosen[i], chosen[j]) for i, j in swapped)
    for i, m in enumerate(chosen):
        if sure[i, i] and size[i, i] < -0.3 * rest[i] and not swapped and not follows[m]:
            yield Finding(
                f"{motion.command_of(m)} pushes joint {motion.coordinates[motion.drivers[m].coordinate].name!r} the "
                f"wrong way ({gain[i, i] / error[i, i]:.0f} standard errors): a sign error in {motion.command}, or in "
                "its positions; negate one of the two columns"
            )


def _responses(motion: Motion, chosen: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """Robust linear answers of accelerations to commands, with standard errors; the commands' and rests' spread.

    Of each joint where it is away from its stops: one that is pushed against a stop answers to nothing. Infinite errors
    where it hardly ever is. A controller answers to loads, so that commands come with what pushes against them: what
    the last step's command and acceleration tell of that does not count.
    """
    at = [motion.drivers[m].coordinate for m in chosen]
    u = motion.u[:, chosen] * [np.sign(motion.drivers[m].scale) for m in chosen]
    if motion.v_now is not None and motion.v_after is not None:
        q, v, y = motion.now[:, at], motion.v_now[:, at], (motion.v_after - motion.v_now)[:, at]
        moves = motion.dt * np.maximum(np.abs(v), np.abs(motion.v_after[:, at]))
        free = _away_from_stops(motion, at, q, moves) & _away_from_stops(motion, at, motion.after[:, at], moves)
        before, later = _neighbours(motion.blocks)
        past = np.hstack([u[before], y[before]])
        if 2 * len(later) > len(y):  # else rows are in no order, and have no past
            q, v, y, u, free = q[later], v[later], y[later], u[later], free[later]
        else:
            past = np.zeros((len(y), 0))
    else:
        q, v, y, u = _from_positions(motion, at, u)
        free, past = _away_from_stops(motion, at, q, 2 * np.abs(v)), np.zeros((len(q), 0))
    take = np.unique(np.linspace(0, len(y) - 1, MOST).astype(int)) if len(y) else np.arange(0)
    q, v, y, u, free, past = (x[take] for x in (q, v, y, u, free, past))
    least = max(ROWS, 10 * u.shape[1])
    if len(y) < least:
        return None
    state = np.column_stack([np.ones(len(y)), _scaled(q), _scaled(v), _scaled(past)])
    forced = _beside(state, u)
    spread = forced.std(axis=0)
    if not (spread > 1e-9).all():  # a command that rests, or follows from the state: nothing is told
        return None
    if np.linalg.cond(forced / spread) > 30:
        return None
    shape = (y.shape[1], u.shape[1])
    gain, error, rest = np.zeros(shape), np.full(shape, np.inf), np.zeros(y.shape[1])
    for j in range(y.shape[1]):
        rows = free[:, j]
        if rows.sum() >= least:
            gain[j], error[j], rest[j] = _robust(_beside(state[rows], u[rows]), _beside(state[rows], y[rows, j]))
    return gain, error, spread, rest


def _neighbours(blocks: tuple[slice, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Rows (R,) that the next one continues, and those next ones."""
    before = [np.arange(one.start, one.stop - 1) for one in blocks if one.stop - one.start > 1]
    rows = np.concatenate(before) if before else np.zeros(0, int)
    return rows, rows + 1


def _away_from_stops(motion: Motion, at: list[int], q: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Where (N, n) no stop pushes at positions ``q`` of the coordinates ``at``; far beyond a limit, none is there.

    moves: (N, n) how far a joint may go within the step.
    """
    low, high = (np.array([getattr(motion.coordinates[k], side) for k in at]) for side in ("low", "high"))
    room = moves + np.where(np.isfinite(high - low), AT_STOP * (high - low), 0.0)
    return np.asarray((np.abs(q - low) > room) & (np.abs(q - high) > room))


def _beside(state: np.ndarray, x: np.ndarray) -> np.ndarray:
    """What of ``x`` (N, ...) is not linear in ``state`` (N, s)."""
    return np.asarray(x - state @ np.linalg.lstsq(state, x, rcond=1e-8)[0])


def _from_positions(
    motion: Motion, at: list[int], u: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities, second differences over some samples, and the commands between them, per block."""
    parts = []
    weights = np.concatenate([np.arange(1, STRIDE + 1), np.arange(STRIDE - 1, 0, -1)]) / STRIDE**2
    for block in motion.blocks:
        x, force = motion.now[block][:, at], u[block]
        if len(x) <= 2 * STRIDE:
            continue
        first, middle, last = x[: -2 * STRIDE], x[STRIDE:-STRIDE], x[2 * STRIDE :]
        mean = sum(w * force[k + 1 : len(force) - 2 * STRIDE + k + 1] for k, w in enumerate(weights))
        rows = slice(None, None, STRIDE)
        parts.append((first[rows], (middle - first)[rows], (last - 2 * middle + first)[rows], np.asarray(mean)[rows]))
    empty = np.zeros((0, len(at)))
    if not parts:
        return empty, empty, empty, empty
    joined = [np.concatenate(part) for part in zip(*parts, strict=True)]
    return joined[0], joined[1], joined[2], joined[3]


def _scaled(array: np.ndarray) -> np.ndarray:
    centred = array - array.mean(axis=0)
    spread = centred.std(axis=0)
    return centred / np.where(spread > 1e-12, spread, 1.0)


def _robust(u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Coefficients of y on u by Huber's weights, their robust standard errors, and the spread of the rest."""
    weight = np.ones(len(y))
    for _ in range(4):
        normal = np.linalg.pinv((u * weight[:, None]).T @ u)
        gain = normal @ ((u * weight[:, None]).T @ y)
        rest = y - u @ gain
        scale = 1.4826 * np.median(np.abs(rest)) + 1e-12
        weight = np.minimum(1.0, 1.5 * scale / np.maximum(np.abs(rest), 1e-300))
    score = u * (weight * rest)[:, None]
    error = np.sqrt(np.maximum(np.diagonal(normal @ (score.T @ score) @ normal), 0.0)) + 1e-300
    return gain, error, float(scale)


def saturation(motion: Motion) -> Iterator[Finding]:
    """A warning for commands that often are at the limit, where they tell little."""
    shares = {}
    for m, driver in enumerate(motion.drivers):
        if np.isfinite([driver.low, driver.high]).all() and driver.high > driver.low:
            u, room = motion.u[:, m], 1e-6 * (driver.high - driver.low)
            shares[m] = float(np.mean((u <= driver.low + room) | (u >= driver.high - room)))
    often = [m for m, share in shares.items() if share > SATURATED]
    if often:
        worst = max(often, key=shares.__getitem__)
        low, high = motion.drivers[worst].low, motion.drivers[worst].high
        more = f" (and {len(often) - 1} more)" if len(often) > 1 else ""
        yield Finding(
            f"{motion.command_of(worst)}{more} is at or beyond its limits {low:g} and {high:g} in {shares[worst]:.0%} "
            "of the samples: saturated, such rows tell little about the motor",
            sure=False,
        )
