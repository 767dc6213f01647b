"""Built-in commands, metrics, methods and layouts, by kind and name: as text like entry points, so
that a name loads no module.

Parts of `contrib` are listed too; a part whose package is missing is omitted.
"""

from typing import Any, NamedTuple

VERBS_ROOM = "ggvs_eval.pipelines.commands"


class Derived(NamedTuple):
    """An entry that is made of something else when it is asked for.

    Attributes:
        base: name of another entry of its table, or ``module:attribute``.
        make: ``module:function`` of that and of the arguments.
        arguments: its further arguments.
    """

    base: str
    make: str
    arguments: tuple[Any, ...] = ()


class Verb(NamedTuple):
    """A verb of the command line.

    Attributes:
        target: its function, or the table of its subcommands, as ``module:attribute``.
        about: the first line of its help.
        group: heading under which the overview lists it.
        example: arguments of one call, which its help shows; NETWORK represents the name of a
            subcommand.
    """

    target: str
    about: str
    group: str
    example: str


START, CAPTURE, EVALUATE, LOOK, MORE = "start", "capture", "evaluate", "look", "more"

# In the order of the overview.
VERBS: dict[str, Verb] = {
    "demo": Verb(
        target=f"{VERBS_ROOM}.captures:demo",
        about="Unpack a demo capture (a procedural dynamic room) in seconds.",
        group=START,
        example="room",
    ),
    "get": Verb(
        target=f"{VERBS_ROOM}.captures:get",
        about="Download a public capture; its name then works as --capture.",
        group=START,
        example="n3v:flame_steak",
    ),
    "evaluate": Verb(
        target=f"{VERBS_ROOM}.evaluate:evaluate",
        about="Calibrate, check and evaluate the videos of a rig in one command.",
        group=START,
        example="my_videos out/rig --frames 30",
    ),
    "check": Verb(
        target=f"{VERBS_ROOM}.check:check",
        about="Check a capture for faults in frames, poses, timing and colour.",
        group=CAPTURE,
        example="my_capture --repair",
    ),
    "calibrate": Verb(
        target=f"{VERBS_ROOM}.calibrate:calibrate",
        about="Calibrate a fixed rig from one instant with COLMAP.",
        group=CAPTURE,
        example="my_videos my_capture",
    ),
    "undistort": Verb(
        target=f"{VERBS_ROOM}.calibrate:undistort",
        about="Convert videos of known lenses to pinhole videos.",
        group=CAPTURE,
        example="raw_videos pinhole_videos --lenses rig.yml",
    ),
    "protocol": Verb(
        target=f"{VERBS_ROOM}.captures:protocol",
        about="Propose a protocol for a capture and explain its test views.",
        group=CAPTURE,
        example="my_capture mine.toml --test cam02 cam05 --metrics PSNR SSIM LPIPS",
    ),
    "run": Verb(
        target=f"{VERBS_ROOM}.runs:run",
        about="Run the whole evaluation; a second call resumes.",
        group=EVALUATE,
        example="out/mine --capture my_capture --protocol mine.toml --methods ours distance-based",
    ),
    "score": Verb(
        target=f"{VERBS_ROOM}.runs:score",
        about="Score all renders of a run, and your own, under one protocol.",
        group=EVALUATE,
        example="--renders mine=my_renders --capture my_capture --protocol mine.toml",
    ),
    "doctor": Verb(
        target=f"{VERBS_ROOM}.doctor:doctor",
        about="Find faults in rendered frames before they are scored.",
        group=EVALUATE,
        example="my_renders --capture my_capture --protocol mine.toml",
    ),
    "what-if": Verb(
        target="ggvs_eval.contrib.what_if.command:what_if",
        about="Score rendered frames again with each fault that doctor finds undone.",
        group=EVALUATE,
        example="my_renders --capture my_capture --protocol mine.toml",
    ),
    "explain": Verb(
        target="ggvs_eval.contrib.explain.command:explain",
        about="Find the metric conventions that give a quoted number.",
        group=EVALUATE,
        example="out/mine ssim 0.936 --method mine",
    ),
    "check-table": Verb(
        target="ggvs_eval.contrib.explain.command:check_table",
        about="Check every cell of a published table against scored runs.",
        group=EVALUATE,
        example="out/mine --table paper.tex --out out/checked",
    ),
    "prepare": Verb(
        target=f"{VERBS_ROOM}.runs:prepare",
        about="Write reference frames, source views and depth of a capture.",
        group=EVALUATE,
        example="out/mine --capture my_capture --protocol mine.toml",
    ),
    "render": Verb(
        target=f"{VERBS_ROOM}.runs:render",
        about="Render all test views of a prepared run by each method.",
        group=EVALUATE,
        example="out/mine --methods ours no-blending",
    ),
    "sweep": Verb(
        target=f"{VERBS_ROOM}.runs:sweep",
        about="Evaluate the rows of a sweep in each variant, into one table.",
        group=EVALUATE,
        example="ablations out/ablations --capture my_capture --protocol mine.toml",
    ),
    "calibrations": Verb(
        target="ggvs_eval.contrib.given_depth.calibrations:calibrations",
        about="Render one capture under several calibrations or depths and compare.",
        group=EVALUATE,
        example="out/cal given=room refined=room_refined --depths vggt=vggt_depth",
    ),
    "status": Verb(
        target=f"{VERBS_ROOM}.runs:status",
        about="Show progress, failures and disk use of a run or sweep.",
        group=EVALUATE,
        example="out/ablations",
    ),
    "merge": Verb(
        target=f"{VERBS_ROOM}.runs:merge",
        about="Merge run folders of one capture and protocol into a new one.",
        group=EVALUATE,
        example="out/both out/first out/second",
    ),
    "report": Verb(
        target=f"{VERBS_ROOM}.figures:report",
        about="Write the page, tables, figures and the comparison with the paper.",
        group=LOOK,
        example="out/mine",
    ),
    "table": Verb(
        target=f"{VERBS_ROOM}.figures:table",
        about="Print a table of scored runs for a paper.",
        group=LOOK,
        example="out/mine --columns PSNR SSIM LPIPS --to latex",
    ),
    "figure": Verb(
        target=f"{VERBS_ROOM}.figure:figure",
        about="Draw a labelled figure for a paper.",
        group=LOOK,
        example="crops out/mine figures/crops",
    ),
    "compare": Verb(
        target=f"{VERBS_ROOM}.compare:compare",
        about="Compare two runs, or two methods of a run, with paired tests.",
        group=LOOK,
        example="ours mine --run out/mine",
    ),
    "view": Verb(
        target="ggvs_eval.contrib.view.command:view",
        about="View a scene in the browser: drag the camera, play or pause time.",
        group=LOOK,
        example="my_capture",
    ),
    "play": Verb(
        target=f"{VERBS_ROOM}.play:play",
        about="Render a camera orbit within the rig to a video; print the frame rate.",
        group=LOOK,
        example="my_capture round.mp4",
    ),
    "film": Verb(
        target="ggvs_eval.contrib.worlds.command:film",
        about="Film a procedural demo capture in the layout of a data set.",
        group=MORE,
        example="room --layout dynerf --n-frames 8",
    ),
    "steadiness": Verb(
        target=f"{VERBS_ROOM}.steadiness:steadiness",
        about="Measure stability and sharpness of videos without a reference.",
        group=MORE,
        example="mine=my_video.mp4 theirs=their_video.mp4",
    ),
    "metric-study": Verb(
        target="ggvs_eval.contrib.study.command:metric_study",
        about="Measure how each metric responds to known degradations.",
        group=MORE,
        example="out/study --capture my_capture",
    ),
    "export": Verb(
        target="ggvs_eval.contrib.export.command:export",
        about="Write 3D Gaussians as one .glb (glTF, KHR_gaussian_splatting).",
        group=MORE,
        example="my_clouds sequence.glb --capture my_capture",
    ),
    "train": Verb(
        target="ggvs_eval.contrib.training.command:TRAININGS",
        about="Train a network of this package; a second call resumes.",
        group=MORE,
        example="out/NETWORK --steps 5000",
    ),
}

