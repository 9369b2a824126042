"""One damaged store tried: it is read and used, or refused by an error of ours."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import scenetruth as st
from scenetruth.errors import ScenetruthError
from scenetruth.storage import verify_store

__all__ = ["STORE_OUTCOMES", "try_store"]

STORE_OUTCOMES = ("refused", "refused when used", "used")
"""What may become of a store."""


def try_store(store: Path, others: dict[str, Any]) -> str:
    """Verify a store, load it, and do with it what it is for.

    Parameters
    ----------
    store
        The store.
    others
        The data sets that belong to it, whole, by kind.

    Returns
    -------
    str
        ``refused``, ``refused when used`` (estimated from, or scored) or ``used``. Any error but ours is not caught.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", st.EstimateWarning)
        verified = _is_refused(lambda: verify_store(store))
        found: dict[str, Any] = {}
        if _is_refused(lambda: found.update(read=st.load_store(store))):
            assert verified, "loading refuses what verifying takes"
            return "refused"
        dataset = found["read"]
        repr(dataset), dataset._repr_html_()
        kind = dataset.attrs["scenetruth"]
        parts = others | {kind: dataset}
        if kind == "recording":
            refused = _is_refused(lambda: st.estimate(dataset, working_point_px=0))
        else:
            refused = _is_refused(lambda: st.score(parts["estimate"], parts["truth"], parts["recording"]))
        return "refused when used" if refused else "used"


def _is_refused(work: Any) -> bool:
    try:
        work()
    except ScenetruthError as error:
        text = str(error)
        assert text
        assert len(text) < 200_000
        assert text.replace("\n", "").isprintable()
        return True
    return False
