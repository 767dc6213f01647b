"""The plan of the tree: rooms stand on floors, and imports go down. docs/architecture.md
draws it.
"""

import ast
import subprocess
import sys

import pytest

from helpers.import_graph import imported_modules, imports_of_test, modules, parsed, rooms_that_use

MODULES = modules()
# Each learned baseline is a folder of its own, and knows no other.
IN_BASELINES = {
    name
    for name, file in MODULES.items()
    if name.startswith("baselines.") and file.name == "__init__.py"
}
LEARNED = tuple(sorted(IN_BASELINES))

# Rooms from the ground up; rooms of one floor do not import each other. A module of the package
# itself, e.g. `ggvs_eval.camera`, is a room of its own; what stands in a folder belongs to the
# longest name listed here.
FLOORS = (
    (
        "arrays",
        "built_in",
        "errors",
        "finding",
        "kernels",
        "metric_choices",
        "raft_config",
        "residual_block",
    ),
    ("camera", "progress", "plugins", "raft_update", "side_process"),
    ("files", "lens", "compute_device", "method"),
    ("geometry", "capture", "colour_maps", "transforms"),
    ("capture_edit", "depth_options", "protocol", "gaussians", "tasks.identity"),
    ("measured_frames", "run_folder", "results", "sweep"),
    ("tasks.task",),
    ("depth_store",),
    ("depth_work", "scene_fitter"),
    ("statistics", "merged_results", "datasets", "jobs", "synthetic.d3dmv_scene", "coverage"),
    ("tasks",),
    ("synthetic", "renders", "scoring"),
    ("baselines", "metrics.inputs", "metrics.metric"),
    ("metrics.on_device", "metrics.colour_moments"),
    (*LEARNED, "metrics.image", "metrics.noise"),
    ("baselines.registry", "metrics.path", "metrics.time"),
    ("metrics",),
    ("reports.model",),
    ("reports.tables.verdict",),
    ("reports.section",),
    ("reports.figures", "reports.tables"),
    ("reports.run_groups",),
    ("reports.page", "reports.tables_of_runs"),
    ("reports.report", "reports.depth_page"),
    ("pipelines.offline.depth.matchers",),  # what depth asks of those that stand below it
    (
        *(
            "pipelines.online",
            "pipelines.offline.stereo",
            "pipelines.offline.itermvs",
            "pipelines.offline.plane_sweep",
        ),
        "pipelines.offline.calibration",
    ),
    ("pipelines.offline.sensor",),
    ("pipelines.methods",),
    ("pipelines.offline.depth",),
    ("pipelines.offline.export", "pipelines.inspection"),
    ("pipelines.inspection.capture", "pipelines.inspection.renders"),
    ("pipelines.run",),
    ("pipelines.play",),
    ("pipelines.sweep.merging", "pipelines.sweep"),
    ("pipelines.commands",),
    ("api",),
    ("__main__", "install"),
    # What the package can do without, each part by itself; more_metrics adds conventions, and
    # training stands on two others.
    ("contrib.explain",),
    (
        "contrib.cluster",
        "contrib.export",
        "contrib.given_depth",
        "contrib.more_baselines",
        "contrib.more_metrics",
        "contrib.study",
        "contrib.view",
        "contrib.warp",
        "contrib.what_if",
    ),
    ("contrib.worlds.room",),
    ("contrib.worlds.film",),
    ("contrib.worlds.layouts",),
    ("contrib.worlds",),
    ("contrib.training",),
)
FLOOR_OF = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}

# What measures must not know who made the frames, and reports read run folders alone. `reports`
# stands below the pipelines because they start it; it may not be reached from anywhere else.
FORBIDDEN = {
    "reports": ("metrics", "baselines"),
    "metrics": ("baselines", "synthetic"),
    "baselines": ("metrics", "synthetic"),
    "pipelines": ("reports",),
}
MAY_START_REPORTS = {
    *(
        f"pipelines.commands.{verb}"
        for verb in ("figures", "figure", "compare", "steadiness", "runs")
    ),
    *("pipelines.run.evaluate", "pipelines.run.depth_outputs"),
}


def room_of(module: str) -> str:
    """The longest room whose name the module's begins with."""
    parts = module.split(".")
    return next(
        (room for end in range(len(parts), 0, -1) if (room := ".".join(parts[:end])) in FLOOR_OF),
        "",
    )


def test_every_module_has_a_room():
    """A module that stands in no listed room has no place in the plan; packages without code need
    none.
    """
    empty = {
        name
        for name, file in MODULES.items()
        if file.name == "__init__.py" and not imported_modules(file)
    }

    assert sorted(name for name in MODULES if not room_of(name) and name not in empty) == []
    assert (
        sorted(room for room in FLOOR_OF if not any(room_of(name) == room for name in MODULES))
        == []
    )


