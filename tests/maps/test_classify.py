"""What motions settle to, against one-lane simulations, known orbits, and made-up returns."""

import math

import numpy as np
import pytest

from tests.reference.closed_forms import COCO, FORCED
from tests.reference.exact_flights import settled
from tests.reference.reference_orbit import PERIOD, PERIODS, RELEASE
from tests.support.hard_to_prove import cartesian_pendulum, pendulum
from tests.support.mechanisms import clocked_oscillator, oscillator
from tests.support.returns import multipliers_at
from zeno_orbits.errors import InputError, RunawayError
from zeno_orbits.maps import Accuracy, AttractorClass, attractors_at, usual_time
from zeno_orbits.model import load_problem, own_time
from zeno_orbits.simulation import SimulationSettings, simulate

TEN_TURNS = 20 * math.pi

PENDULUM = load_problem("motor_pendulum")
START = PENDULUM.state_vector(PENDULUM.starts[0])


def at(kp, kd, **parameters):
    return PENDULUM.values(gains={"Kp": kp, "Kd": kd}, parameters=parameters)


def dynamics_at(values):
    return PENDULUM.dynamics(values)


def state_of(attractor):
    return np.array([attractor.state[name] for name in PENDULUM.state_names])


def test_the_reference_values_settles_to_the_reference_orbit():
    (found,) = attractors_at(PENDULUM, [PENDULUM.values()])
    assert (found.fate, found.returns) == (AttractorClass.ZENO, 1)
    # 300 steps with a local error of 1e-8, most of which the layers damp.
    assert found.period == pytest.approx(PERIOD, abs=1e-8)
    assert state_of(found) == pytest.approx(RELEASE, abs=1e-7)
    # The derivative of the steps as computed; 4e-6 was seen, a tenth of it at a tenth of the error.
    assert found.spectral_radius == pytest.approx(0.0193686, abs=1e-5)


@pytest.mark.parametrize(("restitution", "inductance"), [(0.05, 0.1), (0.08, 0.1), (0.05, 1.0)])
def test_a_link_on_its_stop_does_not_rest_while_the_current_that_lifts_it_grows(
    restitution, inductance
):
    valve = load_problem("motor_valve")
    values = valve.values(parameters={"restitution": restitution, "L": inductance})
    (found,) = attractors_at(valve, [values])
    start = valve.state_vector(valve.starts[0])
    released = [one.time for one in simulate(valve.dynamics(values), start, until=20.0).releases]
    assert (found.fate, found.returns) == (AttractorClass.ZENO, 1)
    assert found.period == pytest.approx(released[-1] - released[-2], rel=1e-8)


def test_orbits_multipliers_and_margins_are_those_of_a_single_simulation():
    settings = [at(2.0, -0.9), at(4.2, -1.4), at(3.1, -0.42), at(3.0, -1.2, L1=0.22, R=2.5)]
    for values, found in zip(settings, attractors_at(PENDULUM, settings), strict=True):
        dynamics = dynamics_at(values)
        release = state_of(found)
        run = simulate(dynamics, release, until=3.0, releases=2)
        (back, *_) = run.returns(found.period)
        assert back.time == pytest.approx(found.period, abs=2e-8)
        assert back.state == pytest.approx(release, abs=2e-7)
        zeno = run.zeno_points[0]
        assert found.margins == pytest.approx(
            {
                "gap_acceleration": -dynamics.gap_acceleration(zeno.state),
                "first_impact_speed": -run.impacts[0].approach_rate,
                "release_transversality": -dynamics.multiplier_rate(back.state),
                "locked_time": back.time - zeno.time,
            },
            rel=1e-6,
        )
        known = multipliers_at(dynamics, release, found.period)
        assert found.multipliers[0] == pytest.approx(known[0], abs=1e-5)


@pytest.mark.parametrize("restitution", PERIODS)
def test_other_restitutions_have_their_periods_and_a_plastic_stop_a_simple_orbit(restitution):
    (found,) = attractors_at(PENDULUM, [at(2.5, -1.0, restitution=restitution)])
    assert found.fate is (AttractorClass.ZENO if restitution > 0.0 else AttractorClass.SIMPLE)
    assert found.period == pytest.approx(PERIODS[restitution], abs=2e-8)


