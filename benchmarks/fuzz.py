"""Thousands of damaged captures and renders, each read or refused in one line: no traceback, no
hang, no more than 2 GB.

Command: ``python -m benchmarks.fuzz --inputs 10000 --seed 0``

Every input is a valid capture or set of renders in which one file is damaged (bytes flipped, cut,
replaced, inserted, repeated, a key of 60 kB) or has given its place to something else (a pipe, a
device, an endless file, a folder, a link). The seed and its number say which, so that a failure is
had again by ``--only KIND --first NUMBER --inputs 1``. They are read in processes of their own, so
that one that hangs or dies costs itself alone.
"""

import json
import os
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import tyro

from ggvs_eval.errors import GgvsError
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.run_folder import RunFolder

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # what is damaged is the tests' own

from helpers.fuzz import (  # type: ignore[import-not-found]
    CAPTURES,
    IMPOSTORS,
    add_long_key,
    damaged,
    random_edit,
    read_everything,
)
from helpers.render_folders import (  # type: ignore[import-not-found]
    VIEWS,
    make_run,
    pack,
    stack,
    view_major,
    write_4dgaussians,
    write_easyvolcap,
    write_flat,
    write_folders,
    write_nerfbaselines,
    write_videos,
)


def write_arrays(folder: Path, suffix: str) -> Path:
    """A stack of frames per view."""
    folder.mkdir()
    for view in VIEWS:
        if suffix == ".npy":
            np.save(folder / f"{view}.npy", stack(view))
        else:
            np.savez_compressed(folder / f"{view}.npz", frames=stack(view, "float32"))
    return folder


def write_packed(folder: Path, suffix: str) -> Path:
    """An archive of folders of pictures, alone in a folder."""
    folder.mkdir()
    pack(write_folders(folder.with_name(f"{folder.name}_unpacked")), folder / f"theirs{suffix}")
    return folder


def write_other_run(folder: Path) -> Path:
    """Another run folder with a method of somebody's."""
    write_folders(make_run(folder).root / "renders" / "theirs")
    return folder


RENDERS: dict[str, Callable[[Path], Path]] = {
    "folders": write_folders,
    "folders of JPEG": lambda folder: write_folders(folder, pattern="{view}/{number:04d}.jpg"),
    "run": write_other_run,
    "nerfbaselines": write_nerfbaselines,
    "easyvolcap": write_easyvolcap,
    "flat": lambda folder: write_flat(folder, view_major()),
    "4dgaussians": lambda folder: write_4dgaussians(folder) / "test",
    "videos": write_videos,
    "npy": lambda folder: write_arrays(folder, ".npy"),
    "npz": lambda folder: write_arrays(folder, ".npz"),
    "zip": lambda folder: write_packed(folder, ".zip"),
    "tar.gz": lambda folder: write_packed(folder, ".tar.gz"),
}
LONGEST_S = 60.0  # on a machine that has other work; the largest is reported
GRACE_S = 20.0  # after that a process which did not stop itself is killed
START_S = 240.0  # of a process: its imports and its valid input, on a machine that has other work
LARGEST_KIB = 2_000_000_000 // 1024
ADDRESS_BYTES = 12 << 30
IMPOSTOR_SHARE, KEY_SHARE = 0.15, 0.05
PICTURES = (".png", ".jpg", ".mp4")
KINDS = [*(f"capture/{name}" for name in CAPTURES), *(f"renders/{name}" for name in RENDERS)]
# their models are read in a process each: fewer of them
SLOW = {"capture/colmap": 0.1, "capture/multipleview": 0.1}
Outcome = dict[str, Any]


def import_everything(path: Path, run: RunFolder) -> str:
    """Import renders into a run; ``imported``, or the line with which they were refused."""
    archives = (
        [item for item in path.iterdir() if item.name.startswith("theirs.")]
        if path.is_dir()
        else []
    )
    try:
        import_renders(run, "mine", archives[0] if archives else path)
        return "imported"
    except GgvsError as error:
        message = str(error)
        assert message.isprintable()
        return message


class HangError(BaseException):
    """It took too long; no reader takes this for what a damaged file makes it stumble over."""


@dataclass(frozen=True)
class FuzzOptions:
    """Options of a fuzzing run.

    Attributes:
        inputs: how many, over all kinds.
        seed: chooses the damage.
        only: a kind, such as capture/rgbd or renders/zip; all of them by default.
        first: number of the first input of each kind.
        out: JSON file with counts and failures.
    """

    inputs: int = 10_000
    seed: int = 0
    only: str | None = None
    first: int = 0
    out: Path = Path("out/fuzz.json")


