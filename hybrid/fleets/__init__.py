"""Monitoring of many arms over many periods, on Dask."""

from hybrid.fleets.fleet import Fleet, fleet
from hybrid.fleets.plan import Plan, read_plan
from hybrid.fleets.series import State

__all__ = ["Fleet", "Plan", "State", "fleet", "read_plan"]