def test_a_flipped_orbit_has_two_releases_a_period_as_a_long_simulation_has():
    values = at(4.37, -1.58)
    (found,) = attractors_at(PENDULUM, [values])
    assert (found.fate, found.returns) == (AttractorClass.ZENO, 2)
    run = simulate(dynamics_at(values), state_of(found), until=1.2 * found.period)
    first, second = run.returns(found.period)[:2]
    assert second.time == pytest.approx(found.period, abs=1e-7)
    assert second.state == pytest.approx(state_of(found), abs=1e-6)
    assert abs(first.state[0] - state_of(found)[0]) > 1e-3


@pytest.mark.parametrize(
    "numbers",
    [
        # Multipliers near -0.9, and near 0.9 times a third root of 1: after two returns, and after
        # three, the motion is nearer than after one.
        (0.0609, 0.0847, 0.0625, 0.0141, 30.41, 0.2685, 12.75, 0.184),
        (0.057118, 0.107194, 0.055668, 0.0114361, 30.6622, 0.389469, 10.18166, 0.118076),
    ],
)
def test_a_motion_that_circles_around_its_orbit_has_the_period_of_the_orbit(numbers):
    surface = load_problem("curved_surface")
    names = ("m", "rho", "c", "A", "omega", "lean", "g", "restitution")
    values = surface.values(parameters=dict(zip(names, numbers, strict=True)))
    (found,) = attractors_at(surface, [values])
    assert (found.fate, found.returns) == (AttractorClass.ZENO, 1)
    assert found.period == pytest.approx(2 * math.pi / numbers[4], rel=1e-8)


def test_an_escape_is_told_in_the_words_of_the_problem():
    (found,) = attractors_at(PENDULUM, [at(1.2, -1.95)])
    assert found.fate is AttractorClass.ESCAPE
    assert found.detail == PENDULUM.escapes[found.escaped].phrase


def test_what_runs_away_is_named_as_a_single_simulation_names_it():
    bounds = dict.fromkeys(("theta1", "theta2"), TEN_TURNS)
    for values in (at(1.2, -1.95), at(1.63, -2.0)):
        (found,) = attractors_at(PENDULUM, [values], bounds=bounds)
        assert found.fate is AttractorClass.ESCAPE
        with pytest.raises(RunawayError) as error:
            simulate(
                dynamics_at(values), START, until=60.0, settings=SimulationSettings(far=TEN_TURNS)
            )
        assert error.value.reason.split()[0] == found.escaped


def test_a_bound_of_the_users_is_kept():
    (found,) = attractors_at(PENDULUM, [PENDULUM.values()], bounds={"theta2": 0.01})
    assert (found.fate, found.escaped) == (AttractorClass.ESCAPE, "theta2")


def test_a_motion_that_dies_out_is_at_rest_long_before_it_stands_still():
    values = at(3.0, -0.02)
    (found,) = attractors_at(PENDULUM, [values])
    assert found.fate is AttractorClass.REST
    assert found.trend < 1.0
    first, *_, last = simulate(dynamics_at(values), START, until=60.0).releases
    assert abs(last.state[2]) < 0.3 * abs(first.state[2])


def test_a_ball_comes_to_rest():
    ball = load_problem("bouncing_ball")
    found = attractors_at(ball, [ball.values()], start={"height": 1.0}, until=30.0)
    assert [one.fate for one in found] == [AttractorClass.REST]


@pytest.mark.slow
def test_a_motion_near_orbits_that_repel_is_not_taken_for_one_of_them():
    (found,) = attractors_at(PENDULUM, [at(4.384615384615385, -1.5384615384615385)], until=40.0)
    assert found.fate is AttractorClass.UNSETTLED


@pytest.mark.slow
def test_a_motion_that_has_not_settled_tells_its_trend():
    never = Accuracy(near=0.0)
    (found,) = attractors_at(PENDULUM, [at(2.47, -0.21)], until=40.0, accuracy=never)
    assert found.fate is AttractorClass.UNSETTLED
    # It falls slowly to its orbit: by half a percent a return.
    assert 0.98 < found.trend < 1.0


