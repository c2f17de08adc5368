/* The completed execution of a problem with a stop: types and functions of the library.

   A problem is a set of tapes, instructions on registers, one tape a formula. A run is one block of
   memory without pointers: it can be copied, kept and resumed. The functions have no state of their
   own, so runs can go on in several threads at once. */

#ifndef ZENO_LOOP_H
#define ZENO_LOOP_H

enum { ZL_MOST = 32, ZL_LANES = 8, ZL_STAGES = 7, ZL_LOOKS = 4, ZL_GUARDS = 16, ZL_STOPS = 8, ZL_ORDERS = 64
};
/* Most entries of a state, those of a rescaled flight included; tapes carried out in step; stages
   of an implicit step; looks at the pace of a run that are kept; guards beside that of a stop, and
   switches; stops; pairs of switching times. */

typedef struct {
    int op, to, a, b, c;
} zl_instruction;

/* A formula. Its registers are: what varies, parameters, constants, results. */
typedef struct {
    long long n_varying, n_parameters, n_constants, n_registers;
    long long n_once;  /* instructions that depend on parameters alone; they come first */
    long long n_first; /* those that the first output needs besides; they come next */
    long long n_instructions, n_outputs;
    const zl_instruction *code;
    const double *constants;
    const int *outputs;
    const double *const *tables; /* of look-ups: `lookup.c` */
} zl_tape;

/* Modes: off the stop, on it, and a flight in rescaled time. The flight is the free mode between
   two impacts. */
enum { ZL_FREE, ZL_LOCKED, ZL_FLIGHT, ZL_MODES };

enum {
    ZL_RATE = 0,     /* of a mode: dy/dt */
    ZL_GUARD = 3,    /* of a mode: the guard and its rate */
    ZL_JACOBIAN = 6, /* of a mode: d(dy/dt)/dy by columns */
    ZL_WATCHED = 9,  /* of a mode: guard, its rate and second derivative, of which bounds over a box
                        of states are taken; without outputs if samples are enough */
    ZL_GAP = 12,     /* gap, gap rate */
    ZL_LIFT,         /* gap acceleration */
    ZL_PULL,         /* rate of the multiplier */
    ZL_INERTIA,      /* 1 / (J W J') */
    ZL_REBOUND,      /* gap rate after an impact, of the one before it */
    ZL_RESTING,      /* state on the stop, its gap acceleration, its locked flow */
    ZL_LANDING,      /* state after an impact, its gap rate, then as ZL_RESTING of it */
    ZL_LONGEST,      /* of a mode: the largest step that passes no pulse of a table unseen; without
                        outputs if there is no bound */
    ZL_TAPES = ZL_LONGEST + ZL_MODES
};

/* Radau IIA: nodes and matrices by rows, then eigenvalues, columns and rows of the eigenvectors of
   the inverse, real and imaginary parts, one real eigenvalue and one of each pair. */
typedef struct {
    double nodes[ZL_STAGES], inverse[ZL_STAGES * ZL_STAGES], monomials[ZL_STAGES * ZL_STAGES];
    double gamma, embedded[ZL_STAGES];
    double values[2 * 4], columns[2 * 4 * ZL_STAGES], rows[2 * 4 * ZL_STAGES];
} zl_scheme;

typedef struct zl_graph zl_graph;
typedef struct zl_problem zl_problem;

/* Write what a formula of a view gives, nothing for one without outputs; 0 if it is not there. */
typedef int zl_formula(const zl_problem *problem, int tape, const double *registers,
                       const double *varying, double *outputs);

/* Formulas that are compiled: of a state; the rate of a mode for rows of lanes. */
typedef struct {
    zl_formula *one, *lanes;
} zl_code;

struct zl_problem {
    long long n_x, n_q, n_p;
    long long carried[ZL_MODES]; /* the guard of a mode is a state, beside its formula */
    zl_tape tapes[ZL_TAPES];
    const zl_scheme *scheme;
    const zl_graph *graph; /* the views of a run, one of which it may be itself */
    long long formulas;    /* of a view: the number by which code of its formulas knows it */
    const zl_code *code;   /* its formulas, none where they are in the library or interpreted */
};

/* The guard of a switch on one side of it, positive there, along the flow of a mode. */
typedef struct {
    long long place;         /* of its numbers in those of a run */
    zl_tape value, bounds;   /* the guard and its rate; as ZL_WATCHED */
} zl_side;

/* A machine. A mode is the set of closed stops and the side of every kink, as bits. A view is an open
   stop in a mode, where others may be closed. Declared switches come before kinks. A table may be
   incomplete: a run then asks for what it needs. */
