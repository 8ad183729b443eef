"""Photos that most of their image points contradict: they may stand at the wrong one of two places.

Three image points leave up to four places of a photo. One that came by few of them may be at the
wrong one, and its other image points are then suspects for good, however right they are: only
points are looked for at other places (`nonlinearity`).
"""

from __future__ import annotations

import numpy as np

from .ledger import Ledger

LEAST = 3
"""Smallest number of suspects of a photo that may be right against what is in."""


def doubts(ledger: Ledger) -> tuple[str, ...]:
    """Return sentences on photos of which more image points are suspects than accepted."""
    rows, names = ledger.rows, ledger.names
    out, inside = rows.images(ledger.having("suspect")), rows.images(ledger.having("accepted"))
    if len(out) < LEAST:
        return ()
    n = len(names.photos)
    suspects = np.bincount(rows.photo[out], minlength=n)
    accepted = np.bincount(rows.photo[inside], minlength=n)
    told = np.flatnonzero((suspects >= LEAST) & (suspects > accepted))
    return tuple(
        f"{suspects[f]} of {suspects[f] + accepted[f]} image points of photo {names.photos[f]!r} "
        "are suspects: it may be at the wrong one of two places; remove the image points that are "
        "in, or adjust all of them at once (fga.adjust)"
        for f in told.tolist()
    )
