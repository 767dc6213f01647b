"""One capture under several calibrations or depths: the same frames and protocol, and what each
choice costs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ggvs_eval.capture import Capture
from ggvs_eval.errors import CaptureError, CommandError
from ggvs_eval.files.atomic import write_text
from ggvs_eval.pipelines.commands.flags import (
    CAPTURE_DEFAULTS,
    DEPTH_DEFAULTS,
    HERE,
    NONE,
    CaptureFlags,
    CaptureOptions,
    DepthFlags,
    Labels,
    Output,
    Running,
)
from ggvs_eval.pipelines.inspection.table import text_table
from ggvs_eval.protocol import Protocol
from ggvs_eval.reports.tables.compare_runs import (
    Difference,
    cells_of,
    compare_pairs,
    differences_csv,
    run_sides,
)

Variants = Annotated[
    tuple[str, ...],
    tyro.conf.Positional,
    tyro.conf.arg(metavar="NAME=CAPTURE ...", help_behavior_hint="(required)"),
]
Depths = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=DIR ...", help_behavior_hint=NONE)]
METHODS = ("ours-geometric",)


@dataclass(frozen=True)
class Variant:
    """A calibration or a depth under which the capture is rendered.

    Attributes:
        name: as the table calls it, and its run folder.
        path: folder of the capture with that calibration.
        depth: folder of another program's depth; None for the usual one.
    """

    name: str
    path: Path
    depth: Path | None


def calibrations(
    out: Output,
    variants: Variants,
    depths: Depths = (),
    protocol: str | None = None,
    methods: Labels = METHODS,
    reading: CaptureFlags = CAPTURE_DEFAULTS,
    depth: DepthFlags = DEPTH_DEFAULTS,
    engine: Running = HERE,
) -> None:
    """Render one capture under several calibrations or depths and compare.

    Frames and protocol are the same; each variant is a run folder OUT/NAME. The table gives the
    differences to the first one, paired over frames. A second call resumes.

    Args:
        out: folder of the runs, and of calibrations.csv.
        variants: captures with the same frames and another calibration each, as given=room
            refined=room_refined.
        depths: depth of another program for a variant; a new name uses the first capture, as
            vggt=vggt_depth.
        protocol: protocol (.toml or packaged name); fitted to the first capture by default.
        methods: methods that show the difference.
        reading: capture reading; --depth-scale and --depth-is hold for all depths.
        depth: depth estimation.
        engine: job execution.
    """
    from ggvs_eval.pipelines.methods.registry import find_method
    from ggvs_eval.pipelines.run.evaluate import measure
    from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
    from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
    from ggvs_eval.protocol import load_protocol

    for label in methods:
        find_method(label)
    choices = parse_variants(variants, depths)
    opened = {variant: _open(variant, reading) for variant in choices}
    first = opened[choices[0]]
    terms = load_protocol(protocol) if protocol else suggest_protocol(first)
    # each as it is given
    terms = replace(terms, synthesis=replace(terms.synthesis, calibration=None))
    for variant, capture in opened.items():
        require_same_frames(choices[0], first, variant, capture, terms)
    for variant, capture in opened.items():
        measure(
            plan_run(
                RunRequest(
                    root=engine.place(out) / variant.name,
                    capture=capture,
                    protocol=terms,
                    labels=methods,
                    depth=depth,
                )
            ),
            engine,
        )
    reference = choices[0].name
    by_variant = compare_variants(out, reference, [variant.name for variant in choices[1:]])
    by_pair = {
        f"{method}: {name} against {reference}": rows for (name, method), rows in by_variant.items()
    }
    write_text(
        out / "calibrations.csv", differences_csv(by_pair, ("value", f"value of {reference}"))
    )
    print(costs_text(reference, by_variant))


def parse_variants(variants: Sequence[str], depths: Sequence[str]) -> list[Variant]:
    """Return the variants in their order, those with a depth of their own last.

    Raises:
        CommandError: no NAME=PATH, a name that is no folder's, or fewer than two variants.
    """
    folders, maps = (_pairs(words) for words in (variants, depths))
    if not folders:
        raise CommandError(
            "wanted NAME=CAPTURE of at least one capture, got none; give e.g. given=room "
            "refined=room_refined"
        )
    usual = next(iter(folders.values()))
    choices = [Variant(name, path, maps.get(name)) for name, path in folders.items()]
    choices += [
        Variant(name, usual, folder) for name, folder in maps.items() if name not in folders
    ]
    if len(choices) < 2:
        raise CommandError(
            f"wanted at least two variants, got {choices[0].name}; add NAME=CAPTURE, or --depths "
            f"NAME=DIR"
        )
    return choices


def _pairs(words: Sequence[str]) -> dict[str, Path]:
    pairs = [word.partition("=") for word in words]
    for name, equals, path in pairs:
        if not (equals and path) or not name or Path(name).name != name or name.startswith("."):
            raise CommandError(
                f"wanted NAME=PATH with a name that a folder can have, got {name}{equals}{path}"
            )
    if len({name for name, _, _ in pairs}) < len(pairs):
        raise CommandError(
            f"wanted each name once, got {', '.join(name for name, _, _ in pairs)}; rename one"
        )
    return {name: Path(path) for name, _, path in pairs}


def _open(variant: Variant, reading: CaptureOptions) -> Capture:
    return replace(reading, depth=variant.depth or reading.depth).open(variant.path)


def require_same_frames(
    reference: Variant, first: Capture, variant: Variant, second: Capture, protocol: Protocol
) -> None:
    """Refuse a variant whose test views have other pictures, before hours are spent on it.

    Raises:
        CaptureError: a test view is missing, or its first frame differs.
    """
    start = protocol.frames.start
    for view in protocol.views.test:
        if view not in second.camera_names:
            raise CaptureError(
                f"{variant.path}: wanted the test view {view}, got "
                f"{', '.join(second.camera_names)}; add it"
            )
        if not np.array_equal(first.frame(view, start), second.frame(view, start)):
            raise CaptureError(
                f"{variant.path}: wanted the frames of {reference.path}, but frame {start} of "
                f"{view} differs (another lens model is undistorted to other pictures); undistort "
                "once, and calibrate the pinhole videos"
            )


def compare_variants(
    out: Path, reference: str, variants: Sequence[str]
) -> dict[tuple[str, str], tuple[Difference, ...]]:
    """Return (variant, method) -> differences of its run to the reference's, decided together over
    all of them.
    """
    pairs, names = {}, {}
    for variant in variants:
        for base, changed in run_sides(out / reference, out / variant):
            pairs[f"{changed.label}: {variant} against {reference}"] = changed, base
            names[variant, changed.label] = variant, reference
    compared = compare_pairs(pairs, out / reference, dict(zip(pairs, names.values(), strict=True)))
    return dict(zip(names, compared.values(), strict=True))


def costs_text(first: str, compared: Mapping[tuple[str, str], Sequence[Difference]]) -> str:
    """Return a line per variant, method and metric: value of the first, value, and difference with
    its interval.
    """
    rows = []
    for (name, method), several in compared.items():
        for row in several:
            if not row.view:
                metric, _, value, reference, change, interval, _, verdict = cells_of(row)
                rows.append((name, method, metric, reference, value, change, interval, verdict))
    heads = {
        "variant": 0,
        "method": 0,
        "metric": 0,
        first: 0,
        "value": 0,
        f"minus {first}": 0,
        "95 %": 0,
        "verdict": 1,
    }
    return text_table(heads, rows)
