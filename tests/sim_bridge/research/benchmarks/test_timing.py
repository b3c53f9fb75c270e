"""The benchmarks' one way to report: against numpy's percentiles and figures done by hand."""

import numpy as np
import pytest

from sim_bridge.research.benchmarks.timing import Samples, cpu_time_s, repeated, wall_time_s


def test_median_spread_and_number() -> None:
    each = Samples.of([3.0, 1.0, 2.0], scale=10.0)
    assert (each.n, each.median, each.least, each.most) == (3, 20.0, 10.0, 30.0)
    assert each.text("us", 0) == "20 us (10 to 30, n 3)"
    assert Samples.of([1234.5]).text("s") == "1,234.5 s"


def test_the_99th_percentile_is_numpys() -> None:
    values = np.random.default_rng(1).exponential(1.0, 500)
    assert Samples.of(values).p99 == pytest.approx(np.percentile(values, 99))


def test_a_ratio_is_that_of_the_medians() -> None:
    assert Samples.of([4.0, 6.0, 50.0]).over(Samples.of([1.0, 2.0, 3.0])) == pytest.approx(3.0)


def test_work_takes_time_and_waiting_takes_no_cpu() -> None:
    def work() -> None:
        sum(range(200_000))

    assert repeated(work, 2).least > 0.0
    assert cpu_time_s(work) > 0.0
    assert wall_time_s(work) > 0.0
