"""Registration: which landmark each observation is of."""

from __future__ import annotations

from relmap.core.registration.base import UNIDENTIFIED, Registration
from relmap.core.registration.constellation import Constellation
from relmap.core.registration.known import KnownAssociation
from relmap.core.registration.nearest_previous import NearestPrevious

__all__ = [
    "UNIDENTIFIED",
    "Constellation",
    "KnownAssociation",
    "NearestPrevious",
    "Registration",
]
