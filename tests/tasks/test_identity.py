"""The identity of code: a line changed in a room makes what names the room stale, and
nothing else.
"""

import pytest

from ggvs_eval.metrics.metric import ViewMetric
from ggvs_eval.metrics.registry import METRICS, ceiling_metrics
from ggvs_eval.pipelines.methods.registry import METHODS
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.consistency import describe_check
from ggvs_eval.pipelines.offline.plane_sweep.plane_sweep import PlaneSweep
from ggvs_eval.pipelines.run.references import ceilings_code
from ggvs_eval.pipelines.run.render import method_code
from ggvs_eval.pipelines.run.score_code import metric_code
from ggvs_eval.pipelines.run.score_path import path_code
from ggvs_eval.tasks import identity
from ggvs_eval.tasks.identity import code_of
from helpers.other_code import change_code

# A module of the package, with some of the results that are stale when a byte of it changes, and
# some that are not.
STALE = {
    "baselines.enerf.rendering": ({"enerf"}, {"ibrnet", "ours", "PSNR", "depth"}),
    "baselines.learned": ({"enerf", "ibrnet", "no-blending", "3dgs-per-instant"}, {"ours", "PSNR"}),
    "pipelines.online.temporal_filters": (
        {"ours", "ours-geometric"},
        {"enerf", "PSNR", "depth", "path"},
    ),
    "metrics.image.lpips": ({"LPIPS", "PSNR"}, {"ours", "depth"}),
    "metrics.time.tcc": ({"TCC"}, {"PSNR", "ours"}),
    "metrics.stream": ({"PSNR", "TCC", "ceilings", "path"}, {"ours", "depth"}),
    "metrics.path.view_consistency": ({"path"}, {"PSNR"}),
    "metrics.noise.estimate": ({"ceilings"}, {"ours"}),
    "pipelines.offline.plane_sweep.plane_sweep": ({"depth by sweep"}, {"depth", "ours"}),
    "pipelines.offline.depth.depth_stream": (
        {"depth", "depth by sweep", "checked depth"},
        {"ours", "PSNR"},
    ),
    "contrib.warp.step": ({"ours on a GPU"}, {"ours"}),
    "camera": ({"ours", "PSNR", "path", "ceilings", "depth", "checked depth"}, set()),
    "geometry.splat": ({"ours", "PSNR", "depth"}, set()),
    "built_in": (set(), {"ours", "PSNR", "path", "ceilings", "depth"}),
    "errors": (set(), {"ours", "PSNR", "path", "ceilings", "depth"}),
    "reports.report": (set(), {"ours", "PSNR", "path", "ceilings", "depth"}),
}


def codes() -> dict[str, object]:
    """Return the hashes of the code of every kind of result, by its name."""
    return {
        **{label: method_code(spec) for label, spec in METHODS.items()},
        **{
            name: metric_code(metric)
            for name, metric in METRICS.items()
            if isinstance(metric, ViewMetric)
        },
        "path": path_code(()),
        "ceilings": ceilings_code(ceiling_metrics()),
        "depth": DepthOptions().describe()["code"],
        "depth by sweep": DepthOptions(matcher=PlaneSweep()).describe()["code"],
        "checked depth": describe_check()["code"],
        "ours on a GPU": method_code(METHODS["ours"].on("cuda")),
    }


@pytest.fixture(scope="module")
def before() -> dict[str, object]:
    """Return the hashes of the code as it is."""
    return codes()


@pytest.mark.parametrize("name", STALE)
def test_a_change_makes_what_names_its_room_stale(name, before, monkeypatch):
    """A changed file makes those methods, scores and depth maps stale that name its room."""
    change_code(monkeypatch, name)
    after = codes()
    changed = {result for result in before if before[result] != after[result]}
    stale, fresh = STALE[name]
    assert stale <= changed
    assert fresh.isdisjoint(changed)


def test_equal_code_has_equal_hashes_on_every_machine(tmp_path):
    """Line ends do not count; of an extension module its sources do, and not its bytes."""
    unix, windows = tmp_path / "unix.py", tmp_path / "windows.py"
    unix.write_bytes(b"x = 1\ny = 2\n")
    windows.write_bytes(b"x = 1\r\ny = 2\r\n")
    assert identity._file_digest(unix) == identity._file_digest(windows)
    sources = b"ggvs-eval sources " + b"a" * 64
    first, second = tmp_path / "first.so", tmp_path / "second.so"
    first.write_bytes(b"gcc " + sources)
    second.write_bytes(b"clang " + sources)
    assert identity._file_digest(first) == identity._file_digest(second) == "a" * 64


def test_a_name_without_code_is_refused():
    """What is not there has no identity."""
    with pytest.raises(ModuleNotFoundError, match="no_such_room"):
        code_of("ggvs_eval.no_such_room")


def test_the_package_has_one_hash():
    """Machines that share work compare it; it is found by reading, not by importing."""
    assert identity.package_digest() == identity.package_digest.__wrapped__()
