"""The public names: all present, fast to import, with the recorded signatures; plug-ins by name."""

import inspect
import json
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

import companion
import ground_station
import sim_bridge
from companion.core.base.errors import LeewayError
from companion.core.base.plugin import PLANNERS, load_plugin
from companion.core.wind.checked_filter import checked_filter_factory
from ground_station.adapters.files.params import read_airframe as read_airframe_of_a_day
from sim_bridge.app.flight.wind_plugin import checked_wind

ROOT = Path(__file__).parents[2]
SIGNATURES = ROOT / "tests" / "reference" / "api.json"
PACKAGES = (companion, ground_station, sim_bridge)
SQUARE = {
    "format": "delivery-scenario/1", "name": "square",
    "vertices_m": [[0, 0, 0], [300, 0, 0], [0, 300, 0]],
    "edges": [[0, 1], [1, 0], [0, 2], [2, 0], [1, 2], [2, 1]],
    "depot": 0, "target": 1, "budget_wh": 100.0, "airspeed_mps": 15.0,
    "power_w": {"loaded": 2000.0, "empty": 1100.0},
    "wind": {"kind": "chain", "states_en_mps": [[4, 0], [0, 4]],
             "rate_per_s": [[-0.01, 0.01], [0.01, -0.01]], "initial": [0.5, 0.5]},
}  # fmt: skip
PLUGINS = """
import numpy as np
from companion import WindBelief

class Direct:
    def __init__(self, task): self.task = task
    def start_batch(self, numbers): return self
    def select_edges(self, seen): return self.task.graph.out_edges_by_vertex[seen.vertex, 0]

class Teleports(Direct):
    def select_edges(self, seen): return np.full(seen.mission_count, 3)

class Floats(Direct):
    def select_edges(self, seen): return super().select_edges(seen) * 1.0

class Short(Direct):
    def select_edges(self, seen): return super().select_edges(seen)[1:]

class TooHigh(Direct):
    def select_edges(self, seen): return np.full(seen.mission_count, 99)

class Raises(Direct):
    def select_edges(self, seen): raise RuntimeError("two\\nlines")

class Wind:
    def __init__(self, mean=(3.0, 4.0), cov=((1.0, 0.0), (0.0, 1.0))):
        self.mean, self.cov = mean, cov
    def __call__(self, airframe): return self
    def update(self, seen): return ()
    def belief(self, t_s):
        return WindBelief(t_s, np.array(self.mean), np.array(self.cov), ("tilt",), True)
    def to_ne_mps(self, t_s): return self.mean

GOOD = Wind()
NAN = Wind((float("nan"), 0.0))
LONG = Wind((1.0, 2.0, 3.0))
HUGE = Wind((300.0, 0.0))
NEGATIVE = Wind((0.0, 0.0), ((-1.0, 0.0), (0.0, 1.0)))
SKEWED = Wind((0.0, 0.0), ((1.0, 0.5), (0.0, 1.0)))
"""


