"""``python -m fastcoil``."""

from fastcoil.cli import main

if __name__ == "__main__":
    main()
