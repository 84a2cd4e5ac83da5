"""All drawings of the pages: ``python -m docs.drawings.draw``, from the repository's root."""

from __future__ import annotations

import matplotlib

from docs.drawings import flow
from docs.drawings.base import STYLE


def main() -> None:
    """Draw them all; the same drawing gives the same bytes."""
    with matplotlib.rc_context(STYLE):
        flow.draw()


if __name__ == "__main__":
    main()
