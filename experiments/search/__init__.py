"""Population searches of the literature, one file each.

Each is built with bounds and ``rng``, proposes points by ``ask() -> (P, d)``, takes
their values by ``tell((P,))`` and holds the ``best``; ``minimise`` runs one. For the
plain algorithms see ``scipy.optimize``; only what is particular to a publication is
written here.
"""

from search.search import Best, Search, minimise

__all__ = ["Best", "Search", "minimise"]
