"""Optional libraries: the extras of the package, what each is for, and a message where one is missing."""

from __future__ import annotations

import importlib
from typing import Any

from bcfj_jax.core.errors import InputError

# What each extra is for, for users; the libraries stand in pyproject.toml.
EXTRAS = {
    "io": "measured data in Excel, Parquet, HDF5, MAT 7.3, TDMS, UFF, C3D and MDF files",
    "uq": "posteriors by NUTS (bcfj calibrate --intervals posterior)",
    "study": "studies (bcfj study): tables on disk, sampling, global sensitivity",
    "cluster": "studies by a Dask cluster (bcfj study run --scheduler)",
    "cuda": "an NVIDIA GPU with CUDA 13, on which large studies run",
    "table": "results as tables and labelled arrays: to_pandas(), to_xarray()",
    "animation": "movies of a run in MP4 (bcfj simulate --animate mp4)",
    "petab": "PEtab 2 tables, in and out",
    "life": "rainflow counting of loads (bcfj_jax.analysis.life)",
}


def library(name: str, where: str, extra: str) -> Any:
    """A module of an optional library, as "pyarrow.parquet"; where it is missing, the message names the ``extra`` to install."""
    try:
        return importlib.import_module(name)
    except ImportError:
        package = name.partition(".")[0]
        remedy = f'pip install "bcfj-jax[{extra}]": {EXTRAS[extra]}'
        raise InputError(where, f"needs {package}, which is not installed", remedy) from None
