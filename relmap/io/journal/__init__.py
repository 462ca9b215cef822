"""The journal of a run: what was seen and taken for what, kept so that a run survives.

A journal is an SQLite file; `relmap.io.journal.layout` documents its tables, which any tool that
reads SQLite can read.  As the mapping is deterministic, feeding a mapper what is in the journal
gives the very mapper that wrote it; so nothing else is kept.
"""

from __future__ import annotations

from relmap.io.journal.reading import JournalReader, RecordedScan
from relmap.io.journal.salvage import salvage
from relmap.io.journal.writing import Journal

__all__ = ["Journal", "JournalReader", "RecordedScan", "salvage"]
