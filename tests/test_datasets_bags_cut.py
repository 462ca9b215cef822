"""MCAP files that end within a chunk."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from relmap.datasets import open_scans
from tests.bagfiles import Types, file_of, write_bag


@pytest.mark.parametrize("packing", ["", "lz4", "zstd"])
def test_a_truncated_chunk_of_mcap_is_read_up_to_its_end(packing: str, tmp_path: Path) -> None:
    mcap = pytest.importorskip("mcap.writer")
    types, ranges = Types("mcap"), np.random.default_rng(0).uniform(1, 5, (300, 500)).tolist()
    scans = [("/scan", 2.0 + k, types.scan(2.0 + k, r, 0.0, 1e-3)) for k, r in enumerate(ranges)]
    whole = file_of(write_bag(tmp_path, "mcap", types, scans)).read_bytes()
    kinds = {"": "NONE", "lz4": "LZ4", "zstd": "ZSTD"}
    stream = BytesIO()
    writer = mcap.Writer(stream, compression=getattr(mcap.CompressionType, kinds[packing]))
    repacked(whole, writer)
    file = tmp_path / "a.mcap"
    file.write_bytes(stream.getvalue()[: len(stream.getvalue()) * 6 // 10])
    assert 90 < len(open_scans(file)) < 240


def repacked(whole: bytes, writer: Any) -> None:
    """Write schemas, channels and messages of an MCAP file anew, as one chunk."""
    from mcap.records import Channel, Message, Schema
    from mcap.stream_reader import StreamReader

    writer.start(profile="ros2")
    for record in StreamReader(BytesIO(whole)).records:
        if isinstance(record, Schema):
            writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel):
            writer.register_channel(record.topic, record.message_encoding, record.schema_id)
        elif isinstance(record, Message):
            t = record.log_time
            writer.add_message(record.channel_id, t, record.data, t, record.sequence)
    writer.finish()
