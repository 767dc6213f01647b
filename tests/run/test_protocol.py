"""Protocols: what is packaged loads, what is mistyped is refused with the mend."""

import dataclasses

import pytest

from ggvs_eval.errors import ProtocolError
from ggvs_eval.protocol import load_protocol, packaged_protocols
from helpers.refusals import refused

DEMO_SHA256 = "f25aff147bd9170d9c2c6249a923c3ffb6af271568f72c610bd99b08fcbc3240"  # at 3326e7f
HASHES = {  # as they begin; results bear them
    "d3dmv": "5c396f5d47c1",
    "demo": "0885aaea3365",
    "demo-d3dmv": "3e267f59abe9",
    "demo-enerf-outdoor": "292ee462b1b1",
    "demo-k": "f4a5f7456ed4",
    "dynerf": "a1071aa52738",
    "enerf-outdoor": "262490b85392",
    "immersive_stg": "65ccd53fd7fa",
    "llff_3view_fern": "861a536fe1cb",
    "llff_3view_flower": "3246e5a911c9",
    "llff_3view_fortress": "7394fa3bbef8",
    "llff_3view_horns": "e75e1505e32e",
    "llff_3view_leaves": "be0c0afa8c3f",
    "llff_3view_orchids": "8822bb0181c3",
    "llff_3view_room": "84700648829b",
    "llff_3view_trex": "557806baf63c",
    "llff_sparse2_fern": "418ba046bac2",
    "llff_sparse2_flower": "af85361ebc7a",
    "llff_sparse2_fortress": "ad31e977d288",
    "llff_sparse2_horns": "c423bacb5937",
    "llff_sparse2_leaves": "b186d40455ba",
    "llff_sparse2_orchids": "e2a66a4a8baf",
    "llff_sparse2_room": "f5de012ce5fa",
    "llff_sparse2_trex": "07d9b25c03ab",
    "llff_sparse3_fern": "524233981733",
    "llff_sparse3_flower": "49cca2d07ce9",
    "llff_sparse3_fortress": "61b2978864b3",
    "llff_sparse3_horns": "27381acac88e",
    "llff_sparse3_leaves": "e92976b3958c",
    "llff_sparse3_orchids": "6e42c25634bb",
    "llff_sparse3_room": "8ef040182530",
    "llff_sparse3_trex": "1866433b511f",
    "llff_sparse4_fern": "c170ef9b1980",
    "llff_sparse4_flower": "af299f2be399",
    "llff_sparse4_fortress": "9ac309b31993",
    "llff_sparse4_horns": "af3435e3fb93",
    "llff_sparse4_leaves": "28f8fdc55219",
    "llff_sparse4_orchids": "ff0592669c38",
    "llff_sparse4_room": "5d95962fbd3c",
    "llff_sparse4_trex": "6e81ea964bc3",
    "meetroom_3dgstream": "88fd6ae441b4",
    "n3v_3dgstream": "b114f4e6b8d9",
    "n3v_4dgs": "dc14c9a17c98",
    "n3v_queen": "c5e37936b990",
    "n3v_sparse2": "aba57a75e10c",
    "n3v_sparse2_instant": "8ef65873e25f",
    "n3v_sparse3": "4e6952e4e57f",
    "n3v_sparse3_instant": "de11e8061d08",
    "n3v_sparse4": "45554fb66f30",
    "n3v_sparse4_instant": "3812a51b156f",
    "n3v_stg": "dc7042b94f2e",
    "offline": "b31d2107d3bd",
    "panoptic_sports": "9c943d5419df",
    "readings": "9b78aff8d8a5",
    "real_frame": "8623c788d767",
    "real_frame_coverage": "87471cd0c255",
    "real_frame_held": "5096f52f1a98",
    "real_frame_small": "ca34271acb4f",
    "rooms": "33380ff22977",
    "rooms_short": "b566d5c10cd7",
    "technicolor_stg": "0e7bd2564ab1",
}


