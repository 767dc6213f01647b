"""The identity of code: a line changed somewhere makes exactly those jobs stale that run it."""

import ast
import importlib.util
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from ggvs_eval.errors import WeightsError
from ggvs_eval.jobs import code_identity as identity
from ggvs_eval.jobs.code_identity import BUILT_FROM, CodeTree, installed_code
from ggvs_eval.metrics.metric import ViewMetric
from ggvs_eval.metrics.registry import METRICS, ceiling_metrics
from ggvs_eval.pipelines.methods.fitted import FittedMethod, StoredSplats
from ggvs_eval.pipelines.methods.registry import METHODS, find_method
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.consistency import describe_check
from ggvs_eval.pipelines.offline.plane_sweep.planes import PlaneSweep
from ggvs_eval.pipelines.offline.sensor.sensor_depth import describe_filter
from ggvs_eval.pipelines.offline.stereo.live import LiveMatcher
from ggvs_eval.pipelines.offline.stereo.raft_matcher import RaftMatcher
from ggvs_eval.pipelines.run.render import method_code
from ggvs_eval.pipelines.run.score_code import ceilings_code, metric_code, path_code

ROOT = Path(__file__).resolve().parents[2]
checkout = pytest.mark.skipif(not (ROOT / "setup.py").exists(), reason="the kernels' sources are in the checkout alone")

IBRNET = ("method", "network", "rendering")
LEARNED = {"naive", "ours", "ours+no-tsdf", "ours+no-temporal"}
OURS = LEARNED | {label for label in METHODS if label.startswith("ours-geometric")}
GPS_GAUSSIAN = {"gps-gaussian", "gps-gaussian+given-depth"}
SPLATTED = OURS | {"no-blending", "distance-based"}
FITTED = {"4dgs", "3dgs-per-instant", "3dgstream"}
ALL_METHODS = SPLATTED | GPS_GAUSSIAN | {"fwd", "ibrnet", "enerf", "mvsplat", "mvsnerf", "interpolation"} | FITTED


def parts(*measures: str) -> set[str]:
    """Measures of the parts of an image."""
    return {f"{measure}_{region}" for measure in measures for region in ("static", "moving", "disoccluded")}


def with_parts(*measures: str) -> set[str]:
    """Measures, and those of the parts."""
    return {*measures, *parts(*measures)}


CORRECTED = with_parts("PSNR_cc", "SSIM_cc", "LPIPS_cc")  # one scorer: a frame is corrected once for all of them
WITH_SSIM = with_parts("SSIM", "TCC", "DSSIM1", "DSSIM2") | {"ceilings"} | CORRECTED
STED, FLICKER = {"STED", "STED_ssn"}, {"Flicker", "Flicker_excess"}
LPIPS = with_parts("LPIPS", "DISTS") | CORRECTED
OTHERS = with_parts("PSNR", "L1", "IV_PSNR", "PSNR_YCbCr", "MS_SSIM", "FLIP") | {"VMAF_v0", "VMAF_v1", "CVVDP"}
STEADY, PATHS = {"mTV", "mTV2"}, {"path", "path with COLMAP"}
ALL_SCORES = WITH_SSIM | OTHERS | STED | FLICKER | LPIPS | STEADY | {"Sharpness"} | PATHS
REGIONS = {name for name in ALL_SCORES if name.endswith(("_static", "_moving", "_disoccluded"))}
STEREO = {"depth by sgbm", "depth by live", "depth by sweep", "depth by raft"}
ALL_DEPTH = STEREO | {"checked depth", "sensor depth"}

TABLES = (
    "VERBS",
    "DATASETS",
    "VIEW_METRICS",
    "METHODS",
    "LEARNED_BASELINES",
    "ENGINES",
    "CONVENTIONS",
    "SPLAT_FILES",
    "TRACKERS",
)

