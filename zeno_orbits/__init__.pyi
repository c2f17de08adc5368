__version__: str

from .api.models import ZenoCondition as ZenoCondition
from .api.orbit_search import find_orbit_by_shooting as find_orbit_by_shooting
from .api import compare as compare
from .api.machines import compare_laws as compare_laws
from .api import compare_transient as compare_transient
from .api import compile_problem as compile_problem
from .api import continue_orbit as continue_orbit
from .api import crop as crop
from .api import describe_recording as describe_recording
from .api import enclose_period as enclose_period
from .api.models import equilibrium_acceleration as equilibrium_acceleration
from .api import find_orbit as find_orbit
from .api import floquet_multipliers as floquet_multipliers
from .api import design_feedback as design_feedback
from .api.feedbacks import hold_inputs as hold_inputs
from .api import stabilize as stabilize
from .continuation import HeldFamilies as HeldFamilies
from .continuation import HeldPoint as HeldPoint
from .api import return_map as return_map
from .api.machines import identify as identify
from .api import largest_push as largest_push
from .api.studies import parameter_map as parameter_map
from .api.pictures import plot as plot
from .api import check_branch as check_branch
from .api import prove as prove
from .api import prove_branch as prove_branch
from .api import recovery as recovery
from .api import reduced_model_errors as reduced_model_errors
from .api.pages import report_page as report_page
from .api import rig_recording as rig_recording
from .api import scatter as scatter
from .api import sample_execution as sample_execution
from .api import search_gains as search_gains
from .api.executions import simulate as simulate
from .api import simulate_experiment as simulate_experiment
from .api import simulate_periods as simulate_periods
from .api import simulate_rig as simulate_rig
from .api import simulate_to_accuracy as simulate_to_accuracy
from .api import simulate_with_error as simulate_with_error
from .api import verify as verify
from .api import work_precision as work_precision
from .api import zeno_condition as zeno_condition
from .continuation.families import Continuation as Continuation
from .continuation.families import Family as Family
from .continuation.families import SpecialPointKind as SpecialPointKind
from .continuation.setup import ContinuationSettings as ContinuationSettings
from .errors import ChatterError as ChatterError
from .errors import EquationsWarning as EquationsWarning
from .errors import InputError as InputError
from .errors import OrbitFileError as OrbitFileError
from .errors import PenetrationError as PenetrationError
from .errors import RunawayError as RunawayError
from .errors import SimulationError as SimulationError
from .errors import SimultaneousEventsError as SimultaneousEventsError
from .errors import SlidingError as SlidingError
from .errors import SwitchingTimesError as SwitchingTimesError
from .errors import ZenoOrbitsError as ZenoOrbitsError
from .experiment.comparison.comparison import Comparison as Comparison
from .experiment.identification.identification import Identification as Identification
from .experiment.recordings.columns import ColumnNotes as ColumnNotes
from .experiment.recordings.recording import Recording as Recording
from .experiment.recordings.recording import read_recording as read_recording
from .experiment.recordings.records import read_record as read_record
from .experiment.recordings.recording import write_recording as write_recording
from .experiment.rig.run import RigRun as RigRun
from .experiment.rig.run import RigSettings as RigSettings
from .experiment.transients.impact_laws import LawComparison as LawComparison
from .experiment.transients.impact_laws import LawFit as LawFit
from .experiment.transients.transient_comparison import TransientComparison as TransientComparison
from .experiment.transients.transient_fit import TransientFit as TransientFit
from .maps.mapping import ParameterMap as ParameterMap
from .maps.pushes import Pushes as Pushes
from .maps.pushes import PushSettings as PushSettings
from .maps.recovery import Recovery as Recovery
from .maps.recovery import RecoverySettings as RecoverySettings
from .maps.scatter import Scatter as Scatter
from .maps.scatter import ScatterSettings as ScatterSettings
from .model.contact import impact_speed as impact_speed
from .model.drives.auxiliary import Auxiliary as Auxiliary
from .model.drives.friction import DryFriction as DryFriction
from .model.drives.holds import Hold as Hold
from .model.drives.circuits import Circuit as Circuit
from .model.drives.circuits import circuit_drive as circuit_drive
from .model.clock import Clock as Clock
from .model.clock import Time as Time
from .model.declared.drawing import Drawing as Drawing
from .model.drives.drives import corrected_drive as corrected_drive
from .model.drives.drives import full_drive as full_drive
from .model.drives.drives import ideal_torque_drive as ideal_torque_drive
from .model.drives.drives import no_drive as no_drive
from .model.drives.drives import quasi_static_drive as quasi_static_drive
from .model.hybrid import CompletedSystem as CompletedSystem
from .model.graph import hybrid_system as hybrid_system
from .model.lagrangian import HybridLagrangian as HybridLagrangian
from .model.library import bundled_problems as bundled_problems
from .model.library import load_problem as load_problem
from .model.drives.motors import MotorBank as MotorBank
from .model.problem import ParameterValues as ParameterValues
from .model.problem import Problem as Problem
from .model.declared.quantities import StateLimit as StateLimit
from .model.declared.quantities import Output as Output
from .model.declared.quantities import Quantity as Quantity
from .model.declared.rig_parts import HBridge as HBridge
from .model.declared.rig_parts import Contact as Contact
from .model.declared.rig_parts import Controller as Controller
from .model.declared.rig_parts import Friction as Friction
from .model.declared.rig_parts import Gear as Gear
from .model.declared.rig_parts import Rig as Rig
from .model.declared.rig_parts import Sensors as Sensors
from .model.declared.rig_parts import PwmSettings as PwmSettings
from .model.stops import Stop as Stop
from .model.stops import Switch as Switch
from .model.drives.records import Record as Record
from .model.drives.records import record as record
from .model.drives.waveforms import harmonics as harmonics
from .model.drives.waveforms import piecewise as piecewise
from .model.expressions.tables import table as table
from .orbits.bounds import Bound as Bound
from .orbits.orbit_file import read_orbit as read_orbit
from .orbits.orbit_file import write_orbit as write_orbit
from .orbits.orbit import Orbit as Orbit
from .orbits.orbit_file import orbit_from_json as orbit_from_json
from .orbits.shape import EventSequence as EventSequence
from .maps.corners import LoopCorner as LoopCorner
from .maps.feedback import Feedback as Feedback
from .maps.feedback import HeldMotion as HeldMotion
from .orbits.events.named_map import ReturnMap as ReturnMap
from .orbits.events.named_map import ReturnSlopes as ReturnSlopes
from .orbits.stability import Stability as Stability
from .precision.accuracy import ExecutionWithError as ExecutionWithError
from .precision.landmark import execution_distance as execution_distance
from .precision.trials import WorkPrecisionSettings as WorkPrecisionSettings
from .precision.work_precision import WorkPrecision as WorkPrecision
from .proof.branch_theorem import BranchProof as BranchProof
from .proof.checker.branch_verdict import BranchVerdict as BranchVerdict
from .proof.checker.certificate import check_proof as check_proof
from .proof.checker.verdict import ProofVerdict as ProofVerdict
from .proof.period_enclosure import EnclosedEvent as EnclosedEvent
from .proof.period_enclosure import PeriodEnclosure as PeriodEnclosure
from .proof.theorem import Proof as Proof
from .report.plots import plot_zeno_set as plot_zeno_set
from .report.plots import plot_zeno_neighbourhood as plot_zeno_neighbourhood
from .report.plots import save_figure as save_figure
from .search.objectives import MinSpectralRadius as MinSpectralRadius
from .search.objectives import MinEnergy as MinEnergy
from .search.objectives import MinPeak as MinPeak
from .report.exploration.explore import explore as explore
from .search.objectives import MaxPush as MaxPush
from .search.objectives import MinBounceTime as MinBounceTime
from .search.objectives import MinImpactLoss as MinImpactLoss
from .search.objectives import NearestGains as NearestGains
from .search.settings import SearchMethod as SearchMethod
from .search.objectives import TargetAmplitude as TargetAmplitude
from .search.objectives import TargetPeriod as TargetPeriod
from .search.objectives import MaxMargin as MaxMargin
from .search.outcome import OrbitNotFoundError as OrbitNotFoundError
from .search.outcome import SearchResult as SearchResult
from .search.settings import SearchSettings as SearchSettings
from .simulation.zeno.completion import Truncation as Truncation
from .simulation.execution import Execution as Execution
from .simulation.execution import SwitchEvent as SwitchEvent
from .simulation.simulator import SimulationSettings as SimulationSettings
from .verification.certificate import OrbitCertificate as OrbitCertificate
from .verification.verifier import VerificationSettings as VerificationSettings
from .verification.verifier import with_certificate as with_certificate
from .work import Cluster as Cluster
from .work import ExecutionPlan as ExecutionPlan
from .work import Workers as Workers
from .work import parallel_map as parallel_map

