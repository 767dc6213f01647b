"""``python -m benchmarks.depth_validation --data FOLDER --matchers sgbm``: depth evaluated in six
ways, as tables.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.depth_validation.evaluate_matcher import PARTS, validate_depth
from ggvs_eval.errors import GgvsError


def main(words: Sequence[str] | None = None) -> None:
    """Parse the command line and evaluate; what the user can correct is one line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--data",
        type=Path,
        default=Path("../shared/data"),
        help="folder with the real pair and the real rig",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out"), help="folder of rooms, tables and figures"
    )
    parser.add_argument("--matchers", default="sgbm", help="names, with commas between them")
    parser.add_argument("--only", default=",".join(PARTS), help="some of the parts")
    arguments = parser.parse_args(words)
    try:
        validate_depth(
            arguments.data, arguments.out, arguments.matchers.split(","), arguments.only.split(",")
        )
    except GgvsError as error:
        sys.exit(f"ggvs-eval: {error}")
    print(arguments.out / "depth_validation" / "figures.json")


if __name__ == "__main__":
    main()
