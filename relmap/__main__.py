"""``python -m relmap``: same as the command ``relmap``."""

from __future__ import annotations

from relmap.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
