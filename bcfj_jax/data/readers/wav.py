"""WAV by SciPy: samples as shares of the full scale, whose physical value no WAV file states."""

from __future__ import annotations

import warnings

import numpy as np

from bcfj_jax.data.columns import FULL_SCALE, Content, Refused, Sampled, sampled

KINDS, LIBRARY = (".wav", ".wave"), "scipy.io"
SIGNATURE = rb"(?s)(RIFF|RF64|RIFX).{4}WAVE"


def read(file: str, wanted: str) -> Content:
    """The channels; whole numbers of b bits are divided by 2^(b - 1)."""
    from scipy.io import wavfile

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", wavfile.WavFileWarning)
        rate, values = wavfile.read(file)
    if not (rate > 0 and values.size):
        raise Refused("it holds no samples or no rate", "record or export the file again")
    # SciPy holds 24 bits in the upper bytes of 32, and 8 bits without a sign.
    if values.dtype.kind == "u":
        values = values.astype(float) - 128.0
        size = 128.0
    else:
        size = 2.0 ** (8 * values.dtype.itemsize - 1) if values.dtype.kind == "i" else 1.0
    tall = np.atleast_2d(values.T).T
    names = ["channel"] if tall.shape[1] == 1 else [f"channel {j + 1}" for j in range(tall.shape[1])]
    channels = [Sampled(n, FULL_SCALE, tall[:, j] / size, 0.0, 1.0 / rate) for j, n in enumerate(names)]
    return Content(sampled("", channels), _cut(file))


def _cut(file: str) -> str:
    """Whether the file is shorter than it states."""
    with open(file, "rb") as content:
        head = content.read(8)
        content.seek(0, 2)
        stated, size = int.from_bytes(head[4:8], "little") + 8, content.tell()
    cut = head[:4] == b"RIFF" and size < stated
    return f"the file is cut off: it lacks {stated - size} bytes" if cut else ""
