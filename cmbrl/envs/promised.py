"""What a real system earns of what a model promised: the model is not the robot where it is far less."""

from __future__ import annotations

import numpy as np

from cmbrl.envs.evaluation import Evaluation

FAR = 0.2  #: share of what the model promised, beyond no action, that may be lacking
CERTAIN = 2.0  # standard errors of the difference


def lacking(real: Evaluation, model: Evaluation, idle: Evaluation) -> float:
    """Share of what ``model`` promised that ``real`` lacks, in episodes of the same starts.

    The promise is the mean return, or what it is above that of no action in the model (``idle``) where that is more:
    returns of costs are near 0 at best. 0 where less than CERTAIN standard errors are lacking.
    """
    lost = model.returns - real.returns
    error = lost.std(ddof=1) / np.sqrt(len(lost)) if len(lost) > 1 else 0.0
    promised = float(model.returns.mean())
    size = max(abs(promised), promised - float(idle.returns.mean()))
    return float(lost.mean()) / size if size and lost.mean() > CERTAIN * error else 0.0
