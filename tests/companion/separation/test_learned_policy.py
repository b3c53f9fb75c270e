"""The learned actor without torch, and its file and card on disk."""

from pathlib import Path

import numpy as np
import pytest

from companion.adapters.files.policy_file import read_policy
from companion.core.base.errors import LeewayError
from companion.core.separation.learned_policy import SHAPES, AvoidancePolicy, max_pooled_view


def random_weights(seed: int = 0) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    return {k: random.normal(0.0, 0.2, s).astype(np.float32) for k, s in SHAPES.items()}


def by_hand(weights: dict[str, np.ndarray], view: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """The network written out in loops over its definition."""

    def convolved(x: np.ndarray, name: str, stride: int) -> np.ndarray:
        kernel, bias = weights[f"{name}.weight"], weights[f"{name}.bias"]
        size = (x.shape[1] - kernel.shape[2]) // stride + 1
        out = np.empty((len(kernel), size, size))
        for c, r, k in np.ndindex(out.shape):
            part = x[
                :,
                r * stride : r * stride + kernel.shape[2],
                k * stride : k * stride + kernel.shape[3],
            ]
            out[c, r, k] = max((part * kernel[c]).sum() + bias[c], 0.0)
        return out

    cells = np.zeros((3, 31, 31))
    for c, r, k in np.argwhere(view):
        cells[c, r // 5, k // 5] = 1.0
    seen = convolved(convolved(cells, "encoder.first", 3), "encoder.second", 2)
    x = np.concatenate([seen.ravel(), vectors / 200.0])
    for name in ("encoder.joined", "hidden"):
        x = np.maximum(weights[f"{name}.weight"] @ x + weights[f"{name}.bias"], 0.0)
    return np.tanh(weights["out.weight"] @ x + weights["out.bias"])


def test_the_actor_computes_what_its_definition_says() -> None:
    weights, random = random_weights(), np.random.default_rng(1)
    view = (random.random((2, 3, 155, 155)) < 0.01).astype(np.uint8)
    vectors = random.uniform(-300.0, 300.0, (2, 4)).astype(np.float32)
    found = AvoidancePolicy(weights).heading_and_speed_actions(view, vectors)
    for k in range(2):
        assert found[k] == pytest.approx(by_hand(weights, view[k], vectors[k]), abs=1e-4)


def test_torch_and_numpy_agree() -> None:
    torch = pytest.importorskip("torch", reason="needs leeway-uas[train]")
    from sim_bridge.research.avoidance.maddpg import Actor

    actor = Actor()
    weights = {k: v.numpy() for k, v in actor.state_dict().items()}
    random = np.random.default_rng(2)
    view = (random.random((4, 3, 155, 155)) < 0.02).astype(np.uint8)
    vectors = random.uniform(-300.0, 300.0, (4, 4)).astype(np.float32)
    with torch.no_grad():
        seen = torch.from_numpy(max_pooled_view(view).astype(np.float32))
        expected = actor(seen, torch.from_numpy(vectors)).numpy()
    assert AvoidancePolicy(weights).heading_and_speed_actions(view, vectors) == pytest.approx(
        expected, abs=1e-5
    )


def test_weights_of_another_shape_or_not_finite_are_refused_by_name() -> None:
    weights = random_weights()
    with pytest.raises(LeewayError, match=r"out\.bias"):
        AvoidancePolicy(weights | {"out.bias": np.zeros(3, np.float32)})
    with pytest.raises(LeewayError, match=r"hidden\.bias"):
        AvoidancePolicy(weights | {"hidden.bias": np.full(64, np.nan, np.float32)})
    with pytest.raises(LeewayError, match="missing or unknown"):
        AvoidancePolicy({k: v for k, v in weights.items() if k != "out.bias"})


def shipped(folder: Path) -> Path:
    """A card and weights in `folder`, as `train-avoid --export` writes them."""
    import hashlib

    np.savez(folder / "p.npz", **random_weights())  # pyright: ignore[reportArgumentType]
    digest = hashlib.sha256((folder / "p.npz").read_bytes()).hexdigest()
    card = folder / "p.toml"
    card.write_text(
        f'format = "policy/1"\nweights = "p.npz"\nsha256 = "{digest}"\nframe = "goal"\n'
        'reward = "paper"\nbehind_filter = false\nseed = 1\nsteps = 2\nagent_steps = 3\n'
        'commit = "abc"\ncommand = "sim-bridge train-avoid"\ncurve = "p_curve.csv"\n'
    )
    return card


def test_a_policy_is_read_with_its_card(tmp_path: Path) -> None:
    policy, card = read_policy(str(shipped(tmp_path)))
    assert card.frame == "goal"
    assert policy.weights["out.bias"].shape == (2,)


def test_weights_that_are_not_the_cards_are_refused_with_both_hashes(tmp_path: Path) -> None:
    card = shipped(tmp_path)
    np.savez(tmp_path / "p.npz", **random_weights(9))  # pyright: ignore[reportArgumentType]
    with pytest.raises(LeewayError, match=r"SHA-256 is .* expected"):
        read_policy(str(card))


def test_a_card_that_is_missing_or_strange_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LeewayError, match="no such policy card"):
        read_policy(str(tmp_path / "none.toml"))
    card = shipped(tmp_path)
    card.write_text(card.read_text() + "extra = 1\n")
    with pytest.raises(LeewayError, match="extra"):
        read_policy(str(card))


def test_the_shipped_policy_is_the_one_on_its_card_and_flies_on_when_nobody_is_near() -> None:
    """Nothing in view, the goal 300 m ahead: roughly straight on, and not slowly."""
    policy, card = read_policy("avoid")
    assert card.frame == "goal"
    view = np.zeros((1, 3, 155, 155), np.uint8)
    heading, speed = policy.heading_and_speed_actions(
        view, np.array([[300.0, 0.0, 0.0, 0.0]], np.float32)
    )[0]
    assert abs(heading) < 0.25
    assert speed > 0.3