struct zl_graph {
    long long n_stops, n_declared, n_switches, n_views, n_sides;
    long long n_frictional;                   /* the last declared switches: those of dry friction */
    long long n_numbers;                      /* of a run, apart from its settings and parameters */
    long long switches_place, delassus_place, orders_place;
    long long first_clock, end_clock;         /* the states of the clock */
    /* Of a state, the sizes of its entries and the sides of kinks: formulas, their sizes, `armed`. With
       dry friction also of the closed stops, and where declared switches occur without a zero. */
    zl_tape switches;
    zl_tape delassus; /* J W J' of all stops */
    zl_tape orders;   /* of switching times: lower, upper, and least upper times */
    const zl_tape *resets;                    /* the state after each declared switch */
    const long long *reset_places;
    const long long *causes;                  /* ZL_CAUSE of each declared switch, -1: its guard */
    const long long *view_keys, *view_places; /* ZL_VIEW_KEY; places of numbers */
    const zl_problem *views;
    const long long *side_keys;               /* ZL_SIDE_KEY */
    const zl_side *sides;
};

/* The event of a stop that causes a switch, whose guard then never falls. */
#define ZL_CAUSE(kind, stop) ((long long)(kind) << 5 | (stop))

#define ZL_MODE_KEY(closed, branches) ((branches) << ZL_STOPS | (closed))
#define ZL_VIEW_KEY(mode, stop) ((mode) << 5 | (stop))
#define ZL_SIDE_KEY(mode, a_switch, positive) ((mode) << 5 | (a_switch) << 1 | (positive))

/* How a sequence of impacts is completed. */
enum { ZL_EXTRAPOLATION, ZL_PASSAGE, ZL_TRUNCATION, ZL_FIXED_IMPACTS, ZL_PLASTIC_AFTER };

typedef struct {
    double until, relative, absolute, contact, restitution;
    double time, gap, gap_rate, gap_acceleration, multiplier; /* sizes of the problem's numbers */
    double largest_explicit, largest_implicit;
    double limit_tolerance, resolved, delta, n_fixed;
    double most_releases, most_landings;
    double sizes[ZL_MOST], weights[ZL_MOST], flight_weights[ZL_MOST], reach[ZL_MOST];
    long long begins_explicit, goes_implicit, completion, most_steps, most_impacts, records;
    long long past; /* 1 + the switch that has just occurred at the start, 0: none, -1: any */
    long long varies; /* whether the restitution depends on the speed of an impact */
} zl_settings;

/* Records that a call writes: the caller's memory, and how much of it was used. */
typedef struct {
    double *steps, *polynomials, *arcs, *events;
    long long most_steps, most_polynomials, most_arcs, most_events;
    long long n_steps, n_polynomials, n_arcs, n_events;
    double *estimates; /* of the impacts of one sequence; kept from call to call */
    long long most_estimates;
} zl_records;

/* Events at one time at most: a switch, and an impact, a Zeno point and two releases of each stop. A
   declared switch that an event causes is one more. */
#define ZL_AT_ONCE(n_stops, n_declared) (1 + 4 * (n_stops) + (n_declared))

enum { ZL_STEP_WIDTH = 2, ZL_ARC_WIDTH = 14, ZL_EVENT_WIDTH = 6, ZL_ESTIMATE_WIDTH = 4 };
/* Entries of a record before its states: after a step; at start and end of an arc; before and after
   an event; on the stop and at the limit of an estimate. */

enum { ZL_IMPACT, ZL_ZENO, ZL_RELEASE, ZL_HORIZON, ZL_SWITCH };
/* Kinds of events, and ends of arcs. */

