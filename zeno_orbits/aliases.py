"""Old public names, which keep working for one release with a `DeprecationWarning`."""

from __future__ import annotations

ALIASES = {
    "Bridge": ("HBridge", "model.rig_parts:Bridge"),
    "Escape": ("StateLimit", "model.quantities:Escape"),
    "FastestContraction": ("MinSpectralRadius", "search.objectives:FastestContraction"),
    "LeastEnergy": ("MinEnergy", "search.objectives:LeastEnergy"),
    "LeastPeak": ("MinPeak", "search.objectives:LeastPeak"),
    "Lines": ("Drawing", "model.drawing:Lines"),
    "OrbitShape": ("EventSequence", "orbits.shape:OrbitShape"),
    "Plan": ("ExecutionPlan", "work.plan:Plan"),
    "QUICK": ("WorkPrecisionSettings.quick()", "precision.trials:QUICK"),
    "Switching": ("PwmSettings", "model.rig_parts:Switching"),
    "WidestMargin": ("MaxMargin", "search.objectives:WidestMargin"),
    "certified": ("with_certificate", "verification.verifier:certified"),
    "close_orbit": ("find_orbit_by_shooting", "api.orbit_search:find_orbit_by_shooting"),
    "complete": ("hybrid_system", "model.graph:complete"),
    "cut": ("crop", "experiment.recordings.recording:cut"),
    "difference": ("execution_distance", "precision.landmark:difference"),
    "plot_zeno_region": ("plot_zeno_set", "report.plots:plot_zeno_region"),
    "plot_zeno_zoom": ("plot_zeno_neighbourhood", "report.plots:plot_zeno_zoom"),
    "positive": ("Quantity.positive", "model.quantities:positive"),
    "restitution": ("Quantity.restitution", "model.quantities:restitution"),
    "rig_cycles": ("simulate_experiment", "experiment.rig:rig_cycles"),
    "simulate_to": ("simulate_to_accuracy", "api.executions:simulate_to_accuracy"),
    "spread": ("parallel_map", "work.scheduling:spread"),
    "trade": ("work_precision", "precision.trials:trade"),
}
"""Old name to the new name, and to the module and name of the object in the package.

An old function whose arguments differ from those of the new function keeps its arguments.
"""
