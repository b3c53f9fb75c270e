"""The benchmark of the fleet's wind measures what it says, and more drones cost more."""

from sim_bridge.research.benchmarks.field_bench import DRONES, ROUNDS, WARM, measured, sheet


def test_each_round_after_the_warm_ones_is_timed() -> None:
    few, many = measured(1, 1), measured(12, 1)
    for cost in (few, many):
        assert cost.update.n == cost.forecast.n == ROUNDS - WARM
        assert cost.update.least > 0.0
    assert many.update.median > few.update.median
    table = sheet([few, many])
    assert [row[0] for row in table.rows] == ["1", "12"]
    assert max(DRONES) == 100
    amid = measured(12, 1, front=True)
    assert amid.update.median > 1.2 * many.update.median  # judged without it, then with it
    assert sheet([amid]).rows[0][0] == "12, a front"
