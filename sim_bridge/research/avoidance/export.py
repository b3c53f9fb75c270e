"""From a checkpoint to what flies: weights, card and curve (needs leeway-uas[train])."""

import shutil
from pathlib import Path

import numpy as np

from companion.core.separation.learned_policy import SHAPES, AvoidancePolicy
from sim_bridge.research.avoidance.environment import Frame
from sim_bridge.research.avoidance.train_avoid import sha256_of, weights_of

CARD = """\
# What this policy is and where it comes from; `sim-bridge avoid` and the companion check it.
format = "policy/1"
weights = "{name}.npz"
sha256 = "{sha256}"
frame = "{frame}"         # what is up in its view, and heading 0
reward = "{reward}"
behind_filter = {behind_filter}
seed = {seed}
steps = {steps}            # decisions of each of {episodes} episodes with {agents} drones
agent_steps = {agent_steps}
commit = "{commit}"
command = "{command}"
curve = "{name}_curve.csv"
"""


def export(checkpoint: Path, out: Path, name: str, commit: str) -> list[Path]:
    """Writes name.npz, name.toml and name_curve.csv; returns their paths."""
    weights, run = weights_of(checkpoint)
    AvoidancePolicy(weights)
    out.mkdir(parents=True, exist_ok=True)
    archive = out / f"{name}.npz"
    np.savez(archive, **{key: weights[key] for key in SHAPES})  # pyright: ignore[reportArgumentType]
    params = run["params"]
    filtered = " --filtered" if params["filtered"] else ""
    taught = f" --taught {params['taught']}" if params["taught"] else ""
    begun = f" --begin-with {params['begin_with']}" if params["begin_with"] else ""
    card = CARD.format(
        name=name,
        sha256=sha256_of(archive),
        frame=Frame.GOAL.value,
        reward=params["reward"],
        behind_filter=str(params["filtered"]).lower(),
        seed=params["seed"],
        steps=run["step"],
        episodes=params["episodes"],
        agents=params["agents"],
        agent_steps=run["agent_steps"],
        commit=commit,
        command=f"sim-bridge train-avoid --reward {params['reward']} --seed {params['seed']}"
        f" --steps {params['steps']}{filtered}{taught}{begun}",
    )
    written = [archive, out / f"{name}.toml", out / f"{name}_curve.csv"]
    written[1].write_text(card, encoding="utf-8")
    shutil.copyfile(checkpoint.parent / "curve.csv", written[2])
    return written
