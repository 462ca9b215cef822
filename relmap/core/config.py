"""Settings of the mapper: typed, frozen, validated once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from relmap.core.errors import RelmapError, known_name, told

MOST = 10**9
"""Whole numbers and lengths beyond this are a mistake; products of two are no problem below."""
REGISTRATIONS = ("constellation", "nearest-previous")
WITH_POINTS = {"bridge_m": "only walls can leave a way along themselves open"}
WITH_IDS = WITH_POINTS | dict.fromkeys(("registration", "gate_m"), "with ids nothing is matched")
WITH_WALLS = dict.fromkeys(
    ("registration", "gate_m", "keep_observations"),
    "walls are matched and refined in a way of their own",
)
"""Settings that would be ignored, and why."""


@dataclass(frozen=True, kw_only=True)
class MapperConfig:
    """What a user may set; the defaults work on all data the project is measured on.

    Attributes
    ----------
    group_after : int
        Observations after which a landmark is grouped first: the "few iterations" of section III.
        The second and the third pass are due after multiples of it.  Grouped early, nearly
        everything in view is on the map when a new landmark is aligned to it, and groups that
        share many landmarks drift least.
    second_pass, third_pass : int
        Observations after which the second pass is due, and the third where a landmark stays in
        view, in units of `group_after` (section III).  The second needs enough of them to tell who
        moves.
    max_missed : int
        A landmark unseen for more iterations than this has left the view.
    registration : "constellation" or "nearest-previous"
        How observations without ids find their landmarks: by relative locations that agree, or the
        paper's own way, by the nearest of the previous iteration.
    gate_m : float or None
        Only for "nearest-previous": largest displacement, metres, between two iterations; None
        takes half the median distance between neighbours in the scan.
    keep_observations : bool
        Keep every single observation, 32 bytes each, so that `refine` can make use of noise that is
        bounded.
    refine_live : bool
        Refine the map while it is being built, when landmarks came back into view.
    bridge_m : float
        Only for walls, metres: along walls where nothing measures the way, nor odometry tells it,
        the robot is taken to go on as before until that may be so far off; there the submap ends.

    Notes
    -----
    A setting that would be ignored is refused: `gate_m` with another registration, `registration`
    where ids are given, both and `keep_observations` where walls are mapped, and `bridge_m` where
    points are.
    """

    group_after: int = 10
    second_pass: int = 3
    third_pass: int = 6
    max_missed: int = 5
    registration: str = "constellation"
    gate_m: float | None = None
    keep_observations: bool = False
    refine_live: bool = True
    bridge_m: float = 1.0

    def __post_init__(self) -> None:
        """Check every value.

        Raises
        ------
        RelmapError
            Names the key, the value and what would be right.
        """
        second, third = ("second_pass", 2), ("third_pass", 3)
        for key, lowest in (("group_after", 1), second, third, ("max_missed", 0)):
            value = getattr(self, key)
            if type(value) is not int or not lowest <= value <= MOST:
                raise RelmapError(
                    f"setting {key} is {told(value)}; it must be a whole number, {lowest} or more, "
                    f"up to {MOST}"
                )
        if self.third_pass <= self.second_pass:
            raise RelmapError(
                f"setting third_pass is {self.third_pass}; it must be more than second_pass, "
                f"{self.second_pass}"
            )
        if self.registration not in REGISTRATIONS:
            raise RelmapError(
                f"setting registration is {told(self.registration)}; "
                f"it must be {' or '.join(REGISTRATIONS)}"
            )
        for key in ("keep_observations", "refine_live"):
            if type(getattr(self, key)) is not bool:
                raise RelmapError(
                    f"setting {key} is {told(getattr(self, key))}; it must be true or false"
                )
        for key, length in (("gate_m", self.gate_m), ("bridge_m", self.bridge_m)):
            if not ((key == "gate_m" and length is None) or _is_length(length)):
                raise RelmapError(
                    f"setting {key} is {told(length)}; it must be a length above 0, in metres, "
                    f"up to {MOST}"
                )
        if self.gate_m is not None and self.registration != "nearest-previous":
            raise RelmapError(
                f"setting gate_m is only for registration nearest-previous, and registration is "
                f"{self.registration}"
            )

    def refuse(self, unused: Mapping[str, str]) -> None:
        """Make sure that settings that would be ignored are as they are by default.

        Parameters
        ----------
        unused : mapping
            Their names, and why they would.

        Raises
        ------
        RelmapError
            Names the first that is not.
        """
        default = {field.name: field.default for field in fields(self)}
        refuse([name for name in default if getattr(self, name) != default[name]], unused)

    def in_use(self, unused: Mapping[str, str]) -> dict[str, Any]:
        """Return the settings by name, but for those that are ignored.

        Parameters
        ----------
        unused : mapping
            Their names, and why they are.
        """
        used = {key: value for key, value in asdict(self).items() if key not in unused}
        if used.get("registration") != "nearest-previous":
            used.pop("gate_m", None)
        return used

    @classmethod
    def from_mapping(cls, settings: Mapping[str, Any]) -> MapperConfig:
        """Build the configuration from keys and values, as read from a file.

        Raises
        ------
        RelmapError
            Where a key is unknown or a value cannot be used.
        """
        known = [field.name for field in fields(cls)]
        for key in settings:
            known_name(key, known, "setting")
        return cls(**settings)


def refuse(given: Iterable[str], unused: Mapping[str, str]) -> None:
    """Make sure that no setting that is given would be ignored.

    Raises
    ------
    RelmapError
        Names the first that would.
    """
    for name in given:
        if name in unused:
            raise RelmapError(f"setting {name} would be ignored: {unused[name]}")


def _is_length(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return 0 < value <= MOST
