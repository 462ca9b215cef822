"""``python -m relmap.cli``: same as the command ``relmap``."""

from __future__ import annotations

import sys

from relmap.cli import main

if __name__ == "__main__":
    sys.exit(main())