# Layouts of captures, in the order in which they are tried: what is particular before what is
# general, plug-ins last.
_DATASETS = "ggvs_eval.datasets"
DATASETS = {
    "capture.toml": f"{_DATASETS}.capture_toml:LAYOUT",
    "d3dmv": f"{_DATASETS}.d3dmv:LAYOUT",
    "spaces": f"{_DATASETS}.google_light_fields:SPACES_LAYOUT",
    "immersive": f"{_DATASETS}.google_light_fields:IMMERSIVE_LAYOUT",
    "technicolor": f"{_DATASETS}.technicolor:LAYOUT",
    "panoptic": f"{_DATASETS}.panoptic:LAYOUT",
    "rgbd": f"{_DATASETS}.rgbd:LAYOUT",
    "multipleview": f"{_DATASETS}.colmap:MULTIPLEVIEW_LAYOUT",
    "3dgstream": f"{_DATASETS}.colmap:FRAME_FOLDERS_LAYOUT",
    "dynerf": f"{_DATASETS}.llff:DYNERF_LAYOUT",
    "meetroom": f"{_DATASETS}.llff:MEETROOM_LAYOUT",
    "enerf-outdoor": f"{_DATASETS}.easymocap:LAYOUT",
    "colmap": f"{_DATASETS}.colmap:COLMAP_LAYOUT",
    "nerfstudio": f"{_DATASETS}.nerfstudio:LAYOUT",
    "qualisys": f"{_DATASETS}.calibration_file:QUALISYS_LAYOUT",
    "anipose": f"{_DATASETS}.calibration_file:ANIPOSE_LAYOUT",
    "opencv": f"{_DATASETS}.calibration_file:OPENCV_LAYOUT",
}

