"""How accelerations answer to commands: a robust regression beside what the state tells, and what noise does to it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cmbrl.data.plausible.motion import Motion, white_noise

ROWS = 200  #: fewer do not show which command moves which joint
MOST = 20000  #: rows of a regression
AT_STOP = 0.02  #: share of a joint's range on either side of a limit where the stop may push it
HIDES = 0.67  #: share of the variance that commands leave of an acceleration
USUAL = 20.0  #: times the median
SLOW = 0.05  #: [s] over which the noise of encoders is small beside what torques do
LATE = 5  #: of it that commands may be late by, which are tried
STRIDE = 4  #: samples over which accelerations are taken from positions alone
Responses = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def of_noise(motion: Motion, chosen: list[int]) -> np.ndarray:
    """What noise of velocities adds to the answers (joint, command): what as much noise again adds; 0 without them."""
    own, noisier = _rows(motion, chosen), _noisier(motion)
    more = None if own is None or noisier is None else _rows(noisier, chosen)
    if own is None or more is None:
        return np.zeros((len(chosen), len(chosen)))
    found = []
    for added, free in zip((more.y - own.y).T, more.free.T, strict=True):
        forced = _beside(more.state[free], more.u[free])
        found.append(np.linalg.lstsq(forced, added[free], rcond=1e-8)[0])
    return np.array(found)


def _noisier(motion: Motion) -> Motion | None:
    """``motion`` with as much noise again in its velocities as third differences show; None if rows are in no order."""
    v, rows = motion.v_now, _neighbours(motion.blocks)
    if v is None or motion.v_after is None or not any(block.stop - block.start > 3 for block in motion.blocks):
        return None
    size = white_noise(v[block] for block in motion.blocks)
    draw = np.random.default_rng(0)
    now, after = (size * draw.normal(size=v.shape) for _ in range(2))
    after[rows[0]] = now[rows[1]]
    return replace(motion, v_now=v + now, v_after=motion.v_after + after)


def hidden(motion: Motion, chosen: list[int], rest: np.ndarray) -> np.ndarray:
    """Of which joints (m,) noise of velocities is most of what commands leave of accelerations, ``rest`` (m,).

    There the last acceleration does not tell what pushes a joint, and a controller that answers to it seems to push the
    wrong way. Noise shows in how second differences two samples apart go together; where they do by more than what
    nothing explains, they are motion.
    """
    bent = [np.diff(motion.v_now[block], n=2, axis=0) for block in motion.blocks] if motion.v_now is not None else []
    pairs = [part[2:] * part[:-2] for part in bent if len(part) > 2]
    if not pairs:
        return np.zeros(len(chosen), dtype=bool)
    product = np.concatenate(pairs)[:, [motion.drivers[m].coordinate for m in chosen]]
    most = USUAL * np.median(np.abs(product), axis=0)  # blows do not count
    square = np.clip(product, -most, most).mean(axis=0)
    return np.asarray((2.0 * square > HIDES * rest**2) & (square < rest**2))  # noise of the step's end is unforeseen


@dataclass(frozen=True)
class _Rows:
    """Accelerations ``y`` (N, n), ``state`` (N, s) and commands ``u`` (N, m); where joints are ``free`` of stops."""

    state: np.ndarray
    u: np.ndarray
    y: np.ndarray
    free: np.ndarray


def responses(motion: Motion, chosen: list[int]) -> Responses | None:
    """Robust linear answers of accelerations to commands, with standard errors; the commands' and rests' spread.

    Of each joint where it is away from its stops: one that is pushed against a stop answers to nothing. Infinite errors
    where it hardly ever is. A controller answers to loads, so that commands come with what pushes against them: what
    the last step's command and acceleration tell of that does not count.
    """
    rows = _rows(motion, chosen)
    if rows is None:
        return None
    state, u, y, free, least = rows.state, rows.u, rows.y, rows.free, _least(rows.u)
    forced = _beside(state, u)
    spread = forced.std(axis=0)
    if not (spread > 1e-9).all():  # a command that rests, or follows from the state: nothing is told
        return None
    if np.linalg.cond(forced / spread) > 30:
        return None
    shape = (y.shape[1], u.shape[1])
    gain, error, rest = np.zeros(shape), np.full(shape, np.inf), np.zeros(y.shape[1])
    for j in range(y.shape[1]):
        told = free[:, j]
        if told.sum() >= least:
            gain[j], error[j], rest[j] = _robust(_beside(state[told], u[told]), _beside(state[told], y[told, j]))
    return gain, error, spread, rest


def _least(u: np.ndarray) -> int:
    return max(ROWS, 10 * u.shape[1])


def _rows(motion: Motion, chosen: list[int]) -> _Rows | None:
    """The rows of a regression of accelerations on the ``chosen`` commands; None where they are too few."""
    at = [motion.drivers[m].coordinate for m in chosen]
    u = motion.u[:, chosen] * [np.sign(motion.drivers[m].scale) for m in chosen]
    if motion.v_now is not None and motion.v_after is not None:
        q, v, y = motion.now[:, at], motion.v_now[:, at], (motion.v_after - motion.v_now)[:, at]
        moves = motion.dt * np.maximum(np.abs(v), np.abs(motion.v_after[:, at]))
        free = _away_from_stops(motion, at, q, moves) & _away_from_stops(motion, at, motion.after[:, at], moves)
        before, later = _neighbours(motion.blocks)
        past = np.hstack([u[before], y[before]])
        q, v = motion.now, motion.v_now  # controllers answer to joints that nothing drives, too
        if 2 * len(later) > len(y):  # else rows are in no order, and have no past
            q, v, y, u, free = q[later], v[later], y[later], u[later], free[later]
        else:
            past = np.zeros((len(y), 0))
    else:
        q, v, y, u = _from_positions(motion, at, u)
        free, past = _away_from_stops(motion, at, q[:, at], 2 * np.abs(v[:, at])), np.zeros((len(q), 0))
    take = np.unique(np.linspace(0, len(y) - 1, MOST).astype(int)) if len(y) else np.arange(0)
    q, v, y, u, free, past = (x[take] for x in (q, v, y, u, free, past))
    if len(y) < _least(u):
        return None
    return _Rows(np.column_stack([np.ones(len(y)), _scaled(q), _scaled(v), _scaled(past)]), u, y, free)


def steered(motion: Motion, chosen: list[int]) -> bool:
    """Whether most of what the ``chosen`` commands vary by answers to the state."""
    rows = _rows(motion, chosen)
    if rows is None:
        return False
    with np.errstate(invalid="ignore"):
        free = _beside(rows.state, rows.u).var(axis=0) / rows.u.var(axis=0)
    return bool(np.nanmedian(free) < 0.5)


def slowly(motion: Motion, chosen: list[int]) -> np.ndarray:
    """How surely joints answer to their own commands over SLOW, by positions alone: slopes in standard errors (L, m).

    By how late the commands may act: not at all, and up to SLOW. Beside weight, which goes with sines of angles, and
    friction, which goes with the direction. 0 of too few rows.
    """
    late = np.unique(np.linspace(0, max(1, round(SLOW / motion.dt)), LATE).astype(int))
    return np.array([_slowly(motion.later(by), chosen) for by in late.tolist()])


def _slowly(motion: Motion, chosen: list[int]) -> np.ndarray:
    at = [motion.drivers[m].coordinate for m in chosen]
    u = motion.u[:, chosen] * [np.sign(motion.drivers[m].scale) for m in chosen]
    q, v, y, u = _from_positions(motion, at, u, max(1, round(SLOW / motion.dt)))
    state = np.column_stack([np.ones(len(q)), np.sin(q), np.cos(q), _scaled(q), _scaled(v), np.sign(v)])
    if len(y) < 2 * (state.shape[1] + len(chosen)):
        return np.zeros(len(chosen))
    found = [_robust(_beside(state, u), _beside(state, y[:, j])) for j in range(len(chosen))]
    return np.array([gain[j] / error[j] for j, (gain, error, _) in enumerate(found)])


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
    motion: Motion, at: list[int], u: np.ndarray, stride: int = STRIDE
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions and velocities of all coordinates, second differences of those ``at`` that commands drive, commands.

    Over some samples, by block. Positions and velocities are told by the samples
    beside those of the differences, whose noise a command that goes with the state would seem to explain.
    """
    parts = []
    weights = np.concatenate([np.arange(1, stride + 1), np.arange(stride - 1, 0, -1)]) / stride**2
    for block in motion.blocks:
        x, force = motion.now[block], u[block]
        if len(x) <= 2 * stride + 2:
            continue
        before, after, inside = x[: -2 * stride - 2], x[2 * stride + 2 :], x[1:-1]
        first, middle, last = inside[: -2 * stride], inside[stride:-stride], inside[2 * stride :]
        mean = sum(w * force[k + 2 : len(force) - 2 * stride + k] for k, w in enumerate(weights))
        rows = slice(None, None, stride)
        bent = (last - 2 * middle + first)[rows][:, at]
        parts.append((before[rows], (after - before)[rows] / 2, bent, np.asarray(mean)[rows]))
    if not parts:
        every, driven = np.zeros((0, motion.now.shape[1])), np.zeros((0, len(at)))
        return every, every, driven, driven
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
