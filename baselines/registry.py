"""The learned baselines by name; each is a folder beside this file, and a line here."""

from importlib import import_module

from ggvs_eval.baselines.learned import LearnedBaseline

FOLDERS = (
    "fwd",
    "ibrnet",
    "gps_gaussian",
    "enerf",
    "mvsplat",
    "mvsnerf",
)

LEARNED_BASELINES: dict[str, LearnedBaseline] = {
    baseline.name: baseline for baseline in (import_module(f"ggvs_eval.baselines.{folder}").BASELINE for folder in FOLDERS)
}
TRAINED_BASELINES = {name: baseline for name, baseline in LEARNED_BASELINES.items() if baseline.recipe}  # have a training here