# Metrics of a view's frames, of what is derived from these, and of all views; in the order in which
# they are scored and listed.
_IMAGE, _TIME, _PATH = "ggvs_eval.metrics.image", "ggvs_eval.metrics.time", "ggvs_eval.metrics.path"
_MORE = "ggvs_eval.contrib.more_metrics"
_OF_IMAGES = {
    "PSNR": f"{_IMAGE}.psnr:PSNR",
    "SSIM": f"{_IMAGE}.ssim:SSIM",
    "L1": f"{_IMAGE}.l1:L1",
    "LPIPS": f"{_IMAGE}.lpips:LPIPS",
    "PSNR_cc": f"{_IMAGE}.corrected:PSNR_CC",
    "SSIM_cc": f"{_IMAGE}.corrected:SSIM_CC",
    "LPIPS_cc": f"{_IMAGE}.corrected:LPIPS_CC",
    "IV_PSNR": f"{_MORE}.iv_psnr:IV_PSNR",
    "PSNR_YCbCr": f"{_MORE}.iv_psnr:PSNR_YCBCR",
    "PSNR_registered": f"{_MORE}.registered:PSNR_REGISTERED",
    "MS_SSIM": f"{_IMAGE}.ms_ssim:MS_SSIM",
    "DSSIM1": f"{_IMAGE}.dssim:DSSIM1",
    "DSSIM2": f"{_IMAGE}.dssim:DSSIM2",
    "FLIP": f"{_MORE}.flip:FLIP",
    "DISTS": f"{_MORE}.dists:DISTS",
}
REGIONS = ("static", "moving", "disoccluded")
IN_PARTS = (*_OF_IMAGES, "TCC")  # that have a form for a part of the image
VIEW_METRICS: dict[str, str | Derived] = {
    **_OF_IMAGES,
    **{
        f"{name}_{region}": Derived(name, f"{_IMAGE}.regions:metric_of_part", (region,))
        for region in REGIONS
        for name in IN_PARTS
    },
    "TCC": f"{_TIME}.tcc:TCC",
    "STED": f"{_TIME}.strred:STED",
    "STED_ssn": f"{_TIME}.strred:STED_SSN",
    "Flicker": f"{_TIME}.flicker:FLICKER",
    "Flicker_excess": f"{_TIME}.flicker:FLICKER_EXCESS",
    "SDT": f"{_TIME}.deviations:SDT",
    "SDV": f"{_TIME}.deviations:SDV",
    "VMAF_v0": f"{_MORE}.vmaf:VMAF_V0",
    "VMAF_v1": f"{_MORE}.vmaf:VMAF_V1",
    "CVVDP": f"{_MORE}.colour_video_vdp:CVVDP",
    "mTV": f"{_TIME}.temporal_variation:MTV",
    "Sharpness": f"{_IMAGE}.sharpness:SHARPNESS",
    "mTV2": f"{_TIME}.temporal_variation:MTV2",
}
PATH_METRICS = {
    "EPI_coherence": f"{_PATH}.epi_metrics:EPI_COHERENCE",
    "EPI_line_texture": f"{_PATH}.epi_metrics:EPI_LINE_TEXTURE",
    "EPI_slope_error": f"{_PATH}.epi_metrics:EPI_SLOPE_ERROR",
    "EPI_slope_agreeing": f"{_PATH}.epi_metrics:EPI_SLOPE_AGREEING",
    "reprojection": f"{_PATH}.view_consistency:REPROJECTION",
    "reprojection_visible": f"{_PATH}.view_consistency:REPROJECTION_VISIBLE",
    "E_warp": f"{_PATH}.view_consistency:E_WARP",
    "path_sharpness": f"{_PATH}.view_consistency:PATH_SHARPNESS",
    "switch_ratio": f"{_PATH}.view_consistency:SWITCH_RATIO",
    "switch_excess": f"{_PATH}.view_consistency:SWITCH_EXCESS",
    "COLMAP_registered": f"{_MORE}.colmap_consistency:COLMAP_REGISTERED",
    "COLMAP_track_length": f"{_MORE}.colmap_consistency:COLMAP_TRACK_LENGTH",
    "COLMAP_matches": f"{_MORE}.colmap_consistency:COLMAP_MATCHES",
    "SGC_rotation": f"{_MORE}.spatial_consistency:SGC_ROTATION",
    "SGC_translation": f"{_MORE}.spatial_consistency:SGC_TRANSLATION",
}
DEPTH_METRICS = {
    "depth_mTV": f"{_TIME}.depth_variation:DEPTH_MTV",
    "depth_Sharpness": f"{_TIME}.depth_variation:DEPTH_SHARPNESS",
    "depth_mTV2": f"{_TIME}.depth_variation:DEPTH_MTV2",
    "depth_blinking": f"{_TIME}.depth_variation:DEPTH_BLINKING",
}
# of one call, in this order
COLMAP_METRICS = ("COLMAP_registered", "COLMAP_track_length", "COLMAP_matches")
METRICS_OF_VIDEOS = ("mTV", "Sharpness", "mTV2")  # that have a form without truth
METRICS_WITH_CEILING = ("PSNR", "SSIM", "TCC", "STED")  # that perfect renderings are scored with
# How the metrics of plug-ins are measured.
FOREIGN_METRICS = {
    "scorer": "ggvs_eval.metrics.foreign:ForeignScorer",
    "values": "ggvs_eval.metrics.foreign:foreign_values",
}

