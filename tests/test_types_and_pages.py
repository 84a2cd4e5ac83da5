"""Types and the site of the documents, each made by its own tool in a process of its own, while the other worker tests."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.full
@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
@pytest.mark.parametrize("goal", ["types", "docs"])
def test_make(goal):
    done = subprocess.run(["make", "--no-print-directory", goal], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, f"make {goal}\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}"
