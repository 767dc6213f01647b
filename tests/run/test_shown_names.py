"""What is written of methods beside their numbers: titles, and what differs between them by
design.
"""

import pytest

from ggvs_eval.pipelines.methods.registry import METHODS, find_method
from ggvs_eval.pipelines.methods.spec import digest_weights
from ggvs_eval.pipelines.run.score import write_shown_names
from ggvs_eval.reports.tables_of_runs import scores_text
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json, write_json
from helpers.run_folders import RunShape, make_protocol, write_run

LABELS = ("enerf", "4dgs", "no-blending", "mine")


@pytest.fixture
def run(tmp_path):
    """A run of a learned, a fitted and a plain method, and of somebody's frames."""
    shape = RunShape(
        labels=LABELS, names=tuple(zip(LABELS, LABELS, strict=True)), metrics=("PSNR",), poses=0
    )
    return RunFolder(write_run(tmp_path / "run", shape)), make_protocol(shape)


def write_identity(run, protocol, digests):
    """Say of every render of ENeRF by which weights it was made."""
    for view in protocol.views.test:
        file = run.renders("enerf", view) / JOB_FILE
        write_json(file, read_json(file) | {"identity": {"weights": digests}})


def test_each_kind_of_method_declares_what_no_protocol_removes(run):
    """Depth, what was learned from, what is not as published; of somebody's frames there is no
    entry.
    """
    folder, protocol = run
    write_identity(
        folder, protocol, [digest_weights(file) for file in find_method("enerf").weights]
    )
    write_shown_names(folder, protocol, LABELS)
    record = read_json(folder.root / "methods.json")

    declared = record["declared"]
    assert declared["no-blending"] == {
        "depth": "given",
        "learned from": "nothing",
        "not as published": "-",
    }
    assert declared["enerf"]["depth"] == "none"
    assert "million pixels" in declared["enerf"]["learned from"]
    assert "compact" in declared["enerf"]["not as published"]
    assert "without the fold" in declared["4dgs"]["learned from"]
    assert "estimated depth" in declared["4dgs"]["not as published"]
    assert "mine" not in declared
    assert record["names"]["enerf"] == "ENeRF (retrained, compact)"


def test_a_family_has_a_title_without_the_option_that_its_members_differ_in(run):
    """A figure over sizes and a table over steps name their lines by it, whether or not the method
    itself is there.
    """
    folder, protocol = run
    write_shown_names(folder, protocol, ("ours+scale=0.5", "4dgs+motion=linear+steps=300"))
    names = read_json(folder.root / "methods.json")["names"]

    assert names["ours"] == "GGVS (online)"
    assert names["4dgs+motion=linear"] == find_method("4dgs+motion=linear").title
    assert "steps" not in names["4dgs+motion=linear"]


def test_weights_that_were_given_are_not_called_retrained(run):
    """The renders say which file made them: with another than the one that ships, title and origin
    are another.
    """
    folder, protocol = run
    write_identity(folder, protocol, ["0" * 64])
    write_shown_names(folder, protocol, LABELS)
    record = read_json(folder.root / "methods.json")

    assert record["names"]["enerf"] == "ENeRF"
    assert record["declared"]["enerf"]["learned from"] == "weights that were given"


def test_what_the_paper_does_not_have_is_declared_of_ours():
    """The additions by name; with an option set, the option too."""
    assert all("exposure compensation" in spec.departs for spec in METHODS.values() if spec.ours)
    assert "recurrent" not in find_method("ours+no-temporal").departs
    assert find_method("ours+compensated=false").departs.endswith("except for compensated")


@pytest.mark.parametrize("label", sorted(METHODS))
def test_every_method_declares_the_same_columns(label):
    """A table of them has no blank; each has a title, a line of description, and a label fit for a
    folder's name.
    """
    method = find_method(label)
    assert list(method.declared) == ["depth", "learned from", "not as published"]
    assert all([*method.declared.values(), method.title, method.describe])
    assert label == label.lower().replace(" ", "-")


def test_a_reduced_model_says_so_in_printed_tables(run):
    """`score` prints the label with the mark; with weights that were given there is none."""
    folder, protocol = run
    for digests, shown in (
        ([digest_weights(file) for file in find_method("enerf").weights], True),
        (["0" * 64], False),
    ):
        write_identity(folder, protocol, digests)
        write_shown_names(folder, protocol, LABELS)
        lines = scores_text(folder.root).splitlines()
        assert lines[1].split() == ["PSNR"]
        assert any(line.startswith("enerf (retrained, compact) ") for line in lines) == shown
        assert any(line.startswith("4dgs ") for line in lines)
