"""Command-line interface."""

from __future__ import annotations

__all__ = ["main"]


def main() -> None:
    """Run the command ``scenetruth``."""
    try:
        from scenetruth.cli.app import run_app

        run_app()
    except KeyboardInterrupt:  # during the import of modules
        raise SystemExit(130) from None
