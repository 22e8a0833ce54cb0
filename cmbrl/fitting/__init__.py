"""From a log to physical parameters: ``cmbrl.fit(model, data)`` is :func:`cmbrl.fitting.fit.fit`. In order of reading:

``fit``      the door: what may move, from which log, by which method
``course``   the whole procedure, top to bottom; ``standing``: where it stands; ``state``: the journal by which a killed
             fit resumes; ``refining``: its time steps; ``budget``, ``pace``, ``clock``: how much work each part may do
``search``   named, bounded parameters (``space``), errors of predictions (``loss``, ``objective``), and what minimises
             them: ``random_search``, ``cma``, ``gauss_newton``; ``folds``: episodes held out in turn
``log``      what the log tells before any choice: ``evidence``, ``noise``, horizon (``survey``), laws (``sliding``)
``choice``   the parameters (``parsimony``) and the laws of friction and motors (``extension``) that held-out episodes
             call for; both rest on ``trials``, fits of some parameters. ``unexplained``: what residuals say of play
             (``play_shown``) and of time steps (``finer_steps``)
``outcome``  intervals (``identify``), what it is worth (``verdict``), and the report, as text and as a page
``played``   the same of the file with play between motors and links, where residuals show it
``result``   what a fit returns, and the folder that stores it; ``learn_residual``: a small net in front of a fit

Imports run one way: search, log, choice, outcome.
"""

from __future__ import annotations

from cmbrl.fitting.budget import Budget
from cmbrl.fitting.fit import fit
from cmbrl.fitting.fitted_parameter import FittedParameter
from cmbrl.fitting.played import fit_or_played, keep
from cmbrl.fitting.result import FitResult

__all__ = ["Budget", "FitResult", "FittedParameter", "fit", "fit_or_played", "keep"]
