"""Many arms, many periods, on Dask."""

from hybrid.fleet.fleet import Fleet, State, fleet
from hybrid.fleet.plan import Plan, read_plan

__all__ = ["Fleet", "Plan", "State", "fleet", "read_plan"]
