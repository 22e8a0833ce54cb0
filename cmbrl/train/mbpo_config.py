"""Settings of MBPO, whose names are ours."""

from __future__ import annotations

from dataclasses import dataclass, replace

from cmbrl.settings import setting


@dataclass(frozen=True)
class MBPOConfig:
    """Settings of MBPO; the defaults are the original's for Hopper, 125,000 real steps."""

    iterations: int = setting(480, "blocks of the run", least=1)
    block: int = setting(250, "real steps between refits (without a real system: rounds of updates)", least=1)
    warmup: int = setting(5000, "random real steps before the first block; a log replaces them", least=1)
    updates_per_step: int = setting(20, "updates of the soft actor-critic per real step", least=1, most=10_000)
    real_share: float = setting(0.05, "share of real steps in each of its batches", least=0)
    rollouts: int = setting(100_000, "model rollouts started at each refit", least=1)
    length_start: int = setting(1, "model steps of a rollout until epoch_start", least=1)
    length_end: int = setting(15, "model steps of a rollout from epoch_end on; linear in between", least=1)
    epoch_start: int = setting(20, "epoch at which rollouts begin to grow", least=0)
    epoch_end: int = setting(150, "epoch at which rollouts are fully grown", least=0)
    epoch: int = setting(1000, "real steps of an epoch", least=1)
    keep_blocks: int = setting(4, "imagined steps older than this number of blocks are forgotten", least=1)
    hidden: tuple[int, ...] = setting((256, 256), "hidden layers of actor and critics", least=1, most=8_192)
    rate: float = setting(3e-4, "learning rate of the soft actor-critic", least=0)
    batch: int = setting(256, "size of its batches", least=1)
    discount: float = setting(0.99, "discount per control step", least=0)
    target_share: float = setting(0.005, "share of the critics that their targets take on at each update", least=0)
    target_entropy: float = setting(-1.0, "target entropy of the policy")
    fit_updates: int | None = setting(None, "gradient steps of the ensemble's first fit; none: its own", least=1)
    refit_updates: int | None = setting(None, "the same for later fits, which start from the present weights", least=1)
    max_seconds: float | None = setting(None, "wall-clock limit, after which the run ends", least=0)

    def two_cores(self) -> MBPOConfig:
        """A cheaper run, our choice: a fifth of the rollouts, short fits."""
        return replace(self, rollouts=20_000, fit_updates=2000, refit_updates=300)

    def rollout_length(self, iteration: int) -> int:
        """Model steps of the rollouts of block ``iteration`` (from 0): the original's truncated linear schedule.

        A jump where ``epoch_end`` is not after ``epoch_start``.
        """
        epoch = iteration * self.block // self.epoch
        growth = self.epoch_end - self.epoch_start
        share = (epoch - self.epoch_start) / growth if growth > 0 else float(epoch >= self.epoch_end)
        return int(self.length_start + min(max(share, 0.0), 1.0) * (self.length_end - self.length_start))
