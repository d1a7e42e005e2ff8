"""``python -m phugoid`` is the command ``phugoid``."""

from .cli.app import main

if __name__ == "__main__":
    main()
