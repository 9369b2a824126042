"""``python -m scenetruth``: the same as the command ``scenetruth``."""

from scenetruth.cli import main

if __name__ == "__main__":
    main()