# Questions that scoring asks of every method's frames, and what it measures besides the frames of
# test views: a function that plans it.
_RUN = "ggvs_eval.pipelines.run"
QUESTIONS = {
    "quick checks": "ggvs_eval.pipelines.inspection.renders.quick_checks:QUESTION",
    "test view seen": f"{_RUN}.seen_views:QUESTION",
    "same frames": f"{_RUN}.same_frames:QUESTION",
}
SCORE_PARTS = {
    "noise ceilings": f"{_RUN}.references:plan_ceilings",
    "camera path": f"{_RUN}.score_path:plan_path_scores",
    "stream": f"{_RUN}.screens:plan_screens",
}

# The learned baselines: of each a description. Every method by its label: its specification, which
# names its class and keywords, or what makes one of a baseline; in the order in which they are
# listed.
_BASELINES, _MORE_BASELINES = "ggvs_eval.baselines", "ggvs_eval.contrib.more_baselines"
LEARNED_BASELINES = {
    "fwd": f"{_BASELINES}.fwd:BASELINE",
    "ibrnet": f"{_BASELINES}.ibrnet:BASELINE",
    "gps-gaussian": f"{_BASELINES}.gps_gaussian:BASELINE",
    "enerf": f"{_BASELINES}.enerf:BASELINE",
    "mvsplat": f"{_MORE_BASELINES}.mvsplat:BASELINE",
    "mvsnerf": f"{_MORE_BASELINES}.mvsnerf:BASELINE",
}
_METHODS = "ggvs_eval.pipelines.methods"
_BY_WEIGHTS = f"{_METHODS}.baselines:learned_method"
METHODS: dict[str, str | Derived] = {
    "no-blending": f"{_METHODS}.baselines:NO_BLENDING",
    "distance-based": f"{_METHODS}.baselines:DISTANCE_BASED",
    "interpolation": f"{_METHODS}.baselines:INTERPOLATION",
    "fwd": Derived(LEARNED_BASELINES["fwd"], _BY_WEIGHTS),
    "ibrnet": Derived(LEARNED_BASELINES["ibrnet"], _BY_WEIGHTS),
    "gps-gaussian": Derived(LEARNED_BASELINES["gps-gaussian"], _BY_WEIGHTS),
    "gps-gaussian+given-depth": Derived(f"{_BASELINES}.gps_gaussian:GIVEN_DEPTH", _BY_WEIGHTS),
    "enerf": Derived(LEARNED_BASELINES["enerf"], _BY_WEIGHTS),
    "mvsplat": Derived(LEARNED_BASELINES["mvsplat"], _BY_WEIGHTS),
    "mvsnerf": Derived(LEARNED_BASELINES["mvsnerf"], _BY_WEIGHTS),
    "4dgs": f"{_METHODS}.fitted:FOUR_D",
    "3dgs-per-instant": f"{_METHODS}.fitted:PER_INSTANT",
    "3dgstream": f"{_METHODS}.fitted:STREAM",
    "naive": f"{_METHODS}.ours:NAIVE",
    "ours+no-tsdf": f"{_METHODS}.ours:NO_TSDF",
    "ours+no-temporal": f"{_METHODS}.ours:NO_TEMPORAL",
    "ours": f"{_METHODS}.ours:OURS",
    "ours-geometric": f"{_METHODS}.ours:GEOMETRIC",
    "ours-geometric+no-temporal": f"{_METHODS}.ours:GEOMETRIC_NO_TEMPORAL",
    "ours-geometric+point-splat": f"{_METHODS}.ours:POINT_SPLAT",
    "ours-geometric+no-background": f"{_METHODS}.ours:NO_BACKGROUND",
    "ours-geometric+offline": f"{_METHODS}.ours:OFFLINE",
}
# Scenes that others have fitted, which become a method of the label that the user gives.
STORED_SCENES = {"splats": f"{_METHODS}.fitted:StoredSplats"}
# Those that are rendered where none are named.
USUAL_METHODS = (
    "no-blending",
    "distance-based",
    "ours+no-tsdf",
    "ours+no-temporal",
    "ours",
    "ours-geometric",
)

