"""Solution of a program with named rows by Ipopt. Source: [WachterBiegler2006]_."""

from __future__ import annotations

import contextlib
import io
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Array
from zeno_orbits.search.transcription.program import NonlinearProgram
from zeno_orbits.work import Checked


class SolveStatus(Enum):
    """Result of a solve. The value is the sentence shown to the user."""

    SOLVED = "the solver converged"
    ACCEPTABLE = "the solver converged to a looser tolerance only"
    INFEASIBLE = "the solver converged to a point where the conditions cannot all be met"
    ITERATION_LIMIT = "the solver reached its iteration limit"
    TIME_LIMIT = "the solver reached its time limit"
    RESTORATION_FAILED = "the solver could not come back to the conditions"
    DIVERGING = "the iterates of the solver diverge"
    NOT_FINITE = "the solver met a number that is not finite"
    TOO_FEW_FREEDOMS = "the conditions outnumber the unknowns"
    STEP_TOO_SMALL = "the steps of the solver became too small"
    STOPPED = "the solver stopped for another reason"

    @classmethod
    def from_ipopt(cls, return_status: str) -> SolveStatus:
        """Convert Ipopt's return status. No other code depends on Ipopt's words."""
        return _IPOPT_STATUS.get(return_status, cls.STOPPED)


_IPOPT_STATUS = {
    "Solve_Succeeded": SolveStatus.SOLVED,
    "Feasible_Point_Found": SolveStatus.SOLVED,
    "Solved_To_Acceptable_Level": SolveStatus.ACCEPTABLE,
    "Infeasible_Problem_Detected": SolveStatus.INFEASIBLE,
    "Maximum_Iterations_Exceeded": SolveStatus.ITERATION_LIMIT,
    "Maximum_CpuTime_Exceeded": SolveStatus.TIME_LIMIT,
    "Maximum_WallTime_Exceeded": SolveStatus.TIME_LIMIT,
    "Restoration_Failed": SolveStatus.RESTORATION_FAILED,
    "Diverging_Iterates": SolveStatus.DIVERGING,
    "Invalid_Number_Detected": SolveStatus.NOT_FINITE,
    "Not_Enough_Degrees_Of_Freedom": SolveStatus.TOO_FEW_FREEDOMS,
    "Search_Direction_Becomes_Too_Small": SolveStatus.STEP_TOO_SMALL,
}


class Hessian(Enum):
    """Second derivatives of the Lagrangian: exact, or approximated from gradients."""

    EXACT = "exact"
    LIMITED_MEMORY = "limited-memory"


@dataclass(frozen=True, slots=True, kw_only=True)
class IpoptSettings(Checked):
    """Tolerances and limits of Ipopt.

    Attributes:
        tolerance: Largest scaled violation of a row.
        optimality: Largest scaled dual infeasibility. An orbit is accurate long before its gains
            are optimal.
        most_iterations: Largest number of iterations.
        most_seconds: Largest wall time [s].
        first_barrier: First barrier parameter, small as the guess comes from a simulation.
        hessian: Exact or approximated second derivatives.
    """

    tolerance: float = 1e-11
    optimality: float = 1e-6
    most_iterations: int = 150
    most_seconds: float = 60.0
    first_barrier: float = 1e-5
    hessian: Hessian = Hessian.EXACT

    def as_casadi(self) -> dict[str, Any]:
        """Return the options of ``nlpsol``."""
        return {
            "print_time": False,
            "error_on_fail": False,
            # The gradient of the Lagrangian serves only multipliers, which are not used.
            "calc_lam_p": False,
            "no_nlp_grad": True,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "tol": self.optimality,
                "constr_viol_tol": self.tolerance,
                "acceptable_tol": 10 * self.optimality,
                "acceptable_constr_viol_tol": 10 * self.tolerance,
                "max_iter": self.most_iterations,
                "max_wall_time": self.most_seconds,
                "mu_init": self.first_barrier,
                "bound_push": 1e-6,
                "bound_frac": 1e-6,
                "slack_bound_push": 1e-8,
                "slack_bound_frac": 1e-8,
                "nlp_scaling_method": "none",
                "hessian_approximation": self.hessian.value,
            },
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """Result of a solve, successful or not. Residuals are recomputed from the rows.

    Attributes:
        status: Status of the solve.
        values: Name of a block or report to its values, in its own units and shape.
        residuals: Name of a row to its scaled violation. For rows of the same name, the largest.
        objective: Value of the objective.
        iterations: Number of iterations.
        wall_time: Time in the solver, without the construction of the program [s].
    """

    status: SolveStatus
    values: Mapping[str, Array]
    residuals: Mapping[str, float]
    objective: float
    iterations: int
    wall_time: float

    def worst(self, n: int = 3) -> list[tuple[str, float]]:
        """Return the names and sizes of the largest violations."""
        return sorted(self.residuals.items(), key=lambda item: -item[1])[:n]


