"""The identity of code: a line changed somewhere makes exactly those jobs stale that run it."""

import importlib.util
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from ggvs_eval.jobs import code_identity as identity
from ggvs_eval.jobs.code_identity import BUILT_FROM, CodeTree, installed_code
from ggvs_eval.metrics.metric import ViewMetric
from ggvs_eval.metrics.registry import METRICS, ceiling_metrics
from ggvs_eval.pipelines.methods.fitted import StoredSplats
from ggvs_eval.pipelines.methods.registry import METHODS, find_method
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.consistency import describe_check
from ggvs_eval.pipelines.offline.plane_sweep.plane_sweep import PlaneSweep
from ggvs_eval.pipelines.run.references import ceilings_code
from ggvs_eval.pipelines.run.render import method_code
from ggvs_eval.pipelines.run.score_code import metric_code
from ggvs_eval.pipelines.run.score_path import path_code
from helpers.places import ROOT

checkout = pytest.mark.skipif(not (ROOT / "setup.py").exists(), reason="the kernels' sources are in the checkout alone")

OURS = {"naive", *(label for label in METHODS if label.startswith("ours"))}
REGIONS = ("", "_static", "_moving", "_disoccluded")
WITH_SSIM = {f"{name}{region}" for name in ("SSIM", "SSIM_cc", "TCC", "DSSIM1", "DSSIM2") for region in REGIONS}
CORRECTED = {f"{name}_cc{region}" for name in ("PSNR", "SSIM", "LPIPS") for region in REGIONS}  # one scorer
# A file of the package, and the jobs that are stale when one byte of it changes.
STALE: dict[str, set[str]] = {
    "baselines/enerf/rendering.py": {"enerf"},
    "contrib/more_baselines/mvsplat/depth.py": {"mvsplat"},
    "baselines/fixed_blending.py": {"no-blending", "distance-based"},
    "pipelines/online/temporal_filters.py": OURS,
    "pipelines/online/whole_sequence.py": {"ours-geometric+offline"},
    "baselines/fitted/training_log.py": {"4dgs", "3dgs-per-instant", "3dgstream"},
    "kernels/_ssim": WITH_SSIM | CORRECTED | {"ceilings"},
    "metrics/image/lpips.py": {f"LPIPS{region}" for region in REGIONS} | CORRECTED,
    "metrics/path/view_consistency.py": {"path", "path with COLMAP"},
    "contrib/more_metrics/colmap_worker.py": {"path with COLMAP"},
    "metrics/noise/estimate.py": {"ceilings"},
    "pipelines/offline/plane_sweep/plane_sweep.py": {"depth by sweep"},
    "pipelines/offline/depth/depth_stream.py": {"depth by sgbm", "depth by sweep"},
    "pipelines/offline/depth/consistency.py": {"checked depth"},
}
NOBODY = ("errors", "progress", "protocol", "plugins", "reports/report", "datasets/llff", "pipelines/run/score")
TABLES = [
    "VERBS",
    "DATASETS",
    "VIEW_METRICS",
    "METHODS",
    "LEARNED_BASELINES",
    "ENGINES",
    "CONVENTIONS",
    "SPLAT_FILES",
    "TRACKERS",
]


@pytest.fixture(scope="module")
def copied(tmp_path_factory) -> CodeTree:
    """The package in one folder, as a wheel lays it out."""
    folder, installed = tmp_path_factory.mktemp("package"), installed_code()
    for module in installed.modules():
        source = installed.file(module)
        target = folder.joinpath(*module.split("."))
        target = target / source.name if source.name == "__init__.py" else target.with_name(source.name)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
    return CodeTree(folder / "ggvs_eval")


@pytest.fixture(scope="module")
def before(copied) -> dict[str, Any]:
    """The hashes of the code as it is."""
    return codes_of(copied)