enum {
    ZL_DONE,          /* the execution has ended */
    ZL_FULL,          /* a record is full */
    ZL_ESTIMATES,     /* the estimates need more memory */
    ZL_CURVE,         /* the curve of the impacts is worth a try: answer with zl_answer */
    ZL_TOO_STIFF,     /* the step size fell to rounding level */
    ZL_SINGULAR,      /* the same of implicit steps */
    ZL_NOT_FINITE,    /* a flow is not finite at its start */
    ZL_LEFT,          /* the state leaves the admissible set */
    ZL_MANY_STEPS,    /* a limit of the settings */
    ZL_MANY_IMPACTS,  /* the same */
    ZL_BEYOND,        /* a coordinate is beyond its bound */
    ZL_GROWS,         /* a velocity grows without end */
    ZL_NOT_CLOSING,   /* an impact does not close the gap */
    ZL_INTO_STOP,     /* the reset sends the state into the stop */
    ZL_TOO_LARGE,     /* more states than ZL_MOST */
    ZL_MODE,          /* a view or side is missing; `about` has what */
    ZL_INSIDE,        /* the first state is inside of the stop `index`; its gap is `number` */
    ZL_SLIDES,        /* the flows on both sides of the switch `index` point to it */
    ZL_COINCIDE,      /* two events at once: kind and index of both are in `about` */
    ZL_SPLITS,        /* impacts accumulate on a stop, and a switch changes every flight: `about` */
    ZL_TOGETHER,      /* the same, and events of the switch come in between */
    ZL_IN_TURN,       /* impacts accumulate on stops in turn: the last one and the others: `about` */
    ZL_ACCUMULATE,    /* events of the switch `index` accumulate */
    ZL_UNDEFINED,     /* the guard of the switch `index` is not a number */
    ZL_UNDETERMINED,  /* no set, or several sets of the stops in `about` fulfil the laws of contact */
    ZL_BY_SWITCH,     /* the reset of a switch sends the state into a stop: `about` */
    ZL_ARMED,         /* the switch `index` is armed at the start */
    ZL_UNORDERED,     /* switching times of a piecewise input do not increase */
    ZL_BEYOND_LAW,    /* the restitution leaves [0, 1] at the speed of an impact: rates before, after */
    ZL_MANY_SWITCHES  /* a limit of the settings; the last one is the switch `index` */
};

/* What a status is about. A singular flow names a kink nearby, or -1, as `index`. */
typedef struct {
    double time, state[ZL_MOST], number, steps;
    long long n_state, index, about[4];
} zl_detail;

/* Where the next arc starts. Without a speed it is no rescaled flight. The scaled gap and its rate are
   `height` and `launch`: 0 and 1 on the stop. */
typedef struct {
    long long mode, has_speed, has_impact;
    double time, speed, height, launch, lift;
    double state[ZL_MOST], plus[ZL_MOST], resting[ZL_MOST], rate[ZL_MOST];
} zl_start;

typedef struct {
    double steps, time, speed;
} zl_look;

/* What an arc changes of a run while it is followed. The window is the time in which the next event
   is looked for first, and `fastest` the largest velocity since the last look at the pace. */
typedef struct {
    double window, fastest;
    zl_look looks[ZL_LOOKS];
    long long in_sequence, first_impact, n_estimates, n_steps, next_look, n_looks, which;
} zl_pace;

/* What a run looks at: bits but for the stop `focus`. */
typedef struct {
    long long rest, focus, sides, above, splits;
} zl_outlook;

typedef struct zl_run zl_run;

#if defined(_WIN32)
#define ZL_EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define ZL_EXPORT __attribute__((visibility("default")))
#else
#define ZL_EXPORT
#endif

ZL_EXPORT long long zl_size(const zl_problem *problem);
ZL_EXPORT int zl_begin(const zl_problem *problem, zl_run *run, const zl_settings *settings,
                       const double *p, const double *x);
ZL_EXPORT int zl_resume(const zl_problem *problem, zl_run *run, zl_records *records);
ZL_EXPORT void zl_answer(zl_run *run, int found, double time, double error, const double *state);
ZL_EXPORT void zl_tell(const zl_run *run, zl_detail *detail);
ZL_EXPORT double zl_now(const zl_problem *problem, const zl_run *run, int *mode, double *state);
/* States after explicit steps, each from a state of its own, row by row. */
ZL_EXPORT void zl_states_at(const zl_problem *problem, zl_run *run, int mode, double speed,
                            const double *before, const double *offsets, long long count,
                            double *states);
ZL_EXPORT int zl_flight(const zl_problem *problem, zl_run *run, const double *state, double speed,
                        double relative, double absolute, double *landing);
ZL_EXPORT void zl_evaluate(const zl_problem *problem, zl_run *run, int tape, const double *varying,
                           double *outputs);
ZL_EXPORT int zl_begin_leg(const zl_problem *problem, zl_run *run, const zl_settings *settings,
                           const double *p, const double *y, int on_guard, double rounding,
                           double late);
ZL_EXPORT int zl_resume_leg(const zl_problem *problem, zl_run *run, zl_records *records);
ZL_EXPORT int zl_fault(const double *v);
ZL_EXPORT long long zl_room(const zl_problem *problem);
ZL_EXPORT void zl_outlook_of(const zl_run *run, zl_outlook *outlook);
ZL_EXPORT void zl_copy(const zl_problem *problem, const zl_run *from, zl_run *to);

#endif
