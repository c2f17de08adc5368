"""Settings and statuses of Ipopt. Source: [WachterBiegler2006]_."""

from __future__ import annotations

import contextlib
import io
import threading
from dataclasses import dataclass
from enum import Enum
from typing import Any

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
    """

    tolerance: float = 1e-11
    optimality: float = 1e-6
    most_iterations: int = 150
    most_seconds: float = 60.0
    first_barrier: float = 1e-5

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
            },
        }


def quiet_interrupts() -> contextlib.AbstractContextManager[object]:
    """Suppress CasADi's line about an interrupt on the terminal, in the main thread only."""
    if threading.current_thread() is threading.main_thread():
        return contextlib.redirect_stderr(io.StringIO())
    return contextlib.nullcontext()