def test_arrows_go_down():
    """A module imports its own room and rooms of lower floors alone: so there is no circle
    either.
    """
    wrong = [
        f"{module} ({FLOOR_OF[room_of(module)]}) imports {other} ({FLOOR_OF[room_of(other)]})"
        for module, file in sorted(MODULES.items())
        if room_of(module)
        for other in sorted(imported_modules(file))
        if room_of(other)
        and room_of(other) != room_of(module)
        and FLOOR_OF[room_of(other)] >= FLOOR_OF[room_of(module)]
    ]

    assert wrong == []


def test_rooms_that_must_not_know_each_other():
    """Metrics know no method, methods no metric, reports neither; pipelines start a report from a
    few doors alone.
    """
    wrong = [
        f"{module} imports {other}"
        for module, file in sorted(MODULES.items())
        if module not in MAY_START_REPORTS
        for other in sorted(imported_modules(file))
        if other.split(".")[0] in FORBIDDEN.get(module.split(".")[0], ())
    ]

    assert wrong == []


def test_parts_of_contrib_know_no_other():
    """Training builds on others: rooms to learn from, networks that it trains; more_metrics adds
    conventions to explain's.
    """
    crossing = {
        (module.split(".")[1], other.split(".")[1])
        for module, file in MODULES.items()
        if module.count(".") > 1 and module.startswith("contrib.")
        for other in imported_modules(file)
        if other.startswith("contrib.") and other.split(".")[1] != module.split(".")[1]
    }

    assert crossing == {
        ("training", "worlds"),
        ("training", "more_baselines"),
        ("more_metrics", "explain"),
    }


def test_what_can_be_taken_away_is_named_in_one_place():
    """Core knows parts of contrib by the table of what ships alone, in which they are text."""
    naming = {
        name for name, file in MODULES.items() if "ggvs_eval.contrib" in file.read_text("utf-8")
    }

    assert {name for name in naming if not name.startswith("contrib.")} == {"built_in"}


def test_modules_of_a_room_make_no_circle():
    """Inside a room, too, imports make no circle."""
    arrows = {
        module: imported_modules(file) & MODULES.keys() - {module}
        for module, file in MODULES.items()
    }
    cleared: set[str] = set()
    while free := {module for module in arrows.keys() - cleared if arrows[module] <= cleared}:
        cleared |= free

    assert sorted(arrows.keys() - cleared) == []


@pytest.mark.slow
def test_importing_the_package_loads_nothing_heavy():
    """`import ggvs_eval` and its words stay light: torch, Open3D, pycolmap, PyAV and matplotlib
    load when they are used.
    """
    code = (
        "import sys, ggvs_eval.camera, ggvs_eval.capture, ggvs_eval.protocol, "
        "ggvs_eval.datasets;import ggvs_eval.pipelines.methods.registry;print([name for name in "
        "('torch', 'open3d', 'pycolmap', 'av', 'matplotlib') if name in sys.modules])"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout.strip()
        == "[]"
    )


@pytest.mark.slow
def test_lines_of_imports_are_those_of_the_syntax_trees():
    """What the plan is read from are the real imports, of every module."""
    for module, file in MODULES.items():
        names = set()
        for node in ast.walk(parsed(file)):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                inner = {f"{node.module}.{alias.name}" for alias in node.names}
                names |= {
                    name if name.removeprefix("ggvs_eval.") in MODULES else node.module
                    for name in inner
                }
        wanted = {
            name.removeprefix("ggvs_eval.") for name in names if name.startswith("ggvs_eval.")
        }
        assert imported_modules(file) == wanted, module


def test_a_room_names_the_rooms_that_import_it(tmp_path):
    """So `--room` chooses tests: those of the room and of its users, by what a test or a helper of
    it imports.
    """
    assert rooms_that_use("online") == rooms_that_use("pipelines.online")
    assert rooms_that_use("online") >= {"pipelines.online", "contrib.warp"}
    assert not rooms_that_use("online") & {"reports", "geometry", "metrics.image"}
    with pytest.raises(KeyError, match="no room is called 'onlin'"):
        rooms_that_use("onlin")
    file = tmp_path / "test_x.py"
    file.write_text("from helpers.small_runs import LABELS\nimport ggvs_eval.lens\n")
    assert imports_of_test(file) >= {"lens", "capture", "protocol", "reports.report"}
    assert "pipelines.online" not in imports_of_test(file)
