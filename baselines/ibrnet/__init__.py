"""IBRNet (Wang et al. 2021): colours of the source views, blended along each target ray by a
network that was trained once.
"""

from ggvs_eval.baselines.learned import LearnedBaseline

BASELINE = LearnedBaseline(
    name="ibrnet",
    title="IBRNet",
    source="Wang et al., CVPR 2021",
    checkpoint="model_255000.pth of googleinterns/IBRNet",
    method="ggvs_eval.baselines.ibrnet.method:IBRNet",
    describe="colours of the views blended along rays",
    retrained="compact",
)