# A file of the package, and the jobs that are stale when one byte of it changes.
STALE: dict[str, set[str]] = {
    "camera.py": ALL_METHODS | ALL_DEPTH | PATHS,
    "kernels/_film": ALL_METHODS | ALL_DEPTH | PATHS,
    "files/images.py": ALL_METHODS | ALL_SCORES | {"sensor depth"},
    "geometry/difference_mask.py": OURS | REGIONS | STEADY,
    "geometry/warp.py": OURS | PATHS,
    "geometry/splat.py": SPLATTED | PATHS,
    "method.py": ALL_METHODS | PATHS,
    "kernels/_core": SPLATTED | {"ibrnet"} | REGIONS | STEADY | PATHS,
    "kernels/_ssim": WITH_SSIM,
    "kernels/_iv_psnr": with_parts("IV_PSNR", "PSNR_YCbCr"),
    "kernels/_stereo": STEREO,
    **{f"baselines/ibrnet/{name}.py": {"ibrnet"} for name in IBRNET},
    "baselines/enerf/rendering.py": {"enerf"},
    "baselines/fixed_blending.py": {"no-blending", "distance-based"},
    "baselines/gps_gaussian/network.py": GPS_GAUSSIAN,
    "contrib/more_baselines/mvsplat/depth.py": {"mvsplat"},
    "contrib/more_baselines/mvsnerf/volume.py": {"mvsnerf"},
    "baselines/view_interpolation.py": {"interpolation"},
    "gaussians/cloud.py": {"mvsplat"} | FITTED,
    "pipelines/online/blend_network.py": LEARNED,
    "pipelines/online/temporal_filters.py": OURS,
    "pipelines/online/whole_sequence.py": {"ours-geometric+offline"},
    "pipelines/methods/render_unit.py": ALL_METHODS,
    "pipelines/offline/stereo/sgbm.py": {"depth by sgbm", "depth by live", "depth by raft"},
    "pipelines/offline/stereo/live.py": {"depth by live"},
    "raft_update.py": GPS_GAUSSIAN | {"depth by raft"},
    "pipelines/offline/plane_sweep/plane_sweep.py": {"depth by sweep"},
    "pipelines/offline/depth/depth_stream.py": STEREO,
    "pipelines/offline/depth/consistency.py": {"checked depth"},
    "pipelines/offline/sensor/sensor_grid.py": {"sensor depth"},
    "metrics/image/lpips.py": LPIPS - with_parts("DISTS"),
    "metrics/image/lpips_network.py": LPIPS,
    "metrics/time/strred.py": STED | {"ceilings"},
    "metrics/time/tcc.py": with_parts("TCC") | {"ceilings"},
    "contrib/more_metrics/dists.py": with_parts("DISTS"),
    "metrics/time/flicker.py": FLICKER,
    "metrics/image/regions.py": REGIONS | STEADY,
    "metrics/image/sharpness.py": STEADY | {"Sharpness"} | PATHS,
    "metrics/time/temporal_variation.py": STEADY,
    "metrics/time/depth_variation.py": set(),
    "contrib/more_metrics/colmap_worker.py": {"path with COLMAP"},
    "metrics/noise/estimate.py": {"ceilings"},
    "metrics/noise/recording.py": {"ceilings"},
    "metrics/path/view_consistency.py": PATHS,
    "metrics/stream.py": ALL_SCORES - PATHS,
    "built_in.py": set(),
    "plugins.py": set(),
    "datasets/llff.py": set(),
    "contrib/cluster/dask_engine.py": set(),
    "contrib/cluster/plan.py": set(),
    "contrib/export/tracking.py": set(),
    "contrib/export/gltf_reading.py": set(),
    "contrib/more_metrics/perceptual_conventions.py": set(),
    "contrib/study/command.py": set(),
    "contrib/worlds/command.py": set(),
    "contrib/worlds/room/room.py": set(),
    "contrib/training/train_one.py": set(),
    "contrib/training/recipes/enerf.py": set(),
    "synthetic/shipped.py": set(),
    "baselines/fitted/training_log.py": FITTED,
    "errors.py": set(),
    "progress.py": set(),
    "metrics/registry.py": set(),
    "metrics/__init__.py": set(),
    "protocol.py": set(),
    "run_folder.py": set(),
    "jobs/job.py": set(),
    "jobs/code_identity.py": set(),
    "reports/report.py": set(),
    "reports/tables/report_tables.py": set(),
    "pipelines/methods/registry.py": set(),
    "pipelines/run/render.py": set(),
    "pipelines/run/score.py": set(),
    "pipelines/run/prepare.py": set(),
    "pipelines/run/run_plan.py": set(),
    "pipelines/commands/main.py": set(),
}


