"""Old public names, which keep working for one release with a `DeprecationWarning`."""

from __future__ import annotations

ALIASES = {
    "Bridge": ("HBridge", "model.rig_parts:HBridge"),
    "Escape": ("StateLimit", "model.quantities:StateLimit"),
    "EventComparison": ("Comparison", "experiment.comparison.comparison:Comparison"),
    "FastestContraction": ("MinSpectralRadius", "search.objectives:MinSpectralRadius"),
    "LeastEnergy": ("MinEnergy", "search.objectives:MinEnergy"),
    "LeastPeak": ("MinPeak", "search.objectives:MinPeak"),
    "Lines": ("Drawing", "model.drawing:Drawing"),
    "OrbitShape": ("EventSequence", "orbits.shape:EventSequence"),
    "Plan": ("ExecutionPlan", "work.plan:ExecutionPlan"),
    "QUICK": ("WorkPrecisionSettings.quick()", "precision.trials:QUICK"),
    "Switching": ("PwmSettings", "model.rig_parts:PwmSettings"),
    "WidestMargin": ("MaxMargin", "search.objectives:MaxMargin"),
    "certified": ("with_certificate", "verification.verifier:with_certificate"),
    "close_orbit": ("find_orbit_by_shooting", "api.orbit_search:find_orbit_by_shooting"),
    "complete": ("hybrid_system", "model.graph:hybrid_system"),
    "cut": ("crop", "experiment.recordings.recording:crop_recording"),
    "difference": ("execution_distance", "precision.landmark:execution_distance"),
    "plot_zeno_region": ("plot_zeno_set", "report.plots:plot_zeno_set"),
    "plot_zeno_zoom": ("plot_zeno_neighbourhood", "report.plots:plot_zeno_neighbourhood"),
    "positive": ("Quantity.positive", "model.quantities:positive"),
    "restitution": ("Quantity.restitution", "model.quantities:restitution"),
    "rig_cycles": ("simulate_experiment", "experiment.rig:settle_rig"),
    "simulate_to": ("simulate_to_accuracy", "api.executions:simulate_to_accuracy"),
    "spread": ("parallel_map", "work.scheduling:parallel_map"),
    "trade": ("work_precision", "precision.trials:measure_work_precision"),
}
"""Old name to the new name, and to the module and name of the object in the package.

An old function whose arguments differ from those of the new function keeps its arguments.
"""
