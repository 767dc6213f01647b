"""GPS-Gaussian (Zheng et al., CVPR 2024): stereo of one rectified pair, one Gaussian per pixel, all of them rendered at once."""

from ggvs_eval.baselines.learned import LearnedBaseline, Rendition

BASELINE = LearnedBaseline(
    name="gps-gaussian",
    title="GPS-Gaussian",
    source="Zheng et al., CVPR 2024",
    checkpoint="GPS-GS_stage2_final.pth of aipixel/GPS-Gaussian",
    method="ggvs_eval.baselines.gps_gaussian.method:GpsGaussian",
    renditions=(
        Rendition("GPS-Gaussian", "Gaussians of the nearest pair by its own stereo"),
        Rendition(
            "GPS-Gaussian, Given Depth",
            "Gaussians of the nearest pair by the depth of the other methods",
            retrained="compact",
            variant="given-depth",
            options={"depth": "given"},
            uses_depth=True,
        ),
    ),
    takes_depth=True,
)
