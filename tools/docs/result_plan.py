"""What measures each table of the pages: commands, their cost, and the identity of the code that a
table comes from.

A table comes from what its commands run and from what makes its text of their results: methods and
metrics, the depth that a command's matcher finds, the film of a room, statistics and tables.
`Measurement.modules` names modules in the rooms of the rest.
"""

import ast
import inspect
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from types import CodeType, FunctionType

from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.files.digest import digest_values
from ggvs_eval.metrics.registry import METRICS
from ggvs_eval.pipelines.methods.registry import find_method, usual_methods
from ggvs_eval.pipelines.methods.spec import OnlineMethod, digest_weights
from ggvs_eval.pipelines.offline.depth import camera_depth, consistency
from ggvs_eval.pipelines.offline.itermvs.estimator import IterMvs
from ggvs_eval.pipelines.run.render import method_code
from ggvs_eval.pipelines.run.score_code import metric_code
from ggvs_eval.pipelines.run.score_path import path_code
from ggvs_eval.protocol import Protocol, load_protocol
from ggvs_eval.run_folder import read_json
from ggvs_eval.sweep import load_sweep
from ggvs_eval.tasks.identity import PACKAGE, code_of

ROOT = Path(__file__).parents[2]
OUT = ROOT / "out"
RECORDS = OUT / "results"  # one per measurement that was made here, with its log
SHORT = 12  # digits of an identity that a page shows
FLAME_STEAK, HOLOLENS, DOME = "n3v_flame_steak", "hololens_rgbd", "panoptic_basketball"
VIDEO_PROTOCOL = "benchmarks/real_video.toml"
DEMO_CAPTURE = "out/demo-capture"
# as the main job makes it, which may have been there first
UNPACK_DEMO = f"ggvs-eval demo {DEMO_CAPTURE}"
ROOMS = tuple(f"out/rooms/{seed}" for seed in range(3))
ON_A_VIDEO = (
    "no-blending",
    "distance-based",
    "enerf",
    "ours",
    "ours-geometric",
    "ours+no-temporal",
)
ON_A_LONG_VIDEO = ("ours", "distance-based", "ours+no-temporal")
FITTED = ("ours", "3dgs-per-instant")
FILLED = ("ours", "ours-geometric")
ITERMVS_FILE, MVSNERF_FILE = "itermvs_blendedmvs_000015.ckpt", "mvsnerf-v0.tar"
CHECKPOINTS = {  # that do not ship: their bytes
    ITERMVS_FILE: "8563268624cf203750212a0e0bfa4825a5af05c0005a225ef02f138258b0fc42",
    MVSNERF_FILE: "84c2a397760d5e717c21faee9c4f8f8f8a1ba22b378b10971c44f4a0b932c124",
}
CAPTURES = {
    "demo": ("ggvs_eval.synthetic",),
    "film": ("ggvs_eval.contrib.worlds.film", "ggvs_eval.contrib.worlds.room"),
}  # verb -> rooms
MEANS = ("ggvs_eval.results", "ggvs_eval.statistics")
EDITS, EDITED = ("--hold-frames", "--sensor-noise"), "ggvs_eval.capture_edit"
STREAMED = ("ggvs_eval.pipelines.run.screens", "ggvs_eval.metrics.time.on_screen")
# tables of a report, by their modules
REPORTED = {"drift": "timing", "price": "costs", "costs": "costs", "seeds": "costs"}
PLAIN = "report_tables"  # ... and of all others
MANY_CAMERAS = 100  # more than any K of a sweep wants
ON_A_REAL_FRAME = (
    "no-blending",
    "distance-based",
    "interpolation",
    "fwd",
    "gps-gaussian+given-depth",
    "ibrnet",
    "enerf",
    "ours",
)
ON_AN_INSTANT = ("no-blending", "distance-based", "ibrnet", "enerf", "mvsnerf", "ours")
LLFF_SCENES, ON_LLFF = (
    ("fern", "flower"),
    ("distance-based", "enerf", "mvsnerf", "ours-geometric", "ours"),
)
ON_SPARSE = ("no-blending", "distance-based", "enerf", "fwd", "ours-geometric", "ours")
SPARSE_RUNS = {  # folder below out/sparse -> capture and protocol
    f"{scene}{n_sources}": (capture, protocol.format(n_sources))
    for scene, capture, protocol in (
        ("flame_steak", FLAME_STEAK, "n3v_sparse{}_instant"),
        *((scene, f"llff/{scene}", f"llff_sparse{{}}_{scene}") for scene in LLFF_SCENES),
    )
    for n_sources in (2, 3, 4)
}
ON_A_SMALL_FRAME = (*ON_A_REAL_FRAME[:-1], "mvsplat", "mvsnerf", "ours", "ours-geometric")


