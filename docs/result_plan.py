"""What measures each table of the pages: commands, their cost, and the identity of the code that a table comes from."""

import ast
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

from ggvs_eval.files.digest import digest_values
from ggvs_eval.jobs.code_identity import code_identity, installed_code, what_runs
from ggvs_eval.metrics.registry import METRICS
from ggvs_eval.pipelines.methods.registry import find_method, usual_methods
from ggvs_eval.pipelines.methods.spec import OnlineMethod, digest_weights
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.run.render import method_code
from ggvs_eval.pipelines.run.score_code import metric_code, path_code
from ggvs_eval.protocol import load_protocol
from ggvs_eval.run_folder import read_json
from ggvs_eval.sweep import load_sweep

ROOT = Path(__file__).parents[1]
OUT = ROOT / "out"
RECORDS = OUT / "results"  # one per measurement that was made here, with its log
SHORT = 12  # digits of an identity that a page shows
FLAME_STEAK, HOLOLENS, DOME = "n3v_flame_steak", "hololens_rgbd", "panoptic_basketball"
VIDEO_PROTOCOL = "benchmarks/real_video.toml"
DEMO_CAPTURE = "out/demo-capture"
FILM_DEMO = f"ggvs-eval demo {DEMO_CAPTURE} --depth-stride 0"  # as the main job makes it, which may have been there first
ROOMS = tuple(f"out/rooms/{seed}" for seed in range(3))
ON_A_VIDEO = ("no-blending", "distance-based", "enerf", "ours", "ours-geometric", "ours+no-temporal")
ON_A_LONG_VIDEO = ("ours", "distance-based", "ours+no-temporal")
FITTED = ("ours", "3dgs-per-instant")
FILLED = ("ours", "ours-geometric")
ITERMVS_FILE = "itermvs_blendedmvs_000015.ckpt"
ON_A_REAL_FRAME = ("no-blending", "distance-based", "interpolation", "fwd", "gps-gaussian+given-depth", "ibrnet", "enerf", "ours")
ON_AN_INSTANT = ("no-blending", "distance-based", "ibrnet", "enerf", "mvsnerf", "ours")
ON_A_SMALL_FRAME = (*ON_A_REAL_FRAME[:-1], "mvsplat", "mvsnerf", "ours", "ours-geometric")


@dataclass(frozen=True)
class Measurement:
    """What fills some tables.

    Attributes:
        name: for `make results ONLY=name`.
        commands: run one after the other from the root of the checkout; ``{data}`` and ``{weights}`` are the folders of the
            inputs that do not ship. Each goes on where it was killed.
        minutes: what they take on two cores that share them with little else.
        methods: labels that are rendered.
        protocol: under which, if any.
        sweep: packaged, whose rows are rendered.
        sources: other files of the checkout whose code is measured, with what they import of the package.
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
        """Digest of the code, weights and settings that the numbers follow from, as they are now."""
        labels = self.methods or tuple(row.method for row in load_sweep(self.sweep).row) if self.sweep else self.methods
        return digest_values(*self.commands, *_of_methods(labels), *_of_protocol(self.protocol), *map(_of_source, self.sources))

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


def _run(name: str, capture: str, methods: tuple[str, ...], minutes: int, protocol: str = "", more: str = "") -> Measurement:
    """The evaluation of one capture under a protocol, by default one of the measurement's own name."""
    protocol = protocol or name
    command = f"ggvs-eval run out/{name} --capture {capture} --protocol {protocol} --methods {' '.join(methods)} {more}"
    captures = (FLAME_STEAK,) if FLAME_STEAK in capture or "refined" in capture else ()
    return Measurement(name, (command.strip(),), minutes, methods, protocol, captures=captures)


def _sweep(name: str, sweep: str, captures: tuple[str, ...], minutes: int, protocol: str) -> Measurement:
    """A packaged sweep; rooms are filmed first where they are not there."""
    films = [f"ggvs-eval demo {room} --seed {room[-1]} --n-frames 30" for room in captures if room in ROOMS]
    films += [FILM_DEMO] * (DEMO_CAPTURE in captures)
    command = f"ggvs-eval sweep {sweep} out/{name} --capture {' '.join(captures)} --protocol {protocol}"
    return Measurement(name, (*films, command), minutes, protocol=protocol, sweep=sweep)


