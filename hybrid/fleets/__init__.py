"""Many arms, many periods, on Dask."""

from hybrid.fleets.fleet import Fleet, State, fleet
from hybrid.fleets.plan import Plan, read_plan

__all__ = ["Fleet", "Plan", "State", "fleet", "read_plan"]
