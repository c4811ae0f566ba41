"""Online identification: dynamic parameters tracked while the arm works."""

from hybrid.online.health import Health
from hybrid.online.identifier import OnlineIdentifier
from hybrid.online.intake import Sample

__all__ = ["Health", "OnlineIdentifier", "Sample"]
