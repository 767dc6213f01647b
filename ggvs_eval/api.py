"""What a part may use of the rest of the package: public modules, and single names of others.

At most 150 together.

A part is a metric, a method, a layout, a section, a question, a matcher, a verb: whatever can be
deleted. It imports from where a name is defined; this list is what a test holds all parts to, those
of `contrib` among them. One more name here is a decision about design: from then on it cannot
change without its users.
"""

# ruff: noqa: F401 - names are listed, not used

from ggvs_eval import (
    arrays,
    built_in,
    camera,
    capture,
    colour_maps,
    compute_device,
    coverage,
    depth_options,
    depth_store,
    depth_work,
    errors,
    finding,
    kernels,
    lens,
    measured_frames,
    method,
    metric_choices,
    plugins,
    progress,
    protocol,
    results,
    run_folder,
    scoring,
    side_process,
)
from ggvs_eval.datasets import (
    assemble,
    camera_frames,
    colmap_model,
    corrections,
    depth_range,
    detect_layout,
    entries,
    find_cameras,
    frames,
    instants,
    llff,
    media,
    open_capture,
    rig,
    units,
)
from ggvs_eval.datasets.colmap import by_camera, find_model
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.public_captures import locate
from ggvs_eval.datasets.refusal import calibration_mark
from ggvs_eval.datasets.undistort import UndistortedFrames
from ggvs_eval.datasets.unread_files import unused_note
from ggvs_eval.files import (
    array_file,
    atomic,
    coding,
    colmap_text,
    digest,
    download,
    images,
    listing,
    names,
    pickle_reader,
    plain,
    toml_tables,
    video,
    weights_file,
)
from ggvs_eval.files.packed_maps import unpack
from ggvs_eval.files.picture_header import read_picture_header
from ggvs_eval.files.templates import open_templates
from ggvs_eval.geometry import (
    epipolar,
    pinhole,
    rectification,
    registration,
    reproject_depth,
    sight,
    source_views,
)
from ggvs_eval.jobs import engine, processes
from ggvs_eval.jobs.machine import PeakMemory
from ggvs_eval.kernels import portable
from ggvs_eval.merged_results import merge_results, tell_scenes_apart
from ggvs_eval.metrics import inputs, metric, stream
from ggvs_eval.metrics import registry as metric_registry
from ggvs_eval.metrics.colour_moments import ColourMoments
from ggvs_eval.pipelines.commands import captures, flags, renders, runs
from ggvs_eval.pipelines.inspection import table as text_tables
from ggvs_eval.pipelines.methods import registry as method_registry
from ggvs_eval.pipelines.methods import render_unit, spec
from ggvs_eval.pipelines.methods.network_options import NetworkOptions, checked_device
from ggvs_eval.pipelines.methods.stage_costs import depth_cost
from ggvs_eval.pipelines.run import run_plan
from ggvs_eval.pipelines.run.depth_of_run import DepthProvider
from ggvs_eval.pipelines.run.derived_files import cache_frames, path_task, seen_from
from ggvs_eval.pipelines.run.evaluate import measure, recorded_capture, reopen
from ggvs_eval.pipelines.run.import_renders import named_renders
from ggvs_eval.pipelines.run.prepare import prepare_run
from ggvs_eval.pipelines.run.render import FITS, UnitTask, diagnostics_picture
from ggvs_eval.pipelines.run.score_code import MEASURING, metric_code
from ggvs_eval.pipelines.run.score_view import digest_frames, metric_options, truth_frames
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
from ggvs_eval.pipelines.sweep.cells import Captures, Cell, sweep_cells, units_of
from ggvs_eval.renders.view_streams import ARRAY_SUFFIXES, ArrayStack, npz_members
from ggvs_eval.reports import section
from ggvs_eval.reports.figures import axes
from ggvs_eval.reports.model import measured
from ggvs_eval.reports.model import table as report_table
from ggvs_eval.reports.page.page import fill_page, run_words
from ggvs_eval.reports.run_groups import read_groups, runs_by_protocol
from ggvs_eval.reports.tables import table_formats, verdict
from ggvs_eval.reports.tables.report_tables import main_tables, metric_column
from ggvs_eval.statistics import decomposition, paired
from ggvs_eval.statistics.autocorrelation import ErrorOfMean, correlation_posterior, describe_short
from ggvs_eval.statistics.intervals import LEVEL, intervals
from ggvs_eval.statistics.pooling import Pooling, powers_of_means
from ggvs_eval.statistics.rank_correlation import answer
from ggvs_eval.sweep import Sweep
from ggvs_eval.synthetic.d3dmv_scene import SCENE, write_scene
from ggvs_eval.synthetic.shipped import MAIN, is_written, write_room
from ggvs_eval.tasks import run_tasks, task, task_list
from ggvs_eval.tasks.identity import code_of
