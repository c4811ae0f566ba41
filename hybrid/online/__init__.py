"""Online identification: dynamic parameters tracked while the arm works."""

from hybrid.online.identifier import OnlineIdentifier as OnlineIdentifier
from hybrid.online.intake import Sample as Sample
