"""MVSplat (Chen et al., ECCV 2024): a cost volume per source view, one Gaussian per pixel, all of
them rendered at once.
"""

from ggvs_eval.baselines.learned import LearnedBaseline

BASELINE = LearnedBaseline(
    name="mvsplat",
    title="MVSplat",
    source="Chen et al., ECCV 2024",
    checkpoint="re10k.ckpt of donydchen/mvsplat",
    method="ggvs_eval.contrib.more_baselines.mvsplat.method:Mvsplat",
    describe="Gaussians of all sources' pixels, by cost volumes between them",
    retrained="compact",
    takes_depth=True,
)
