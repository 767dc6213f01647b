"""ENeRF (Lin et al. 2022): cost volumes find the surface, a few samples around it blend the views'
colours.
"""

from ggvs_eval.baselines.learned import LearnedBaseline

BASELINE = LearnedBaseline(
    name="enerf",
    title="ENeRF",
    source="Lin et al., SIGGRAPH Asia 2022",
    checkpoint="dtu_pretrain/latest.pth of zju3dv/ENeRF",
    method="ggvs_eval.baselines.enerf.method:ENeRF",
    describe="radiance near the surface of a cost volume",
    retrained="compact",
)