def _of_dome(name: str, methods: tuple[str, ...], minutes: int, protocol: str = "", more: str = "") -> Measurement:
    """The real video under ``benchmarks/PROTOCOL.toml``, by default one of the measurement's own name."""
    file = f"benchmarks/{protocol or name}.toml"
    command = f"ggvs-eval run out/{name} --capture {{data}}/{DOME} --protocol {file} --methods {' '.join(methods)} {more}"
    return Measurement(name, (command.strip(),), minutes, methods, str(ROOT / file), captures=(DOME,))


def _stream(name: str, capture: str, minutes: int, protocol: str, captures: tuple[str, ...] = ()) -> Measurement:
    """The sweep of what is on the screen, one job at a time, as its seconds count."""
    film = (FILM_DEMO,) * (capture == DEMO_CAPTURE)
    command = f"ggvs-eval sweep stream out/{name} --capture {capture} --protocol {protocol} --jobs 1"
    return Measurement(name, (*film, command), minutes, protocol=str(ROOT / protocol), sweep="stream", captures=captures)


_NOISE = ("ours+no-temporal", "ours")
_STEAK = f"{{data}}/{FLAME_STEAK}"
MEASUREMENTS = {
    each.name: each
    for each in (
        Measurement("demo", ("ggvs-eval run out/demo",), 15, usual_methods(), "demo"),
        _run("real_frame", _STEAK, (*ON_A_REAL_FRAME, "ours-geometric"), 75),
        _run("real_frame_small", _STEAK, ON_A_SMALL_FRAME, 35, more="--weights mvsnerf={weights}/mvsnerf-v0.tar"),
        Measurement(
            "demo_instant",
            (
                FILM_DEMO,
                f"ggvs-eval run out/demo_instant --capture {DEMO_CAPTURE} --protocol benchmarks/demo_instant.toml --methods "
                f"{' '.join(ON_AN_INSTANT)} --weights mvsnerf={{weights}}/mvsnerf-v0.tar",
            ),
            12,
            ON_AN_INSTANT,
            str(ROOT / "benchmarks/demo_instant.toml"),
        ),
        _run("real_frame_coverage", _STEAK, ("no-blending", "distance-based", "ours", "ours-geometric"), 12),
        _run("real_frame_folds", _STEAK, FITTED, 45, "real_frame"),
        _run("real_frame_held", _STEAK, usual_methods()[:5], 60, more="--hold-frames 16 --sensor-noise 1.5"),
        Measurement(
            "refined_capture",
            (f"ggvs-eval calibrate {_STEAK} out/refined --known-poses {_STEAK} --refine",),
            10,
            sources=("pipelines/offline/calibration/calibrate.py",),
            captures=(FLAME_STEAK,),
        ),
        _run("real_frame_refined", "out/refined", ("ours", "ours-geometric", "distance-based", "no-blending"), 12, "real_frame"),
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
        Measurement("additions", ("python -m benchmarks.additions",), 40, ("ours",), sources=("benchmarks/additions.py",)),
        Measurement(
            "depth",
            ("python -m benchmarks.depth_validation --data {data} --matchers sgbm,sweep,raft", "python -m benchmarks depth"),
            25,
            sources=("benchmarks/depth_validation/evaluate_matcher.py", "benchmarks/bench_depth.py"),
            captures=(FLAME_STEAK,),
        ),
        Measurement("speed", ("python -m benchmarks online",), 3, ("ours",), sources=("benchmarks/bench_online.py",)),
        Measurement("bench", ("python -m benchmarks",), 25, ("ours",), sources=("benchmarks/__main__.py",)),
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
                "ggvs-eval demo out/long-room --seed 101 --width 320 --height 240 --n-frames 300 --cameras-per-row 3 "
                "--supersampling 1 --path-poses 0 --depth-stride 0",
                "ggvs-eval run out/long --capture out/long-room --protocol benchmarks/long_room.toml --matcher live "
                f"--methods {' '.join(ON_A_LONG_VIDEO)}",
            ),
            25,
            ON_A_LONG_VIDEO,
            str(ROOT / "benchmarks/long_room.toml"),
        ),
        _sweep("offline", "offline", (DEMO_CAPTURE,), 480, "offline"),
        Measurement(
            "offline_unseen",
            (
                "ggvs-eval demo out/unseen-capture --seed 2 --rig grid --width 320 --height 240 --n-frames 12 --path-poses 24",
                "ggvs-eval sweep offline out/offline_unseen --capture out/unseen-capture --protocol offline",
            ),
            300,
            protocol="offline",
            sweep="offline",
        ),
        Measurement(
            "colmap_controls", ("python -m benchmarks.colmap_controls out/demo",), 15, sources=("benchmarks/colmap_controls.py",)
        ),
        Measurement(
            "metric_study",
            ("ggvs-eval metric-study out/metric_study --metrics all",),
            30,
            sources=("pipelines/study/measure.py",),
        ),
        Measurement(
            "metric_study_real",
            (f"ggvs-eval metric-study out/metric_study_real --capture {{data}}/{HOLOLENS} --metrics all",),
            30,
            sources=("pipelines/study/measure.py",),
            captures=(HOLOLENS,),
        ),
        Measurement(
            "ceiling_accuracy",
            ("python -m benchmarks.ceiling_accuracy --seeds 11 16",),
            30,
            sources=("benchmarks/ceiling_accuracy.py",),
        ),
        Measurement("intervals", ("python -m benchmarks.interval_coverage",), 20, sources=("benchmarks/interval_coverage.py",)),
        Measurement("device", (), 10, ("ours",), sources=("benchmarks/bench_device_step.py",)),  # by hand, where there is a GPU
        Measurement(
            "real_video",
            (
                f"ggvs-eval run out/real_video/dome --capture {{data}}/{DOME} --protocol {VIDEO_PROTOCOL} "
                f"--methods {' '.join(ON_A_VIDEO)}",
            ),
            30,
            ON_A_VIDEO,
            str(ROOT / VIDEO_PROTOCOL),
            captures=(DOME,),
        ),
        _of_dome("real_video_itermvs", FILLED, 75, "real_video", f"--matcher sgbm+itermvs:{{weights}}/{ITERMVS_FILE}"),
        Measurement("author_clips", (), 40, sources=("benchmarks/author_clips.py",)),  # of a folder of clips that nobody ships
        Measurement(
            "rooms_noise",
            tuple(
                line
                for seed in range(3)
                for line in (
                    f"ggvs-eval demo out/noisy/{seed} --seed {seed} --n-frames 30 --sensor-noise 1.5",
                    f"ggvs-eval run out/rooms_noise/{seed} --capture out/noisy/{seed} --protocol rooms --methods "
                    + " ".join(_NOISE),
                )
            ),
            40,
            _NOISE,
            "rooms",
        ),
    )
}


