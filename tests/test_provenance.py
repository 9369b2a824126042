"""The release that a version belongs to."""

from __future__ import annotations

from unittest.mock import patch

from hypothesis import given
from hypothesis import strategies as some

from scenetruth.provenance import own_release

RELEASES = some.lists(some.integers(0, 99), min_size=3, max_size=3).map(lambda parts: ".".join(map(str, parts)))
BEHIND = some.sampled_from(["", "rc1", ".post2"])
COMMITS = some.sampled_from(["", ".dev0", ".dev7+g1a2b3c4", ".dev12+g1a2b3c4d5.d20261123", "+local"])


@given(RELEASES, BEHIND, COMMITS)
def test_commits_between_releases_belong_to_one(release: str, behind: str, commit: str) -> None:
    with patch("scenetruth.provenance.version", return_value=release + behind + commit):
        found = own_release()
    # Only commits after a release are .post1.devN: a release that is named .post2 is one.
    assert found == release + ("" if behind == ".post2" and commit.startswith(".dev") else behind)
