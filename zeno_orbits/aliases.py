"""Former names: aliases, which warn for one release, and the successors of removed names."""

from __future__ import annotations

from collections.abc import Mapping

ALIASES: Mapping[str, tuple[str, str]] = {
    "EventOrbit": ("Orbit", "orbits.orbit:Orbit"),
    "EventSearchResult": ("SearchResult", "search.outcome:SearchResult"),
    "ZenoOrbit": ("Orbit", "orbits.orbit:Orbit"),
    "find_event_orbit": ("find_orbit", "api.former:find_event_orbit"),
    "read_event_orbit": ("read_orbit", "orbits.orbit_file:read_orbit"),
    "search_event_gains": ("search_gains", "api.former:search_event_gains"),
    "write_event_orbit": ("write_orbit", "orbits.orbit_file:write_orbit"),
}
"""Former public name to the new name, and to the module and name of the object in the package."""

FORMER: Mapping[str, tuple[str, ...]] = {
    # Names of the package.
    "Bridge": ("HBridge",),
    "Escape": ("StateLimit",),
    "EventComparison": ("Comparison",),
    "FastestContraction": ("MinSpectralRadius",),
    "LeastEnergy": ("MinEnergy",),
    "LeastPeak": ("MinPeak",),
    "Lines": ("Drawing",),
    "OrbitShape": ("EventSequence",),
    "Plan": ("ExecutionPlan",),
    "QUICK": ("WorkPrecisionSettings.quick()",),
    "Switching": ("PwmSettings",),
    "WidestMargin": ("MaxMargin",),
    "certified": ("with_certificate",),
    "close_orbit": ("find_orbit_by_shooting",),
    "complete": ("hybrid_system",),
    "cut": ("crop",),
    "difference": ("execution_distance",),
    "plot_zeno_region": ("plot_zeno_set",),
    "plot_zeno_zoom": ("plot_zeno_neighbourhood",),
    "positive": ("Quantity.positive",),
    "restitution": ("Quantity.restitution",),
    "rig_cycles": ("simulate_experiment",),
    "simulate_to": ("simulate_to_accuracy",),
    "spread": ("parallel_map",),
    "trade": ("work_precision", "work-precision"),
    # Arguments of functions.
    "box": ("parameter",),
    "free": ("vary",),
    "over": ("interval",),
    "second": ("parameter2",),
    # Commands and options. The command decides among several successors.
    "conditions": ("zeno-condition",),
    "fidelity": ("reduced-models",),
    "--bound": ("--bounds",),
    "--data": ("--recording", "--output"),
    "--direction": ("--directions",),
    "--exact": ("--exact-pwm",),
    "--fix": ("--set",),
    "--free": ("--vary",),
    "--from": ("--near", "--t-start"),
    "--gain": ("--vary", "--set"),
    "--gains": ("--set",),
    "--in": ("--parameter",),
    "--initial": ("--start",),
    "--keep": ("--bounds",),
    "--max-time": ("--until",),
    "--most-steps": ("--max-steps",),
    "--output": ("--plot",),
    "--over": ("--interval",),
    "--picture": ("--plot",),
    "--point": ("--kind",),
    "--points": ("--grid",),
    "--second": ("--parameter2",),
    "--starts": ("--n-starts",),
    "--steps": ("--max-points",),
    "--t-end": ("--until",),
    "--to": ("--t-end",),
    "-o": ("--plot",),
    # Integrators.
    "taylor": ("automatic",),
}
"""Removed name to its successors. Messages about unknown names suggest the first known one."""