# Depth from images: the class of a matcher; of a network what makes one of a checkpoint (empty: its
# own), a device, and whether it fills what another one does not find.
_OFFLINE = "ggvs_eval.pipelines.offline"
MATCHERS = {
    "sgbm": f"{_OFFLINE}.stereo.sgbm:SgbmMatcher",
    "live": f"{_OFFLINE}.stereo.live:LiveMatcher",
    "sweep": f"{_OFFLINE}.plane_sweep.plane_sweep:PlaneSweep",
    "raft": f"{_OFFLINE}.stereo.raft_matcher:matcher_of_weights",
    "itermvs": f"{_OFFLINE}.itermvs.estimator:matcher_of_weights",
}
# Depth that a sensor measured, made fit for rendering.
SENSORS = {"sensor depth": f"{_OFFLINE}.sensor.sensor_depth:SensorDepthEstimator"}
# Depth of the source cameras of a run.
DEPTH = {"depth": f"{_OFFLINE}.depth.run_depth:MatchedDepth"}
# Cameras of a run: as given or refined.
_RUN = "ggvs_eval.pipelines.run"
CALIBRATIONS = {"calibration": f"{_RUN}.calibration_of_run:calibrate"}
# What runs need before they are rendered, besides captured frames and depth; in the order in which
# it is made.
PREPARATIONS = {
    "camera path": f"{_RUN}.camera_path",
    "fits": f"{_RUN}.fits",
    "live depth": f"{_RUN}.live_depth",
    "disocclusion": f"{_RUN}.disocclusion",
}

