"""Plan a day: truck stops and drone sorties, as lists.

python examples/plan_a_day.py
"""

# %%
import ground_station

day = ground_station.read_day("harbour")
plan = ground_station.plan_day(day, trials=200, seed=1)
print(f"{len(day.orders)} orders, back at the depot after {plan.makespan_s / 60.0:.0f} min")

# %%
for stop in plan.stops:
    print(f"stop {stop.id}: arrive {stop.arrive_s / 60.0:.0f} min")
for sortie in plan.sorties:
    print(f"drone {sortie.vehicle}: order {sortie.order}, launch at {sortie.launch}")
for left in plan.unplanned:
    print(f"not planned: {left.order}: {left.reason}")
