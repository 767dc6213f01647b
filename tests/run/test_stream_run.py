"""A whole run with a stream: live depth is timed once and counted, offline depth takes no time, and
a sweep sets the stream.
"""

from dataclasses import replace
from statistics import median

import pytest

from ggvs_eval.capture import Capture
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.pipelines.methods.network_options import NetworkOptions
from ggvs_eval.pipelines.run.evaluate import measure
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from ggvs_eval.protocol import Stream
from ggvs_eval.results import Results, split_label
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json
from ggvs_eval.sweep import Sweep, SweepRow, load_sweep
from helpers.itermvs_weights import write_checkpoint
from helpers.small_runs import small_protocol, write_small_capture

STREAM = Stream(fps=1.0)  # slow enough for any machine
LABELS = ("distance-based", "distance-based+scale=0.5")


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Capture:
    """Six cameras, three frames."""
    return write_small_capture(tmp_path_factory.mktemp("capture") / "room", 3)


def evaluated(root, capture: Capture, matcher: str, device: str = "cpu") -> RunFolder:
    """The run, measured."""
    protocol = small_protocol(3, 0, ("PSNR", "TCC")).streamed(STREAM)
    networks = NetworkOptions(device=device)
    measure(
        plan_run(
            RunRequest(root, capture, protocol, LABELS, DepthRunOptions(matcher), networks=networks)
        ),
        1,
    )
    return RunFolder(root)


@pytest.mark.slow
def test_live_depth_counts_and_is_timed_once(capture, tmp_path):
    """Its median is the first stage of every method that looks at depth; a second call measures
    nothing again.
    """
    run = evaluated(tmp_path / "live", capture, "live")
    timed = run.live_depth_record.read_bytes()
    stream = read_json(run.stream_record)

    for label in LABELS:
        assert next(iter(stream["methods"][label]["stages_ms"])) == "depth"
        assert stream["methods"][label]["stages_ms"]["depth"] > 0
    assert "shrink" in stream["methods"][LABELS[1]]["stages_ms"]
    assert "live" in stream["depth"]
    assert read_json(run.renders(LABELS[0], "cam00") / JOB_FILE)["peak_bytes"] > 50e6
    evaluated(tmp_path / "live", capture, "live")
    assert run.live_depth_record.read_bytes() == timed
    summary = Results.read(run.root).summary().droplevel("dataset")
    for label in LABELS:  # a frame late
        assert summary["PSNR"][split_label(f"{label}@screen")] < summary["PSNR"][split_label(label)]


@pytest.mark.slow
def test_depth_of_a_network_counts_on_a_device_alone(capture, tmp_path):
    """A GPU finds it as frames arrive; the CPU has computed it before. ``cpu:0`` goes the GPU's
    way.
    """
    matcher = f"itermvs:{write_checkpoint(tmp_path / 'model.ckpt')}"
    there, here = (
        evaluated(tmp_path / name, capture, matcher, device)
        for name, device in (("there", "cpu:0"), ("here", "cpu"))
    )

    stages = read_json(there.stream_record)["methods"][LABELS[0]]["stages_ms"]
    seconds = read_json(there.live_depth_record)["seconds"]
    assert stages["depth"] == 1000 * median(seconds)
    assert not here.live_depth_record.exists()
    assert "depth" not in read_json(here.stream_record)["methods"][LABELS[0]]["stages_ms"]


@pytest.mark.slow
def test_depth_that_was_computed_before_takes_no_time(capture, tmp_path):
    """No stage of depth, no record, and the table's caption can say so."""
    run = evaluated(tmp_path / "before", capture, "sgbm")
    stream = read_json(run.stream_record)

    assert not run.live_depth_record.exists()
    assert "depth" not in stream["methods"][LABELS[0]]["stages_ms"]
    assert stream["depth"].startswith("without depth")


def test_a_sweep_streams_every_variant_and_a_protocols_own_stays():
    """The packaged sweep has its rate, and the metrics of the protocol stay."""
    sweep, protocol = load_sweep("stream"), small_protocol(3, 0, ("PSNR", "L1", "TCC"))
    variants = sweep.protocols(protocol, 6)

    assert {variant.synthesis.k for variant in variants.values()} == set(sweep.k)
    for variant in variants.values():
        assert variant.stream == Stream(fps=30.0, warm_up=1)  # of three frames at most half
        assert variant.measurement == protocol.measurement
    own = replace(protocol, stream=STREAM)
    assert {each.stream for each in sweep.protocols(own, 6).values()} == {STREAM}
    unstreamed = Sweep("plain", "", (SweepRow("One", "no-blending"),))
    assert [*unstreamed.protocols(protocol, 6).values()] == [protocol]
