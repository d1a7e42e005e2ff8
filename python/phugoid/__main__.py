"""``python -m phugoid`` is the command ``phugoid``."""

from .cli import main

if __name__ == "__main__":
    main()
