"""Access to bags of ROS 1 and ROS 2 and MCAP files.

`rosbags` reads them; a damaged bag is read up to the damage (`relmap.datasets.bag_salvage`), with a
warning.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from relmap.core.errors import RelmapError
from relmap.datasets.foreign import BAGS, foreign_at
from relmap.datasets.headers import members_of
from relmap.datasets.textfile import invalid, listed, quoted, shown, warn

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

    from relmap.datasets.bag_salvage import Found

_ENDINGS = (".bag", ".db3", ".mcap")


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag or contains one, damaged or not."""
    if os.path.isdir(path):
        return bool(_files(path))
    return path.suffix in _ENDINGS and foreign_at(path) in BAGS


def can_read() -> bool:
    """Return whether the reader of bags is installed."""
    return find_spec("rosbags") is not None


def topics_in(path: Path, types: Iterable[str]) -> list[str] | None:
    """Return the topics of given types in a bag; None if it is not a bag, or cannot be opened."""
    if not is_bag(path) or not can_read():
        return None
    try:
        with closing(Bag(path)) as bag:
            return bag.topics_of(types)
    except RelmapError:
        return None


class Bag:
    """An open bag, with the ROS 2 name of the type of each topic; any error is a RelmapError."""

    def __init__(self, path: Path) -> None:
        if not can_read():
            found = foreign_at(path)
            raise invalid(path, f"is {found}: pip install 'relmap[bags]' to read it")
        self.path = path
        self.types: dict[str, str] = {}
        self._reader: Any = None
        self._found: list[Found] = []
        self._damage: Exception | None = None
        self._typestore: Typestore | None = None
        self._is_ros1 = _files(path)[0].suffix == ".bag"
        with bag_errors(path):
            self._open()

    def _open(self) -> None:
        from rosbags.highlevel import AnyReader

        from relmap.datasets.bag_salvage import known_types, salvaged

        files = _files(self.path)
        whole = [self.path] if (self.path / "metadata.yaml").is_file() else files
        store = known_types()
        for paths in [whole, *([files] if whole != files else [])]:
            try:
                reader = AnyReader(paths, default_typestore=store)
                reader.open()
            except Exception as error:  # noqa: BLE001 - of a damaged file any error may come
                reason = error
                continue
            self._reader, self._typestore = reader, reader.typestore
            self.types = {each.topic: each.msgtype for each in reader.connections}
            return
        self._found, self._typestore = salvaged(files)
        if not self._found:
            raise reason
        self.types = {found.topic: found.type for found in self._found}
        self._damage = reason

    def close(self) -> None:
        """Close its files, if they are open."""
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.close()

    def topics_of(self, types: Iterable[str]) -> list[str]:
        """Return the sorted topics whose messages are of one of the types."""
        return sorted(topic for topic, type_ in self.types.items() if type_ in types)

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yield the time, nanoseconds, and content of each message of a topic."""
        n = 0
        try:
            for t, raw in self._raw(topic):
                with bag_errors(self.path):
                    message = self._decoded(topic, raw)
                yield t, message
                n += 1
        except RelmapError as error:
            if not n:
                raise
            self._warn(error.__cause__ or error, n)

    def message_at(self, topic: str, t: int, nth: int) -> Any:
        """Return the n-th message of a topic at a time, nanoseconds."""
        with bag_errors(self.path):
            at = [raw for time, raw in self._raw(topic, t, t + 1) if time == t]
            return self._decoded(topic, at[nth])

    def _raw(
        self, topic: str, start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[int, bytes]]:
        if self._reader is None:
            yield from ((found.t, found.raw) for found in self._found if found.topic == topic)
            return
        connections = [each for each in self._reader.connections if each.topic == topic]
        with bag_errors(self.path):
            for _, t, raw in self._reader.messages(connections, start, stop):
                yield t, raw

    def _decoded(self, topic: str, raw: bytes) -> Any:
        assert self._typestore is not None
        if self._is_ros1:
            return self._typestore.deserialize_ros1(raw, self.types[topic])
        return self._typestore.deserialize_cdr(raw, self.types[topic])

    def _warn(self, error: BaseException, n: int) -> None:
        reason = quoted(str(error) or type(error).__name__)
        warn(self.path, f"damaged ({reason}): only the first {n} messages")

    def chosen(self, types: Sequence[str], topics: Sequence[str], what: str) -> str:
        """Return the only topic of given types, among the named ones or all.

        Logs a warning if the bag is damaged. Raises `RelmapError` if there is none, or several; the
        message lists what the bag holds.
        """
        if self._damage is not None:
            self._warn(self._damage, len(self._found))
        fitting = self.topics_of(types)
        named = [topic for topic in topics if topic in fitting]
        unknown = [topic for topic in topics if topic not in self.types]
        if unknown:
            raise self._refused(f"no topic {quoted(unknown[0])}")
        if len(named or fitting) == 1:
            return (named or fitting)[0]
        if not fitting:
            raise self._refused(f"no topic with {what}")
        raise self._refused(f"several topics with {what}: name one with --topic")

    def _refused(self, problem: str) -> RelmapError:
        names = [f"{topic} ({type_})" for topic, type_ in sorted(self.types.items())]
        return invalid(self.path, f"{problem}; the bag holds {shown(listed(names))}")


@contextmanager
def bag_errors(path: Path) -> Iterator[None]:
    """Convert any error while a bag is read into a RelmapError."""
    try:
        yield
    except (RelmapError, GeneratorExit):
        raise
    except Exception as error:  # damaged files can raise any error
        reason = quoted(str(error).partition("\n")[0] or type(error).__name__)
        found = foreign_at(path) or "a bag"
        raise invalid(path, f"is {found}, but cannot be read: {reason}") from error


def _files(path: Path) -> list[Path]:
    """Return the files of a bag; none if a folder contains none."""
    if not os.path.isdir(path):
        return [path]
    return [file for file in members_of(path, _ENDINGS) if foreign_at(file) in BAGS]
