"""FWD (Cao, Rockwell, Johnson, CVPR 2022): features of every view warped forward as points, fused
by attention, decoded.
"""

from ggvs_eval.baselines.learned import LearnedBaseline

BASELINE = LearnedBaseline(
    name="fwd",
    title="FWD",
    source="Cao, Rockwell and Johnson, CVPR 2022",
    checkpoint="a checkpoint of this package's network",
    method="ggvs_eval.baselines.fwd.method:Fwd",
    describe="features splatted by the given depth, fused by attention",
    retrained="compact",
    uses_depth=True,
    takes_depth=True,
)
