"""GPS-Gaussian (Zheng et al., CVPR 2024): stereo of one rectified pair, one Gaussian per pixel, all
of them rendered at once.
"""

from dataclasses import replace

from ggvs_eval.baselines.learned import LearnedBaseline

BASELINE = LearnedBaseline(
    name="gps-gaussian",
    title="GPS-Gaussian",
    source="Zheng et al., CVPR 2024",
    checkpoint="GPS-GS_stage2_final.pth of aipixel/GPS-Gaussian",
    method="ggvs_eval.baselines.gps_gaussian.method:GpsGaussian",
    describe="Gaussians of the nearest pair by its own stereo",
    takes_depth=True,
)
GIVEN_DEPTH = replace(
    BASELINE,
    title="GPS-Gaussian, Given Depth",
    describe="Gaussians of the nearest pair by the depth of the other methods",
    retrained="compact",
    options={"depth": "given"},
    uses_depth=True,
)