@pytest.mark.slow
def test_the_answer_at_a_point_does_not_depend_on_the_other_points():
    grid = [at(kp, kd) for kp in (1.5, 3.0, 4.5) for kd in (-1.9, -1.2, -0.45, -0.2)]
    together = attractors_at(PENDULUM, grid)
    order = np.random.default_rng(5).permutation(len(grid))
    shuffled = attractors_at(PENDULUM, [grid[k] for k in order])
    alone = [attractors_at(PENDULUM, [grid[k]])[0] for k in (0, 5, 7)]
    for k, found in [*zip(order, shuffled, strict=True), *zip((0, 5, 7), alone, strict=True)]:
        assert repr(found) == repr(together[k])


def test_a_start_inside_the_stop_fails_by_name_and_others_do_not():
    (found,) = attractors_at(PENDULUM, [PENDULUM.values()], start={"theta2": -0.1})
    assert found.fate is AttractorClass.FAILED
    assert "gap is negative" in found.detail


def test_wrong_arguments_are_refused():
    values = PENDULUM.values()
    with pytest.raises(InputError, match="theta9"):
        attractors_at(PENDULUM, [values], bounds={"theta9": 1.0})
    with pytest.raises(InputError, match="bounds"):
        attractors_at(PENDULUM, [values], bounds={"theta1": 0.0})
    with pytest.raises(InputError, match="until"):
        attractors_at(PENDULUM, [values], until=math.nan)
    with pytest.raises(InputError, match="theta9"):
        attractors_at(PENDULUM, [values], start={"theta9": 1.0})
    assert attractors_at(PENDULUM, []) == ()


def test_progress_counts_the_points_up_to_all():
    parts: list[float | None] = []
    settings = [at(2.5, -1.0), at(1.2, -1.95)]
    attractors_at(PENDULUM, settings, on_progress=lambda _, part: parts.append(part))
    assert parts == sorted(set(parts))
    assert parts[-1] == 1.0


def test_oscillators_with_a_stop_have_their_orbits_in_closed_form():
    zeno = clocked_oscillator(FORCED, attracting=True)
    (found,) = attractors_at(zeno, [zeno.values()], until=200.0)
    assert found.fate is AttractorClass.ZENO
    assert found.period == pytest.approx(2 * math.pi, abs=1e-8)
    # It lets go where the forcing is that of the stop; y = cos t there.
    assert found.state["y"] == pytest.approx(FORCED.stop, abs=1e-7)
    # The clock forgets a displacement r of its circle by exp(-2 pi), its only multiplier.
    assert found.multipliers[0] == pytest.approx(math.exp(-2 * math.pi), rel=1e-4)
    struck = clocked_oscillator(COCO, attracting=True)
    (found,) = attractors_at(struck, [struck.values()], until=400.0)
    assert found.fate is AttractorClass.NO_ZENO
    # Its two multipliers as COCO prints them, and those of the clock: it forgets its amplitude.
    published = -0.58429531434153 + 0.00560035149247j
    assert sorted(abs(value - published) for value in found.multipliers)[0] < 1e-6
    clock = math.exp(-2 * math.pi)
    assert sorted(abs(value - clock) for value in found.multipliers)[0] < 1e-6
    # Just after its impact, by Recipes for Continuation, chapter 15.
    assert found.period == pytest.approx(2 * math.pi, abs=1e-7)
    assert found.state["dx"] == pytest.approx(-1.3565863500759056, abs=1e-6)
    assert found.state["dy"] == pytest.approx(-math.sin(0.07595216493831239), abs=1e-6)


def test_orbits_without_a_zeno_point_have_the_multipliers_of_their_closed_form():
    # The flow shrinks areas by exp(-c T), an impact by e squared; by COCO at A = 1.
    oscillator = load_problem("forced_oscillator")
    numbers = {"c": 0.1, "stop": 1.0, "restitution": 0.8}
    settings = [oscillator.values(parameters={**numbers, "A": a}) for a in (1.0, 0.5, 1.3)]
    start = {"speed": 1.0, "cosine": 1.0}
    found = attractors_at(oscillator, settings, start=start, until=400.0)
    assert [one.fate for one in found] == 3 * [AttractorClass.NO_ZENO]
    for one in found:
        assert one.period == pytest.approx(2 * math.pi, abs=1e-8)
        product = np.prod(one.multipliers)
        assert product == pytest.approx(0.64 * math.exp(-0.2 * math.pi), abs=1e-6)
    published = -0.58429531434153 + 0.00560035149247j
    assert found[0].multipliers[0] in (
        pytest.approx(published, abs=1e-6),
        pytest.approx(published.conjugate(), abs=1e-6),
    )
    assert found[0].state["speed"] == pytest.approx(1.3565863500759056, abs=1e-8)


@pytest.mark.slow
def test_an_orbit_is_not_that_of_a_motion_whose_errors_led_to_it():
    # Errors of 1e-6 lead this ball, after 140 turns, to an attracting orbit of ten turns. Exact
    # flights do not come near it in 3000 turns, in which no other start within 1e-6 does either.
    table = load_problem("vibrating_table")
    acceleration, restitution, omega = 1.85373900692, 0.52901548872, 30.0
    shaken = {"A": acceleration * 9.81 / omega**2, "restitution": restitution}
    turn = 2 * math.pi / omega
    coarse = Accuracy(motion=1e-6, orbit=1e-8)
    values = table.values(parameters=shaken)
    assert attractors_at(table, [values], until=240 * turn)[0].fate is AttractorClass.UNSETTLED
    (found,) = attractors_at(table, [values], until=240 * turn, accuracy=coarse)
    assert found.fate is AttractorClass.UNSETTLED
    assert found.detail == "its attractor depends on the smallest errors"
    truth = settled(acceleration, restitution, 600)
    assert truth.turns != 10
    # Where accuracy does not matter, no finer simulation is needed to be sure.
    alike = Accuracy(motion=1e-8)
    (once,) = attractors_at(PENDULUM, [PENDULUM.values()], accuracy=alike)
    assert once.fate is AttractorClass.ZENO


@pytest.mark.parametrize("name", ["vibrating_table", "two_tone_table", "forced_oscillator"])
def test_a_stop_that_will_let_go_as_the_clock_runs_on_is_no_rest(name):
    table = load_problem(name)
    (found,) = attractors_at(table, [table.values()])
    assert found.fate is AttractorClass.ZENO
    turn = 2 * math.pi / table.values().number("omega")
    # A local error of 1e-8 over a hundred steps.
    assert found.period == pytest.approx(turn, rel=1e-7)


def test_a_table_that_shakes_too_weakly_to_throw_is_at_rest():
    table = load_problem("vibrating_table")
    # Gravity exceeds what the table does to the ball: A omega^2 < g, just and clearly.
    least = 9.81 / 30.0**2
    settings = [table.values(parameters={"A": part * least}) for part in (0.3, 0.98, 1.02)]
    fates = [one.fate for one in attractors_at(table, settings)]
    assert fates == [AttractorClass.REST, AttractorClass.REST, AttractorClass.ZENO]


def test_sections_that_a_small_release_state_is_off_do_not_spoil_differences():
    bowl = load_problem("curved_surface")
    (found,) = attractors_at(bowl, [bowl.values()])
    assert (found.fate, found.returns) == (AttractorClass.ZENO, 1)
    assert found.period == pytest.approx(2 * math.pi / 30.0, rel=1e-8)
    # As `search` verifies it: |-0.5802935 +- 0.6813662 i|.
    assert found.spectral_radius == pytest.approx(abs(-0.5802935 + 0.6813662j), rel=1e-5)


def test_a_motion_that_never_leaves_its_stop_stays_on_it_and_neither_settles_nor_grows():
    bowl = load_problem("curved_surface")
    (found,) = attractors_at(bowl, [bowl.values(parameters={"A": 1e-3})], until=6.0)
    assert found.fate is AttractorClass.HELD
    assert math.isnan(found.trend)
    assert found.phrase == "permanent contact"


def test_a_linear_machine_settles_alike_however_hard_it_is_shaken():
    forced = load_problem("forced_oscillator")
    (found,) = attractors_at(forced, [forced.values(parameters={"A": 2000.0})])
    assert found.fate is AttractorClass.ZENO
    # It lets go where the forcing is that of the stop, A cos t = -0.8.
    assert found.state["cosine"] == pytest.approx(-0.8 / 2000.0, rel=1e-6)


def test_a_length_without_a_bound_runs_away_if_it_is_far_beyond_where_it_was():
    away = oscillator(stiffness=-1.0)
    (found,) = attractors_at(away, [away.values()], until=40.0)
    assert (found.fate, found.escaped) == (AttractorClass.ESCAPE, "x")
    # In units a million times as large it is the same motion.
    (found,) = attractors_at(away, [away.values()], until=40.0, start={"x": 1e6})
    assert (found.fate, found.escaped) == (AttractorClass.ESCAPE, "x")
    swinging = oscillator(damping=0.0)
    (found,) = attractors_at(swinging, [swinging.values()], until=40.0, start={"x": 9.0})
    never = "it strikes no stop, passes no switch"
    assert (found.fate, found.detail) == (AttractorClass.UNSETTLED, never)


@pytest.mark.parametrize(
    ("name", "metre", "second"),
    [
        ("vibrating_table", 1e6, 1.0),
        ("vibrating_table", 1e-6, 1.0),
        ("vibrating_table", 1.0, 1e3),
        ("vibrating_table", 1e2, 1e-3),
        pytest.param("curved_surface", 1e3, 1e3, marks=pytest.mark.slow),
        pytest.param("curved_surface", 1e-3, 1.0, marks=pytest.mark.slow),
    ],
)
def test_the_same_machine_in_other_units_settles_to_the_same_orbit(name, metre, second):
    shaken = load_problem(name)
    own = shaken.values().parameters
    scaled = {"A": metre, "omega": 1 / second, "g": metre / second**2}
    scaled |= {"rho": metre, "c": 1 / second} if name == "curved_surface" else {}
    numbers = {key: unit * own[key] for key, unit in scaled.items()}
    (found,) = attractors_at(shaken, [shaken.values(parameters=numbers)])
    assert (found.fate, found.returns) == (AttractorClass.ZENO, 1)
    # A local error of 1e-8, of which the clock keeps the hundredth part.
    assert found.period == pytest.approx(second * 2 * math.pi / own["omega"], rel=1e-9)


def test_bouncier_motions_are_given_longer_to_settle() -> None:
    problem = load_problem("motor_pendulum")
    start = problem.state_vector(problem.starts[0])

    def waited(e: float) -> float:
        return usual_time(problem, [problem.values(parameters={"restitution": e})], start)

    usual = 115 * own_time(problem.dynamics(problem.values()), np.array(start))
    # To one digit: ln 0.5 / ln 0.7 = 1.94, ln 0.5 / ln 0.9 = 6.58, and ten at most.
    for e, longer in ((0.0, 1.0), (0.2, 1.0), (0.5, 1.0), (0.7, 1.94), (0.9, 6.58), (0.999, 10.0)):
        assert waited(e) == float(f"{longer * usual:.0e}")


def test_a_constraint_adds_no_slow_oscillation_to_the_time_of_a_motion() -> None:
    # Along a constraint the eigenvalue zero is double, and rounding makes it an oscillation.
    angle, places = pendulum(), cartesian_pendulum()
    times = [
        usual_time(one, [one.values()], np.array(one.state_vector(one.starts[0])))
        for one in (angle, places)
    ]
    assert times[1] == pytest.approx(times[0], rel=0.5)


@pytest.mark.parametrize("until", [1e3, 1e9])
def test_a_longer_limit_finds_the_same_attractor(until: float) -> None:
    table = load_problem("vibrating_table")
    (found,) = attractors_at(table, [table.values()], until=until)
    assert found.fate is AttractorClass.ZENO
    assert found.period == pytest.approx(2 * np.pi / 30.0, rel=1e-6)


@pytest.mark.parametrize("omega", [1.0, 1e-7])
def test_the_period_of_a_clock_is_the_time_beside_any_faster_decay(omega: float) -> None:
    # The damping decays within 1e-8 s, and the spring along it within 1e8 s.
    values = {"c": 1e8, "omega": omega}
    for one in (load_problem("forced_oscillator"), cartesian_pendulum()):
        dynamics = one.dynamics(one.values(parameters=values))
        found = own_time(dynamics, np.array(one.state_vector(one.starts[0])))
        assert found == pytest.approx(2 * np.pi / omega, rel=1e-6)