@pytest.mark.parametrize("name", packaged_protocols())
def test_packaged_protocols_survive_a_round_trip(name, tmp_path):
    """A protocol written as TOML reads back equal, with an equal hash."""
    protocol = load_protocol(name)
    (tmp_path / "copy.toml").write_text(protocol.to_toml())

    copy = load_protocol(tmp_path / "copy.toml")

    assert copy == protocol
    assert copy.sha256 == protocol.sha256
    assert protocol.sha256.startswith(HASHES[name])


def test_the_hash_depends_on_every_value():
    """Changing any one value changes the hash; without what came later it is the one of older
    results.
    """
    protocol = load_protocol("demo")
    changed = [
        dataclasses.replace(protocol, name="other"),
        dataclasses.replace(protocol, frames=dataclasses.replace(protocol.frames, count=3)),
        dataclasses.replace(
            protocol, measurement=dataclasses.replace(protocol.measurement, ddof=0)
        ),
        dataclasses.replace(
            protocol, synthesis=dataclasses.replace(protocol.synthesis, resize_filter="area")
        ),
        dataclasses.replace(
            protocol, synthesis=dataclasses.replace(protocol.synthesis, sources="coverage")
        ),
    ]

    assert len({item.sha256 for item in [protocol, *changed]}) == 6
    protocol = load_protocol("demo")
    older = dataclasses.replace(
        protocol, measurement=dataclasses.replace(protocol.measurement, lpips_every=1)
    )
    assert older.sha256 == DEMO_SHA256
    assert protocol.sha256 != DEMO_SHA256


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("k = 4", "kk = 4", r"unknown key synthesis.kk; did you mean synthesis.k\?"),
        ("k = 4", "k = '4'", "synthesis.k must be a whole number, got '4'"),
        ("k = 4", "k = true", "synthesis.k must be a whole number, got True"),
        ("k = 4", "k = 0", "synthesis.k must be at least 1"),
        (
            "k = 4",
            "k = 4\nsources = 'covrage'",
            "synthesis.sources must be one of 'nearest', 'coverage', 'triplet', got 'covrage'",
        ),
        ("count = 24", "count = -1", "frames.count must be at least 0"),
        (
            "[views]\ntest",
            "kind = 3\n[views]\nviews",
            r"unknown key kind; did you mean .*; also unknown key views.views; .*; also missing "
            r"key views.test; add it",
        ),
        ('"lanczos"', '"lanzcos"', "synthesis.resize_filter must be one of 'area', 'lanczos'"),
        ("[frames]", "[frame]", r"unknown key frame; did you mean frames\?"),
        ('"cam03"', '"cam00"', "name each test view once"),
        ("[frames]", "[frames", "not valid TOML"),
    ],
)
def test_mistakes_are_refused_in_one_line(old, new, message, tmp_path):
    """An unknown, missing or mistyped key names the file, the key and what was meant."""
    from importlib import resources

    text = (resources.files("ggvs_eval") / "protocols" / "demo.toml").read_text()
    assert old in text
    file = tmp_path / "mine.toml"
    file.write_text(text.replace(old, new, 1))

    with pytest.raises(ProtocolError, match=message) as caught:
        load_protocol(file)

    assert "mine.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_test_views_alone_are_a_protocol(tmp_path):
    """All else has a default: the file's name, four sources, the usual metrics, and as many frames
    as the capture has.
    """
    (tmp_path / "mine.toml").write_text("views.test = ['cam01', 'cam04']\n")
    protocol = load_protocol(tmp_path / "mine.toml")
    assert (protocol.name, protocol.dataset, protocol.synthesis.k) == ("mine", "mine", 4)
    assert protocol.measurement.metrics == ("PSNR", "SSIM", "LPIPS", "TCC", "STED")
    assert protocol.over(7).frames.numbers == range(7)
    assert load_protocol("demo").over(7) == load_protocol("demo")


def test_an_unknown_name_lists_the_packaged_ones():
    """Asking for a protocol that does not ship says which do."""
    packaged = "demo, demo-d3dmv, demo-enerf-outdoor, demo-k, dynerf"
    with refused(ProtocolError, "'dinerf'", packaged, "did you mean dynerf?"):
        load_protocol("dinerf")