def _of_methods(labels: tuple[str, ...]) -> Iterator[str]:
    """Label, code and weights of each method; a file of weights that does not ship counts by its label."""
    for label in labels:
        spec = find_method(label)
        weights = spec.weights if isinstance(spec, OnlineMethod) else ()
        yield " ".join([label, method_code(spec), *(digest_weights(file) for file in weights)])


@cache
def _of_protocol(name: str) -> tuple[str, ...]:
    """Views, frames and metrics, the code that measures these, and that of depth."""
    if not name:
        return ()
    protocol = load_protocol(name)
    names = protocol.measurement.metrics
    codes = [metric_code(METRICS[metric]) for metric in names if METRICS[metric].kind != "path"]
    along_path = [metric for metric in names if METRICS[metric].kind == "path"] if protocol.path.poses else []
    codes += [path_code(along_path)] if along_path else []
    return protocol.sha256, str(DepthOptions().describe()["code"]), *codes


@cache
def _of_source(file: str) -> str:
    """A file of the checkout, the benchmarks that it imports, and what all of them import of the package."""
    seen: set[str] = set()
    waiting, modules, texts = [file], set[str](), []
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        text = (ROOT / name).read_text(encoding="utf-8")
        texts.append(hashlib.sha256(what_runs(text).encode()).hexdigest())
        for imported in _imports(text):
            path = f"{imported.replace('.', '/')}.py"
            if imported.startswith("benchmarks.") and (ROOT / path).is_file():
                waiting.append(path)
            elif imported in _package():
                modules.add(imported)
    return digest_values(*sorted(texts), code_identity(*sorted(modules)) if modules else "")


def _imports(text: str) -> Iterator[str]:
    """Dotted names that a source may mean by its imports, modules and words of modules alike."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@cache
def _package() -> frozenset[str]:
    return frozenset(installed_code().modules())