# What `prepare` makes of depth besides the store.
DEPTH_OUTPUTS = {
    "depth page": f"{_RUN}.depth_outputs:write_prepared_page",
    "fused instant": f"{_RUN}.depth_outputs:fuse_prepared",
    "dense workspace": f"{_RUN}.depth_outputs:export_prepared",
}
# all parameters of what a user chooses
DEPTH_CHOICES = {"depth": f"{_OFFLINE}.depth.depth_choice:depth_options"}
# Depth that another program has computed, in place of a matcher's.
REFUSALS = {"capture": "ggvs_eval.datasets.refusal:unfit"}
DEPTH_FILES = {"maps": "ggvs_eval.contrib.given_depth.attach:attach_depth"}
NETWORK_MATCHERS = ("raft", "itermvs")

# Engines besides processes of this machine, and plans of sweeps for other schedulers.
ENGINES = {"dask": "ggvs_eval.contrib.cluster.dask_engine:run_on_dask"}
# below the table of a sweep
SWEEP_LINES = {"published": "ggvs_eval.reports.tables.published:published_lines"}
SWEEP_PLANS = {"commands": "ggvs_eval.contrib.cluster.plan:write_commands"}

# Files of Gaussians by suffix, besides .ply; and experiment trackers that results are written for.
SPLAT_FILES = {".glb": "ggvs_eval.contrib.export.gltf_reading:GLB"}
TRACKERS = {
    name: "ggvs_eval.contrib.export.tracking:track_results"
    for name in ("tensorboard", "mlflow", "wandb")
}

# pages without frames
LEADERBOARDS = {"leaderboard": "ggvs_eval.reports.page.leaderboard:write_leaderboard"}

