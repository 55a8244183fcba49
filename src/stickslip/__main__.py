"""Command line, run as `python -m stickslip`."""

from .cli import main

if __name__ == "__main__":
    main()
