"""Files that are read are files, and files that are written stay where they belong."""

import os

import pytest

from eladapt.errors import EladaptError, MeshWarning, printable
from eladapt.files import file_name, open_regular, read_bytes


def test_a_regular_file_is_read_up_to_its_bound(tmp_path):
    (tmp_path / "a").write_bytes(b"1234")
    (tmp_path / "link").symlink_to("a")
    assert read_bytes(tmp_path / "a", 4) == read_bytes(tmp_path / "link", 4) == b"1234"
    with pytest.raises(OSError, match="has more than 3 bytes"):
        read_bytes(tmp_path / "a", 3)


def test_nothing_else_is_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "device").symlink_to("/dev/zero")
    for path in (tmp_path / "pipe", tmp_path / "device", tmp_path):
        with pytest.raises(OSError, match="is no regular file"):
            open_regular(path)
    with pytest.raises(FileNotFoundError):
        open_regular(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("text", "stem"),
    [
        ("panda", "panda"), ("arm.v2", "arm.v2"), ("Arm\u00e9-7", "Arm\u00e9-7"), ("a" * 300, "a" * 100),
        (".", "unnamed"), ("..", "unnamed"), ("/", "unnamed"), ("", "unnamed"), ("\0", "unnamed"),
        ("../../up", "up"), ("/etc/arm", "arm"), ("..\\..\\up", "_.._up"), (".hidden", "hidden"),
        ("an arm\u202e\n", "an_arm__"),
    ],
)  # fmt: skip
def test_a_name_from_outside_is_one_in_its_folder(tmp_path, text, stem):
    assert file_name(text) == stem
    (tmp_path / f"{stem}.npz").touch()
    assert os.listdir(tmp_path) == [f"{stem}.npz"]


def test_what_cannot_be_printed_is_spelt_out():
    """Commands of 7 and 8 bits, line breaks, marks of direction, what no encoding has; letters stay."""
    assert printable("a\x1b[2J\x9b\r\n\t\u202e\u2066\ud800") == r"a\x1b[2J\x9b\r\n\t\u202e\u2066\ud800"
    assert printable("Gelenk \u00fc, \u5173\u8282 \u0663") == "Gelenk \u00fc, \u5173\u8282 \u0663"


@pytest.mark.parametrize("kind", [EladaptError, MeshWarning])
def test_a_message_is_printable_line_by_line(kind):
    assert str(kind("one\ntwo\x1b")) == "one\ntwo\\x1b"