@pytest.fixture
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installed package of two planners, one of them broken, and modules of plug-ins."""
    (tmp_path / "stranger.py").write_text(PLUGINS)
    info = tmp_path / "stranger_plans-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger-plans\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(
        "[leeway.planners]\ndirect = stranger:Direct\nbroken = stranger:Missing\n"
        "[leeway.airframes]\nlight = stranger:__file__\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "stranger", raising=False)
    return tmp_path


def signature_of(value: object) -> object:
    """Return parameters with annotations and defaults; of a class those of its public methods."""
    if isinstance(value, int):
        return value
    if not inspect.isclass(value):
        return str(inspect.signature(value))  # type: ignore[arg-type]
    members = {
        name: str(inspect.signature(member))
        for name, member in vars(value).items()
        if inspect.isfunction(member) and (name == "__init__" or not name.startswith("_"))
    }
    return members | {"fields": list(getattr(value, "__annotations__", {}))}


def signatures() -> dict[str, object]:
    return {
        f"{package.__name__}.{name}": signature_of(getattr(package, name))
        for package in PACKAGES
        for name in package.__all__
    }


def test_signatures_are_those_of_the_record():
    """`python -m tests.house.test_public_interface` records an intended change."""
    assert signatures() == json.loads(SIGNATURES.read_text()), "changelog: Changed (API)"


def test_names_are_listed_and_in_the_reference():
    page = (ROOT / "docs" / "reference" / "api.md").read_text()
    for package in PACKAGES:
        assert set(package.__all__) <= set(dir(package))
        for name in package.__all__:
            assert f"::: {package.__name__}.{name}\n" in page
    with pytest.raises(AttributeError, match="'companion' has no attribute 'fly'"):
        _ = companion.fly  # type: ignore[attr-defined]


def test_an_import_loads_neither_numpy_nor_the_programs():
    code = "import companion, ground_station, sim_bridge, sys; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    loaded = set(done.stdout.split())
    assert not loaded & {"numpy", "typing", "companion.app.api", "sim_bridge.research.api"}


def test_more_wind_and_less_energy_lower_the_probability_of_returning():
    def p_home(left_wh: float, wind_mps: float) -> float:
        return companion.can_return("m100", (0.0, -900.0, 40.0), left_wh, (0.0, -wind_mps)).p_home

    assert p_home(40.0, 0.0) > 0.99 > p_home(23.0, 6.0) > p_home(23.0, 10.0) > p_home(12.0, 10.0)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"here_neu_m": (0.0, 0.0)}, "here_neu_m = .*: expected 3 numbers"),
        ({"wind_to_ne_mps": (np.nan, 0.0)}, "wind_to_ne_mps = .*: expected 2 numbers"),
        ({"energy_left_wh": np.inf}, "energy_left_wh"),
        ({"here_neu_m": (0.0, 0.0, -3.0)}, "expected above home"),
        ({"wind_std_mps": 0.0}, "wind_std_mps"),
        ({"max_loss": -0.1}, "max_loss"),
        ({"airframe": "no_such"}, "airframe 'no_such': expected .*m100"),
    ],
)
def test_invalid_arguments_are_refused_by_name(changed, message):
    good = {
        "airframe": "m100", "here_neu_m": (0.0, -900.0, 40.0), "energy_left_wh": 30.0,
        "wind_to_ne_mps": (0.0, 0.0),
    }  # fmt: skip
    with pytest.raises(LeewayError, match=message):
        companion.can_return(**(good | changed))


def test_a_planner_of_another_package_flies_in_the_same_winds(stranger):
    planners = {"again": "direct", "ber": None, "mine": "stranger:Direct"}
    again, ber, mine = sim_bridge.campaign(SQUARE, planners, missions=200)
    assert (again.planner, ber.planner, mine.planner) == tuple(planners)
    assert again.SUC == mine.SUC == 200
    assert ber.energy_wh_mean <= mine.energy_wh_mean + 1e-9
    assert load_plugin(PLANNERS, "direct").version == "stranger-plans 1.2"
    twice = sim_bridge.campaign([SQUARE, SQUARE], {"b": "rer", "a": "rer"}, missions=50)
    assert [row.planner for row in twice] == ["b", "a", "b", "a"]
    with pytest.raises(LeewayError, match="'rer': both a class and a name"):
        sim_bridge.campaign(SQUARE, {"a": "rer", "rer": lambda task: None}, missions=50)


@pytest.mark.parametrize(
    ("planner", "message"),
    [
        ("stranger:Teleports", "mission 0: edge 3 at vertex 0: expected an edge from 0 to 1"),
        ("stranger:TooHigh", "edge 99 at vertex 0"),
        ("stranger:Floats", "returned float64 of shape .*: expected 200 integers"),
        ("stranger:Short", r"shape \(199,\)"),
        ("stranger:Raises", r"raised RuntimeError: two lines \(.*stranger.py:23\)$"),
        ("broken", r"planner broken \(stranger-plans 1.2\): not loaded: AttributeError"),
        ("gone", "planner 'gone': expected ser, .*broken, direct or MODULE:NAME"),
        ("no_such_module:X", "no_such_module:X: not loaded: ModuleNotFoundError"),
        ("stranger:", "expected MODULE:NAME"),
    ],
)
def test_an_invalid_planner_is_refused_in_one_line(stranger, planner, message):
    with pytest.raises(LeewayError, match=message) as error:
        sim_bridge.campaign(SQUARE, {"x": planner}, missions=200)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["NAN", "LONG", "HUGE", "NEGATIVE", "SKEWED"])
def test_an_invalid_estimate_or_wind_is_refused(stranger, name):
    made = checked_filter_factory(f"stranger:{name}")(companion.read_airframe("m100"))
    with pytest.raises(LeewayError, match=rf"wind estimator stranger:{name} .*belief at 5.00 s"):
        made.belief(5.0)
    if name in ("NAN", "LONG", "HUGE"):
        with pytest.raises(LeewayError, match=rf"wind stranger:{name} .*to_ne_mps\(5.00\)"):
            checked_wind(f"stranger:{name}").to_ne_mps(5.0)


def test_valid_ones_pass_unchanged(stranger):
    made = checked_filter_factory("stranger:GOOD")(companion.read_airframe("m100"))
    assert made.belief(5.0).mean_to_ne_mps.tolist() == [3.0, 4.0]
    assert checked_wind("stranger:GOOD").to_ne_mps(0.0) == (3.0, 4.0)


def test_an_airframe_of_another_package_is_a_file(stranger):
    with pytest.raises(LeewayError, match=r"stranger\.py"):  # no TOML file
        companion.read_airframe("light")
    own = stranger / "heavy.toml"
    own.write_bytes((ROOT / "params" / "airframes" / "m100.toml").read_bytes())
    (stranger / "frames.py").write_text(f"HEAVY = {str(own)!r}\n")
    found = companion.read_airframe("frames:HEAVY")
    assert msgspec.to_builtins(found) == msgspec.to_builtins(companion.read_airframe("m100"))
    with pytest.raises(LeewayError, match="no flight with an anemometer"):
        sim_bridge.score_wind(stranger, airframe="frames:HEAVY")
    with pytest.raises(LeewayError, match=r"frames:HEAVY: no such airframe; names: .*light, m100"):
        read_airframe_of_a_day("frames:HEAVY", stranger)


def test_an_estimator_that_fails_in_flight_ends_the_command_with_its_reason(stranger, monkeypatch):
    monkeypatch.chdir(stranger)
    with pytest.raises(
        LeewayError, match=r"^wind estimator stranger:NAN .*belief at .*nan"
    ) as error:
        sim_bridge.fly(estimator="stranger:NAN")
    assert "\n" not in str(error.value)


def test_a_companion_imports_no_plug_in(stranger):
    code = "from companion.app.cli.main import main; main()"
    words = ["run", "--link", "udpin:127.0.0.1:0", "--mission", "default", "--airframe", "light"]
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-c", code, *words],
        capture_output=True, text=True, check=False, cwd=stranger,
        env={"PYTHONPATH": f"{ROOT}:{stranger}", "PATH": ""},
    )  # fmt: skip
    assert done.returncode == 2
    assert "light.toml: no such airframe" in done.stderr
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "companion.app.cli.flying" in imported
    assert not imported & {"stranger", "companion.core.base.plugin"}


if __name__ == "__main__":
    SIGNATURES.write_text(json.dumps(signatures(), indent=1, sort_keys=True) + "\n")
