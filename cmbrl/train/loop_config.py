"""Settings of the loop of acting, fitting and improving, and how its updates are shared out."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from cmbrl.errors import UserError
from cmbrl.settings import setting
from cmbrl.train.shac import SHACConfig


@dataclass(frozen=True)
class LoopConfig(SHACConfig):
    """SHAC's settings and the loop's; ``iterations`` are the updates of all rounds and policies but further ones."""

    iterations: int = setting(6000, "updates of all rounds and policies together, without further ones", least=1)
    rounds: int = setting(1, "rounds of acting, fitting and improving", least=1)
    transitions: int = setting(1000, "real transitions of the first round, by random actions; a log counts", least=1)
    more: int = setting(1000, "real transitions of each further round, by the policy with its noise", least=1)
    policies: int = setting(2, "policies started in each round", least=1, most=1_000)
    further: int = setting(
        2, "policies trained in each round besides, one by one, while the best fails its trials", least=0, most=1_000
    )
    on_file: float = setting(
        0.5, "share of its updates that each policy but the first spends on the file before the fit; 0: none",
        least=0, most=0.9,
    )  # fmt: skip
    play: bool = setting(True, "whether a fit whose errors look like play is compared with one of the file with play")
    trial: float = setting(1.0, "share of its updates that each policy gets before the best one is chosen", above=0)
    score_episodes: int = setting(128, "model episodes by which policies are compared", least=1, most=1_000_000)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.trial <= 1:
            raise UserError(f"trial = {self.trial:g}: must be a share of a policy's updates: above 0, at most 1")

    def shac(self) -> SHACConfig:
        """The settings of one policy in one round."""
        names = [field.name for field in fields(SHACConfig)]
        own = SHACConfig(**{name: getattr(self, name) for name in names})
        updates = max(1, int(self.iterations / (self.rounds * (1 + self._extra()))))
        return replace(own, iterations=updates, again=0)  # where a policy fails, further ones are trained instead

    def trial_updates(self) -> int:
        """Updates of each policy before one is chosen."""
        return max(1, round(self.trial * self.shac().iterations)) if self.policies + self.further > 1 else 0

    def _extra(self) -> float:
        """Updates of policies that are not trained to the end, in units of one that is."""
        return self.trial * (self.policies - 1)
