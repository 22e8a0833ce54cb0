"""How much work each part of a fit may do."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

_COORDINATES = 18  # up to so many that are compared, rows are as in Budget
_LEAST_ROWS = 800  # fewer would miss rare events
_WINDOWS = 15  # of a noisy log that choices have at least, over the longest horizon
_OF_NOISY = 0.2  # share of the work of choices
_CHOICES = (
    "survey_rows", "survey_iterations", "trial_rows", "trial_rounds", "trial_population", "trial_iterations",
    "trial_fold_iterations", "screen_iterations", "held_out_rows", "starts", "start_iterations", "search_rows",
)  # fmt: skip
_ROWS, _ITERATIONS, _SEARCHES = 0.75, 0.25, 0.5  # exponents of the share of the work: rows are missed the least
_SHRINKS = {  # with those exponents, and not below what tells anything
    **dict.fromkeys(("survey_rows", "trial_rows", "held_out_rows", "search_rows", "draw_rows"), (_ROWS, 100)),
    **{"polish_rows": (_ROWS, 200), "noise_rows": (_ROWS, 400), "judged": (_ROWS, 0.02), "draws": (_ROWS, 8)},
    **dict.fromkeys(("survey_iterations", "trial_iterations", "trial_fold_iterations"), (_ITERATIONS, 1)),
    **dict.fromkeys(("screen_iterations", "start_iterations", "polish_iterations", "horizons"), (_ITERATIONS, 1)),
    **{"fold_iterations": (_ITERATIONS, 2), "folds": (_ITERATIONS, 0.0)},
    **dict.fromkeys(("trial_rounds", "trial_population", "starts"), (_SEARCHES, 1)),
    **dict.fromkeys(("search_rounds", "search_population"), (_SEARCHES, 1)),
}


@dataclass(frozen=True)
class Budget:
    """Rows are predicted transitions, drawn under the seed if the log has more."""

    survey_rows: int = 2000  # for each horizon that the survey tries
    survey_iterations: int = 8  # Gauss-Newton over all parameters
    trial_rows: int = 2000  # for each group that the selection tries: fewer would miss rare events
    trial_rounds: int = 3  # random search over the parameters of that group
    trial_population: int = 16
    trial_iterations: int = 6  # Gauss-Newton over all selected parameters
    trial_fold_iterations: int = 1  # from there, without the episodes held out in turn
    screen_iterations: int = 3  # without a group and the first episodes held out: is it needed at once?
    held_out_rows: int = 2000  # to judge a group on, all folds together
    starts: int = 8  # of Gauss-Newton, screened before the best is polished
    start_iterations: int = 4
    search_rows: int = 1000  # those starts, or a search over all selected parameters
    search_rounds: int = 20
    search_population: int = 64
    polish_rows: int = 5000  # final Gauss-Newton
    polish_iterations: int = 15
    fold_iterations: int = 5  # from there, without the episodes held out in turn
    folds: float = 1.0  # share of those that are held out in turn
    horizons: int = 4  # that the survey tries, the shortest ones
    noise_rows: int = 5000  # to tell sensor noise by
    judged: float = 1.0  # share of the windows that judges over several horizons have
    draws: int = 32  # around the fit, to tell how wide they may be
    draw_rows: int = 4000  # predicted for each of them

    @classmethod
    def of(cls, coordinates: int, noisy: bool = False, longest: int = 20) -> Budget:
        """For predictions of so many coordinates: where each row tells of more, fewer do to choose by.

        Rows of a ``noisy`` log are several times as dear, since each has a start of its own, and choices gain nothing
        from more of them: only what comes after the choices has its usual work. But a few windows over the ``longest``
        horizon, more than 20 steps where they are short, lie in a small part of the log, and say little of the rest.
        """
        budget, share = cls(), min(1.0, _COORDINATES / coordinates)
        if noisy:
            less = budget.shrunk(_OF_NOISY)
            budget = replace(budget, **{name: getattr(less, name) for name in _CHOICES})
        names = ("survey_rows", "trial_rows", "held_out_rows", "search_rows")
        rows = {name: getattr(budget, name) for name in names}
        budget = replace(budget, **{name: min(n, max(_LEAST_ROWS, round(share * n))) for name, n in rows.items()})
        least = _WINDOWS * longest if noisy else 0
        return replace(budget, **{name: max(getattr(budget, name), least) for name in names})

    def shrunk(self, share: float) -> Budget:
        """About ``share`` of the work in each part: the same for 1, and never so little that it tells nothing."""

        def less(name: str) -> Any:
            whole, (exponent, least) = getattr(self, name), _SHRINKS[name]
            scaled = max(least, whole * share**exponent)
            return min(whole, scaled if isinstance(whole, float) else round(scaled))

        return replace(self, **{field.name: less(field.name) for field in fields(self)})
