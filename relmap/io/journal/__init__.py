"""The journal of a run: observations and associations, stored so that a run can be resumed.

A journal is an SQLite file; `relmap.io.journal.layout` documents its tables, readable by any SQLite
tool. Mapping is deterministic, so mapping the scans of the journal again restores the mapper
exactly; nothing else is stored.
"""

from __future__ import annotations

from relmap.io.journal.layout import RecordedScan
from relmap.io.journal.reading import JournalReader
from relmap.io.journal.salvage import salvage
from relmap.io.journal.writing import Journal

__all__ = ["Journal", "JournalReader", "RecordedScan", "salvage"]
