"""Settings of the mapper: typed, frozen, validated once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from relmap.core.errors import RelmapError, brief, known_name

MOST = 10**9
"""Largest accepted integer or length; products of two such values cannot overflow."""
REGISTRATIONS = ("constellation", "nearest-previous")
WITH_POINTS = {"bridge_m": "it applies only to walls"}
WITH_IDS = WITH_POINTS | dict.fromkeys(("registration", "gate_m"), "ids are given")
WITH_WALLS = dict.fromkeys(
    ("registration", "gate_m", "keep_observations"),
    "walls have their own registration and refinement",
)
"""Settings that would be ignored, with the reason."""


@dataclass(frozen=True, kw_only=True)
class MapperConfig:
    """Settings of a mapper; the benchmarks use the defaults for all data.

    Attributes
    ----------
    group_after : int
        Observations after which a landmark is first grouped: the "few iterations" of section III.
        The second and third passes are due after multiples of it. With early grouping most
        landmarks in view are mapped when a new one is aligned, and groups that share many landmarks
        drift least.
    second_pass, third_pass : int
        Observations, in units of `group_after`, after which the second pass is due, and the third
        for landmarks that stay in view (section III). The second needs enough observations to
        detect moving landmarks.
    max_missed : int
        A landmark that is missed for more iterations than this has left the view.
    registration : "constellation" or "nearest-previous"
        Data association without ids: by consistent relative locations, or as in the paper by the
        nearest observation of the previous iteration.
    gate_m : float or None
        Only for "nearest-previous": largest displacement, metres, between two iterations; None
        takes half the median distance between neighbours in the scan.
    keep_observations : bool
        Keep every observation, 32 bytes each, so that `refine` can exploit bounded noise.
    refine_live : bool
        Refine the map while it is being built, after landmarks come back into view.
    bridge_m : float
        Walls only, metres. Where neither walls nor odometry measure the motion in one direction,
        constant motion is assumed until its error may exceed this length, or half of it where beams
        prefer none of several places along parallel walls; the submap then ends.

    Notes
    -----
    A setting that would be ignored is an error: `gate_m` with another registration, `registration`
    with ids, both and `keep_observations` for walls, and `bridge_m` for points.
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

        The `RelmapError` names the key, the value and what is expected.
        """
        second, third = ("second_pass", 2), ("third_pass", 3)
        for key, lowest in (("group_after", 1), second, third, ("max_missed", 0)):
            value = getattr(self, key)
            if type(value) is not int or not lowest <= value <= MOST:
                raise RelmapError(
                    f"setting {key} is {brief(value)}; it must be a whole number, {lowest} or "
                    f"more, up to {MOST}"
                )
        if self.third_pass <= self.second_pass:
            raise RelmapError(
                f"setting third_pass is {self.third_pass}; it must be more than second_pass, "
                f"{self.second_pass}"
            )
        if self.registration not in REGISTRATIONS:
            raise RelmapError(
                f"setting registration is {brief(self.registration)}; "
                f"it must be {' or '.join(REGISTRATIONS)}"
            )
        for key in ("keep_observations", "refine_live"):
            if type(getattr(self, key)) is not bool:
                raise RelmapError(
                    f"setting {key} is {brief(getattr(self, key))}; it must be true or false"
                )
        for key, length in (("gate_m", self.gate_m), ("bridge_m", self.bridge_m)):
            if not ((key == "gate_m" and length is None) or _is_length(length)):
                raise RelmapError(
                    f"setting {key} is {brief(length)}; it must be a length above 0, in metres, "
                    f"up to {MOST}"
                )
        if self.gate_m is not None and self.registration != "nearest-previous":
            raise RelmapError(
                f"setting gate_m is only for registration nearest-previous, and registration is "
                f"{self.registration}"
            )

    @classmethod
    def from_mapping(cls, settings: Mapping[str, Any]) -> MapperConfig:
        """Build the configuration from keys and values, as read from a file.

        Parameters
        ----------
        settings : mapping
            Names of fields, and their values.

        Returns
        -------
        MapperConfig

        Raises
        ------
        RelmapError
            If a key is unknown or a value is invalid.
        """
        known = [field.name for field in fields(cls)]
        for key in settings:
            known_name(key, known, "setting")
        return cls(**settings)


def changed(config: MapperConfig) -> list[str]:
    """Return the names of the settings that do not have their default values."""
    return [each.name for each in fields(config) if getattr(config, each.name) != each.default]


def in_use(config: MapperConfig, unused: Mapping[str, str]) -> dict[str, Any]:
    """Return the settings by name, without those that are ignored."""
    used = {key: value for key, value in asdict(config).items() if key not in unused}
    if used.get("registration") != "nearest-previous":
        used.pop("gate_m", None)
    return used


def refuse(given: Iterable[str], unused: Mapping[str, str]) -> None:
    """Check that no given setting would be ignored.

    The `RelmapError` names the first that would.
    """
    for name in given:
        if name in unused:
            raise RelmapError(f"setting {name} would be ignored: {unused[name]}")


def _is_length(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return 0 < value <= MOST
