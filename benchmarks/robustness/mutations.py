"""Mutations of good files: of bytes, of lines, and of the keys and values of a TOML file.

A mutation is drawn from a NumPy generator, so that every case can be made again from its seed.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

Rng = np.random.Generator

# Values as a TOML file would hold them: of a wrong type, out of range, of a wrong unit, huge, nested, or not TOML at all.
HOSTILE = (
    "nan", "-nan", "inf", "-inf", "0", "-0.0", "-1", "1e-320", "1e308", "1e400", "-1e-9", "5e-324", "9" * 400,
    "0x7fffffffffffffff", "0.1e1000", "true", "false", '""', '" "', '"abc"', '"nan"', '"inf"', '"-1 kg"',
    '"1e400 m"', '"0,5 kg"', '"1 parsec"', '"12 furlong/fortnight"', '"1 kg**9**9**9**9"',
    '"' + "(" * 300 + "1" + ")" * 300 + '"', '"1 m +- 900 %"', '"5 %"', '"1 +- nan m"', '"' + "x" * 5000 + '"',
    '"' + "µ" * 300 + '"', '"\\u0000"', '"\\u202e1 m"', '"../../../etc/passwd"', '"/dev/zero"', '"C:\\\\x"', "[]",
    "[[]]", "[1, 2]", "[nan, inf]", '["a"]', "[" * 900 + "]" * 900, "{}", "{ a = 1 }", "{ kind = { kind = {} } }",
    "1979-05-27", "07:32:00", "1979-05-27T07:32:00Z", "''", '"""\n\n"""', "@", "= 3", "1 2", '"open', "[1, 2",
    "# nothing",
)  # fmt: skip

KEYS = (
    "kind", "name", "a.b.c", '""', '"x y"', "nan", "stiffness", "mass", "end", "samples", "free", "scene", "law", "é",
    "9" * 50,
)  # fmt: skip


def of_bytes(rng: Rng, data: bytes) -> bytes:
    """A few bytes flipped, taken out, repeated, put in, or everything from some place on cut off."""
    made = bytearray(data)
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.integers(0, max(len(made), 1)))
        length = int(min(len(made), 2 ** rng.integers(0, 8)))
        match int(rng.integers(0, 6)):
            case 0 if made:
                made[at] ^= 1 << int(rng.integers(0, 8))
            case 1:
                del made[at : at + length]
            case 2:
                made[at:at] = made[at : at + length]
            case 3:
                made[at:at] = rng.bytes(length)
            case 4:
                made[at : at + length] = bytes(length)
            case _ if rng.random() < 0.3:
                del made[at:]
    return bytes(made)


def _pick(rng: Rng, options: tuple[str, ...]) -> str:
    return options[int(rng.integers(0, len(options)))]


def _hostile_value(rng: Rng, line: str) -> str:
    key, sign, _ = line.partition("=")
    return f"{key}= {_pick(rng, HOSTILE)}" if sign else line


def _scaled_number(rng: Rng, line: str) -> str:
    """One number of the line times a power of ten, or negative: what a slip of the hand makes."""
    numbers = list(re.finditer(r"(?<![\w.])\d+(\.\d+)?(e[+-]?\d+)?", line))
    if not numbers:
        return line
    match = numbers[int(rng.integers(0, len(numbers)))]
    value = float(match[0]) * 10.0 ** float(rng.integers(-12, 13)) * (-1.0 if rng.random() < 0.2 else 1.0)
    return f"{line[: match.start()]}{value!r}{line[match.end() :]}"


def _other_key(rng: Rng, line: str) -> str:
    key, sign, value = line.partition("=")
    if not sign:
        return line
    at = int(rng.integers(0, max(len(key.rstrip()), 1)))
    misspelt = key[:at] + key[at + 1 :]
    return f"{misspelt if rng.random() < 0.5 and misspelt.strip() else _pick(rng, KEYS)} = {value}"


def _other_header(rng: Rng, line: str) -> str:
    if not line.lstrip().startswith("["):
        return line
    name = line.strip().strip("[]")
    return _pick(
        rng, (f"[{name}x]", f"[[{name}]]", f"[{name}.more]", f"[{name[:-1]}]", "[]", f"[{name}", f"[{name}.{name}]")
    )


_OF_A_LINE: tuple[Callable[[Rng, str], str], ...] = (
    _hostile_value, _hostile_value, _scaled_number, _scaled_number, _other_key, _other_header,
)  # fmt: skip


CELLS = (
    "", " ", "nan", "NaN", "inf", "-inf", "1e400", "1,5", "1.5.2", "--3", "0x12", "3 N", "#REF!", "=1+1", '"', '"a', "é",
    "\x00", "9" * 400, "x" * 5000, "1_000", "1e5e5", "+", "12:30", "true",
)  # fmt: skip


def of_lines(rng: Rng, text: str) -> bytes:
    """One to three changes of a table in text: a row twice, gone, elsewhere or cut; a cell of another kind; its ends."""
    rows = text.splitlines()
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(0, len(rows)))
        cells = re.split(r"([,;\t])", rows[at])
        match int(rng.integers(0, 7)):
            case 0:
                rows.insert(at, rows[int(rng.integers(0, len(rows)))])
            case 1 if len(rows) > 1:
                del rows[at]
            case 2:
                rows[at] = rows[at][: int(rng.integers(0, len(rows[at]) + 1))]
            case 3:
                rows[at] += _pick(rng, (",", ";", "\t", ",,,", " # note"))
            case 4:
                rows.insert(at, _pick(rng, ("# a comment", "", "sep=;", "[data]", "x" * 3000, ",,,")))
            case _:
                cells[2 * int(rng.integers(0, (len(cells) + 1) // 2))] = _pick(rng, CELLS)
                rows[at] = "".join(cells)
    ends = _pick(rng, ("\n", "\n", "\r\n", "\r"))
    return (ends.join(rows) + ends).encode("utf-8", "surrogatepass")


def of_toml(rng: Rng, good: bytes) -> bytes:
    """One to three changes of lines that hold something; in one of eight cases of bytes instead."""
    if rng.random() < 0.125:
        return of_bytes(rng, good)
    lines = good.decode().splitlines()
    for _ in range(int(rng.integers(1, 4))):
        live = [k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")]
        if not live:
            break
        at = live[int(rng.integers(0, len(live)))]
        match int(rng.integers(0, 9)):
            case 0:
                lines.insert(at, lines[live[int(rng.integers(0, len(live)))]])
            case 1:
                del lines[at]
            case 2:
                lines.insert(at + 1, f"{_pick(rng, KEYS)} = {_pick(rng, HOSTILE)}")
            case _:
                lines[at] = _OF_A_LINE[int(rng.integers(0, len(_OF_A_LINE)))](rng, lines[at])
    made = ("\n".join(lines) + "\n").encode("utf-8", "surrogatepass")
    return b"\xef\xbb\xbf" + made if rng.random() < 0.02 else made


# What may stand in the place of any value of a file, each of another kind.
OF_ANOTHER_KIND: tuple[Any, ...] = (
    "z", "", "nan", "1e400 m", 0, -1, 10**18, 1.5, float("nan"), float("inf"), -1e300, True, [], ["a"], [1, 2], [[1.0], [2.0]],
    [{}], {}, {"a": 1}, {"kind": "z"}, {"name": []},
)  # fmt: skip


def of_nodes(content: Any) -> Iterator[tuple[str, Any]]:
    """Every value of a file's content, tables and lists too, replaced by each of ``OF_ANOTHER_KIND``, taken out, or named anew.

    The content is that of ``tomllib``; what comes out is (the path and the value in words, the changed content), to be written
    by ``tomli_w``.
    """
    for path in _paths(content):
        where = ".".join(map(str, path))
        for value in OF_ANOTHER_KIND:
            yield f"{where} = {value!r}", _changed(content, path, value)
        yield f"{where} taken out", _changed(content, path, _OUT)
        if isinstance(path[-1], str):
            yield f"{where} misspelt", _changed(content, (*path[:-1], f"{path[-1]}x"), _at(content, path))


_OUT = object()


def _paths(content: Any, above: tuple = ()) -> Iterator[tuple]:
    inside = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in inside:
        yield (*above, key)
        yield from _paths(value, (*above, key))


def _at(content: Any, path: tuple) -> Any:
    for key in path:
        content = content[key]
    return content


def _changed(content: Any, path: tuple, value: Any) -> Any:
    """A copy with another value at a path."""
    made = dict(content) if isinstance(content, dict) else list(content)
    key, *rest = path
    if rest:
        made[key] = _changed(content[key], tuple(rest), value)
    elif value is _OUT:
        del made[key]
    else:
        made[key] = value
    return made