# Sections of a report, in the order in which they are read; and published values for its main
# tables.
_FIGURES, _PAGE, _TABLES = (f"ggvs_eval.reports.{room}" for room in ("figures", "page", "tables"))
_OF_RUNS = "ggvs_eval.reports.section:tables_of_runs"
SECTIONS: dict[str, str | Derived] = {
    "sweep": f"{_PAGE}.sweep_section:sweeps_section",
    "what-if": Derived(
        "ggvs_eval.contrib.what_if.page:undo_faults",
        "ggvs_eval.reports.section:value_of_runs",
        ("undone_frames",),
    ),
    "viewer": f"{_PAGE}.viewer:viewer_section",
    "stream": f"{_PAGE}.stream_section:stream_section",
    "worst frames": Derived(f"{_TABLES}.worst_frames:worst_frames_table", _OF_RUNS, ("views",)),
    "error budget": f"{_TABLES}.error_budget:error_section",
    "drift": Derived(f"{_TABLES}.drift:drift_table", _OF_RUNS, ("views",)),
    "heat maps": f"{_PAGE}.heat_map:heat_section",
    "curves": f"{_FIGURES}.curves:curves_section",
    "slices": f"{_FIGURES}.slices:slices_section",
    "crops": f"{_FIGURES}.paper_figures:crops_section",
    "timing": Derived(f"{_TABLES}.timing:timing_table", _OF_RUNS, ("timing",)),
    "costs": f"{_TABLES}.costs:costs_section",
    "quality over time": f"{_PAGE}.quality_over_time:over_time_section",
    "paper": f"{_TABLES}.reproduction:paper_section",
    "depth": "ggvs_eval.reports.depth_page.section:depth_section",
}
PUBLISHED_VALUES = {
    "paper": f"{_TABLES}.published:paper_beside",
    "community": f"{_TABLES}.published:community_beside",
}

# Functions of metrics that `ggvs_eval.metrics` offers besides those of its own modules.
METRIC_FUNCTIONS = {
    "colmap_consistency": f"{_MORE}.colmap_consistency:colmap_consistency",
    "dists": f"{_MORE}.dists:dists",
    "flip": f"{_MORE}.flip:flip",
    "iv_psnr": f"{_MORE}.iv_psnr:iv_psnr",
    "psnr_ycbcr": f"{_MORE}.iv_psnr:psnr_ycbcr",
    "spatial_consistency": f"{_MORE}.spatial_consistency:spatial_consistency",
}
# Functions that download the weights of a metric's network.
FETCHED_WEIGHTS = {
    "LPIPS": f"{_IMAGE}.fetch_lpips:fetch_weights",
    "DISTS": f"{_MORE}.fetch_dists:fetch_dists_weights",
}

# Conventions under which the numbers of a family of metrics are recomputed (`explain`).
_EXPLAIN = "ggvs_eval.contrib.explain"
CONVENTIONS = {
    "psnr": f"{_EXPLAIN}.frame_conventions:psnr_conventions",
    "iv-psnr": f"{_MORE}.perceptual_conventions:iv_psnr_conventions",
    "ssim": f"{_EXPLAIN}.ssim_conventions:ssim_conventions",
    "ms-ssim": f"{_EXPLAIN}.ssim_conventions:ms_ssim_conventions",
    "dssim": f"{_EXPLAIN}.ssim_conventions:dssim_conventions",
    "lpips": f"{_EXPLAIN}.frame_conventions:lpips_conventions",
    "dists": f"{_MORE}.perceptual_conventions:dists_conventions",
    "flip": f"{_MORE}.perceptual_conventions:flip_conventions",
    "vmaf": f"{_MORE}.perceptual_conventions:vmaf_conventions",
    "cvvdp": f"{_MORE}.perceptual_conventions:vdp_conventions",
    "l1": f"{_EXPLAIN}.frame_conventions:error_conventions",
    "rmse": f"{_EXPLAIN}.frame_conventions:rmse_conventions",
    "tcc": f"{_EXPLAIN}.ssim_conventions:tcc_conventions",
    "sted": f"{_EXPLAIN}.ssim_conventions:sted_conventions",
    "sdt": f"{_EXPLAIN}.ssim_conventions:sdt_conventions",
    "sdv": f"{_EXPLAIN}.ssim_conventions:sdv_conventions",
    "mtv": f"{_EXPLAIN}.steadiness_conventions:mtv_conventions",
    "e_warp": f"{_EXPLAIN}.steadiness_conventions:warping_conventions",
}

# The online step, the finish of found depth, and training samples, where another device computes
# them.
DEVICE_PARTS = {
    "online step": "ggvs_eval.contrib.warp.step:DeviceGuided",
    "depth finish": "ggvs_eval.contrib.warp.depth:finish_maps",
    "training samples": "ggvs_eval.contrib.warp.sampling:sampled_maps",
}
