"""MATLAB files are read by a process of its own: what ends that process is a message, and nothing that it reads is lost."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
import tiers

from bcfj_jax import InputError
from bcfj_jax.data import child, isolated
from bcfj_jax.data.readers import hdf5, mat
from bcfj_jax.data.reading import read
from benchmarks.robustness import records

h5py = pytest.importorskip("h5py", reason="the extra io is not installed")
SOURCE = Path(child.__file__).read_text(encoding="utf-8")
TIME, FORCE = np.linspace(0.0, 1.0, 5), np.ones(5)


@pytest.fixture
def whole(tmp_path):
    from scipy.io import savemat

    path = tmp_path / "record.mat"
    savemat(path, {"run": {"time": TIME, "force": FORCE}})
    return path


def flip(path, at: int, bit: int, expected: int) -> None:
    content = bytearray(path.read_bytes())
    assert content[at] == expected, "the file is laid out otherwise than this test knows"
    content[at] ^= 1 << bit
    path.write_bytes(content)


def test_a_file_that_crashes_its_reader_is_refused(whole):
    # The type of the values, 9, becomes 8, which is none: SciPy follows a null pointer.
    flip(whole, 256, 0, 9)
    with pytest.raises(
        InputError, match=r"here: .*record\.mat .*SIG.*; save it again, with -v7\.3, or write it as CSV"
    ):
        read(whole, "here")


def test_a_file_that_asks_for_all_the_memory_is_refused(whole):
    # A struct of one element becomes one of 2^28.
    flip(whole, 163, 4, 0)
    with pytest.raises(InputError, match=r"here: .*record\.mat .*sizes that its length cannot hold.*; save it again"):
        read(whole, "here")


def test_a_file_that_is_read_without_end_is_refused(whole, monkeypatch):
    endless = whole.parent / "endless.py"
    source = SOURCE.partition("if __name__")[0]
    loop = "def write(content, wanted):\n    while True:\n        pass\n"
    endless.write_text(f"{source}\n{loop}\n\nsys.exit(main())\n")
    monkeypatch.setattr(child, "__file__", str(endless))
    monkeypatch.setattr(isolated, "_SECONDS", 1)
    with pytest.raises(InputError, match=r"here: .*record\.mat .*longer than 1 s.*; save it again"):
        read(whole, "here")


def test_a_directory_of_hostile_modules_is_not_imported(whole, monkeypatch):
    (whole.parent / "scipy.py").write_text("raise SystemExit(0)\n")
    monkeypatch.chdir(whole.parent)
    table = read(whole, "here")
    np.testing.assert_array_equal(table.numbers("force", "N", "here", False), FORCE)


def test_a_file_that_changed_is_read_again(whole):
    from scipy.io import savemat

    read(whole, "here")
    savemat(whole, {"run": {"time": TIME, "force": 2.0 * FORCE}, "more": 1.0})
    np.testing.assert_array_equal(read(whole, "here", "run").numbers("force", "N", "here", False), 2.0 * FORCE)


def test_what_is_in_a_file_arrives_bit_for_bit(tmp_path):
    from scipy.io import savemat

    numbers = {
        "double": np.array([1.0, np.nan, -np.inf, 5e-324]),
        "single": np.float32([1, 2, 3, 4]),
        "whole": np.array([1, -2, 3, 2**62]),
    }
    left_out = {"matrix": np.eye(3), "complex": np.array([1j, 2]), "ragged": np.array([TIME, FORCE[:2]], dtype=object)}
    texts = {"cell": np.array(["a", "ümlaut", "c", "d"], dtype=object)}
    savemat(
        tmp_path / "a.mat",
        {"x": {"y": {**numbers, **left_out, **texts}, "who": "ö"}, "alone": 3.0},
        do_compression=True,
    )
    found = isolated.read(tmp_path / "a.mat", "here", None, mat).tables
    assert {name: set(columns) for name, columns in found.items()} == {
        "": {"alone", "who"}, "x/y": {*numbers, *texts, "alone", "who"},
    }  # fmt: skip  # Single values are about all that stands below.
    for name, values in numbers.items():
        column = found["x/y"][name].values()
        assert column.dtype == values.dtype and column.tobytes() == values.tobytes(), name
    assert found["x/y"]["cell"].values().tolist() == texts["cell"].tolist()
    assert (found[""]["who"].values().item(), found[""]["alone"].values().item()) == ("ö", 3.0)


def test_of_a_large_file_only_the_table_that_is_meant_has_values(tmp_path, monkeypatch):
    monkeypatch.setattr(isolated, "_SMALL", 0)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a/force [N]"], file["b/force [N]"] = FORCE, 2.0 * FORCE
    np.testing.assert_array_equal(
        read(tmp_path / "a.h5", "here", "/b").numbers("force", "N", "here", False), 2.0 * FORCE
    )
    assert isolated.read(tmp_path / "a.h5", "here", "b", hdf5).tables["a"]["force [N]"].values().size == 0
    with pytest.raises(InputError, match=r"holds 2 tables; choose with table = .*'a', 'b'"):
        read(tmp_path / "a.h5", "here")


def test_the_child_knows_nothing_of_ours():
    # Its start is most of what a file costs; the front door of the package imports JAX.
    code = (
        f"import runpy, sys\nrunpy.run_path({child.__file__!r})['stand_in']({mat.__file__!r})\n"
        "from bcfj_jax.data.readers import named\nassert named('mat').KINDS\n"
        "print([m for m in sys.modules if m.partition('.')[0] in ('jax', 'jaxlib', 'scipy', 'pint', 'calibration')])"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


def _spreadsheet(path):
    import openpyxl

    book = openpyxl.Workbook()
    book.active["A1"], book.active["XFD1048576"] = "time [ms]", 1.0
    book.save(path)


def _parquet(path):
    import pyarrow
    from pyarrow import parquet

    zeros = np.zeros(1 << 24)
    with parquet.ParquetWriter(path, pyarrow.schema([("a", "f8"), ("b", "f8")]), compression="zstd") as writer:
        for _ in range(8):
            writer.write_table(pyarrow.table({"a": zeros, "b": zeros}))


def _hdf5(path):
    with h5py.File(path, "w") as file:
        for name in "ab":
            file.create_dataset(name, shape=(1 << 40,), dtype="f8", chunks=(1 << 20,), compression="gzip")


@pytest.mark.parametrize(
    "make", tiers.ci([_spreadsheet, _parquet, _hdf5], _spreadsheet, _hdf5), ids=lambda make: make.__name__
)
def test_a_small_file_that_holds_more_than_memory_is_refused(make, tmp_path):
    suffix = {"_spreadsheet": ".xlsx", "_parquet": ".parquet", "_hdf5": ".h5"}[make.__name__]
    path = tmp_path / f"small{suffix}"
    make(path)
    assert path.stat().st_size < 2 << 20
    # In a process whose only child is the one that reads.
    code = (
        "import resource, sys; from pathlib import Path; from bcfj_jax import InputError\n"
        "from bcfj_jax.data.reading import read\n"
        "try: read(Path(sys.argv[1]), 'here')\n"
        "except InputError as error: print(error)\n"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024**2)"
    )
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", code, str(path)], capture_output=True, text=True)
    said, gigabytes = done.stdout.strip().rsplit("\n", 1)
    assert re.search(r"here: .*small.*(too many cells|sizes that its length cannot hold)", said, re.DOTALL), done.stderr
    assert float(gigabytes) < 2.0


def test_every_kind_of_binary_file_is_read_by_the_other_process():
    # In this one no library of theirs is imported.
    code = (
        "import sys; from pathlib import Path; import calibration; from bcfj_jax.data.reading import read\n"
        "for name in sys.argv[1:]: assert read(Path(name), 'here').columns\n"
        "print(sorted({'python_calamine', 'pyarrow', 'h5py', 'nptdms', 'scipy.io'} & set(sys.modules)))"
    )
    with tempfile.TemporaryDirectory() as folder:
        names = []
        for suffix in (".xlsx", ".parquet", ".h5", ".mat", ".tdms"):
            names.append(str(Path(folder) / f"a{suffix}"))
            Path(names[-1]).write_bytes(records.FORMATS[suffix]())
        done = subprocess.run([sys.executable, "-W", "ignore", "-c", code, *names], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr
