"""The search for method and step, on methods whose errors are known formulas."""

from types import SimpleNamespace

import numpy as np
import pytest

from particlerb.integrators import METHODS
from particlerb.simulation import step_ladder as ladder
from particlerb.simulation.accuracy import cheapest
from particlerb.simulation.step_ladder import MIN_NS, Ladder

T_END = 10.0
COSTS = {"second": 1.0, "sixth": 11.0}  # ns per body-step
ORDERS = {"second": 2, "sixth": 6}


class FakePilot:
    """A pilot whose runs end where a formula says, at 0 without error."""

    def __init__(self, wanted, laws, bodies=1000, seen=32):
        self.wanted, self.laws, self.spent, self.steps, self.looks = wanted, laws, 0.0, [], []
        self.rate, self.lengths, self.calm = 1.0, [T_END], 1.0
        self.has_changing_forces = False
        self.sampled, self.group = np.arange(seen), SimpleNamespace(members=np.arange(bodies))
        self.system = SimpleNamespace(run=SimpleNamespace(t_end=T_END, dt=None))

    def longest(self, turn):
        return min(turn, T_END)

    def poses(self, stepping, times):
        steps = np.ceil(T_END / stepping.dt)
        self.steps.append(stepping)
        self.looks.append(times.size)
        self.spent += self.cost(stepping, steps, self.sampled.size)
        return self.laws[stepping.method](stepping.dt), float(steps)

    def errors(self, times, found, expected, rows=None):
        return np.full((1, 1), abs(found - expected))

    def cost(self, stepping, steps, n):
        return steps * n * COSTS[stepping.method]


@pytest.fixture(autouse=True)
def methods(monkeypatch):
    for name, order in ORDERS.items():
        method = SimpleNamespace(order=order, is_adaptive=False)
        monkeypatch.setitem(METHODS, name, method)
        monkeypatch.setitem(ladder.RATIO, name, 2.0)
        monkeypatch.setitem(ladder.FIRST_TURNS, name, (1.0, 1.0))


def choice(pilot, *names):
    """What is chosen among the methods of these names."""
    return cheapest(pilot, [Ladder(pilot, name) for name in names or ORDERS])


def law(constant, order, next_order=0.0):
    """Error of a method with two terms."""
    return lambda h: constant * h**order + next_order * h ** (order + 2)


