"""Why draws were refused, as a table."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping

__all__ = ["refusal_rows"]

_MOST_TOLD = 20
_NUMBER = re.compile(r"(?<![\w.])-?[0-9]+(\.[0-9]+)?(e[-+]?[0-9]+)?(?![\w]|\.\w)")


def refusal_rows(reasons: Mapping[str, int]) -> list[tuple[str, int]]:
    """Return why draws were refused and how many, the most frequent first.

    Parameters
    ----------
    reasons
        The reasons as a draw tells them. Of scenes that cannot be made, numbers do not count.

    Examples
    --------
    >>> refusal_rows({"depth of cube over 9 mm": 4, "cannot be made: at frame 3": 3, "cannot be made: at frame 12": 2})
    [('cannot be made: at frame …', 5), ('depth of cube over 9 mm', 4)]
    """
    found = Counter[str]()
    for reason, count in reasons.items():
        unmade = reason.startswith("cannot be made")
        found[_NUMBER.sub("…", reason) if unmade else reason] += count
    return sorted(found.items(), key=lambda one: (-one[1], one[0]))[:_MOST_TOLD]
