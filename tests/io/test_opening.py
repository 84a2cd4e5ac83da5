"""Files that a user names: what is no regular file, too large or not readable is refused at once."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from bcfj_jax import InputError
from bcfj_jax.io import opening, tables

pytestmark = pytest.mark.filterwarnings("error")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda p: p.mkdir(), "is a folder"),
        (lambda p: os.mkfifo(p), "a pipe or a device"),
        (lambda p: p.symlink_to("/dev/zero"), "a pipe or a device"),
        (lambda p: p.write_bytes(b"#" * (2 * opening.MEGABYTE + 1)), "holds 2 MB, more than the 2 MB"),
        (lambda p: None, "there is no such file"),
        (lambda p: p.write_bytes(b"a = 1\nb = '\xff'"), "line 2: byte 0xff is not UTF-8"),
        (lambda p: p.write_text("a = " + "[" * 5000), "too deep"),
        (lambda p: p.write_text("a = " + "9" * 5000), "not TOML"),
        (lambda p: p.write_text(".".join("a" * 5000) + " = 1"), "a key of more than 30 parts"),
    ],
    ids=["folder", "pipe", "device", "large", "missing", "encoding", "deep", "digits", "dotted"],
)
def test_a_file_of_settings_is_a_regular_file_of_limited_size(make, words, tmp_path):
    make(tmp_path / "f.toml")
    with pytest.raises(InputError, match=words):
        tables.read(tmp_path / "f.toml")


@pytest.mark.parametrize("name", ["a\0b.toml", "a" * 5000 + ".toml"])
def test_a_path_that_cannot_be_one_is_refused(name):
    with pytest.raises(InputError, match="cannot be read") as caught:
        tables.read(Path(name))
    assert len(str(caught.value)) < 1000


def test_settings_may_begin_with_a_byte_order_mark(tmp_path):
    (tmp_path / "f.toml").write_text("a = 1\n", encoding="utf-8-sig")
    assert tables.read(tmp_path / "f.toml") == {"a": 1}
