"""Results: one tidy table of every measured value, with the provenance that makes it quotable."""

import json
import os
import platform
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ggvs_eval.errors import ResultsError
from ggvs_eval.files.atomic import atomic_file, write_text

if TYPE_CHECKING:
    import pandas as pd

# These variables make libraries use fewer instruction sets than the processor has.
INSTRUCTION_SETS = (
    *(
        "OPENBLAS_CORETYPE",
        "NPY_DISABLE_CPU_FEATURES",
        "OPENCV_CPU_DISABLE",
        "OPENCV_IPP",
        "ONEDNN_MAX_CPU_ISA",
    ),
    *("ATEN_CPU_CAPABILITY", "MKL_ENABLE_INSTRUCTIONS", "MKL_CBWR", "GLIBC_TUNABLES"),
)
COLUMNS = ("dataset", "scene", "method", "variant", "view", "frame", "metric", "value")
MOVING_NUMBERS = (  # packages whose version can
    *(
        "ggvs-eval",
        "numpy",
        "opencv-python-headless",
        "torch",
        "scipy",
        "pyrtools",
        "av",
        "pandas",
        "pillow",
        "pycolmap",
    ),
    *("flip-evaluator", "imageio-ffmpeg", "cvvdp", "torchvision"),
)
TABLE_FILE = "results.parquet"
PROVENANCE_FILE = "results.json"
# Fault of renders -> what it looks like, to follow the method's name.
SAME_FRAMES = "same frames as "  # ... another method or view: the begin of a fault's question
SYMPTOMS = {
    "reversed time": "has its frames in reversed order",
    "channel order": "has swapped colour channels",
    "mirrored": "is mirrored",
    "blank frames": "has blank frames",
    "flicker": "flickers as a whole",
    "black border": "has black borders",
    "test view seen": "was trained on the test view",
}


class Absence(NamedTuple):
    """A value that a method lacks in a view, while the metric has values elsewhere.

    ``view`` is empty if it lacks all.
    """

    metric: str
    label: str
    scene: str
    view: str
    reason: str


class Fault(NamedTuple):
    """Fault that the quick checks of `ggvs-eval doctor` found in a view's renders.

    ``called``: a word for it, or empty.
    """

    label: str
    scene: str
    view: str
    question: str
    verdict: str
    measured: str
    advice: str
    called: str = ""

    @property
    def is_certain(self) -> bool:
        """True if nothing else explains the frames, so that their numbers say nothing of the
        method.
        """
        return self.verdict == "certain"

    @property
    def words(self) -> str:
        """The fault as it follows the method's name, e.g. ``shows every frame one instant
        late``.
        """
        if self.called:
            lag = re.search(r"t[+-](\d+)", self.measured)
            instants = f"{lag[1]} instants" if lag and lag[1] != "1" else "one instant"
            return f"shows every frame {instants} {self.called}"
        if self.question.startswith(SAME_FRAMES):
            return f"shows the {self.question}"
        return SYMPTOMS.get(self.question, f"has a fault: {self.question}")

    @property
    def remedy(self) -> str:
        """First thing to do about it, one sentence, e.g. ``Renumber the frames by -1.``.

        Empty if none is known.
        """
        first = re.match(r"[^:;?]+\??", self.advice)
        return (
            f"{first[0][0].upper()}{first[0][1:]}{'' if first[0].endswith('?') else '.'}"
            if first
            else ""
        )


