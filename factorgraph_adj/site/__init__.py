"""The site: networks that live for years, their journals in a database, an API and a page."""

from .client import Client, Event, ServiceAway
from .outbox import Outbox

__all__ = ["Client", "Event", "Outbox", "ServiceAway"]
