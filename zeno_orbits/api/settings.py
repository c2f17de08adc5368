"""Settings for an accuracy and an integrator, as the options of the command line name them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zeno_orbits.integrators import ENGINES, engine_named

if TYPE_CHECKING:
    from zeno_orbits.search import SearchMethod
    from zeno_orbits.simulation import SimulationSettings
    from zeno_orbits.verification import VerificationSettings

TOLERANCE = 1e-9
"""Largest relative residual of an orbit that passes its verification by default."""

ENGINE_NAMES = tuple(ENGINES)
"""Names of the integrators, the default first."""


METHODS = ("auto", "program", "shooting")
"""Names of the methods of a search, the default first."""


def search_method(name: str) -> SearchMethod:
    """Return the method of a search.

    Args:
        name: One of ``METHODS``.
    """
    from zeno_orbits.search import SearchMethod

    return SearchMethod(name)


def simulation_settings(engine: str | None = None) -> SimulationSettings:
    """Return the settings of a simulation with an integrator.

    Args:
        engine: Name of the integrator. The default chooses automatically.

    Raises:
        InputError: If the integrator is unknown or not installed.
    """
    from zeno_orbits.simulation import SimulationSettings

    if engine is None:
        return SimulationSettings()
    return SimulationSettings(engine=engine_named(engine))


def verification_settings(
    *,
    accuracy: float | None = None,
    tolerance: float | None = None,
    engine: str | None = None,
    n_periods: int | None = None,
    use_reference: bool = False,
) -> VerificationSettings:
    """Return the settings of a verification.

    Args:
        accuracy: Largest relative error of the orbit. The integration follows it.
        tolerance: Largest relative residual that passes. The default is the accuracy, or 1e-9.
        engine: Name of the integrator. The default chooses automatically.
        n_periods: Number of periods to integrate. The default is the value in
            `VerificationSettings`.
        use_reference: True integrates the hand-written model of the problem.

    Raises:
        InputError: If the accuracy is out of range, or the integrator is unknown.
    """
    from dataclasses import replace

    from zeno_orbits.orbits import LOOSER
    from zeno_orbits.precision import FINEST, settings_for
    from zeno_orbits.verification import VerificationSettings

    simulation = simulation_settings(engine)
    passing = tolerance
    if accuracy is not None:
        settings_for(accuracy)
        # The looser of the two integrations also has to reach the accuracy.
        simulation = settings_for(max(accuracy / LOOSER, FINEST), simulation)
        passing = accuracy if tolerance is None else tolerance
    found = VerificationSettings(
        tolerance=TOLERANCE if passing is None else passing,
        simulation=simulation,
        use_reference=use_reference,
    )
    return found if n_periods is None else replace(found, n_periods=n_periods)