__all__ = [
    "Auxiliary",
    "Bound",
    "BranchProof",
    "BranchVerdict",
    "ChatterError",
    "Circuit",
    "Clock",
    "Cluster",
    "ColumnNotes",
    "Comparison",
    "CompletedSystem",
    "Contact",
    "Continuation",
    "ContinuationSettings",
    "Controller",
    "Drawing",
    "EnclosedEvent",
    "EquationsWarning",
    "EventSequence",
    "Execution",
    "ExecutionPlan",
    "ExecutionWithError",
    "Family",
    "Feedback",
    "Friction",
    "Gear",
    "HBridge",
    "HeldFamilies",
    "HeldMotion",
    "HeldPoint",
    "Hold",
    "HybridLagrangian",
    "Identification",
    "InputError",
    "LawComparison",
    "LawFit",
    "LoopCorner",
    "MaxMargin",
    "MaxPush",
    "MinBounceTime",
    "MinEnergy",
    "MinImpactLoss",
    "MinPeak",
    "MinSpectralRadius",
    "MotorBank",
    "NearestGains",
    "Orbit",
    "OrbitCertificate",
    "OrbitFileError",
    "OrbitNotFoundError",
    "Output",
    "ParameterMap",
    "ParameterValues",
    "PenetrationError",
    "PeriodEnclosure",
    "Problem",
    "Proof",
    "ProofVerdict",
    "PushSettings",
    "Pushes",
    "PwmSettings",
    "Quantity",
    "Record",
    "Recording",
    "Recovery",
    "RecoverySettings",
    "ReturnMap",
    "ReturnSlopes",
    "Rig",
    "RigRun",
    "RigSettings",
    "RunawayError",
    "Scatter",
    "ScatterSettings",
    "SearchMethod",
    "SearchResult",
    "SearchSettings",
    "Sensors",
    "SimulationError",
    "SimulationSettings",
    "SimultaneousEventsError",
    "SlidingError",
    "SpecialPointKind",
    "Stability",
    "StateLimit",
    "Stop",
    "Switch",
    "SwitchEvent",
    "SwitchingTimesError",
    "TargetAmplitude",
    "TargetPeriod",
    "Time",
    "TransientComparison",
    "TransientFit",
    "Truncation",
    "VerificationSettings",
    "WorkPrecision",
    "WorkPrecisionSettings",
    "Workers",
    "ZenoCondition",
    "ZenoOrbitsError",
    "__version__",
    "bundled_problems",
    "check_branch",
    "check_proof",
    "circuit_drive",
    "compare",
    "compare_laws",
    "compare_transient",
    "compile_problem",
    "continue_orbit",
    "corrected_drive",
    "crop",
    "describe_recording",
    "design_feedback",
    "enclose_period",
    "equilibrium_acceleration",
    "execution_distance",
    "explore",
    "find_orbit",
    "find_orbit_by_shooting",
    "floquet_multipliers",
    "full_drive",
    "harmonics",
    "hold_inputs",
    "hybrid_system",
    "ideal_torque_drive",
    "identify",
    "impact_speed",
    "largest_push",
    "load_problem",
    "no_drive",
    "orbit_from_json",
    "parallel_map",
    "parameter_map",
    "piecewise",
    "plot",
    "plot_zeno_neighbourhood",
    "plot_zeno_set",
    "prove",
    "prove_branch",
    "quasi_static_drive",
    "read_orbit",
    "read_record",
    "read_recording",
    "record",
    "recovery",
    "reduced_model_errors",
    "report_page",
    "return_map",
    "rig_recording",
    "sample_execution",
    "save_figure",
    "scatter",
    "search_gains",
    "simulate",
    "simulate_experiment",
    "simulate_periods",
    "simulate_rig",
    "simulate_to_accuracy",
    "simulate_with_error",
    "stabilize",
    "table",
    "verify",
    "with_certificate",
    "work_precision",
    "write_orbit",
    "write_recording",
    "zeno_condition",
]
