"""Bytes of a text file become text: UTF-8, UTF-16 by its mark or its zeros, else Windows' Latin-1."""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from bcfj_jax.core.errors import InputError, clip

_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig", "UTF-8"),
    (codecs.BOM_UTF32_LE, "utf-32", "UTF-32"),
    (codecs.BOM_UTF16_LE, "utf-16", "UTF-16"),
    (codecs.BOM_UTF16_BE, "utf-16", "UTF-16"),
)
_PAGE = "a web page: open it in a spreadsheet and save the table as .xlsx or CSV"
BINARY = (
    (b"PK\x03\x04", "a zip archive: where Excel wrote it name it .xlsx, else unpack it, then give its file"),
    (b"\x1f\x8b", "a gzip archive: unpack it, then give the file in it"),
    (b"\xd0\xcf\x11\xe0", "an old Excel file: name it .xls"),
    (b"\x89HDF", "an HDF5 file: name it .h5"),
    (b"PAR1", "a Parquet file: name it .parquet"),
    (b"TDSm", "a TDMS file: name it .tdms"),
    (b"MATLAB 5", "a MATLAB file: name it .mat"),
    (b"{", "JSON: name it .json"),
    (b"<html", _PAGE),
    (b"<table", _PAGE),
    (b"<!DOCTYPE", _PAGE),
    (b"<?xml", "XML: export it as CSV, or give a reader of your own by --code FILE"),
)
_PAGES = (("cp932", "Shift-JIS"), ("gb18030", "GB 18030"), ("cp949", "Korean"), ("cp1251", "Windows-1251"))
_WORDS = re.compile("時間|荷重|変位|加速度|サンプ|測定|时间|位移|采样|频率|시간|하중|변위|가속도")
_CYRILLIC = re.compile("[А-я]{3}")  # noqa: RUF001
# Letters of two bytes in UTF-8, read as if each byte were a letter: "µ" as "Âµ", "ü" as "Ã¼".
_TWICE = re.compile("[ÂÃ][\u0080-\u00bf]")


def decoded(raw: bytes, path: Path, where: str, encoding: str | None = None) -> tuple[str, str]:
    """The text of a file, and what its encoding is called; refuses what is no text, or mixes two encodings."""
    if encoding is not None:
        return _stated(raw, path, where, encoding)
    for mark, codec, name in _MARKS:
        if raw.startswith(mark):
            return _stated(raw, path, where, codec)[0], name
    begin = raw[:64].lstrip()
    lines = raw.count(b"\n{") > 8  # A log of objects, one a line, is a text.
    for mark, remedy in BINARY:
        if begin.startswith((mark, mark.upper())) and not (mark == b"{" and lines):
            raise InputError(str(path), "is no text file", f"it begins as {remedy}")
    raw = raw.rstrip(b"\0\x1a") if raw[-2:] in (b"\0\0", b"\n\x1a") else raw  # A logger's space that was not written.
    head = raw[:4096]
    if b"\0" in head:
        # Western text in UTF-16 has a zero in every second byte.
        for codec, zeros in (("utf-16-le", head[1::2]), ("utf-16-be", head[0::2])):
            if zeros.count(0) > 0.8 * len(zeros):
                return _stated(raw, path, where, codec)[0], "UTF-16"
        raise InputError(str(path), "is no text file", "give its kind by the extension, such as .mat, .tdms or .xlsx")
    try:
        return raw.decode("utf-8"), "UTF-8"
    except UnicodeDecodeError as error:
        first = error
    # A page of codes is known by the words of measuring that it makes; Cyrillic, the last, by any word.
    for codec, name in _PAGES:
        text = raw.decode(codec, errors="replace")
        if _WORDS.search(text) and text.count("\ufffd") < 3:
            return text, name
    if _CYRILLIC.search(text) and not _TWICE.search(raw.decode("latin-1")):
        return text, "Windows-1251"
    text = raw.decode("cp1252", errors="replace")
    if "\ufffd" in text:
        text = raw.decode("latin-1")
    if _TWICE.search(text):
        line = raw[: first.start].count(b"\n") + 1
        found = f"byte 0x{raw[first.start]:02x} is not UTF-8, though other letters are: two encodings in one file"
        raise InputError(f"{path}: line {line}", found, 'save it in one, or give encoding = "utf-8" or "cp1252"')
    return text, "Latin-1"


def _stated(raw: bytes, path: Path, where: str, encoding: str) -> tuple[str, str]:
    try:
        known = codecs.lookup(encoding)
        if not getattr(known, "_is_text_encoding", True):
            raise LookupError
    except (LookupError, ValueError):
        remedy = 'give one such as "utf-8", "cp1252", "utf-16" or "shift_jis"'
        raise InputError(f"{where} encoding", f"no encoding '{clip(encoding)}'", remedy) from None
    try:
        return raw.decode(encoding), encoding
    except (UnicodeError, ValueError) as error:
        at = getattr(error, "start", 0)
        line = raw[:at].count(b"\n") + 1
        found = f"byte 0x{raw[at]:02x} is not {known.name}" if raw else "an empty file"
        raise InputError(f"{path}: line {line}", found, "give another encoding, or save the file again") from None
