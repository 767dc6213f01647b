"""Leaves of the package: parts that scoring and reporting anybody's renders can do without, each by
its modules.
"""

from helpers.house_measures import imported_names
from helpers.import_graph import modules

# Each leaf by its modules and packages; the folder of contrib adds its parts.
LEAVES: dict[str, tuple[str, ...]] = {
    **{
        f"layout {name}": (f"datasets.{name}",)
        for name in ("capture_toml", "google_light_fields", "technicolor", "panoptic", "nerfstudio")
    },
    "layout d3dmv": ("datasets.d3dmv", "datasets.h5_frames"),
    "layout rgbd": ("datasets.rgbd", "datasets.rgbd_files"),
    "layouts with OpenCV files": (
        *("datasets.easymocap", "datasets.calibration_file", "datasets.calibration_readers"),
        "datasets.filestorage_yaml",
    ),
    "online method": (
        *("pipelines.online", "pipelines.methods.ours"),
        *(
            f"geometry.{name}"
            for name in ("contested_depth", "difference_mask", "per_pixel", "splat", "tsdf", "warp")
        ),
    ),
    "networks": ("raft_config", "raft_update", "residual_block"),
    "matcher sgbm": ("pipelines.offline.stereo.sgbm",),
    "matcher live": ("pipelines.offline.stereo.live",),
    "matcher sweep": ("pipelines.offline.plane_sweep",),
    "matcher raft": (
        "pipelines.offline.stereo.raft_matcher",
        "pipelines.offline.stereo.raft_stereo",
    ),
    # With what any matcher of pairs is made of.
    "depth": ("pipelines.offline.depth", "pipelines.offline.stereo"),
    "IterMVS": ("pipelines.offline.itermvs",),
    "sensor depth": ("pipelines.offline.sensor",),
    "calibration": (
        "pipelines.offline.calibration",
        "pipelines.commands.calibrate",
        "pipelines.run.calibration_of_run",
    ),
    "depth page": ("pipelines.offline.export", "pipelines.run.depth_outputs", "reports.depth_page"),
    "check": (
        "pipelines.inspection.capture",
        "pipelines.commands.check",
        "pipelines.commands.evaluate",
    ),
    "doctor": (
        "pipelines.inspection.renders",
        "pipelines.run.seen_views",
        "pipelines.run.decoding",
        "pipelines.commands.doctor",
        "transforms",
    ),
    "steadiness": (
        *("pipelines.run.steadiness", "pipelines.commands.steadiness", "reports.tables.steadiness"),
        *("metrics.series_scores", "renders.sequences"),
    ),
    # Sections of a report, and what only they use.
    **{
        f"section {module.rpartition('.')[2]}": (f"reports.{module}",)
        for module in (
            *("page.sweep_section", "page.viewer", "page.heat_map", "page.quality_over_time"),
            *("figures.curves", "figures.slices"),
            *("tables.worst_frames", "tables.timing", "tables.costs"),
        )
    },
    "section stream": ("reports.page.stream_section", "reports.figures.stream"),
    "section error_budget": ("reports.tables.error_budget",),
    "section drift": ("reports.tables.drift", "statistics.drift"),
    "section paper": ("reports.tables.reproduction", "reports.tables.published"),
    "pictures of sections": (
        "reports.page.pictures",
        "reports.figures.regions",
        "reports.figures.data_uris",
    ),
    "figures for papers": (
        *("pipelines.commands.figure", "reports.figures.paper_figures"),
        *("reports.figures.look", "reports.figures.sweep_figures"),
    ),
    "leaderboard": ("reports.page.leaderboard",),
    "comparison": ("pipelines.commands.compare", "reports.tables.compare_runs"),
    "baselines": ("baselines", "pipelines.methods.baselines"),
    "fitted methods": (
        "pipelines.methods.fitted",
        "pipelines.methods.splats",
        "pipelines.methods.sequence",
        "gaussians",
        "scene_fitter",
        "pipelines.run.fits",
        "pipelines.run.footage",
        "pipelines.run.folds",
    ),
    "camera path": (
        *("metrics.path", "metrics.path_scores"),
        *("pipelines.run.score_path", "pipelines.run.path_depth", "pipelines.run.camera_path"),
    ),
    "noise ceilings": (
        *("metrics.noise.estimate", "metrics.noise.recording", "metrics.ceilings"),
        "pipelines.run.references",
    ),
    "masks of what no source sees": ("pipelines.run.disocclusion",),
    "stream": ("metrics.time.on_screen", "pipelines.run.screens", "pipelines.run.live_depth"),
    "metrics": ("metrics.image", "metrics.time", "metrics.noise.blocks", "metrics.on_device"),
    "metrics of plug-ins": ("metrics.foreign",),
    "play": ("pipelines.play", "pipelines.commands.play"),
}


def leaf_of(module: str) -> str | None:
    """Return the leaf that a module is of; None for one of the trunk."""
    if module.split(".")[0] == "contrib":
        return ".".join(module.split(".")[:2])
    for leaf, parts in LEAVES.items():
        if any(module == part or module.startswith(f"{part}.") for part in parts):
            return leaf
    return None


def needs_of(own: set[str]) -> set[str]:
    """Return the modules of other leaves that some modules import, directly or not, and the
    packages that they stand in.
    """
    needed = set(own)
    waiting = [*own]
    while waiting:
        module = waiting.pop()
        imported = {name for name, _ in imported_names(modules()[module])}
        packages = {module.rsplit(".", count)[0] for count in range(1, module.count(".") + 1)}
        more = {
            name for name in imported | packages if name in modules() and leaf_of(name)
        } - needed
        needed |= more
        waiting += more
    return needed - own


def names_of_api() -> set[tuple[str, str]]:
    """Module and name of everything that `ggvs_eval.api` lists; ``*`` is a module as a whole."""
    return set(imported_names(modules()["api"]))
