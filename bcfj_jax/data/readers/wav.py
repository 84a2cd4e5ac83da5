"""WAV by SciPy: samples as shares of the full scale, whose physical value no WAV file states."""

from __future__ import annotations

import struct
import warnings

import numpy as np

from bcfj_jax.data.columns import FULL_SCALE, Content, Refused, Sampled, sampled, wrong_length

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
    return Content(sampled("", channels), _length(file))


def _length(file: str) -> str:
    """Whether the file is shorter or longer than it states, or its rate does not go with its bytes a second."""
    with open(file, "rb") as content:
        head = content.read(34)
        content.seek(0, 2)
        stated, size = int.from_bytes(head[4:8], "little") + 8, content.tell()
    # Of a stream that was not closed the length is not known; an odd one may be padded.
    if head[:4] != b"RIFF" or stated >= 1 << 32:
        return ""
    said = wrong_length(size, stated, stated + stated % 2)
    rate, each, frame = struct.unpack("<IIH", head[24:34])
    wrong = head[12:16] == b"fmt " and each != rate * frame
    return said or (f"its rate of {rate} Hz and its {each} bytes a second do not agree" if wrong else "")
