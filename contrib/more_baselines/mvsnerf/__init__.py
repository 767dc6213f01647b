"""MVSNeRF (Chen et al., ICCV 2021): a feature volume in the frustum of one view, and radiance along
the target's rays.
"""

from ggvs_eval.baselines.learned import LearnedBaseline

BASELINE = LearnedBaseline(
    name="mvsnerf",
    title="MVSNeRF",
    source="Chen et al., ICCV 2021",
    checkpoint="ckpts/mvsnerf-v0.tar of apchenstu/mvsnerf",
    method="ggvs_eval.contrib.more_baselines.mvsnerf.method:MvsNerf",
    describe="radiance in a feature volume of three views, by the authors' weights",
)