@dataclass(frozen=True)
class Results:
    """Every value of one evaluation, with its provenance.

    Attributes:
        table: one row per value with the columns `COLUMNS`; ``view`` is None if a value belongs to
            the whole rig (SDV), ``frame`` is -1 if it belongs to the whole sequence (STED, SDT).
        provenance: ``protocol`` (values), ``protocol_sha256``, ``inputs`` (digest per camera),
            ``renders`` (digest per method and view), ``partial`` (method -> what its row is based
            on, if not everything), ``devices`` (method and view -> where its networks computed,
            there alone where that is not the CPU), ``pooling`` (metric -> how its number is made of
            views and frames, see `ggvs_eval.statistics.pooling.Pooling`), ``absent`` (values that
            some methods or views lack, see `Absence`), ``faults`` (of renders, see `Fault`),
            ``versions`` (package -> versions that values were made under), ``machine`` (see
            `describe_machine`).
        not_computed: metric -> reason, for what was asked for and no method has in any view.
        place: folder that they were read from; empty for those of a calculation.
    """

    table: "pd.DataFrame"
    provenance: dict[str, Any]
    not_computed: dict[str, str] = field(default_factory=dict)
    place: str = ""

    def __post_init__(self) -> None:
        missing = [name for name in COLUMNS if name not in self.table.columns]
        if missing or "protocol_sha256" not in self.provenance:
            raise ResultsError(
                f"results lack {', '.join(missing) or 'provenance.protocol_sha256'}; score the run "
                f"again"
            )

    def write(self, folder: Path) -> None:
        """Write the table as Parquet and the provenance as JSON, each whole or not at all."""
        with atomic_file(folder / TABLE_FILE) as temporary:
            self.table.to_parquet(temporary, index=False)
        text = json.dumps(
            {"provenance": self.provenance, "not_computed": self.not_computed},
            indent=1,
            sort_keys=True,
        )
        write_text(folder / PROVENANCE_FILE, text)

    @classmethod
    def read(cls, folder: Path) -> "Results":
        """Read the results that `write` wrote.

        Raises:
            ResultsError: no results in that folder, or damaged ones.
        """
        import pandas as pd

        try:
            table = pd.read_parquet(folder / TABLE_FILE)
            sidecar = json.loads((folder / PROVENANCE_FILE).read_text(encoding="utf-8"))
            return cls(table, sidecar["provenance"], sidecar["not_computed"], str(folder))
        except (OSError, ValueError, KeyError) as error:
            raise ResultsError(
                f"{folder}: wanted {TABLE_FILE} and {PROVENANCE_FILE} ({error}); run `ggvs-eval "
                f"score`"
            ) from None

    @property
    def scenes(self) -> tuple[str, ...]:
        """Names of the captured scenes, in the order of the table."""
        return tuple(dict.fromkeys(self.table["scene"].astype(str)))

    @property
    def row_labels(self) -> list[str]:
        """Label of the method of each row of the table."""
        return [
            label_of(*names)
            for names in zip(self.table["method"], self.table["variant"], strict=True)
        ]

    @property
    def protocol_sha256(self) -> str:
        """Hash of the protocol that everything was measured under."""
        return str(self.provenance["protocol_sha256"])

    @property
    def protocol_values(self) -> dict[str, Any]:
        """That protocol as it was written down; empty in results of earlier versions."""
        return self._recorded("protocol")

    @property
    def inputs(self) -> dict[str, str]:
        """Captured frames, ``scene/view`` -> their hash."""
        return self._recorded("inputs")

    @property
    def renders(self) -> dict[str, str]:
        """Frames of a method in a view -> their hash."""
        return self._recorded("renders")

    @property
    def versions(self) -> dict[str, str]:
        """Packages -> their version when this was measured."""
        return self._recorded("versions")

    @property
    def devices(self) -> dict[str, str]:
        """Devices other than the CPU, ``label/view`` or metrics -> the device."""
        return self._recorded("devices")

    @property
    def partial(self) -> dict[str, str]:
        """Methods whose renders lack views or frames -> what their numbers are based on."""
        return self._recorded("partial")

    def _recorded(self, name: str) -> dict[str, Any]:
        return dict(self.provenance.get(name, {}))

    @property
    def absences(self) -> tuple[Absence, ...]:
        """Values that some methods or views lack while others have them."""
        return tuple(Absence(*row) for row in self.provenance.get("absent", ()))

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Faults that the quick checks found in renders."""
        return tuple(Fault(*row) for row in self.provenance.get("faults", ()))

    @property
    def spoilt(self) -> dict[str, str]:
        """Methods with a certain fault in their renders -> it, as it follows their name.

        They are compared with no other.
        """
        return {fault.label: fault.words for fault in reversed(self.faults) if fault.is_certain}

    @property
    def set_aside(self) -> dict[str, str]:
        """Methods that are not ranked -> why, as it follows their name: partial ones, and those
        with a certain fault.
        """
        return {label: f"is {mark}" for label, mark in self.partial.items()} | self.spoilt

    def fault_lines(self, names: Mapping[str, str] | None = None) -> list[str]:
        """Return each fault of a method, with the views that have it, the measurement in the first
        one, and what to do.

        Args:
            names: label -> name to show, where these differ.
        """
        views: dict[tuple[str, str], list[Fault]] = {}
        for fault in self.faults:
            views.setdefault((fault.label, fault.words), []).append(fault)
        return [
            f"{(names or {}).get(label, label)} "
            f"{words}{', so it is not ranked' if faults[0].is_certain else ''} "
            f"({faults[0].verdict}; {', '.join(fault.view for fault in faults)}: "
            f"{faults[0].measured}). "
            f"{faults[0].remedy}".strip()
            for (label, words), faults in views.items()
        ]

    def why_absent(self, metric: str, label: str, view: str = "") -> str:
        """Return the reason why a method has no value of a metric, in one view or in any.

        Empty if none is recorded.
        """
        absences = (
            absence
            for absence in self.absences
            if (absence.metric, absence.label) == (metric, label)
        )
        reasons = (absence.reason for absence in absences if not view or absence.view in ("", view))
        return next(reasons, self.not_computed.get(metric, ""))

    def summary(self) -> "pd.DataFrame":
        """Return the mean of every metric per dataset, method and variant: over frames, then views,
        then scenes.

        Returns:
            Rows (dataset, method, variant), one column per metric, in the order in which they were
            first measured.

        Examples:
            >>> rows = [
            ...     ("demo", "room", "ours", "", "cam00", frame, "PSNR", value)
            ...     for frame, value in enumerate((30.0, 32.0))
            ... ]
            >>> results = Results(make_table(rows), {"protocol_sha256": "0123"})
            >>> float(results.summary()["PSNR"].iloc[0])
            31.0
        """
        keys = ["dataset", "method", "variant", "metric", "scene"]
        per_view = self.table.groupby([*keys, "view"], sort=False, dropna=False)["value"].mean()
        per_scene = per_view.groupby(keys, sort=False).mean()
        per_dataset = per_scene.groupby(keys[:4], sort=False).mean()
        return per_dataset.unstack("metric", sort=False)

    def per_view(self, metric: str) -> "pd.DataFrame":
        """Return the mean over frames of one metric: rows (method, variant), one column per
        view.
        """
        rows = self.table[(self.table["metric"] == metric) & self.table["view"].notna()]
        return (
            rows.groupby(["method", "variant", "view"], sort=False)["value"]
            .mean()
            .unstack("view", sort=False)
        )

    def per_frame(self, metric: str, view: str) -> "pd.DataFrame":
        """Return one metric along time in one view: rows are frames, one column per (method,
        variant).
        """
        rows = self.table[
            (self.table["metric"] == metric)
            & (self.table["view"] == view)
            & (self.table["frame"] >= 0)
        ]
        means = rows.groupby(["frame", "method", "variant"], sort=False)["value"].mean().dropna()
        return means.unstack(["method", "variant"], sort=False)


def label_of(method: str, variant: str) -> str:
    """Return one name for a method and its variant, as run folders write it."""
    return f"{method}+{variant}" if variant else method


# behind the title of a method with weights that ship, in place of its authors'; of which network
RETRAINED = " (retrained, {})"


def reduced_mark(title: str) -> str:
    """Return what a title says of a reduced model, e.g. `` (retrained, compact)``.

    Empty of other methods.
    """
    match = re.search(r" \(retrained, [^)]*\)", title)
    return match[0] if match else ""


def split_label(label: str) -> tuple[str, str]:
    """(method, variant) of a label; the variant of a plain method is the empty string."""
    method, _, variant = label.partition("+")
    return method, variant


def without_option(label: str, option: str) -> str:
    """Return the label of a method that is the same but for an option.

    Examples:
        >>> without_option("4dgs+motion=linear+seed=1", "seed")
        '4dgs+motion=linear'
    """
    return "+".join(part for part in label.split("+") if not part.startswith(f"{option}="))


def without_labels(results: Results, labels: Collection[str]) -> Results:
    """Return the results without some methods."""
    return (
        replace(results, table=results.table[[label not in labels for label in results.row_labels]])
        if labels
        else results
    )


def make_table(rows: Iterable[Sequence[Any]]) -> "pd.DataFrame":
    """Build the tidy table from rows in the order of `COLUMNS`."""
    import pandas as pd

    table = pd.DataFrame(list(rows), columns=list(COLUMNS))
    return table.astype({"frame": "int64", "value": "float64"})


def installed_versions() -> dict[str, str]:
    """Versions of everything that can move a number."""
    versions: dict[str, str] = {}
    for name in MOVING_NUMBERS:
        with suppress(metadata.PackageNotFoundError):  # of an extra that is not installed
            versions[name] = metadata.version(name)
    return versions


def describe_machine() -> dict[str, str]:
    """The processor, and the instruction sets by which libraries choose their code.

    Results may depend on them in places.

    torch chooses by the same features as NumPy and is not asked: its import takes a second and 190
    MB that most runs do without.
    """
    import cv2

    from ggvs_eval import kernels

    cpuinfo = Path("/proc/cpuinfo")
    described = cpuinfo.read_text().splitlines() if cpuinfo.is_file() else []
    names = [line.split(":", 1)[1].strip() for line in described if line.startswith("model name")]
    numpy_sets = np.show_config(mode="dicts")["SIMD Extensions"]
    return {
        "processor": names[0] if names else platform.processor() or platform.machine(),
        "kernels of ggvs-eval": kernels.get_simd_level(),
        "NumPy": ", ".join(numpy_sets.get("found", [])) or "baseline",
        "OpenCV": cv2.getCPUFeaturesLine(),
        **{name: os.environ[name] for name in INSTRUCTION_SETS if name in os.environ},
    }
