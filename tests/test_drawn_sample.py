"""The drawn sample of tests/conftest.py, on a small family of its own."""

from pathlib import Path

import pytest

FAMILY = """
import pytest

@pytest.mark.drawn(of="autopilot")
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
@pytest.mark.parametrize("case", ["a", "b", "c", "d", "e", "f", "g", "h"])
def test_flight(case, autopilot): pass

@pytest.mark.drawn(keep=3)
@pytest.mark.parametrize("n", range(10))
def test_many(n): pass

def test_alone(): pass
"""
SAMPLES = """
import pytest

@pytest.mark.sample
def test_one(): pass

@pytest.mark.sample
def test_other(): pass

@pytest.mark.sample
@pytest.mark.every_run
def test_in_every_run(): pass

@pytest.mark.sample
def test_safety_rule_1_holds(): pass
"""
SAMPLE_FILES = 10


@pytest.fixture
def family(pytester: pytest.Pytester) -> pytest.Pytester:
    pytester.makeconftest((Path(__file__).parent / "conftest.py").read_text())
    markers = "drawn(keep, of): a family\n  sample: long\n  every_run: always"
    pytester.makeini(f"[pytest]\nmarkers =\n  {markers}\n")
    pytester.makepyfile(test_family=FAMILY)
    return pytester


def ran(family: pytest.Pytester, *asked: str) -> list[str]:
    lines = family.runpytest_inprocess("--collect-only", "-q", *asked).outlines
    return [line.split("::")[1] for line in lines if "::" in line]


def test_every_case_is_run_once_and_of_the_others_as_many_as_are_kept(family):
    names = ran(family, "--draw-seed", "7")
    flights = [name for name in names if name.startswith("test_flight")]
    assert sorted(name[12] for name in flights) == list("abcdefgh")
    assert len({name[14:] for name in flights}) == 2  # both autopilots are drawn
    assert sum(name.startswith("test_many") for name in names) == 3
    assert "test_alone" in names


@pytest.mark.sample
def test_the_same_seed_draws_the_same_and_another_does_not(family):
    assert ran(family, "--draw-seed", "7") == ran(family, "--draw-seed", "7")
    assert ran(family, "--draw-seed", "7") != ran(family, "--draw-seed", "8")


def test_without_a_seed_all_run(family):
    assert len(ran(family)) == 16 + 10 + 1


def test_a_new_seed_is_printed_so_that_it_can_be_given_again(family):
    (line,) = (
        line
        for line in family.runpytest_inprocess("--draw-seed", "new").outlines
        if line.startswith("drawn sample: ")
    )
    assert len(ran(family, *line.removeprefix("drawn sample: ").split())) == 8 + 3 + 1


@pytest.mark.sample
def test_a_seed_that_is_no_number_is_refused(family):
    result = family.runpytest_inprocess("--draw-seed", "many")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines("*expected a whole number*'many'*")


def test_the_samples_of_a_fifth_of_the_files_are_drawn_and_some_run_always(family):
    family.makepyfile(**{f"test_samples_{number}": SAMPLES for number in range(SAMPLE_FILES)})
    for seed in ("7", "8", "9"):
        names = ran(family, "--draw-seed", seed)
        assert names.count("test_one") == names.count("test_other") == SAMPLE_FILES / 5
        assert names.count("test_in_every_run") == SAMPLE_FILES
        assert names.count("test_safety_rule_1_holds") == SAMPLE_FILES
    assert ran(family).count("test_one") == SAMPLE_FILES