def quiet_interrupts() -> contextlib.AbstractContextManager[object]:
    """Suppress CasADi's line about an interrupt on the terminal, in the main thread only."""
    if threading.current_thread() is threading.main_thread():
        return contextlib.redirect_stderr(io.StringIO())
    return contextlib.nullcontext()


def row_rounding(program: NonlinearProgram) -> Array:
    r"""Return the rounding error of each row at the guess, ``(m,)``, a lower limit of its residual.

    .. math:: \epsilon \sum_j |J_{ij} x_j|

    A row with a decay of rate :math:`\rho` over an interval :math:`h` has terms of size
    :math:`h \rho`, and the residual of an iterate cannot be smaller than their rounding error. With
    a smaller tolerance, Ipopt would reach its iteration limit at a solution.
    """
    at = ca.Function("jacobian", [program.unknowns], [program.jacobian])(program.guess)
    terms = ca.mtimes(ca.fabs(at), ca.fabs(ca.DM(program.guess)))
    sizes = np.array(terms.full()).ravel()
    # A row whose terms overflow cannot be satisfied, and must keep its weight.
    finite = np.where(np.isfinite(sizes), sizes, 0.0)
    return _ROUNDINGS * float(np.finfo(np.float64).eps) * finite


_ROUNDINGS = 4.0
"""Number of rounding errors of its terms that a row accumulates."""


def solve(program: NonlinearProgram, settings: IpoptSettings | None = None) -> Solution:
    """Solve a program with Ipopt, from its guess.

    Raises:
        KeyboardInterrupt: If the user interrupts. Ipopt alone would suppress the interrupt.
    """
    settings = settings or IpoptSettings()
    nothing = ca.MX.sym("nothing", 0)
    weights = 1.0 / np.maximum(1.0, row_rounding(program) / settings.tolerance)
    weighted = [weights * program.rows, ca.mtimes(ca.diag(ca.DM(weights)), program.jacobian)]
    rows = ca.Function("rows", [program.unknowns, nothing], weighted)
    options = settings.as_casadi() | {"jac_g": rows}
    nlp = {"x": program.unknowns, "f": program.objective, "g": weighted[0]}
    solver = ca.nlpsol("orbit", "ipopt", nlp, options)
    started = time.perf_counter()
    with quiet_interrupts():
        answer = solver(
            x0=program.guess,
            lbx=program.lower,
            ubx=program.upper,
            lbg=weights * program.row_lower,
            ubg=weights * program.row_upper,
        )
    wall_time = time.perf_counter() - started
    stats = solver.stats()
    return_status = str(stats["return_status"])
    if return_status in ("NonIpopt_Exception_Thrown", "User_Requested_Stop"):
        raise KeyboardInterrupt
    scaled = np.array(answer["x"].full()).ravel()
    met = np.array(answer["g"].full()).ravel() / weights
    violation = np.maximum(program.row_lower - met, met - program.row_upper)
    # A NaN counts as a violation.
    violation[np.isnan(violation)] = np.inf
    residuals: dict[str, float] = {}
    for name, value in zip(program.row_names, violation, strict=True):
        residuals[name] = max(residuals.get(name, 0.0), float(value))
    values: dict[str, Array] = {}
    for name, (start, shape) in program.names.items():
        block = (scaled * program.scales)[start : start + shape[0] * shape[1]]
        values[name] = block.reshape(shape, order="F")
    report = ca.Function("report", [program.unknowns], list(program.reports.values()))
    for name, value in zip(program.reports, report.call([answer["x"]]), strict=True):
        values[name] = np.array(value.full())
    return Solution(
        status=SolveStatus.from_ipopt(return_status),
        values=values,
        residuals=residuals,
        objective=float(answer["f"]),
        iterations=int(stats.get("iter_count", 0)),
        wall_time=wall_time,
    )