@pytest.mark.parametrize("wanted", [1e-2, 1e-4, 1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize("constant", [1e-6, 1e-3, 1.0])
def test_the_error_of_each_method_lies_just_below_what_is_wanted(wanted, constant):
    for name, order in ORDERS.items():
        found = choice(FakePilot(wanted, {name: law(constant, order, 0.3 * constant)}), name)
        error = law(constant, order, 0.3 * constant)(found.stepping.dt)
        is_longest = found.stepping.dt == T_END
        assert error <= wanted
        assert error > wanted / 10 or is_longest


@pytest.mark.parametrize("name", ORDERS)
def test_an_estimate_is_right_once_the_order_is_seen(name):
    """The finest run errs too: less than the others by the order, which three runs show."""
    order = ORDERS[name]
    found = choice(FakePilot(1e-6, {name: law(1e-3, order)}), name)
    assert law(1e-3, order)(found.stepping.dt) == pytest.approx(1e-6 * 1.25**-order, rel=0.01)


@pytest.mark.parametrize("wanted", [1e-2, 1e-3, 1e-5, 1e-7])
def test_the_cheaper_of_two_methods_is_chosen(wanted):
    laws = {"second": law(1e-3, 2), "sixth": law(1e-3, 6)}
    found = choice(FakePilot(wanted, laws))
    exact = {
        name: COSTS[name] * 1000 * T_END / min((wanted / 1e-3) ** (1 / ORDERS[name]), T_END)
        for name in ORDERS
    }
    assert found.cost < 1.5 * min(exact.values())


def test_a_method_that_is_not_of_its_order_is_not_believed():
    """It says six and has two: the step that six would promise is far too long."""
    found = choice(FakePilot(1e-6, {"sixth": law(1e-2, 2)}), "sixth")
    assert law(1e-2, 2)(found.stepping.dt) < 1e-6


def test_errors_that_do_not_fall_below_noise_are_told():
    random = np.random.default_rng(1)
    noisy = {name: lambda h: h**2 + 1e-5 * random.uniform(0.5, 1.0) for name in ORDERS}
    found = choice(FakePilot(1e-9, noisy))
    assert 1e-9 < found.error < 1e-4
    assert found.until == 0.0


def test_noise_that_grows_with_the_number_of_steps_ends_the_search():
    """As of roundings in a chaotic scene: a much finer run lies farther off than two coarser."""
    wanders = {"sixth": lambda h: h**6 + 6e-7 / h * np.cos(51.3 * np.log(h))}
    pilot = FakePilot(1.6e-11, wanders)
    found = choice(pilot, "sixth")
    assert 1e-6 < found.error < 1e-3
    assert pilot.spent < 5e6


def test_where_one_method_is_lost_in_noise_no_far_dearer_one_is_tried():
    """`second` would need 1e6 steps for what rounding keeps `sixth` from."""
    laws = {"second": law(1e-3, 2), "sixth": lambda h: h**6 + 6e-7 * np.cos(51.3 * np.log(h))}
    pilot = FakePilot(1e-13, laws)
    found = choice(pilot)
    assert found.error > 1e-9
    assert min(one.dt for one in pilot.steps if one.method == "second") > 1e-4


def test_a_method_is_not_left_for_one_that_is_hardly_cheaper(monkeypatch):
    """Each costs trials: of two that cost about the same the first one is tried to the end."""
    monkeypatch.setattr(Ladder, "usual_cost", lambda ladder: float(ladder.name != "sixth"))
    pilot = FakePilot(1e-4, {"second": law(1e-3, 2), "sixth": law(1e-3, 6)})
    ladders = [Ladder(pilot, name) for name in ORDERS]
    for ladder_of in ladders:
        ladder_of.cost = 1.6e5
    assert cheapest(pilot, ladders).stepping.method == "sixth"


@pytest.mark.parametrize("wanted", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("bodies", [1, 32, 1000, 100_000])
def test_the_search_takes_no_longer_than_the_run(wanted, bodies):
    """By the table of costs; MIN_NS is what any search may take."""
    laws = {"second": law(1e-3, 2), "sixth": law(1e-6, 6)}
    found = choice(FakePilot(wanted, laws, bodies, min(bodies, 32)))
    assert found.spent <= max(found.cost, MIN_NS)


def test_the_first_run_is_not_coarser_than_the_times_that_are_looked_at(monkeypatch):
    """Longer steps would be cut at these times, and cost as much."""
    monkeypatch.setitem(ladder.FIRST_TURNS, "second", (6.0, 6.0))
    pilot = FakePilot(1e-3, {"second": law(1e-3, 2)})
    choice(pilot, "second")
    assert pilot.steps[0].dt == T_END / ladder.N_TIMES


@pytest.mark.parametrize("wanted", [1e-3, 1e-6, 1e-9, 1e-12])
def test_short_runs_begin_near_the_step_that_is_needed(wanted):
    """Where Python around a run takes longer than its steps three runs do."""
    pilot = FakePilot(wanted, {"sixth": law(1e-3, 6)})
    choice(pilot, "sixth")
    assert len(pilot.steps) == 3


def test_a_long_run_of_few_bodies_is_not_made_again_and_again(monkeypatch):
    """Where a finer run would be dearer than the run, the order must do."""
    monkeypatch.setattr(ladder, "MIN_NS", 0.0)
    monkeypatch.setattr(ladder, "SET_UP", 0.0)
    found = choice(FakePilot(1e-9, {"sixth": law(1e-3, 6)}, 1, 1), "sixth")
    assert law(1e-3, 6)(found.stepping.dt) < 1e-9
    assert found.spent < 2.0 * found.cost


def test_where_a_finer_run_is_too_dear_a_coarser_one_shows_the_order(monkeypatch):
    """Of one body a run with finer steps takes longer than what is searched for."""
    monkeypatch.setitem(COSTS, "second", 1e5)
    pilot = FakePilot(1e-7, {"second": law(1e-3, 2)}, 1, 1)
    found = choice(pilot, "second")
    first, second, *others = (one.dt for one in pilot.steps)
    assert second < first < max(others)
    assert 1e-8 < law(1e-3, 2)(found.stepping.dt) < 1e-7
    assert found.spent < found.cost


def test_where_errors_follow_no_order_steps_shrink_faster(monkeypatch):
    """Runs with errors above 0.1: six, where each half as long a step in turn would take nine."""
    monkeypatch.setitem(COSTS, "second", 1e5)
    pilot = FakePilot(1e-3, {"second": law(1e4, 2)}, 1, 1)
    found = choice(pilot, "second")
    assert 1e-4 < law(1e4, 2)(found.stepping.dt) < 1e-3
    assert sum(law(1e4, 2)(one.dt) > 0.1 for one in pilot.steps) <= 6


def test_how_long_an_accuracy_holds_is_looked_at_once():
    """For the choice alone, and not for the best of each method."""
    random = np.random.default_rng(1)
    noisy = {name: lambda h: h**2 + 1e-5 * random.uniform(0.5, 1.0) for name in ORDERS}
    pilot = FakePilot(1e-9, noisy)
    choice(pilot)
    assert {one.method for one in pilot.steps} == set(ORDERS)
    assert pilot.looks.count(ladder.MORE_TIMES) == 2


@pytest.mark.parametrize(("bodies", "tried"), [(1, {"second"}), (1_000_000, {"second", "sixth"})])
def test_another_method_is_tried_where_it_gains_more_than_trials_take(monkeypatch, bodies, tried):
    """`second` is the usual choice, and `sixth` costs a tenth: that counts for many bodies."""
    costs = {"second": 40.0, "sixth": 11.0}
    pilot = FakePilot(1e-4, {"second": law(1e-3, 2), "sixth": law(1e-9, 6)}, bodies, 1)
    pilot.cost = lambda stepping, steps, n: steps * n * costs[stepping.method]
    ladders = [Ladder(pilot, name) for name in ORDERS]
    monkeypatch.setattr(Ladder, "usual_cost", lambda ladder: float(ladder.name != "second"))
    cheapest(pilot, ladders)
    assert {stepping.method for stepping in pilot.steps} == tried