def main(options: FuzzOptions) -> int:
    """Run all inputs, print a line per kind and each failure.

    The exit code says whether there was one.
    """
    begun_s, record = time.monotonic(), {}
    kinds = [options.only] if options.only else KINDS
    weights = {kind: 1.0 if options.only else SLOW.get(kind, 1.0) for kind in kinds}
    for kind in kinds:
        count = -int(-options.inputs * weights[kind] // sum(weights.values()))
        outcomes = run_kind(kind, options.seed, range(options.first, options.first + count))
        counts = Counter(each["outcome"] for each in outcomes)
        failures = [each for each in outcomes if each["outcome"] not in ("read", "refused")]
        largest = {
            "seconds": max(each["seconds"] for each in outcomes),
            "kib": max(each["kib"] for each in outcomes),
        }
        record[kind] = {"counts": dict(counts), **largest, "failures": failures}
        shown = ", ".join(f"{counts[name]} {name}" for name in sorted(counts))
        print(
            f"{kind}: {shown}; at most {largest['seconds']:.1f} s, {largest['kib'] / 1024:.0f} MiB",
            flush=True,
        )
        for failure in failures:
            print(
                f"  input {failure['number']}, {failure['damage']}: {failure['outcome']}: "
                f"{failure['message']}",
                flush=True,
            )
    n_inputs = sum(sum(each["counts"].values()) for each in record.values())
    n_failures = sum(len(each["failures"]) for each in record.values())
    print(f"{n_inputs} inputs in {time.monotonic() - begun_s:.0f} s, {n_failures} failures")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(
        json.dumps({"seed": options.seed, "inputs": n_inputs, "kinds": record}, indent=1)
    )
    return int(n_failures > 0)


def run_kind(kind: str, seed: int, numbers: range) -> list[Outcome]:
    """Return the outcomes of some inputs of one kind, read in processes that are started again
    where one ends.
    """
    outcomes: list[Outcome] = []
    while len(outcomes) < len(numbers):
        rest = numbers[len(outcomes) :]
        command = [
            sys.executable,
            "-m",
            "benchmarks.fuzz",
            "worker",
            kind,
            str(seed),
            str(rest.start),
            str(rest.stop),
        ]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        ) as process:
            told, why = listen(process)
        outcomes += told
        if len(told) < len(rest):
            outcomes.append(
                {
                    "number": rest[len(told)],
                    "damage": "?",
                    "outcome": "ended",
                    "message": why,
                    "seconds": LONGEST_S,
                    "kib": 0,
                }
            )
    return outcomes


def listen(process: subprocess.Popen[bytes]) -> tuple[list[Outcome], str]:
    """Collect the outcomes that a process reports, and the reason why it stopped reporting."""
    told: list[Outcome] = []
    buffer, output = b"", process.stdout
    while output is not None:
        if not select.select([output], [], [], LONGEST_S + GRACE_S if told else START_S)[0]:
            process.kill()
            return told, "killed, it did not answer"
        chunk = os.read(output.fileno(), 1 << 16)
        if not chunk:
            break
        *lines, buffer = (buffer + chunk).split(b"\n")
        told += [json.loads(line) for line in lines]
    return told, f"the process ended with {process.wait()}"


def work(kind: str, seed: int, numbers: range) -> None:
    """Read inputs of one kind and report each in a line; runs in a separate process."""
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_BYTES, ADDRESS_BYTES))
    signal.signal(signal.SIGALRM, _too_long)
    group, _, name = kind.partition("/")
    with tempfile.TemporaryDirectory() as place:
        root = Path(place)
        written = (CAPTURES if group == "capture" else RENDERS)[name](root / "input")
        read = (
            read_everything
            if group == "capture"
            else partial(import_everything, run=make_run(root / "run"))
        )
        files = sorted(file for file in written.rglob("*") if file.is_file())
        intact = read(written)
        if intact not in (*CAPTURES, "imported"):
            raise ValueError(f"{kind}: the valid input is refused: {intact}")
        for number in numbers:
            random = Random(f"{seed}/{kind}/{number}")
            file = _chosen(files, random)
            content = file.read_bytes()
            damage = _spoil(file, content, random)
            outcome = _try(partial(read, written))
            _remove(file)
            file.write_bytes(content)
            shutil.rmtree(root / "run" / "renders", ignore_errors=True)
            if number == numbers[-1] and read(written) != intact:
                raise ValueError(f"{kind}: the valid input does not come back")
            print(
                json.dumps(
                    {"number": number, "damage": f"{damage} in {file.relative_to(root)}", **outcome}
                ),
                flush=True,
            )


def _chosen(files: list[Path], random: Random) -> Path:
    """Headers are where the trouble is; pictures outnumber them."""
    headers = [file for file in files if file.suffix not in PICTURES]
    return random.choice(headers if headers and random.random() < 2 / 3 else files)


def _spoil(file: Path, content: bytes, random: Random) -> str:
    """Damage a file, and say how."""
    chance = random.random()
    if chance < IMPOSTOR_SHARE:
        name = random.choice(list(IMPOSTORS))
        _remove(file)
        IMPOSTORS[name](file)
        return name
    if chance < IMPOSTOR_SHARE + KEY_SHARE:
        add_long_key(file)
        return "a key of 60 kB"
    edit = random_edit(random)
    file.write_bytes(damaged(content, edit))
    return f"{edit!r:.60}"


def _try(read: Any) -> Outcome:
    """Read one input and return the outcome, the time it took and the peak memory."""
    Path("/proc/self/clear_refs").write_text("5")  # the peak is counted anew
    begun_s = time.monotonic()
    signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
    try:
        message = read()
        outcome = "read" if message in (*CAPTURES, "imported") else "refused"
    except HangError as error:
        outcome, message = "hang", str(error)
    except BaseException as error:
        outcome, message = "traceback", f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    lines = Path("/proc/self/status").read_text().splitlines()
    own_kib = next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    # what reads COLMAP's models is a child
    kib = max(own_kib, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
    if kib > LARGEST_KIB:
        outcome = "memory"
    return {
        "outcome": outcome,
        "message": message[:300],
        "seconds": time.monotonic() - begun_s,
        "kib": kib,
    }


def _too_long(*_: object) -> None:
    raise HangError(f"it took over {LONGEST_S:g} s")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["worker"]:
        work(sys.argv[2], int(sys.argv[3]), range(int(sys.argv[4]), int(sys.argv[5])))
    else:
        sys.exit(main(tyro.cli(FuzzOptions)))
