"""Learned policies on disk: weights (.npz) and the card (.toml) that describes them."""

import hashlib
import tomllib
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.adapters.files.params import params_dir
from companion.core.base.errors import LeewayError
from companion.core.separation.learned_policy import AvoidancePolicy

FORMAT = "policy/1"
CARD_KEYS = {
    "format", "weights", "sha256", "frame", "reward", "behind_filter", "seed", "steps",
    "agent_steps", "commit", "command", "curve",
}  # fmt: skip


@dataclass(frozen=True)
class PolicyCard:
    """Origin of the weights; `frame` is the up direction of the observations in training."""

    frame: str
    reward: str
    seed: int
    command: str
    commit: str
    sha256: str


def read_policy(name: str) -> tuple[AvoidancePolicy, PolicyCard]:
    """Read a policy by name (params/policies) or its card's path; verify hash and shapes."""
    card_path = Path(name) if name.endswith(".toml") else params_dir() / "policies" / f"{name}.toml"
    card = _read_card(card_path)
    weights_path = card_path.parent / str(card["weights"])
    try:
        content = weights_path.read_bytes()
    except OSError as error:
        raise LeewayError(f"{weights_path}: {error.strerror or error}") from error
    digest = hashlib.sha256(content).hexdigest()
    if digest != card["sha256"]:
        raise LeewayError(
            f"{weights_path}: its SHA-256 is {digest}, expected {card['sha256']} ({card_path})"
        )
    try:
        with np.load(weights_path, allow_pickle=False) as arrays:
            policy = AvoidancePolicy({key: arrays[key] for key in arrays.files})
    except (ValueError, OSError, zipfile.BadZipFile) as error:
        raise LeewayError(f"{weights_path}: not an array archive: {error}") from error
    except LeewayError as error:
        raise LeewayError(f"{weights_path}: {error}") from error
    return policy, PolicyCard(
        frame=str(card["frame"]),
        reward=str(card["reward"]),
        seed=int(card["seed"]),
        command=str(card["command"]),
        commit=str(card["commit"]),
        sha256=digest,
    )


def _read_card(path: Path) -> dict:
    try:
        card = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise LeewayError(f"{path}: no such policy card") from error
    except (OSError, ValueError) as error:
        raise LeewayError(f"{path}: {error}") from error
    if card.get("format") != FORMAT:
        raise LeewayError(f"{path}: format is {card.get('format')!r}, expected {FORMAT!r}")
    if set(card) != CARD_KEYS:
        wrong = ", ".join(sorted(set(card) ^ CARD_KEYS))
        raise LeewayError(f"{path}: keys missing or unknown: {wrong}")
    return card