@dataclass(frozen=True)
class Measurement:
    """What fills some tables.

    Attributes:
        name: for `make results ONLY=name`.
        commands: run one after the other from the root of the checkout; ``{data}`` and
            ``{weights}`` are the folders of the inputs that do not ship. Each goes on where it was
            killed.
        minutes: what they take on two cores that share them with little else.
        methods: labels that are rendered.
        protocol: under which, if any.
        sweep: packaged, whose rows are rendered.
        sources: other files of the checkout whose code is measured, with what they import of the
            package.
        captures: folders in ``{data}`` without which it cannot be made.
    """

    name: str
    commands: tuple[str, ...]
    minutes: int
    methods: tuple[str, ...] = ()
    protocol: str = ""
    sweep: str = ""
    sources: tuple[str, ...] = ()
    captures: tuple[str, ...] = ()

    @cached_property
    def identity(self) -> str:
        """Digest of the code, weights and settings that the numbers follow from, as they
        are now.
        """
        return digest_values(
            *self.commands,
            *_of_methods(self.labels),
            *(part for protocol in self.protocols for part in _of_protocol(protocol)),
            *map(_of_source, self.sources),
            *(
                digest
                for file, digest in CHECKPOINTS.items()
                if any(file in command for command in self.commands)
            ),
            code_of(*self.modules),
            *(digest for _, digest in self._table_functions),
        )

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the methods, or of the rows of its sweep."""
        return (
            self.methods or tuple(row.method for row in load_sweep(self.sweep).row)
            if self.sweep
            else self.methods
        )

    @cached_property
    def protocols(self) -> tuple[Protocol, ...]:
        """What runs are measured under: a sweep sets K and a stream."""
        if not self.protocol:
            return ()
        protocol = load_protocol(self.protocol)
        return (
            tuple(load_sweep(self.sweep).protocols(protocol, MANY_CAMERAS).values())
            if self.sweep
            else (protocol,)
        )

    @cached_property
    def modules(self) -> tuple[str, ...]:
        """Modules whose rooms neither a method nor a metric names, sorted."""
        modules = set().union(*(found for found, _ in self._table_functions))
        for program, verb, *words in map(str.split, self.commands):
            if program == "ggvs-eval":
                modules.update(CAPTURES.get(verb, ()))
                modules |= {*MEANS, *_of_depth(words)} if verb in ("run", "sweep") else set()
                modules |= (
                    {EDITED} if verb == "run" and any(word in EDITS for word in words) else set()
                )
        if any(protocol.stream for protocol in self.protocols):
            modules.update(STREAMED)
        return tuple(sorted(modules - {"ggvs_eval.errors"}))

    @cached_property
    def _table_functions(self) -> list[tuple[set[str], str]]:
        """Modules and digest of each function of the checkout that makes its tables."""
        from fill_tables import tables_by_measurement

        functions: dict[str, tuple[set[str], str]] = {}
        for table in tables_by_measurement().get(self.name, []):
            _gather(table.make, functions)
        return [functions[name] for name in sorted(functions)]

    @property
    def record(self) -> Path:
        """Says which code the numbers that lie here came from."""
        return RECORDS / f"{self.name}.json"

    @property
    def made_from(self) -> str:
        """Identity of the code that made what lies here; empty where nothing does."""
        return str(read_json(self.record)["identity"]) if self.record.is_file() else ""

    def lacking(self, data: Path) -> list[str]:
        """Captures that are not there."""
        return [name for name in self.captures if not (data / name).is_dir()]


def _run(
    name: str,
    capture: str,
    methods: tuple[str, ...],
    minutes: int,
    protocol: str = "",
    more: str = "",
) -> Measurement:
    """The evaluation of one capture under a protocol, by default one of the measurement's
    own name.
    """
    protocol = protocol or name
    command = (
        f"ggvs-eval run out/{name} --capture {capture} --protocol {protocol} --methods "
        f"{' '.join(methods)} {more}"
    )
    captures = (FLAME_STEAK,) if FLAME_STEAK in capture or "refined" in capture else ()
    return Measurement(name, (command.strip(),), minutes, methods, protocol, captures=captures)


def _sweep(
    name: str, sweep: str, captures: tuple[str, ...], minutes: int, protocol: str
) -> Measurement:
    """A packaged sweep; rooms are filmed first where they are not there."""
    films = [
        f"ggvs-eval film {room} --seed {room[-1]} --n-frames 30"
        for room in captures
        if room in ROOMS
    ]
    films += [UNPACK_DEMO] * (DEMO_CAPTURE in captures)
    command = (
        f"ggvs-eval sweep {sweep} out/{name} --capture {' '.join(captures)} --protocol {protocol}"
    )
    return Measurement(name, (*films, command), minutes, protocol=protocol, sweep=sweep)


def _of_dome(
    name: str, methods: tuple[str, ...], minutes: int, protocol: str = "", more: str = ""
) -> Measurement:
    """The real video under ``benchmarks/PROTOCOL.toml``, by default one of the measurement's own
    name.
    """
    file = f"benchmarks/{protocol or name}.toml"
    command = (
        f"ggvs-eval run out/{name} --capture {{data}}/{DOME} --protocol {file} --methods "
        f"{' '.join(methods)} {more}"
    )
    return Measurement(
        name, (command.strip(),), minutes, methods, str(ROOT / file), captures=(DOME,)
    )


def _stream(
    name: str, capture: str, minutes: int, protocol: str, captures: tuple[str, ...] = ()
) -> Measurement:
    """The sweep of what is on the screen, one job at a time, as its seconds count."""
    film = (UNPACK_DEMO,) * (capture == DEMO_CAPTURE)
    command = (
        f"ggvs-eval sweep stream out/{name} --capture {capture} --protocol {protocol} --jobs 1"
    )
    return Measurement(
        name,
        (*film, command),
        minutes,
        protocol=str(ROOT / protocol),
        sweep="stream",
        captures=captures,
    )


_NOISE = ("ours+no-temporal", "ours")
_STEAK = f"{{data}}/{FLAME_STEAK}"
MEASUREMENTS = {
    each.name: each
    for each in (
        Measurement("demo", ("ggvs-eval run out/demo",), 15, (*usual_methods(), "fwd"), "demo"),
        _run("real_frame", _STEAK, (*ON_A_REAL_FRAME, "ours-geometric"), 75),
        _run(
            "real_frame_small",
            _STEAK,
            ON_A_SMALL_FRAME,
            35,
            more="--weights mvsnerf={weights}/mvsnerf-v0.tar",
        ),
        Measurement(
            "llff",
            (
                *(
                    f"ggvs-eval run out/llff/{scene} --capture {{data}}/llff/{scene} --protocol "
                    f"llff_3view_{scene} --methods {' '.join(ON_LLFF)} --weights "
                    f"mvsnerf={{weights}}/{MVSNERF_FILE}"
                    for scene in LLFF_SCENES
                ),
                "python -m benchmarks.llff "
                f"{' '.join(f'out/llff/{scene}' for scene in LLFF_SCENES)}",
            ),
            130,
            ON_LLFF,
            "llff_3view_fern",
            sources=("benchmarks/llff.py",),
            captures=tuple(f"llff/{scene}" for scene in LLFF_SCENES),
        ),
        Measurement(
            "sparse",
            (
                *(
                    f"ggvs-eval run out/sparse/{run} --capture {{data}}/{capture} --protocol "
                    f"{protocol} --methods {' '.join(ON_SPARSE)}"
                    for run, (capture, protocol) in SPARSE_RUNS.items()
                ),
                "python -m benchmarks.sparse "
                f"{' '.join(f'out/sparse/{run}' for run in SPARSE_RUNS)}",
            ),
            30,
            ON_SPARSE,
            "n3v_sparse3_instant",
            sources=("benchmarks/sparse.py",),
            captures=(FLAME_STEAK, *(f"llff/{scene}" for scene in LLFF_SCENES)),
        ),
        Measurement(
            "demo_instant",
            (
                UNPACK_DEMO,
                f"ggvs-eval run out/demo_instant --capture {DEMO_CAPTURE} --protocol "
                f"benchmarks/demo_instant.toml --methods {' '.join(ON_AN_INSTANT)} --weights "
                "mvsnerf={weights}/mvsnerf-v0.tar",
            ),
            12,
            ON_AN_INSTANT,
            str(ROOT / "benchmarks/demo_instant.toml"),
        ),
        _run(
            "real_frame_coverage",
            _STEAK,
            ("no-blending", "distance-based", "ours", "ours-geometric"),
            12,
        ),
        _run("real_frame_folds", _STEAK, FITTED, 45, "real_frame"),
        _run(
            "real_frame_held",
            _STEAK,
            usual_methods()[:5],
            60,
            more="--hold-frames 16 --sensor-noise 1.5",
        ),
        Measurement(
            "refined_capture",
            (f"ggvs-eval calibrate {_STEAK} out/refined --known-poses {_STEAK} --refine",),
            10,
            sources=("pipelines/offline/calibration/calibrate.py",),
            captures=(FLAME_STEAK,),
        ),
        _run(
            "real_frame_refined",
            "out/refined",
            ("ours", "ours-geometric", "distance-based", "no-blending"),
            12,
            "real_frame",
        ),
        _run(
            "real_frame_refined_coverage",
            "out/refined",
            ("ours", "ours-geometric", "distance-based", "no-blending"),
            12,
            "real_frame_coverage",
        ),
        Measurement(
            "validate",
            ("python -m benchmarks.validate --data {data}",),
            60,
            sources=("benchmarks/validate.py", "benchmarks/depth_validation/evaluate_matcher.py"),
            captures=(FLAME_STEAK,),
        ),
        Measurement(
            "domains",
            ("python -m benchmarks.domain_validation --data {data}",),
            25,
            ("ours", "ours-geometric", "distance-based"),
            sources=("benchmarks/domain_validation.py",),
        ),
        Measurement(
            "refinement",
            ("python -m benchmarks.refinement_validation",),
            30,
            ("ours-geometric",),
            sources=("benchmarks/refinement_validation.py",),
        ),
        Measurement(
            "additions",
            ("python -m benchmarks.additions",),
            40,
            ("ours",),
            sources=("benchmarks/additions.py",),
        ),
        Measurement(
            "depth",
            (
                "python -m benchmarks.depth_validation --data {data} --matchers sgbm,sweep,raft",
                "python -m benchmarks depth",
            ),
            25,
            sources=(
                "benchmarks/depth_validation/evaluate_matcher.py",
                "benchmarks/bench_depth.py",
            ),
            captures=(FLAME_STEAK,),
        ),
        Measurement(
            "speed",
            ("python -m benchmarks online",),
            3,
            ("ours",),
            sources=("benchmarks/bench_online.py",),
        ),
        Measurement(
            "bench", ("python -m benchmarks",), 25, ("ours",), sources=("benchmarks/__main__.py",)
        ),
        _sweep("rooms_ablations", "ablations_short", ROOMS, 60, "rooms"),
        _sweep("rooms_switches", "switches", ROOMS, 25, "rooms_short"),
        _sweep("rooms_k", "k", ROOMS, 30, "rooms_short"),
        _sweep("rooms_baselines", "baselines", ROOMS, 120, "rooms_short"),
        _of_dome("real_fits", ("4dgs", "3dgs-per-instant+steps=300", "ours", "ours-geometric"), 50),
        _of_dome("real_path", ("ours", "ours-geometric", "distance-based", "no-blending"), 10),
        _stream("stream", DEMO_CAPTURE, 20, "benchmarks/room_stream.toml"),
        _stream("stream_real", f"{{data}}/{DOME}", 60, "benchmarks/real_stream.toml", (DOME,)),
        Measurement(
            "long_room",
            (
                "ggvs-eval film out/long-room --seed 101 --width 320 --height 240 --n-frames 300 "
                "--cameras-per-row 3 --supersampling 1 --path-poses 0 --depth-stride 0",
                "ggvs-eval run out/long --capture out/long-room --protocol "
                f"benchmarks/long_room.toml --matcher live --methods {' '.join(ON_A_LONG_VIDEO)}",
            ),
            25,
            ON_A_LONG_VIDEO,
            str(ROOT / "benchmarks/long_room.toml"),
        ),
        _sweep("offline", "offline", (DEMO_CAPTURE,), 480, "offline"),
        Measurement(
            "offline_unseen",
            (
                "ggvs-eval film out/unseen-capture --seed 2 --rig grid --width 320 --height 240 "
                "--n-frames 12 --path-poses 24",
                "ggvs-eval sweep offline out/offline_unseen --capture out/unseen-capture "
                "--protocol offline",
            ),
            300,
            protocol="offline",
            sweep="offline",
        ),
        Measurement(
            "colmap_controls",
            ("python -m benchmarks.colmap_controls out/demo",),
            15,
            sources=("benchmarks/colmap_controls.py",),
        ),
        Measurement(
            "metric_study",
            ("ggvs-eval metric-study out/metric_study --metrics all",),
            30,
            sources=("contrib/study/measure.py",),
        ),
        Measurement(
            "metric_study_real",
            (
                f"ggvs-eval metric-study out/metric_study_real --capture {{data}}/{HOLOLENS} "
                f"--metrics all",
            ),
            30,
            sources=("contrib/study/measure.py",),
            captures=(HOLOLENS,),
        ),
        Measurement(
            "ceiling_accuracy",
            ("python -m benchmarks.ceiling_accuracy --seeds 11 16",),
            30,
            sources=("benchmarks/ceiling_accuracy.py",),
        ),
        Measurement(
            "intervals",
            ("python -m benchmarks.interval_coverage",),
            20,
            sources=("benchmarks/interval_coverage.py",),
        ),
        # by hand, where there is a GPU
        Measurement("device", (), 10, ("ours",), sources=("benchmarks/bench_device_step.py",)),
        Measurement(
            "real_video",
            (
                f"ggvs-eval run out/real_video/dome --capture {{data}}/{DOME} --protocol "
                f"{VIDEO_PROTOCOL} --methods {' '.join(ON_A_VIDEO)}",
            ),
            30,
            ON_A_VIDEO,
            str(ROOT / VIDEO_PROTOCOL),
            captures=(DOME,),
        ),
        _of_dome(
            "real_video_itermvs",
            FILLED,
            75,
            "real_video",
            f"--matcher sgbm+itermvs:{{weights}}/{ITERMVS_FILE}",
        ),
        # of a folder of clips that nobody ships
        Measurement("author_clips", (), 40, sources=("benchmarks/author_clips.py",)),
        Measurement(
            "rooms_noise",
            tuple(
                line
                for seed in range(3)
                for line in (
                    f"ggvs-eval film out/noisy/{seed} --seed {seed} --n-frames 30 --sensor-noise "
                    f"1.5",
                    f"ggvs-eval run out/rooms_noise/{seed} --capture out/noisy/{seed} --protocol "
                    f"rooms --methods " + " ".join(_NOISE),
                )
            ),
            40,
            _NOISE,
            "rooms",
        ),
    )
}


def _of_methods(labels: tuple[str, ...]) -> Iterator[str]:
    """Label, code and weights of each method.

    A file of weights that does not ship counts by its label.
    """
    for label in labels:
        spec = find_method(label)
        weights = spec.weights if isinstance(spec, OnlineMethod) else ()
        yield " ".join([label, method_code(spec), *(digest_weights(file) for file in weights)])


@cache
def _of_protocol(protocol: Protocol) -> tuple[str, ...]:
    """Views, frames and metrics, and the code that measures these."""
    names = protocol.measurement.metrics
    codes = [metric_code(METRICS[metric]) for metric in names if METRICS[metric].kind != "path"]
    along_path = (
        [metric for metric in names if METRICS[metric].kind == "path"]
        if protocol.path.poses
        else []
    )
    codes += [path_code(along_path)] if along_path else []
    return protocol.sha256, *codes


def _of_depth(words: Sequence[str]) -> set[str]:
    """Modules of the depth that a command's matcher finds, and of how it is held against that of
    others.
    """
    name, _, filler = (
        words[words.index("--matcher") + 1] if "--matcher" in words else ""
    ).partition("+")
    found = DepthRunOptions(name).options() if name else DepthRunOptions().options()
    modules = camera_depth.modules_of(
        found.matcher, IterMvs(Path(), "") if filler.startswith("itermvs") else found.filler
    )
    return {camera_depth.__name__, consistency.FUSION, *modules}


def _gather(make: FunctionType, functions: dict[str, tuple[set[str], str]]) -> None:
    """Collect the functions of the checkout that one calls, itself included: their modules of the
    package, and a digest.
    """
    name = f"{make.__module__}.{make.__qualname__} {make.__code__.co_firstlineno}"
    if name in functions:
        return
    words, constants = _of_code(make.__code__)
    modules, values = {word for word in words if _is_module(word)}, [repr(constants)]
    functions[name] = modules, ""
    for word in words:
        value = make.__globals__.get(word)
        module = str(getattr(value, "__module__", ""))
        if module.startswith(f"{PACKAGE}."):
            modules.add(module)
        elif isinstance(value, FunctionType) and (Path(__file__).parent / f"{module}.py").is_file():
            _gather(value, functions)
            if word == "report_table":
                modules |= {
                    f"ggvs_eval.reports.tables.{REPORTED.get(table, PLAIN)}" for table in constants
                }
        elif isinstance(value, str | tuple | dict) and "Path" not in repr(value):
            values.append(f"{word} {value!r}")
    if make.__name__ != "<lambda>":
        values.append(inspect.getsource(make))
    functions[name] = modules, digest_values(*values)


def _of_code(code: CodeType) -> tuple[list[str], list[str]]:
    """Names that a function looks up, and words that stand in it, those of functions inside it
    included.
    """
    inner = [_of_code(each) for each in code.co_consts if isinstance(each, CodeType)]
    words = [
        word
        for each in code.co_consts
        for word in (each if isinstance(each, tuple) else (each,))
        if isinstance(word, str)
    ]
    names = sorted({*code.co_names, *(name for names, _ in inner for name in names)})
    return names, sorted({*words, *(word for _, words in inner for word in words)})


@cache
def _of_source(file: str) -> str:
    """A file of the checkout, the benchmarks that it imports, and the rooms of the package that
    they import from.
    """
    texts: dict[str, str] = {}
    waiting, modules = [file], set[str]()
    while waiting:
        name = waiting.pop()
        if name in texts:
            continue
        texts[name] = (ROOT / name).read_text(encoding="utf-8")
        imported = [
            node.module
            for node in ast.walk(ast.parse(texts[name]))
            if isinstance(node, ast.ImportFrom) and node.module
        ]
        files = [
            f"{module.replace('.', '/')}.py"
            for module in imported
            if module.startswith("benchmarks.")
        ]
        waiting += [file for file in files if (ROOT / file).is_file()]
        modules.update(module for module in imported if module.partition(".")[0] == PACKAGE)
    return digest_values(*sorted(texts.values()), code_of(*modules))


def _is_module(word: str) -> bool:
    return word.startswith(f"{PACKAGE}.") and word.replace(".", "").isidentifier()
