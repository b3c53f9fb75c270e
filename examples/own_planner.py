"""Own planner: run it in a campaign beside BER, in the same winds.

python examples/own_planner.py
"""

# %%
import numpy as np

import sim_bridge

SCENARIO = {
    "format": "delivery-scenario/1", "name": "square",
    "vertices_m": [[0, 0, 0], [900, 0, 0], [0, 900, 0], [900, 900, 0]],
    "edges": [[0, 1], [1, 0], [0, 2], [2, 0], [1, 3], [3, 1], [2, 3], [3, 2]],
    "depot": 0, "target": 3, "budget_wh": 130.0, "airspeed_mps": 15.0,
    "power_w": {"loaded": 1450.0, "empty": 1450.0},
    "wind": {
        "kind": "chain", "states_en_mps": [[7, 0], [-7, 0], [0, 7], [0, -7]],
        "rate_per_s": [[-0.003, 0.001, 0.001, 0.001], [0.001, -0.003, 0.001, 0.001],
                       [0.001, 0.001, -0.003, 0.001], [0.001, 0.001, 0.001, -0.003]],
        "initial": [0.25, 0.25, 0.25, 0.25],
    },
}  # fmt: skip


# %% A planner is built for a task, starts batches of missions, and selects the next edge of each
class Downwind:
    """Takes the out-edge with the strongest tailwind that does not lead back to the last vertex."""

    def __init__(self, task: sim_bridge.PlanningTask) -> None:
        self.graph = task.graph

    def start_batch(self, uniform_random_by_mission: np.ndarray) -> "Downwind":
        self.last = np.full(len(uniform_random_by_mission), -1)
        return self

    def select_edges(self, seen: sim_bridge.PlannerObservation) -> np.ndarray:
        graph, edges = self.graph, self.graph.out_edges_by_vertex[seen.vertex]
        along = graph.vertices_m[graph.head[edges]] - graph.vertices_m[graph.tail[edges]]
        tailwind = np.einsum("mkc,mc->mk", along[:, :, :2], seen.wind_en_mps)
        unusable = (edges < 0) | (graph.head[edges] == self.last[seen.mission][:, None])
        choice = np.where(unusable, -np.inf, tailwind).argmax(axis=1)
        self.last[seen.mission] = seen.vertex
        return edges[np.arange(len(edges)), choice]


# %%
rows = sim_bridge.campaign(SCENARIO, {"ber": None, "rer": None, "downwind": Downwind}, missions=500)
for row in rows:
    print(f"{row.planner:9} SUC {row.SUC:3}  DEL {row.DEL:3}  FAIL {row.FAIL:3}  ABRT {row.ABRT:3}")
