"""Registration: which landmark each observation belongs to."""

from __future__ import annotations

from relmap.core.association.base import UNIDENTIFIED, Registration
from relmap.core.association.constellation import Constellation
from relmap.core.association.known import KnownAssociation
from relmap.core.association.nearest_previous import NearestPrevious

__all__ = ["UNIDENTIFIED", "Constellation", "KnownAssociation", "NearestPrevious", "Registration"]