def copy_package(folder: Path) -> CodeTree:
    """The installed package in one folder, as a wheel lays it out."""
    installed = installed_code()
    for module in installed.modules():
        source = installed.file(module)
        assert source is not None
        target = folder.joinpath(*module.split("."))
        target = target / source.name if source.name == "__init__.py" else target.with_name(source.name)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
    return CodeTree(folder / "ggvs_eval")


@contextmanager
def changed_line(tree: CodeTree, name: str) -> Iterator[None]:
    """Add a statement; of an extension module, change the hash of its sources, as a build from other sources does.

    The rest of the tree, which has not changed, is not read again: sixty times the whole package would be.
    """
    module = ".".join(["ggvs_eval", *name.removesuffix(".py").removesuffix("/__init__").split("/")])
    file, read = tree.file(module), identity._code_of
    assert file is not None
    content = file.read_bytes()
    built_from = BUILT_FROM.search(content)
    file.write_bytes(content.replace(built_from[1], built_from[1][::-1]) if built_from else content + b"CHANGED = 1\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identity, "_code_of", lambda tree, each: (read.__wrapped__ if each == module else read)(tree, each))
        yield
    file.write_bytes(content)


def codes_of(tree: CodeTree) -> dict[str, Any]:
    """Hashes of the code of every kind of job, by its name."""
    matchers = {
        "sgbm": DepthOptions().matcher,
        "live": LiveMatcher(),
        "sweep": PlaneSweep(),
        "raft": RaftMatcher(Path("weights"), ""),
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identity, "installed_code", lambda: tree)
        return {
            **{label: method_code(spec) for label, spec in METHODS.items()},
            **{name: metric_code(metric) for name, metric in METRICS.items() if isinstance(metric, ViewMetric)},
            "path": path_code(()),
            "path with COLMAP": path_code(("COLMAP_matches",)),
            "ceilings": ceilings_code(ceiling_metrics()),
            **{f"depth by {name}": DepthOptions(matcher=each).describe()["code"] for name, each in matchers.items()},
            "checked depth": describe_check()["code"],
            "sensor depth": describe_filter()["code"],
        }


@pytest.fixture(scope="module")
def installed() -> dict[str, Any]:
    """The hashes of the code as it is."""
    return codes_of(installed_code())


@pytest.fixture(scope="module")
def copied(tmp_path_factory) -> CodeTree:
    """The package somewhere else, as it is."""
    return copy_package(tmp_path_factory.mktemp("package"))


@pytest.mark.slow
@pytest.mark.parametrize("name", STALE)
def test_exactly_the_right_jobs_go_stale(name, installed, copied):
    """A changed line makes those methods, scores and depth maps stale that run it, and no other."""
    with changed_line(copied, name):
        changed = codes_of(copied)

    assert {job for job in installed if installed[job] != changed[job]} == STALE[name]


SAID = """
import os  # where

# a note


class Thing:
    '''What it is.

    More of it.
    '''

    size: int = 3
    "Pixels."

    def act(self):
        '''Act.'''
        return f"{self.size}: {os.name}"  # not 'quoted
"""
RUNS = 'import os\nclass Thing:\n    size: int = 3\n    def act(self):\n        return f"{self.size}: {os.name}"'


def test_what_is_said_about_code_does_not_count():
    """Comments, docstrings, empty lines and line ends cost nobody a night of rendering; what stands in strings does."""
    assert identity.what_runs(SAID).strip() == RUNS
    assert identity.what_runs(SAID.replace("\n", "\r\n")) == identity.what_runs(SAID)
    text = 'value = """a\n\n# b\n"""\ncall(\n    "c"  # d\n    "#e",\n\n)\n'
    assert identity.what_runs(text).strip() == 'value = """a\n\n# b\n"""\ncall(\n    "c"\n    "#e",\n)'


@pytest.mark.slow
def test_all_that_runs_counts():
    """Each source of the package is the same program without what is said, by Python's own parser."""
    tree, compared = installed_code(), 0
    for module in tree.modules():
        file = tree.file(module)
        source = file.read_text(encoding="utf-8") if file is not None and file.suffix == ".py" else ""
        whole = _without_docstrings(ast.parse(source))
        if all(getattr(node, "body", True) for node in ast.walk(whole)):  # a body of nothing else does not parse without it
            compared += 1
            assert ast.dump(ast.parse(identity.what_runs(source))) == ast.dump(whole), module
    assert compared > 300


def _without_docstrings(tree: ast.AST) -> ast.AST:
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):
            node.body = [line for line in body if not _is_text(line)]
    return tree