def codes_of(tree: CodeTree) -> dict[str, Any]:
    """Hashes of the code of every kind of job, by its name."""
    matchers = {"sgbm": DepthOptions().matcher, "sweep": PlaneSweep()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identity, "installed_code", lambda: tree)
        return {
            **{label: method_code(spec) for label, spec in METHODS.items()},
            **{name: metric_code(metric) for name, metric in METRICS.items() if isinstance(metric, ViewMetric)},
            "path": path_code(()),
            "path with COLMAP": path_code(("COLMAP_matches",)),
            "ceilings": ceilings_code(ceiling_metrics()),
            **{f"depth by {name}": DepthOptions(matcher=matcher).describe()["code"] for name, matcher in matchers.items()},
            "checked depth": describe_check()["code"],
            "ours on a GPU": method_code(METHODS["ours"].on("cuda")),
            "Gaussians of a file": method_code(StoredSplats.of("splats", Path("room.glb"))),
        }


@contextmanager
def changed_line(tree: CodeTree, name: str, more: str = "CHANGED = 1\n") -> Iterator[None]:
    """Add a statement; of an extension module, change the hash of its sources, as a build from other sources does."""
    module = ".".join(["ggvs_eval", *name.removesuffix(".py").split("/")])
    file, read = tree.file(module), identity._code_of
    content = file.read_bytes()
    built_from = BUILT_FROM.search(content)
    file.write_bytes(content.replace(built_from[1], built_from[1][::-1]) if built_from else content + more.encode())
    with pytest.MonkeyPatch.context() as patch:  # the rest of the tree is not read again
        patch.setattr(identity, "_code_of", lambda tree, name: (read.__wrapped__ if name == module else read)(tree, name))
        yield
    file.write_bytes(content)


def stale_jobs(tree: CodeTree, before: dict[str, Any]) -> set[str]:
    after = codes_of(tree)
    return {job for job in before if before[job] != after[job]}


@pytest.mark.slow
@pytest.mark.parametrize("name", STALE)
def test_exactly_the_right_jobs_go_stale(name, before, copied):
    """A changed line makes those methods, scores and depth maps stale that run it, and no other."""
    with changed_line(copied, name):
        stale = stale_jobs(copied, before)
    wanted = STALE[name] | ({"ours on a GPU"} if STALE[name] >= OURS else set())
    assert stale == wanted


@pytest.mark.slow
def test_code_of_messages_and_pages_makes_nothing_stale(before, copied):
    """Nor does a comment in the code of a method, or a module of its own with its line in the table of its kind."""
    entries = "".join(f'{table}["added"] = "ggvs_eval.added:psnr"\n' for table in TABLES)
    (copied.folder / "added.py").write_text("from ggvs_eval.metrics.image.psnr import psnr\n", encoding="utf-8")
    for name in NOBODY:
        with changed_line(copied, f"{name}.py"):
            assert stale_jobs(copied, before) == set(), name
    for name, lines in (("built_in.py", entries), ("camera.py", "# a note\n'''A text.'''\n")):
        with changed_line(copied, name, lines):
            assert stale_jobs(copied, before) == set(), name
    (copied.folder / "added.py").unlink()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "stale"), [("warp/step.py", {"ours on a GPU"}), ("export/gltf_reading.py", {"Gaussians of a file"})]
)
def test_what_a_table_loads_counts_where_it_renders(name, stale, before, copied):
    """A step on another device counts there alone, the reader of a file of Gaussians where such a file is rendered."""
    with changed_line(copied, f"contrib/{name}"):
        assert stale_jobs(copied, before) == stale


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
        return f"{self.size}: {os.name}"  # not 'quoted
"""
RUNS = 'import os\nclass Thing:\n    size: int = 3\n    def act(self):\n        return f"{self.size}: {os.name}"'


def test_what_is_said_about_code_does_not_count():
    """Comments, docstrings, empty lines and line ends cost nobody a night of rendering; what stands in strings does."""
    assert identity.what_runs(SAID).strip() == RUNS
    assert identity.what_runs(SAID.replace("\n", "\r\n")) == identity.what_runs(SAID)
    text = 'value = """a\n\n# b\n"""\ncall(\n    "c"  # d\n    "#e",\n\n)\n'
    assert identity.what_runs(text).strip() == 'value = """a\n\n# b\n"""\ncall(\n    "c"\n    "#e",\n)'


