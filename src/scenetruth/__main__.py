"""Entry point of ``python -m scenetruth``, equivalent to the command ``scenetruth``."""

from scenetruth.cli import main

if __name__ == "__main__":
    main()
