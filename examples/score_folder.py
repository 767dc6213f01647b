"""Score folders of renders from Python: the protocol, the captured frames, each number with its
interval, and the page.

On the small capture that ships, where one of two sets of renders is a frame late:

    ggvs-eval demo quick --quick
    python examples/score_folder.py quick/room quick/quick.toml out/scores quick/fixed quick/late
"""

import sys
from pathlib import Path

from ggvs_eval import Results, import_renders, load_protocol, open_capture, score
from ggvs_eval.pipelines.run.evaluate import report
from ggvs_eval.pipelines.run.prepare import prepare_truth
from ggvs_eval.statistics.intervals import intervals


def score_folders(capture: Path, protocol: Path, out: Path, folders: list[Path]) -> Results:
    """Measure each folder of VIEW/FRAME.png against the captured frames.

    What `out` holds already is not measured again.
    """
    run = prepare_truth(out, open_capture(capture), load_protocol(protocol))
    for folder in folders:
        for note in import_renders(run, folder.name, folder)["notes"]:
            print(f"{folder.name}: {note}")
    return score(run)


def print_table(results: Results, metrics: tuple[str, ...]) -> None:
    """Print a line for each metric and method: its number, half the width of the 95 % interval, and
    what that takes as given.
    """
    (dataset,) = results.table["dataset"].unique()
    for metric in metrics:
        for label, interval in intervals(results, metric, dataset).items():
            half_width = "" if interval.half_width is None else f"+- {interval.half_width:.3g}"
            print(f"{metric:8} {label:10} {interval.value:9.4f} {half_width:9} {interval.note}")
    for line in results.fault_lines():  # found by the quick checks of `ggvs-eval doctor`
        print(line)


if __name__ == "__main__":
    capture, protocol, out, *folders = map(Path, sys.argv[1:])
    print_table(
        score_folders(capture, protocol, out, folders), load_protocol(protocol).measurement.metrics
    )
    print(report([out]))
