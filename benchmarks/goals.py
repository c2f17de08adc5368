"""Time searches with several goals at once, the spectral radius among them, in processor time.

One start each. The second question has no answer: on no line of fixed `Kp` are the gains of small
current those of fast contraction, so what is timed is how long the search takes to say so.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from dataclasses import dataclass

from zeno_orbits.model.library import load_problem
from zeno_orbits.orbits.bounds import Bound
from zeno_orbits.search import SearchSettings, search_gains
from zeno_orbits.search.objectives import FastestContraction, LeastEnergy, NearestGains, Objective


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """A search.

    Attributes:
        problem: Name of the problem.
        free: The gains that are free, in the problem's own ranges.
        objective: What is asked.
        bounds: What must be kept.
        answered: Whether there is an orbit.
    """

    problem: str
    free: tuple[str, ...]
    objective: Objective
    bounds: tuple[Bound, ...]
    answered: bool


def kept_below(radius: float, current: float) -> tuple[Bound, Bound]:
    """Return bounds on the spectral radius and on the current [A]."""
    return (
        Bound(name="spectral_radius", upper=radius),
        Bound(name="current", lower=-current, upper=current),
    )


QUESTIONS = {
    "energy, radius <= 0.25, current <= 2 A": Question(
        problem="motor_pendulum",
        free=("Kp", "Kd"),
        objective=LeastEnergy(),
        bounds=kept_below(0.25, 2.0),
        answered=True,
    ),
    "energy, radius <= 0.2, current <= 2 A": Question(
        problem="motor_pendulum",
        free=("Kp", "Kd"),
        objective=LeastEnergy(),
        bounds=kept_below(0.2, 2.0),
        answered=False,
    ),
    "fastest contraction": Question(
        problem="motor_pendulum",
        free=("Kp", "Kd"),
        objective=FastestContraction(),
        bounds=(),
        answered=True,
    ),
    "two motors, radius <= 0.1": Question(
        problem="two_motors",
        free=("Kd",),
        objective=NearestGains(target={}),
        bounds=(Bound(name="spectral_radius", upper=0.1),),
        answered=True,
    ),
}


def asked(question: Question) -> tuple[float, str]:
    """Return the processor time of a search [s] and how it ended."""
    problem = load_problem(question.problem)
    ranges = {gain.name: (gain.lower, gain.upper) for gain in problem.gains}
    started = time.process_time()
    result = search_gains(
        problem,
        problem.values(),
        free={name: ranges[name] for name in question.free},
        objective=question.objective,
        bounds=question.bounds,
        settings=SearchSettings(n_starts=0),
    )
    took = time.process_time() - started
    if (result.orbit is not None) is not question.answered:
        return took, f"WRONG: {result.status.value} {result.detail}"
    if result.orbit is None:
        return took, result.detail
    return took, ", ".join(f"{name} = {result.orbit.gains[name]:.6g}" for name in question.free)


def main() -> int:
    """Ask all questions; 1 if one is answered that has no answer, or the other way round."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=3, metavar="N", help="runs of each search")
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    options = parser.parse_args()
    if options.runs < 1:
        parser.error(f"--runs must be at least 1, but it is {options.runs}")
    rows = []
    for name, question in QUESTIONS.items():
        answers = [asked(question) for _ in range(options.runs)]
        median = statistics.median(took for took, _ in answers)
        rows.append({"question": name, "median": median, "answer": answers[-1][1]})
    if options.json:
        print(json.dumps(rows, indent=2))
    else:
        for row in rows:
            print(f"{row['question']:40}{row['median']:6.1f} s  {row['answer']}")
    return int(any(str(row["answer"]).startswith("WRONG") for row in rows))


if __name__ == "__main__":
    sys.exit(main())
