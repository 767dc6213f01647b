"""Results of several runs as one table: no value twice, no scene taken for another, incomparable
values marked.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import pandas as pd

from ggvs_eval.errors import ResultsError
from ggvs_eval.files.digest import digest_values
from ggvs_eval.results import COLUMNS, Absence, Results, label_of

OF_ONE_SCENE = ("renders", "devices")  # records whose names do not say of which scene they are
BETWEEN = " and "  # versions of a package under which values were made
DIGITS = 6  # of the digest that distinguishes scenes of one name


def merge_results(parts: Sequence[Results]) -> Results:
    """Put results of several methods, scenes or machines into one.

    A method that was not measured on every scene is marked as partial there: its means are of other
    scenes.

    Raises:
        ResultsError: they were measured under different protocols (the message names both hashes),
            or a value is in two of them (it names both places).
    """
    hashes = {part.protocol_sha256 for part in parts}
    if len(hashes) != 1:
        raise ResultsError(
            f"results of different protocols do not belong in one table: "
            f"{', '.join(sorted(digest[:12] for digest in hashes))}; "
            "score them again under one protocol"
        )
    parts = tell_scenes_apart(parts)
    _require_measured_once(parts)
    table = pd.concat([part.table for part in parts], ignore_index=True)
    several = table["scene"].nunique() > 1
    provenance = dict(parts[0].provenance)
    for name in ("inputs", "imported", *OF_ONE_SCENE):
        heads = [
            f"{', '.join(part.scenes)}/" if several and name in OF_ONE_SCENE else ""
            for part in parts
        ]
        records = [part.provenance.get(name, {}) for part in parts]
        if joined := {
            head + key: value
            for head, record in zip(heads, records, strict=True)
            for key, value in record.items()
        }:
            provenance[name] = joined
    for name in ("versions", "machine"):
        provenance[name] = join_versions(part.provenance.get(name, {}) for part in parts)
    marks = [*(part.partial for part in parts), _missing_scenes(table)]
    labels = dict.fromkeys(label for mark in marks for label in mark)
    provenance["partial"] = {
        label: "; ".join(dict.fromkeys(mark[label] for mark in marks if label in mark))
        for label in labels
    }
    provenance["faults"] = [list(fault) for part in parts for fault in part.faults]
    metrics = set(table["metric"])
    lacking = [absence for part in parts for absence in _absent_everywhere(part, metrics)]
    provenance["absent"] = [
        list(absence)
        for absence in (*(absence for part in parts for absence in part.absences), *lacking)
    ]
    reasons = {
        name: why
        for part in reversed(parts)
        for name, why in part.not_computed.items()
        if name not in metrics
    }
    return Results(table, provenance, reasons)


def tell_scenes_apart(parts: Sequence[Results]) -> list[Results]:
    """Return the same results with one name for each scene that was captured, regardless of its
    folders' names.

    Scenes of one name whose captured frames differ have a digest of these behind it; of equal
    frames the first name counts.
    """
    name_of: dict[str, str] = {}
    for part in parts:
        for scene in part.scenes:
            name_of.setdefault(_digest_of(part, scene), scene)
    counts = Counter(name_of.values())
    distinct = {
        digest: f"{name} {digest[:DIGITS]}" if counts[name] > 1 else name
        for digest, name in name_of.items()
    }
    return [
        with_scenes(part, {scene: distinct[_digest_of(part, scene)] for scene in part.scenes})
        for part in parts
    ]


def _digest_of(results: Results, scene: str) -> str:
    """Return the digest of the frames of a scene's cameras, or of its name where no frames are
    recorded.
    """
    inputs = results.inputs
    digests = {
        name.removeprefix(f"{scene}/"): digest
        for name, digest in inputs.items()
        if name.startswith(f"{scene}/")
    }
    return (
        digest_values(*(f"{name} {digests[name]}" for name in sorted(digests)))
        if digests
        else digest_values(scene)
    )


def with_scenes(results: Results, names: Mapping[str, str]) -> Results:
    """Return the results with other names of scenes."""
    names = {scene: name for scene, name in names.items() if scene != name}
    if not names:
        return results
    inputs = results.inputs
    for scene, name in names.items():
        new_keys = {
            key: f"{name}/{key.removeprefix(f'{scene}/')}"
            for key in inputs
            if key.startswith(f"{scene}/")
        }
        inputs = {new_keys.get(key, key): digest for key, digest in inputs.items()}
    absent = [
        list(absence._replace(scene=names.get(absence.scene, absence.scene)))
        for absence in results.absences
    ]
    faults = [
        list(fault._replace(scene=names.get(fault.scene, fault.scene))) for fault in results.faults
    ]
    table = results.table.assign(scene=results.table["scene"].replace(dict(names)))
    return replace(
        results,
        table=table,
        provenance=results.provenance | {"inputs": inputs, "absent": absent, "faults": faults},
    )


def _require_measured_once(parts: Sequence[Results]) -> None:
    """Refuse a value that is there twice: which of the two would be shown is chance."""
    keys = list(COLUMNS[:-1])
    placed = pd.concat(
        [part.table[keys].assign(place=at) for at, part in enumerate(parts)], ignore_index=True
    )
    twice = placed[placed.duplicated(keys, keep=False)]
    if twice.empty:
        return
    first = twice.iloc[0]
    repeats = twice[twice[keys].fillna("").eq(first[keys].fillna("")).all(axis=1)]
    label = label_of(first["method"], first["variant"])
    places = [parts[at].place or f"part {at + 1}" for at in dict.fromkeys(repeats["place"])]
    if len(places) > 1:
        raise ResultsError(
            f"{label} on {first['scene']} is measured in {' and '.join(places)}; leave out one of "
            f"them"
        )
    raise ResultsError(
        f"{places[0]}: {first['metric']} of {label} on {first['scene']} has two values for one "
        "view and frame; run `ggvs-eval score` again"
    )


def _missing_scenes(table: pd.DataFrame) -> dict[str, str]:
    """Return label -> scenes that it lacks and others have, in words.

    Means over other scenes do not compare.
    """
    scenes = list(dict.fromkeys(table["scene"].astype(str)))
    marks = {}
    for (method, variant), rows in table.groupby(["method", "variant"], sort=False):
        if absent := [scene for scene in scenes if scene not in set(rows["scene"])]:
            marks[label_of(str(method), str(variant))] = f"not measured on {', '.join(absent)}"
    return marks


def _absent_everywhere(part: Results, metrics: set[str]) -> list[Absence]:
    """Return the values that no method of a part has and methods of others do, for each of its
    methods.
    """
    labels, scene = dict.fromkeys(part.row_labels), ", ".join(part.scenes)
    return [
        Absence(metric=name, label=label, scene=scene, view="", reason=why)
        for name, why in part.not_computed.items()
        if name in metrics
        for label in labels
    ]


def join_versions(records: Iterable[Mapping[str, str]]) -> dict[str, str]:
    """Return name -> the different entries of several records.

    Examples:
        >>> join_versions([{"torch": "2.3.0"}, {"torch": "2.4.1"}, {"torch": "2.3.0"}])
        {'torch': '2.3.0 and 2.4.1'}
    """
    joined: dict[str, set[str]] = {}
    for record in records:
        for name, versions in record.items():
            joined.setdefault(name, set()).update(versions.split(BETWEEN))
    return {name: BETWEEN.join(sorted(versions)) for name, versions in joined.items()}
