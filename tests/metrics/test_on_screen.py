"""What stands on the screen while frames keep coming, in closed form."""

import numpy as np
import pytest

from ggvs_eval.metrics.time.on_screen import on_screen
from ggvs_eval.protocol import Stream

THIRTY = Stream(fps=30.0)


def test_a_method_without_time_shows_every_frame_at_its_instant():
    """Infinitely fast is the plain score: the sequence on the screen is that of the renders."""
    screen = on_screen([0.0, 0.0], 12, THIRTY)

    assert screen.frames == tuple(range(12))
    assert set(screen.latencies_s) == {0.0}
    assert screen.record() == {
        **{
            "shown": 12,
            "repeated": 0,
            "dropped": 0,
            "dark": 0,
            "latency_ms": 0.0,
            "latency_p95_ms": 0.0,
            "per_second": None,
        }
    }


@pytest.mark.parametrize("fps", [24.0, 25.0, 29.97, 30.0, 60.0])
@pytest.mark.parametrize("frames", [1, 2, 3, 10])
def test_a_method_of_n_frames_is_seen_n_frames_later(fps, frames):
    """Pipelined in stages of a frame each, every picture stands n frames behind, at any rate: no
    rounding moves it.
    """
    screen = on_screen([1 / fps] * frames, 40, Stream(fps=fps, pipelined=True))

    assert screen.frames == (None,) * frames + tuple(range(40 - frames))
    assert screen.latencies_s == pytest.approx([frames / fps] * (40 - frames))


def test_one_at_a_time_drops_what_comes_meanwhile():
    """Ten frames of work: every tenth frame is shown for ten instants, the first ten instants are
    dark.
    """
    screen = on_screen([10 / 30], 40, THIRTY)

    assert screen.frames == (None,) * 10 + (0,) * 10 + (10,) * 10 + (20,) * 10
    assert {key: screen.record()[key] for key in ("shown", "repeated", "dropped", "dark")} == {
        **{"shown": 3, "repeated": 27, "dropped": 18, "dark": 10}
    }
    assert screen.per_second == pytest.approx(3.0)


def test_a_pipeline_raises_the_rate_and_no_picture_is_sooner():
    """The rate is that of the longest stage; the first picture comes as late as without."""
    stages = [0.02, 0.05, 0.03]
    single, pipelined = (
        on_screen(stages, 60, Stream(fps=30, pipelined=each)) for each in (False, True)
    )

    assert (single.per_second, pipelined.per_second) == pytest.approx((10.0, 20.0))
    assert min(single.scored) == min(pipelined.scored) == 3
    assert (
        min(single.latencies_s) == pytest.approx(min(pipelined.latencies_s)) == pytest.approx(0.1)
    )
    assert len(set(pipelined.frames)) > len(set(single.frames))


def test_a_warm_up_is_not_scored():
    """What stands on the screen is the same; the first instant that counts is behind it, or the
    first picture if later.
    """
    plain, warm = (on_screen([0.1], 12, Stream(fps=30, warm_up=each)) for each in (0, 6))

    assert plain.frames == warm.frames
    assert (min(plain.scored), min(warm.scored)) == (3, 6)
    assert min(on_screen([0.1], 12, Stream(fps=30, warm_up=2)).scored) == 3


def test_the_newest_frame_is_begun():
    """1.5 frames of work: frames 0, 1 (half a frame late), 3, 4, 6, ...; every third is lost."""
    screen = on_screen([1.5 / 30], 12, THIRTY)

    assert sorted({each for each in screen.frames if each is not None}) == [0, 1, 3, 4, 6, 7, 9]
    assert screen.latencies_s[:4] == pytest.approx([1.5 / 30, 2 / 30, 1.5 / 30, 2 / 30])


def test_by_deadline_what_is_late_is_never_seen():
    """A picture that had to wait misses a deadline that the others meet; a method slower than it
    shows nothing.
    """
    waiting = Stream(fps=30, policy="deadline", deadline_ms=60)
    assert sorted(
        {each for each in on_screen([1.5 / 30], 12, waiting).frames if each is not None}
    ) == [0, 3, 6, 9]

    dark = on_screen([0.061], 12, waiting)
    assert not dark.scored
    assert dark.latencies_s == ()
    assert dark.record()["dark"] == 12
    assert dark.record()["latency_ms"] is None


@pytest.mark.parametrize("policy", ["drop", "deadline"])
@pytest.mark.parametrize("pipelined", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_laws(seed, pipelined, policy):
    """Nothing is shown before its time, no older picture comes after a newer one, and the counts
    add up.
    """
    rng = np.random.default_rng(seed)
    stages, count, fps = (
        rng.uniform(0, 0.4, rng.integers(1, 5)) ** 2,
        int(rng.integers(1, 40)),
        float(rng.uniform(1, 120)),
    )
    screen = on_screen(stages, count, Stream(fps=fps, pipelined=pipelined, policy=policy))
    lit = [(at, frame) for at, frame in enumerate(screen.frames) if frame is not None]
    record = screen.record()

    assert all(at - frame >= sum(stages) * fps - 1e-5 for at, frame in lit)
    assert [frame for _, frame in lit] == sorted(frame for _, frame in lit)
    assert len(screen.frames) == count == record["shown"] + record["repeated"] + record["dark"]
    assert len(screen.latencies_s) == record["shown"]
    assert all(latency >= sum(stages) - 1e-5 for latency in screen.latencies_s)
