"""The code behind each score: a value is stale when what measures it has changed, and no other value is."""

from collections.abc import Sequence

from ggvs_eval.jobs.code_identity import code_identity

_METRICS = "ggvs_eval.metrics"

# Where each metric is defined; SDT and SDV are deviations of L1, taken anew with every table.
METRIC_MODULES: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("PSNR", "L1"), (f"{_METRICS}.image",)),
    "SSIM": (f"{_METRICS}.ssim_variants",),
    "LPIPS": (f"{_METRICS}.lpips",),
    "TCC": (f"{_METRICS}.temporal",),
    **dict.fromkeys(("STED", "STED_ssn"), (f"{_METRICS}.strred",)),
    **dict.fromkeys(("PSNR_cc", "SSIM_cc"), (f"{_METRICS}.colour_correction", f"{_METRICS}.image")),
    "LPIPS_cc": (f"{_METRICS}.colour_correction", f"{_METRICS}.lpips"),
    **dict.fromkeys(("Flicker", "Flicker_excess"), (f"{_METRICS}.flicker",)),
    **{f"{m}_{r}": (f"{_METRICS}.regions",) for r in ("static", "moving", "disoccluded") for m in ("PSNR", "SSIM", "L1")},
}
PATH_MODULES = (f"{_METRICS}.path_scores", "ggvs_eval.files.images")  # one pass over the path measures all of it

# They read the frames and hand them to every metric: their own text counts for all, what they import for one does not.
SHARED = (
    "ggvs_eval.pipelines.run.score_view",
    *(f"{_METRICS}.{name}" for name in ("stream", "scorers", "time_scorers", "truth_frame")),
)
READING = "ggvs_eval.files.images"


def metric_code(name: str) -> str:
    """Hash of the code that measures a metric of a view."""
    return code_identity(*METRIC_MODULES[name], READING, *SHARED, unfollowed=SHARED)


def ceilings_code(names: Sequence[str]) -> str:
    """Hash of the code that estimates the ceilings of some metrics."""
    modules = [module for name in names for module in METRIC_MODULES[name]]
    return code_identity(f"{_METRICS}.ceilings", *modules, READING, *SHARED, unfollowed=SHARED)


def path_code() -> str:
    """Hash of the code that measures a camera path."""
    return code_identity(*PATH_MODULES)
