"""Which planted faults `make test` finds: ``python -m benchmarks.worth_of_tests [--only NAME
...]``.

Each fault of `worth_of_tests.toml` is one line of the package, written wrongly. It is planted in a
copy of the checkout, where the tests nearest to it run first and, as long as none fails, all others
of `make test`; slow tests and time limits do not count, nor does the test of the list itself, which
no planted line passes. Prints the first test that fails, or that none does, and ends with 1 if
fewer than `LEAST_FOUND` of the faults are found.
"""

import os
import shutil
import subprocess
import sys
import tomllib
from argparse import ArgumentParser
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import Queue
from tempfile import TemporaryDirectory

from ggvs_eval.kernels import usable_cpus
from ggvs_eval.progress import track

ROOT = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_suffix(".toml")
ROOMS = ("pipelines", "baselines", "metrics", "reports", "contrib")  # installed below `ggvs_eval`
NOT_COPIED = (
    ".git",
    ".venv",
    "build",
    "out",
    "__pycache__",
    "*.egg-info",
    ".mypy_cache",
    ".ruff_cache",
    ".pytest_cache",
)
LEAST_FOUND = 0.9
OF_MAKE_TEST = "not slow and not proof and not wheel"
NOT_FOUND = "no test fails"
TEST_OF_LIST = "tests/validation/test_worth_list.py"


@dataclass(frozen=True)
class Fault:
    """One line of the package, written wrongly.

    Attributes:
        name: what is wrong.
        file: relative to the checkout.
        line: the right line without its indentation; it is the only one of its kind in the file.
        replacement: what stands in its place.
        nearest: folder or file of the tests that run first.
    """

    name: str
    file: str
    line: str
    replacement: str
    nearest: str

    def plant(self, checkout: Path) -> None:
        """Write the fault into a copy of the checkout.

        Raises:
            ValueError: the file has no such line, or several.
        """
        file = checkout / self.file
        lines = file.read_text(encoding="utf-8").split("\n")
        places = [number for number, line in enumerate(lines) if line.strip() == self.line]
        if len(places) != 1:
            raise ValueError(
                f"{self.name}: wanted the line once in {self.file}, found it {len(places)} times: "
                f"{self.line}"
            )
        indentation = lines[places[0]][: -len(self.line)]
        lines[places[0]] = indentation + self.replacement
        file.write_text("\n".join(lines), encoding="utf-8")


def read_faults(file: Path = LIST) -> list[Fault]:
    """Return the faults of a list."""
    return [Fault(**fault) for fault in tomllib.loads(file.read_text(encoding="utf-8"))["fault"]]


@contextmanager
def copied_checkout() -> Iterator[Path]:
    """Copy the checkout, and lay its package out as it is installed."""
    with TemporaryDirectory() as folder:
        checkout = Path(
            shutil.copytree(
                ROOT, Path(folder) / "checkout", ignore=shutil.ignore_patterns(*NOT_COPIED)
            )
        )
        package = checkout / "view" / "ggvs_eval"
        package.mkdir(parents=True)
        for entry in [*(checkout / "ggvs_eval").iterdir(), *(checkout / room for room in ROOMS)]:
            (package / entry.name).symlink_to(entry)
        yield checkout


def first_failure(checkout: Path, tests: Sequence[str]) -> str:
    """Return the name of the first test that fails, or that cannot be collected.

    Empty if all pass.
    """
    without = [
        "-p",
        "no:randomly",
        "-p",
        "no:time_limits",
        "-p",
        "no:cacheprovider",
        f"--ignore={TEST_OF_LIST}",
    ]
    options = ["-x", "-q", "--tb=no", "-m", OF_MAKE_TEST, *without]
    environment = os.environ | {
        "PYTHONPATH": f"{checkout / 'view'}{os.pathsep}{checkout}",
        "PYTHONSAFEPATH": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    command = [sys.executable, "-m", "pytest", *options, *tests]
    done = subprocess.run(
        command, cwd=checkout, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode in (0, 5):  # 5: there are none
        return ""
    failures = [line for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return (
        failures[0].split()[1]
        if failures
        else f"pytest ended with {done.returncode}: {done.stdout[-200:]}"
    )


def find(fault: Fault, checkouts: "Queue[Path]") -> str:
    """Return the test that finds a fault, or `NOT_FOUND`.

    It is planted in a checkout that nobody else uses, and taken out.
    """
    checkout = checkouts.get()
    try:
        fault.plant(checkout)
        return (
            first_failure(checkout, [fault.nearest])
            or first_failure(checkout, ["tests"])
            or NOT_FOUND
        )
    finally:
        shutil.copyfile(ROOT / fault.file, checkout / fault.file)
        checkouts.put(checkout)


def main() -> None:
    """Plant the faults, as many at once as there are cores."""
    parser = ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="+", help="names of faults")
    parser.add_argument("--list", type=Path, default=LIST, help="another list of faults")
    arguments = parser.parse_args()
    faults = [
        fault
        for fault in read_faults(arguments.list)
        if not arguments.only or fault.name in arguments.only
    ]
    checkouts: Queue[Path] = Queue()
    workers = usable_cpus()
    with (
        copied_checkout() as first,
        copied_checkout() as second,
        ThreadPoolExecutor(workers) as pool,
    ):
        for checkout in (first, second)[:workers]:
            checkouts.put(checkout)
        finders = list(
            track(
                pool.map(lambda fault: find(fault, checkouts), faults),
                "planting faults",
                len(faults),
            )
        )
    for fault, finder in zip(faults, finders, strict=True):
        print(f"{fault.name} ({fault.file}): {finder}")
    n_found = sum(finder != NOT_FOUND for finder in finders)
    print(f"{n_found} of {len(faults)} faults are found by make test")
    sys.exit(n_found < LEAST_FOUND * len(faults))


if __name__ == "__main__":
    main()