def _is_text(line: ast.stmt) -> bool:
    return isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant) and isinstance(line.value.value, str)


def test_every_kind_of_job_is_tried(installed):
    """The table above speaks of every method, metric and way to find depth."""
    assert installed.keys() == ALL_METHODS | ALL_SCORES | ALL_DEPTH


@pytest.mark.parametrize("table", TABLES)
def test_a_new_entry_makes_no_other_stale(table, installed, copied):
    """A module of its own and its line in the table of its kind leave every job that is there as it was."""
    file = copied.folder / "built_in.py"
    text = file.read_text(encoding="utf-8")
    (copied.folder / "added.py").write_text("from ggvs_eval.metrics.image.psnr import psnr\n", encoding="utf-8")
    with changed_line(copied, "built_in.py"):
        file.write_text(f'{text}\n{table}["added"] = "ggvs_eval.added:psnr"\n', encoding="utf-8")
        assert codes_of(copied) == installed
    (copied.folder / "added.py").unlink()


@pytest.mark.parametrize(("name", "changed"), [("warp/step.py", "on a GPU"), ("export/gltf_reading.py", "room.glb")])
def test_what_a_table_loads_counts_where_it_renders(name, changed, copied):
    """A step on another device counts there alone, the reader of a file of Gaussians where such a file is rendered."""
    specs = {
        "on the CPU": METHODS["ours"],
        "on a GPU": METHODS["ours"].on("cuda"),
        **{name: StoredSplats.of("splats", Path(name)) for name in ("room.glb", "room.ply")},
    }

    def codes() -> dict[str, str]:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(identity, "installed_code", lambda: copied)
            return {label: method_code(spec) for label, spec in specs.items()}

    before = codes()
    with changed_line(copied, f"contrib/{name}"):
        after = codes()
    assert {label for label in specs if before[label] != after[label]} == {changed}


