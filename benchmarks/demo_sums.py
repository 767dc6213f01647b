"""Sums of everything that the quick demo and the three demo rooms make: ``python -m
benchmarks.demo_sums OUT --against FILE``.

A change of structure changes no result: pictures, depth maps and tables of two revisions are the
same bytes. OUT/sums.json has the SHA-256 of each; with ``--against``, what differs from the sums of
another revision is printed, and the exit status is 1. One process works (``--jobs 1``), some half
an hour; with ``--quick`` the rooms are left out. Tables of times always are, as no two runs agree
on them.
"""

import argparse
import hashlib
import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd

SUMS = "sums.json"
ROOM, PROTOCOL = "quick/room", "quick/quick.toml"
QUICK = (
    ("demo", "quick", "--quick"),
    ("doctor", "quick/late", "--capture", ROOM, "--protocol", PROTOCOL),
    (
        *("score", "--renders", "mine=quick/fixed", "late=quick/late"),
        *("--capture", ROOM, "--protocol", PROTOCOL, "--jobs", "1"),
    ),
    ("report", "scores/room"),
    ("run", "runs/quick", "--capture", ROOM, "--protocol", PROTOCOL, "--jobs", "1"),
)
ROOMS = (("run", "runs/rooms", "--jobs", "1"),)
FOUND = 1  # exit status of a check that has found a fault
PICTURES = (".png", ".webp", ".npy", ".npz")
TIMED = (b"timing", b"costs")  # how rows of such tables begin


def main(arguments: Sequence[str] | None = None) -> int:
    """Make everything, write the sums, and compare them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="folder to work in; absent or empty")
    parser.add_argument("--against", type=Path, help="sums.json of another revision")
    parser.add_argument("--quick", action="store_true", help="the quick demo alone")
    asked = parser.parse_args(arguments)
    asked.out.mkdir(parents=True, exist_ok=True)
    for command in QUICK if asked.quick else (*QUICK, *ROOMS):
        status = subprocess.run(
            [sys.executable, "-m", "ggvs_eval", *command],
            cwd=asked.out,
            check=False,
            stdout=subprocess.DEVNULL,
        ).returncode
        if status not in ((0, FOUND) if command[0] == "doctor" else (0,)):
            print(f"ggvs-eval {' '.join(command)} ended with {status}", file=sys.stderr)
            return status
    sums = {file.relative_to(asked.out).as_posix(): digest for file, digest in digests(asked.out)}
    (asked.out / SUMS).write_text(json.dumps(sums, indent=1, sort_keys=True))
    print(f"{len(sums)} sums in {asked.out / SUMS}")
    return compare(sums, json.loads(asked.against.read_text())) if asked.against else 0


def digests(folder: Path) -> Iterator[tuple[Path, str]]:
    """Yield each picture, depth map and table with its SHA-256, without what is measured in seconds
    and bytes.
    """
    for file in sorted(folder.rglob("*")):
        if not file.is_file() or file.name == "k.png":  # which draws seconds over K
            continue
        content = file.read_bytes()
        if file.name == "tables.csv":
            lines = content.splitlines(keepends=True)
            content = b"".join(line for line in lines if not line.startswith(TIMED))
        elif file.name == "sweep.csv":
            content = pd.read_csv(file).drop(columns="s/frame").to_csv(index=False).encode()
        elif file.suffix == ".parquet":
            content = pd.read_parquet(file).to_csv(index=False).encode()
        elif file.suffix not in (".csv", *PICTURES):
            continue
        digest = hashlib.sha256(content).hexdigest()
        if file.suffix == ".npz":  # a folder of depth is called by the hash of code, too
            file = file.parent.parent / f"{file.stem} {digest[:12]}"
        yield file, digest


def compare(sums: dict[str, str], others: dict[str, str]) -> int:
    """Print what differs; 1 if anything does."""
    differing = sorted(
        name for name in sums.keys() | others.keys() if sums.get(name) != others.get(name)
    )
    for name in differing:
        what = (
            "differs"
            if name in sums and name in others
            else "is new"
            if name in sums
            else "is missing"
        )
        print(f"{name} {what}")
    print(f"{len(differing)} of {len(sums.keys() | others.keys())} differ")
    return int(bool(differing))


if __name__ == "__main__":
    sys.exit(main())