@checkout
def test_sources_of_kernels(monkeypatch, tmp_path):
    """A changed source changes the hash of the modules that it is compiled into, and of no other; what is built carries it."""
    specification = importlib.util.spec_from_file_location("kernel_setup", ROOT / "setup.py")
    setup = importlib.util.module_from_spec(specification)
    monkeypatch.chdir(ROOT)
    specification.loader.exec_module(setup)
    carried = {}
    for name in setup.EXTENSIONS:
        if built := installed_code().file(f"ggvs_eval.kernels.{name}"):
            carried[name] = [digest.decode() for digest in BUILT_FROM.findall(built.read_bytes())]
    assert carried["_core"]
    assert carried == {name: [setup.digest_sources(name)] for name in carried}

    shutil.copytree(ROOT / "ggvs_eval/kernels", tmp_path / "kernels")
    monkeypatch.setattr(setup, "KERNELS", tmp_path / "kernels")
    # The second is included by files that are included.
    for source, rebuilt in (("ssim.cpp", {"_ssim"}), ("splat_simd.hpp", {"_core"}), ("sgm.cpp", {"_stereo"})):
        digests = {name: setup.digest_sources(name) for name in setup.EXTENSIONS}
        with (tmp_path / "kernels" / source).open("a") as file:
            file.write("//")
        assert {name for name in digests if setup.digest_sources(name) != digests[name]} == rebuilt


ROOT_MODULE = """
import os.path
from typing import TYPE_CHECKING
from ggvs_eval.head import value
if TYPE_CHECKING:
    from ggvs_eval import for_types
else:
    from ggvs_eval import for_running
class Thing:
    def act(self):
        if value:
            import ggvs_eval.room.inner
        text = "from ggvs_eval import everything"
"""


def test_the_closure(tmp_path):
    """Imports anywhere are followed; text, types, packages on the way and what a chooser could choose are not."""
    files = dict.fromkeys(("everything", "beside", "for_types", "for_running", "chosen", "room/deep/__init__", "jobs/engine"), "")
    files |= {"root": ROOT_MODULE, "__init__": "from ggvs_eval import everything", "room/behind": "import ggvs_eval.root"}
    files |= {"head": "from . import beside\nfrom .room import named\nfrom ggvs_eval.jobs import engine"}
    files |= {
        "room/__init__": "from ggvs_eval.room.behind import named",
        "room/inner": "from .deep import value\nfrom .. import above",
    }
    files |= {"above": "from ggvs_eval.chooser import choose", "chooser": "from ggvs_eval import chosen"}
    for name, text in files.items():
        file = tmp_path / "ggvs_eval" / f"{name}.py"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    package = CodeTree(tmp_path / "ggvs_eval")

    def closure(root: str, **options: Any) -> set[str]:
        return {module.removeprefix("ggvs_eval.") for module in package.closure(f"ggvs_eval.{root}", **options)}

    inner = {"above", "chooser", "chosen", "room.deep", "room.inner"}
    assert closure("room.inner") == inner
    assert closure("root") == inner | {"root", "head", "beside", "for_running", "room", "room.behind"}
    assert closure("above", unfollowed=["ggvs_eval.chooser"]) == {"above", "chooser"}
    with pytest.raises(ModuleNotFoundError, match=r"ggvs_eval\.gone: wanted its code"):
        closure("gone")
    assert package.digest(["ggvs_eval.head"]) != package.digest(["ggvs_eval.head", "ggvs_eval.chosen"])


def test_settings_of_a_label():
    """What a label fixes is told beside the code, so that a label that comes to mean something else is stale; no device is."""
    wanted = {
        "ours": {},
        "naive": {"guidance": "naive", "fused": False},
        "ours-geometric+no-background": {"background": False},
        "gps-gaussian+given-depth": {"depth": "given"},
    }
    assert {label: METHODS[label].settings for label in wanted} == wanted
    assert {label: find_method(label).on("cuda").settings for label in wanted} == wanted