def load_setup() -> ModuleType:
    spec = importlib.util.spec_from_file_location("kernel_setup", ROOT / "setup.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@checkout
@pytest.mark.parametrize(
    ("source", "rebuilt"),
    [
        ("ssim.cpp", {"_ssim"}),
        ("splat_simd.hpp", {"_core"}),  # included by files that are included
        ("sgm.cpp", {"_stereo"}),
        ("minimal_filtering.hpp", {"_core", "_features"}),
        ("gaussian_blend_simd.hpp", {"_gaussians"}),
        ("parallel.hpp", {"_core", "_deformation", "_features", "_gaussians", "_ssim", "_iv_psnr", "_stereo"}),
    ],
)
def test_sources_of_kernels(source, rebuilt, monkeypatch, tmp_path):
    """A changed source changes the hash of the extension modules that it is compiled into, and of no other."""
    setup = load_setup()
    shutil.copytree(ROOT / "ggvs_eval/kernels", tmp_path / "kernels")
    monkeypatch.setattr(setup, "KERNELS", tmp_path / "kernels")
    before = {name: setup.digest_sources(name) for name in setup.EXTENSIONS}

    with (tmp_path / "kernels" / source).open("a") as file:
        file.write("//")

    assert {name for name in before if setup.digest_sources(name) != before[name]} == rebuilt


@checkout
@pytest.mark.parametrize("name", ["_core", "_deformation", "_gaussians", "_ssim", "_iv_psnr", "_stereo"])
def test_kernels_carry_the_hash_of_their_sources(name, monkeypatch):
    """What was built says from what, and that is what lies here; where it is not, `make clean` or setup.py builds it anew."""
    monkeypatch.chdir(ROOT)
    built = installed_code().file(f"ggvs_eval.kernels.{name}")
    assert built is not None

    carried = BUILT_FROM.findall(built.read_bytes())

    assert [each.decode() for each in carried] == [load_setup().digest_sources(name)]


@pytest.fixture
def package(tmp_path) -> CodeTree:
    """A package of a few lines."""
    files = {
        "__init__": "from ggvs_eval import everything",
        "everything": "",
        "root": """
            import os.path
            from typing import TYPE_CHECKING
            from ggvs_eval.head import value
            from ggvs_evaluation import other
            if TYPE_CHECKING:
                from ggvs_eval import for_types
            else:
                from ggvs_eval import for_running
            class Thing:
                def act(self):
                    if value:
                        import ggvs_eval.room.inner
                    text = "from ggvs_eval import everything"
            """,
        "head": "from . import beside\nfrom .room import named\nfrom ggvs_eval.jobs import engine",
        "beside": "",
        "for_types": "",
        "for_running": "",
        "room/__init__": "from ggvs_eval.room.behind import named",
        "room/inner": "from .deep import value\nfrom .. import above",
        "room/behind": "import ggvs_eval.root",
        "room/deep/__init__": "value = 1",
        "above": "from ggvs_eval.chooser import choose",
        "chooser": "from ggvs_eval import chosen",
        "chosen": "",
        "jobs/engine": "",
    }
    for name, text in files.items():
        file = tmp_path / "ggvs_eval" / f"{name}.py"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(re.sub("^            ", "", text, flags=re.MULTILINE))
    return CodeTree(tmp_path / "ggvs_eval")


def names(closure: tuple[str, ...]) -> list[str]:
    return [module.removeprefix("ggvs_eval.") for module in closure]


def test_the_closure(package):
    """Imports at heads, inside functions, relative ones and circles are followed; text, other packages and types are not."""
    assert names(package.closure("ggvs_eval.root")) == sorted(
        ["root", "head", "beside", "for_running", "room", "room.inner", "room.behind", "room.deep", "above", "chooser", "chosen"]
    )


def test_a_package_counts_where_something_is_taken_from_it(package):
    """``room/__init__.py`` belongs to those who import its names, not to those who import a module that lies in it."""
    assert "room" in names(package.closure("ggvs_eval.head"))
    assert names(package.closure("ggvs_eval.room.inner")) == ["above", "chooser", "chosen", "room.deep", "room.inner"]


def test_what_chooses_is_not_followed(package):
    """A module that chooses among many counts itself; what it could choose does not."""
    closure = package.closure("ggvs_eval.above", unfollowed=["ggvs_eval.chooser"])

    assert names(closure) == ["above", "chooser"]


def test_the_digest_depends_on_no_order(package):
    """Neither the order of the modules nor line ends that a checkout on another system has make a difference; a byte does."""
    modules = package.closure("ggvs_eval.root")
    other = CodeTree(package.folder.parent / "again" / "ggvs_eval")
    for file in sorted(package.folder.rglob("*.py"), reverse=True):
        copy = other.folder / file.relative_to(package.folder)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(file.read_bytes().replace(b"\n", b"\r\n"))

    assert other.digest(modules[::-1]) == package.digest(modules)
    assert package.digest(modules[1:]) != package.digest(modules)


def test_a_missing_module_is_named(package):
    """A root that is not there is an error, not an empty closure."""
    with pytest.raises(ModuleNotFoundError, match=r"ggvs_eval\.gone: wanted its code"):
        package.closure("ggvs_eval.gone")


@pytest.mark.slow
def test_nothing_is_imported():
    """The closure of the heaviest method is found without loading it, or anything else."""
    code = (
        "import sys; from ggvs_eval.jobs.code_identity import code_identity, package_digest;"
        "before = set(sys.modules);"
        "code_identity('ggvs_eval.pipelines.online.network_blender', 'ggvs_eval.metrics.image.lpips'); package_digest();"
        "print([name for name in set(sys.modules) - before if name.startswith(('ggvs_eval', 'torch', 'numpy', 'cv2'))])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"


def test_the_whole_package_is_found():
    """Machines that share jobs compare all of it: every room, and the extension modules."""
    modules = set(installed_code().modules())
    rooms = {"camera", "geometry.warp", "kernels._core", "baselines.ibrnet.method", "metrics.image.lpips", "reports.report"}

    assert {f"ggvs_eval.{room}" for room in (*rooms, "pipelines.commands.main", "jobs.code_identity")} <= modules


def test_packages_do_nothing_when_they_are_imported():
    """That a package on the way to a module need not count rests on this: its ``__init__.py`` defines names and no more."""
    harmless = (ast.Import, ast.ImportFrom, ast.FunctionDef, ast.ClassDef, ast.AnnAssign, ast.Assign)
    tree = installed_code()
    acting = []
    for module in tree.modules():
        file = tree.file(module)
        if file is not None and file.name == "__init__.py":
            body = ast.parse(file.read_text(encoding="utf-8")).body[1:]  # after the docstring
            acting += [f"{module}: {ast.unparse(node)}" for node in body if not _is_definition(node, harmless)]

    assert acting == []


def _is_definition(node: ast.stmt, harmless: tuple[type, ...]) -> bool:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    type_checking = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
    return type_checking or (isinstance(node, harmless) and all(isinstance(target, ast.Name) for target in targets))


@pytest.mark.parametrize("label", METHODS)
def test_a_method_names_its_modules(label):
    """Whatever a method is made of stands in the closure of the modules that its spec names."""
    spec = find_method(label)
    try:
        method = spec.make_fitter() if isinstance(spec, FittedMethod) else spec.make()
    except WeightsError:
        pytest.skip("its weights do not ship")
    closure = installed_code().closure(*spec.modules)

    assert {type(part).__module__ for part in _parts(method)} <= set(closure)


def _parts(value: Any, depth: int = 4) -> Iterator[Any]:
    """The objects of this package that an object is made of, itself included."""
    if type(value).__module__.startswith("ggvs_eval.") and depth:
        yield value
        for part in getattr(value, "__dict__", {}).values():
            yield from _parts(part, depth - 1)


@pytest.mark.parametrize(
    ("label", "settings"),
    [
        ("ours", {}),
        ("naive", {"guidance": "naive", "fused": False}),
        ("ours-geometric+no-background", {"background": False}),
        ("gps-gaussian+given-depth", {"depth": "given"}),
    ],
)
def test_settings_of_a_label(label, settings):
    """What a label fixes is told beside the code, so that a label that comes to mean something else is stale; no device is."""
    assert METHODS[label].settings == settings
    assert find_method(label).on("cuda").settings == settings
