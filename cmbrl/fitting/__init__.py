"""From a log to physical parameters: ``cmbrl.fit(model, data)`` is :func:`cmbrl.fitting.fit.fit`. In order of reading:

``fit``            the whole procedure, top to bottom; ``budget``: how much work each part may do
``evidence``       the log as transitions, the model at its time step, and what lies between them
``space``          named, bounded, transformed parameters; ``gauge``: what is known up to a factor, ``unit``: of force
``loss``           prediction errors of candidates, Gauss-Newton equations; ``linearised``: their derivatives;
                   ``objective``: the same plus the prior
``random_search``  candidates around the best so far; ``cma`` and ``gauss_newton``: the alternatives
``polish``         the last Gauss-Newton, with the unit of force kept near the file's
``noise``, ``start_noise``, ``survey``  sensor noise, what starts are off by, and the horizon that the log asks for;
                   ``starts``: windows that start within noise
``parsimony``      the fewest parameters that the held-out data supports; ``forecast``: the gain that a group promises
``extension``      laws of friction and of motors that a fit of positions takes besides
``trials``         what both rest on: fits of some parameters, judged on ``folds``, episodes held out in turn
``identify``       intervals, and what the data leave open
``verdict``        where a fit loses, and what time stepping leaves
``state``          resumes a fit that was killed; ``result``, ``report``, ``report_text``: the result
"""

from __future__ import annotations

from cmbrl.fitting.budget import Budget
from cmbrl.fitting.fit import fit
from cmbrl.fitting.fitted_parameter import FittedParameter
from cmbrl.fitting.result import FitResult

__all__ = ["Budget", "FitResult", "FittedParameter", "fit"]
