"""What the page's viewer shows: maps and images, packed into the page itself."""

from scenetruth.scoring.report.viewer.content import viewer_of

__all__ = ["viewer_of"]
