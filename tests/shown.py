"""What every result shows in Python, whatever its kind: for the tests that have one at hand."""

from __future__ import annotations

import pytest

from bcfj_jax import InputError


def brief(result, first: str) -> None:
    """Text and HTML are short and whole, and the verdict comes first."""
    told = repr(result)
    assert told.splitlines()[0] == first
    assert len(told.splitlines()) <= 15
    assert max(map(len, told.splitlines())) < 300
    assert "array(" not in told
    page = result._repr_html_()
    assert page.startswith("<p><b>") and page.count("<tr>") == page.count("</tr>") > 1


def drawn(result, folder, monkeypatch) -> None:
    """A figure opens no window and writes no file."""
    monkeypatch.chdir(folder)
    before = set(folder.iterdir())
    assert result.plot()._repr_png_().startswith(b"\x89PNG")
    assert set(folder.iterdir()) == before
    with pytest.raises(InputError, match="no picture 'portrait'"):
        result.plot("portrait")
