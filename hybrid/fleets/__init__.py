"""Monitoring of many arms over many periods, on Dask."""

from hybrid.fleets.fleet import Fleet as Fleet
from hybrid.fleets.fleet import fleet as fleet
from hybrid.fleets.plan import Plan as Plan
from hybrid.fleets.plan import read_plan as read_plan
from hybrid.fleets.series import State as State
