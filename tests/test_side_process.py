"""Files read by a process of its own: one for many requests, another one after a crash, a hang, an
interruption or a rest.
"""

import time
from pathlib import Path

import pytest

from ggvs_eval import side_process
from ggvs_eval.side_process import SideProcess, SideProcessError

LONG_S = 60
SCRIPT = """
import os, sys, time
from ggvs_eval import side_process

def read(path):
    print("chatter", flush=True)
    if path.name == "abort":
        os.abort()
    os.write(1, b'{"value": "chatter of a library"}\\n')
    match path.name:
        case "pid":
            return os.getpid()
        case "refused":
            raise ValueError("a first line\\nno camera in it")
        case "missing":
            raise KeyError("model")
        case "exit":
            sys.stderr.write("cannot go on\\n\\n")
            sys.stderr.flush()
            os._exit(3)
        case "hang":
            time.sleep(600)
    return str(path)

side_process.IDLE_S = IDLE
side_process.serve(read)
"""


def started(folder: Path, idle_s: float = LONG_S) -> SideProcess:
    """A reader by the script above."""
    script = folder / "script.py"
    script.write_text(SCRIPT.replace("IDLE\n", f"{idle_s}\n"))
    return SideProcess(script)


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    """One for all tests: each leaves it fit for the next."""
    made = started(tmp_path_factory.mktemp("reader"))
    yield made
    made.end()


def test_one_process_answers_and_what_it_prints_is_no_answer(reader):
    """Values come back in the order of the requests, from one process, whatever signs the paths
    have.
    """
    pid = reader.ask(Path("pid"), LONG_S)
    for path in (Path("a b/ü\nx"), Path("c")):
        assert reader.ask(path, LONG_S) == str(path)
    assert reader.ask(Path("pid"), LONG_S) == pid


def test_a_refusal_is_reported_and_survived(reader):
    """By the last line of its reason, with the kind of error where it is no ValueError."""
    pid = reader.ask(Path("pid"), LONG_S)
    for name, reason in (("refused", "no camera in it"), ("missing", "KeyError: 'model'")):
        with pytest.raises(SideProcessError) as caught:
            reader.ask(Path(name), LONG_S)
        assert str(caught.value) == reason
    assert reader.ask(Path("pid"), LONG_S) == pid


@pytest.mark.parametrize(("name", "reason"), [("exit", "cannot go on"), ("abort", "signal 6")])
def test_a_process_that_dies_is_named_and_replaced(reader, name, reason):
    """By its last words, or by the status that it ended with; the next request has a
    process again.
    """
    pid = reader.ask(Path("pid"), LONG_S)
    with pytest.raises(SideProcessError, match=reason):
        reader.ask(Path(name), LONG_S)
    assert reader.ask(Path("pid"), LONG_S) != pid


def test_a_process_that_hangs_is_ended(reader):
    """After the time that was given, by the file's name; the next request has a process again."""
    with pytest.raises(TimeoutError, match="hang"):
        reader.ask(Path("hang"), 0.2)
    assert reader.ask(Path("c"), LONG_S) == "c"


def test_an_answer_that_nobody_waited_for_is_not_the_next_ones(reader, monkeypatch):
    """After Ctrl-C the process is another one."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(side_process.select, "select", interrupted)
        with pytest.raises(KeyboardInterrupt):
            reader.ask(Path("first"), LONG_S)
    assert reader.ask(Path("second"), LONG_S) == "second"


def test_a_process_that_is_not_asked_ends(tmp_path):
    """Nothing is opened before the first request; idle, it gives back its memory, and the next
    request starts another.
    """
    reader = started(tmp_path, idle_s=0.1)
    assert (reader._child, reader._log) == (None, None)
    pid = reader.ask(Path("pid"), LONG_S)
    began = time.monotonic()
    while reader._child.poll() is None:
        assert time.monotonic() - began < LONG_S
        time.sleep(0.02)
    assert reader._child.returncode == 0
    assert reader.ask(Path("pid"), LONG_S) != pid
    reader.end()
    assert reader._child is None
